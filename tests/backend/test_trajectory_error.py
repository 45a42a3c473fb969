"""Trajectory errors against closed forms and against evo."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from backend.errors import BackendError
from backend.geometry import Sim3, se3, se3_exp, so3_exp
from backend.trajectory_error import (
    connected_error,
    path_length,
    relative_error,
    relative_errors,
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
    assert [e.length_m for e in relative_errors(estimate, truth, [10.0, 20.0])] == [10.0, 20.0]
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
