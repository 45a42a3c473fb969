"""Trajectory errors against closed forms and against evo."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from maslam.backend.errors import BackendError
from maslam.backend.geometry import Sim3, se3, se3_exp, se3_inverse, so3_exp
from maslam.backend.trajectory_error import (
    connected_error,
    path_length,
    relative_error,
    step_error,
    trajectory_error,
)


@given(st.integers(0, 2**31), st.floats(0.1, 10.0))
def test_an_aligned_copy_has_no_error(seed, scale):
    rng = np.random.default_rng(seed)
    truth = rng.normal(size=(20, 3))
    T = Sim3(so3_exp(rng.normal(size=3)), rng.normal(size=3), scale)
    estimate = T.inverse() @ truth
    error = trajectory_error(estimate, truth, with_scale=True)
    assert error.rmse_m < 1e-9 and error.max_m < 1e-9
    np.testing.assert_allclose(error.T_truth_estimate.matrix(), T.matrix(), atol=1e-7)
    assert (trajectory_error(estimate, truth, with_scale=False).rmse_m < 1e-9) == (abs(scale - 1.0) < 1e-9)


def test_rmse_and_mean_of_a_known_error():
    truth = np.array([[1.0, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0]])
    # Moving all points outwards by 10 % and 30 % is no rigid motion: the errors are exactly the radii's difference.
    estimate = truth * np.array([[1.1], [1.1], [1.3], [1.3]])
    error = trajectory_error(estimate, truth, with_scale=False)
    np.testing.assert_allclose(error.errors_m, [0.1, 0.1, 0.3, 0.3], atol=1e-12)
    assert error.rmse_m == pytest.approx(np.sqrt(0.05)) and error.mean_m == pytest.approx(0.2)
    assert error.max_m == pytest.approx(0.3)


def test_connected_error_shares_one_alignment():
    rng = np.random.default_rng(0)
    truths = {k: rng.normal(size=(30, 3)) * 10 for k in (0, 1)}
    T = se3_exp([1.0, 2, 3, 0.1, 0.2, 0.3])
    estimates = {k: (truths[k] - T[:3, 3]) @ T[:3, :3] for k in truths}
    assert all(e.rmse_m < 1e-9 for e in connected_error(estimates, truths, False).values())
    # One agent shifted against the other: alone each is perfect, together they cannot be.
    estimates[1] = estimates[1] + [4.0, 0, 0]
    joint = connected_error(estimates, truths, False)
    assert all(trajectory_error(estimates[k], truths[k], False).rmse_m < 1e-9 for k in truths)
    assert all(e.rmse_m > 1.0 for e in joint.values())
    assert joint[0].T_truth_estimate is joint[1].T_truth_estimate
    assert connected_error({}, {}, False) == {}


def test_relative_error_of_a_constant_drift():
    n = 101
    truth = se3(np.eye(3), np.stack([np.zeros(n), np.zeros(n), np.arange(n)], axis=1))
    estimate = truth.copy()
    estimate[:, 2, 3] *= 1.02
    error = relative_error(estimate, truth, 10.0)
    assert error.translation_percent == pytest.approx(2.0) and error.rotation_deg_per_m == pytest.approx(0.0, abs=1e-9)
    assert error.count == 91
    # 0.1 degrees a metre about the camera's own axis.
    turning = se3(so3_exp(np.radians(0.1) * np.arange(n)[:, None] * [0, 0, 1.0]), truth[:, :3, 3])
    assert relative_error(turning, truth, 20.0).rotation_deg_per_m == pytest.approx(0.1)
    short = relative_error(estimate, truth, 1000.0)
    assert short.count == 0 and np.isnan(short.translation_percent)
    assert path_length(truth[:, :3, 3]) == pytest.approx(100.0)


@pytest.mark.parametrize("with_scale", [False, True])
def test_ate_agrees_with_evo(with_scale):
    evo_metrics = pytest.importorskip("evo.core.metrics", reason="evo is an optional extra")
    from evo.core.trajectory import PosePath3D

    rng = np.random.default_rng(3)
    truth = se3_exp(np.cumsum(rng.normal(scale=0.1, size=(60, 6)), axis=0))
    estimate = truth @ se3_exp(rng.normal(scale=0.02, size=(60, 6)))
    estimate[:, :3, 3] = estimate[:, :3, 3] * 1.7 + 2.0
    reference, path = PosePath3D(poses_se3=list(truth)), PosePath3D(poses_se3=list(estimate))
    path.align(reference, correct_scale=with_scale)
    ape = evo_metrics.APE(evo_metrics.PoseRelation.translation_part)
    ape.process_data((reference, path))
    ours = trajectory_error(estimate[:, :3, 3], truth[:, :3, 3], with_scale)
    assert ours.rmse_m == pytest.approx(ape.get_statistic(evo_metrics.StatisticsType.rmse), rel=1e-9)
    assert ours.mean_m == pytest.approx(ape.get_statistic(evo_metrics.StatisticsType.mean), rel=1e-9)


def test_what_cannot_be_compared_is_said():
    with pytest.raises(BackendError, match="same length"):
        trajectory_error(np.zeros((3, 3)), np.zeros((4, 3)), False)
    with pytest.raises(BackendError, match="empty"):
        trajectory_error(np.zeros((0, 3)), np.zeros((0, 3)), False)
    with pytest.raises(BackendError, match="NaN"):
        trajectory_error(np.full((2, 3), np.nan), np.zeros((2, 3)), False)


def _winding(n: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """A winding way of steps between 0.5 and 1.5 m, and an estimate that drifts off."""
    rng = np.random.default_rng(seed)
    turns = 0.05 * np.sin(np.arange(n) / 9.0)[:, None] * [0.1, 1.0, 0.0]
    ahead = np.stack([np.zeros(n), np.zeros(n), rng.uniform(0.5, 1.5, n)], axis=1)
    steps = se3(so3_exp(turns), ahead)
    wrong = steps @ se3_exp(rng.normal(scale=[0.01, 0.01, 0.02, 0.001, 0.002, 0.001], size=(n, 6)))
    truth, estimate = [np.eye(4)], [se3_exp([5.0, 1, 2, 0.3, 0.2, 0.1])]
    for a, b in zip(steps, wrong, strict=True):
        truth.append(truth[-1] @ a)
        estimate.append(estimate[-1] @ b)
    return np.stack(estimate), np.stack(truth)


def test_relative_error_is_kittis_definition_word_by_word():
    estimate, truth = _winding(150, 1)
    along, drift, turn = [0.0], [], []
    for i in range(1, len(truth)):
        along.append(along[-1] + np.linalg.norm(truth[i, :3, 3] - truth[i - 1, :3, 3]))
    for i in range(len(truth)):
        j = next((j for j in range(len(truth)) if along[j] >= along[i] + 25.0), None)
        if j is not None:
            true_step = np.linalg.inv(truth[i]) @ truth[j]
            error = np.linalg.inv(np.linalg.inv(estimate[i]) @ estimate[j]) @ true_step
            drift.append(np.linalg.norm(error[:3, 3]) / 25.0)
            turn.append(np.degrees(np.arccos((np.trace(error[:3, :3]) - 1) / 2)) / 25.0)
    found = relative_error(estimate, truth, 25.0)
    assert found.count == len(drift) > 100
    assert found.translation_percent == pytest.approx(100 * np.mean(drift), rel=1e-9)
    assert found.rotation_deg_per_m == pytest.approx(np.mean(turn), rel=1e-6)


def test_step_error_of_known_steps():
    n = 20
    truth = se3(np.eye(3), np.stack([np.zeros(n), np.zeros(n), np.arange(n)], axis=1))
    estimate = se3(so3_exp(np.radians(0.5) * np.arange(n)[:, None] * [0, 0, 1.0]), 1.03 * truth[:, :3, 3])
    whole = step_error(estimate, truth, np.arange(n))
    assert whole.count == n - 1
    assert whole.translation_m == pytest.approx(0.03) and whole.rotation_deg == pytest.approx(0.5)
    # Without frame 10, the step over the gap, twice as wrong, does not count.
    kept = np.delete(np.arange(n), 10)
    gap = step_error(estimate[kept], truth[kept], kept)
    assert gap.count == n - 3 and gap.translation_m == pytest.approx(0.03)
    assert np.isnan(step_error(estimate[:1], truth[:1], np.arange(1)).translation_m)


def test_relative_errors_agree_with_evo():
    evo_metrics = pytest.importorskip("evo.core.metrics", reason="evo is an optional extra")
    from evo.core.trajectory import PosePath3D

    estimate, truth = _winding(120, 2)
    pair = (PosePath3D(poses_se3=list(truth)), PosePath3D(poses_se3=list(estimate)))
    for relation, ours in (
        (evo_metrics.PoseRelation.translation_part, step_error(estimate, truth, np.arange(121)).translation_m),
        (evo_metrics.PoseRelation.rotation_angle_deg, step_error(estimate, truth, np.arange(121)).rotation_deg),
    ):
        rpe = evo_metrics.RPE(relation, delta=1, delta_unit=evo_metrics.Unit.frames, all_pairs=True)
        rpe.process_data(pair)
        assert ours == pytest.approx(rpe.get_statistic(evo_metrics.StatisticsType.rmse), rel=1e-6)
    # Over lengths evo takes the pair nearest to it: with steps of 1 m straight on, the same pairs as KITTI's.
    straight = se3(np.eye(3), np.stack([np.zeros(121), np.zeros(121), np.arange(121)], axis=1))
    drifting = straight @ se3_inverse(truth) @ estimate
    rpe = evo_metrics.RPE(
        evo_metrics.PoseRelation.translation_part,
        delta=20,
        delta_unit=evo_metrics.Unit.meters,
        rel_delta_tol=0.01,
        all_pairs=True,
        pairs_from_reference=True,
    )
    rpe.process_data((PosePath3D(poses_se3=list(straight)), PosePath3D(poses_se3=list(drifting))))
    mean = rpe.get_statistic(evo_metrics.StatisticsType.mean)
    assert relative_error(drifting, straight, 20.0).translation_percent == pytest.approx(100 * mean / 20.0, rel=1e-6)
