"""Rotations of a truth whose positions fit are doubted where odometry's turns and steps say what is wrong with them."""

from __future__ import annotations

import re

import numpy as np
import pytest
from test_truth_fit import at, bend, by_hand, moved, told, winding

from maslam.backend.geometry import Array, product, se3, so3_exp

OPENGL = np.diag([1.0, -1.0, -1.0])
ROS = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])  # x ahead, y left, z up


def transposed(poses: Array) -> Array:
    out = poses.copy()
    out[:, :3, :3] = np.swapaxes(poses[:, :3, :3], 1, 2)
    return out


def body(poses: Array, R_B_C: Array) -> Array:
    """Poses of a body in whose axes the camera's are ``R_B_C``."""
    return product(poses, se3(R_B_C.T, np.zeros(3)))


def drifting(poses: Array) -> Array:
    """As odometry has it: in a world of its own, with a drift."""
    drift = np.cumsum(np.random.default_rng(4).normal(0.0, 0.002, (len(poses), 3)), axis=0)
    T_away = se3(so3_exp([0.3, 2.0, -0.4]), [4.0, 5.0, 6.0])
    return product(T_away, product(poses, se3(so3_exp(drift), np.zeros((len(poses), 3)))))


def tilted(poses: Array) -> Array:
    """In a world that a tilted camera's turns are about an oblique axis of."""
    return product(
        se3(so3_exp([1.0, 0.5, 0.2]), np.zeros(3)), product(poses, se3(so3_exp([0.3, 0.1, 0.0]), np.zeros(3)))
    )


ONE_AXIS = {"a bend": bend(), "to and fro": winding(), "tilted": tilted(bend()), "in a hand": by_hand()}


@pytest.mark.parametrize("metric", [True, False])
@pytest.mark.parametrize("path", ONE_AXIS)
def test_inverted_rotations_are_said_also_about_one_axis(path: str, metric: bool) -> None:
    poses = ONE_AXIS[path]
    figures = told(drifting(poses), transposed(poses), metric)
    assert figures.fits and "odometry's only inverted" in figures.rotations and "transpose" in figures.rotations


@pytest.mark.parametrize("path", ONE_AXIS)
@pytest.mark.parametrize(
    ("R_B_C", "words"), [(OPENGL, "y up, z behind (OpenGL's camera)"), (ROS, "x ahead, y left, z up")]
)
def test_other_axes_are_said_with_the_matrix_that_mends_them(path: str, R_B_C: Array, words: str) -> None:
    poses = ONE_AXIS[path]
    given = body(poses, R_B_C)
    said = told(drifting(poses), given).rotations
    assert words in said
    numbers = [float(v) for v in re.findall(r"-?[\d.]+", said.rpartition("from the right by")[2])]
    mended = given.copy()
    mended[:, :3, :3] = product(given[:, :3, :3], np.array(numbers).reshape(3, 3))
    np.testing.assert_allclose(mended, poses, atol=1e-9)


def test_both_at_once_are_said_together() -> None:
    said = told(drifting(by_hand()), transposed(body(by_hand(), OPENGL))).rotations
    assert "only inverted" in said and "OpenGL's camera" in said


def test_axes_of_a_straight_path_are_seen_by_its_direction() -> None:
    ahead = np.zeros((60, 4, 4)) + np.eye(4)
    ahead[:, 2, 3] = np.linspace(0.0, 30.0, 60)
    assert "OpenGL" in told(drifting(ahead), body(ahead, OPENGL)).rotations
    assert not told(drifting(ahead), transposed(ahead)).rotations  # the same


@pytest.mark.parametrize("path", ONE_AXIS)
def test_right_rotations_are_not_doubted(path: str) -> None:
    """Not with noise in the truth's positions, a camera mounted a little askew, or poses of a point beside it."""
    poses = ONE_AXIS[path]
    for truth in (
        poses,
        moved(poses, noise_m=0.05),
        moved(poses, noise_m=1.0),
        body(poses, so3_exp([0.1, 0.1, 0.0])),
        product(poses, se3(np.eye(3), [0.1, 0.05, -0.1])),
    ):
        assert not told(drifting(poses), truth).rotations


def test_noise_for_rotations_is_not_named() -> None:
    noisy = winding()
    noisy[:, :3, :3] = so3_exp(np.random.default_rng(3).normal(0.0, 1.5, (60, 3)))
    assert not told(drifting(winding()), noisy).rotations, "no reading makes sense of them"


def test_few_frames_tell_nothing() -> None:
    from maslam.mas.evaluation.truth_fit import compare

    figures = compare(0, [at(bend()[:5])], at(transposed(bend())), True)
    assert figures is not None and not figures.rotations
