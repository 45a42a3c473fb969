"""Ground truth that cannot be of the images is said with its cause; drift, noise and standing cameras are none."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from factory import circuit, make_sequence, make_world, manifest_of

from maslam.backend.geometry import (
    Array,
    product,
    quat_wxyz_from_rotation,
    rotation_from_quat_wxyz,
    se3,
    se3_inverse,
    so3_exp,
)
from maslam.frontend.files.trajectory import Trajectory
from maslam.mas.evaluation.summary import TruthFigures
from maslam.mas.evaluation.truth_fit import compare
from maslam.mas.policies.presets import preset
from maslam.mas.simulation import run
from maslam.tools.report.command import write_report
from maslam.tools.report.summary_table import table_of
from maslam.tools.report.truth_warnings import misfit_text


def bend(count: int = 60, far_m: float = 100.0) -> Array:
    """Poses on a bend of 30 m and half a turn, ``far_m`` from the world's origin, half a metre a step."""
    angles = np.linspace(0.0, np.pi, count)
    centres = np.column_stack([far_m + 10 * np.sin(angles), 0 * angles, 10 * np.cos(angles)])
    return np.array([se3(so3_exp([0.0, a, 0.0]), c) for a, c in zip(angles, centres, strict=True)])


def winding(count: int = 60) -> Array:
    """Poses that look along a path to and fro: no rotation about one axis, whose inverse is a like one."""
    ahead = np.linspace(0.0, 30.0, count)
    centres = np.column_stack([5 * np.sin(ahead / 5), 0 * ahead, ahead + 50])
    return np.array([se3(so3_exp([0.0, np.cos(z / 5), 0.0]), c) for z, c in zip(ahead, centres, strict=True)])


def other_way(count: int = 60) -> Array:
    """Of another recording: to and fro on a line of 10 m."""
    along = 10 * np.abs(np.linspace(-1.0, 1.0, count))
    return np.array([se3(np.eye(3), [0.0, 0.0, z]) for z in along])


def at(poses: Array) -> Trajectory:
    return Trajectory(np.arange(len(poses), dtype=np.int64) * 100_000_000, poses)


def moved(poses: Array, factor: float = 1.0, noise_m: float = 0.0) -> Array:
    out = poses.copy()
    out[:, :3, 3] = factor * out[:, :3, 3] + np.random.default_rng(1).normal(0.0, noise_m, (len(out), 3))
    return out


def told(estimate: Array, truth: Array, metric: bool = True) -> TruthFigures:
    figures = compare(0, [at(estimate)], at(truth), metric)
    assert figures is not None
    return figures


@pytest.mark.parametrize(
    ("truth", "cause"),
    [
        (moved(bend(), 1000.0), "millimetres"),
        (moved(bend(), 100.0), "centimetres"),
        (moved(bend(), 1e-3), "kilometres"),
        (se3_inverse(bend()), "T_C_W"),
        (moved(bend(), 1.45), "another recording"),  # of the same shape: its ATE is below a third of its spread
        (moved(bend(), 2.0), "another recording"),
        (other_way(), "another recording"),
    ],
)
def test_of_metric_cameras_the_cause_is_found_by_what_makes_it_fit(truth: Array, cause: str) -> None:
    figures = told(bend(), truth)
    assert not figures.fits and cause in figures.cause
    assert figures.odometry_m == pytest.approx(10 * np.pi, rel=1e-3)
    steps = np.linalg.norm(np.diff(truth[:, :3, 3], axis=0), axis=1)
    assert figures.truth_m == pytest.approx(steps.sum())


@pytest.mark.parametrize(("truth", "cause"), [(se3_inverse(winding()), "T_C_W"), (bend(), "another recording")])
def test_of_one_camera_the_shape_decides(truth: Array, cause: str) -> None:
    """Any unit fits, inverse poses do not."""
    assert told(moved(bend(), 0.03), bend(), metric=False).fits
    assert told(bend(), moved(bend(), 1000.0), metric=False).fits
    figures = told(winding(), truth, metric=False)
    assert not figures.fits and cause in figures.cause


