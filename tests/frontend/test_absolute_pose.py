"""Robust absolute pose against the pose that made the pixels."""

import numpy as np

from maslam.backend.geometry import rotation_angle_deg, se3_exp, se3_inverse, transform_points
from maslam.frontend.estimation.absolute_pose import absolute_pose

CAMERA = np.array([400.0, 410.0, 319.5, 179.5, 0.0])


def _scene(count: int, wrong: float, seed: int):
    rng = np.random.default_rng(seed)
    T_C_W = se3_exp(rng.normal(0.0, 0.3, 6))
    seen = np.column_stack([rng.uniform(-3, 3, count), rng.uniform(-2, 2, count), rng.uniform(3, 20, count)])
    uv = seen[:, :2] / seen[:, 2:] * CAMERA[:2] + CAMERA[2:4] + rng.normal(0, 0.3, (count, 2))
    outliers = rng.random(count) < wrong
    uv[outliers] = rng.uniform([0, 0], [640, 360], (int(outliers.sum()), 2))
    return T_C_W, transform_points(se3_inverse(T_C_W), seen), uv


def test_the_pose_is_found_among_half_wrong_points() -> None:
    for seed in range(5):
        T_C_W, points, uv = _scene(200, 0.5, seed)
        found = absolute_pose(points, uv, CAMERA, 2.0)
        assert found is not None
        error = se3_inverse(T_C_W) @ found
        assert np.linalg.norm(error[:3, 3]) < 0.03 and rotation_angle_deg(error[:3, :3]) < 0.2
        np.testing.assert_array_equal(found, absolute_pose(points, uv, CAMERA, 2.0))


def test_too_few_or_contradicting_points_give_none() -> None:
    _, points, uv = _scene(5, 0.0, 0)
    assert absolute_pose(points, uv, CAMERA, 2.0) is None
    assert absolute_pose(np.zeros((0, 3)), np.zeros((0, 2)), CAMERA, 2.0) is None
    rng = np.random.default_rng(1)
    nowhere = absolute_pose(rng.normal((0.0, 0.0, 5.0), 1.0, (40, 3)), rng.uniform(0, 300, (40, 2)), CAMERA, 0.2)
    assert nowhere is None