def test_what_is_merely_bad_is_no_other_truth() -> None:
    assert told(moved(bend(), 0.8), bend()).fits, "odometry a fifth too short"
    noisy = told(bend(), moved(bend(), noise_m=0.5))  # its path is far longer, it spreads no farther
    assert noisy.truth_m > 1.4 * noisy.odometry_m and noisy.fits


def test_cameras_that_stand_and_few_frames_tell_nothing() -> None:
    stand = np.tile(np.eye(4), (60, 1, 1))
    assert compare(0, [at(moved(stand, noise_m=0.001))], at(moved(stand, noise_m=0.02)), True) is None
    assert compare(0, [at(moved(stand, noise_m=0.001))], at(moved(stand, noise_m=0.02)), False) is None
    assert compare(0, [at(bend()[:4])], at(se3_inverse(bend())), True) is None
    assert compare(0, [at(bend())], None, True) is None and compare(0, [], at(bend()), True) is None


def by_hand(count: int = 60) -> Array:
    """A camera in a hand: turns about all axes."""
    t = np.linspace(0.0, 6.0, count)
    turns = np.column_stack([0.5 * np.sin(t), 0.6 * np.cos(1.7 * t), 0.4 * np.sin(2.3 * t + 1)])
    centres = np.column_stack([2 * np.sin(0.9 * t), np.cos(1.3 * t), 0.5 * t])
    return np.array([se3(so3_exp(w), c) for w, c in zip(turns, centres, strict=True)])


def other_end(poses: Array, shift: int) -> Array:
    """Quaternions whose real part was written at one end and read at the other."""
    q = np.roll(quat_wxyz_from_rotation(poses[:, :3, :3]), shift, axis=1)
    return se3(rotation_from_quat_wxyz(q), poses[:, :3, 3])


def test_quaternions_from_the_other_end_are_said_though_positions_fit() -> None:
    rng = np.random.default_rng(6)
    drift = np.cumsum(rng.normal(0.0, 0.002, (60, 3)), axis=0)
    estimate = product(se3(so3_exp(drift), np.zeros((60, 3))), by_hand())
    body = product(by_hand(), se3(so3_exp([1.2, -0.4, 2.0]), np.zeros(3)))  # in a body's axes
    assert not told(estimate, by_hand()).rotations
    assert told(estimate, body).fits and "turned by 135 degrees" in told(estimate, body).rotations
    for truth in (by_hand(), body):
        for shift in (1, -1):
            figures = told(estimate, other_end(truth, shift))
            assert figures.fits and "qw first or last" in figures.rotations
    car = bend()
    assert "qw first or last" in told(car, other_end(car, 1)).rotations, "its steps turn with it, in the wrong world"
    line = misfit_text(told(estimate, other_end(body, 1)).model_dump())
    assert "errors of positions are right, those of matches are not" in line


@pytest.mark.parametrize("inverse", [True, False])
def test_a_run_says_so_in_its_summary_on_the_console_and_in_the_report(inverse: bool, tmp_path: Path) -> None:
    alone = make_sequence(make_world(2), circuit(0.0, 40.0), 2)
    truth = alone.groundtruth
    assert truth is not None
    if inverse:
        T_away = se3(np.eye(3), [300.0, 0.0, 200.0])
        alone = replace(alone, groundtruth=Trajectory(truth.stamps_ns, se3_inverse(T_away @ truth.poses)))
    (figures,) = run(manifest_of([alone]), [alone], preset("default"), tmp_path / "run").truths
    said = [line for line in table_of(tmp_path / "run").splitlines() if "the ground truth has" in line]
    assert figures.fits is not inverse and len(said) == int(inverse)
    assert ("Ground truth that does not fit" in write_report(tmp_path / "run").read_text()) is inverse
    for line in said:
        assert line.startswith("warning: agent_00: ") and "T_C_W" in line
        assert f"{figures.truth_m:.4g} m" in line and f"{figures.odometry_m:.4g} m" in line
