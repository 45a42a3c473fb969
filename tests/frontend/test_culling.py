"""Found ratios against the definition, point by point."""

from __future__ import annotations

import numpy as np
import pytest
import room

from maslam.backend.geometry import se3, so3_exp
from maslam.frontend.cameras.models import PinholeCamera
from maslam.frontend.mapping.point_culling import AFTER, BEFORE, found_ratio

CAMERA = PinholeCamera(320, 240, 260.0, 260.0, 159.5, 119.5)


def by_definition(poses: np.ndarray, points: np.ndarray, observations: np.ndarray) -> list[float]:
    out = []
    for j, point in enumerate(points):
        found = [int(k) for k, p in observations.tolist() if p == j]
        chances = 0
        for k in range(max(min(found) - BEFORE, 0), min(max(found) + AFTER, len(poses) - 1) + 1):
            x, y, z = np.linalg.inv(poses[k])[:3] @ [*point, 1.0]
            u, v = CAMERA.fx * x / z + CAMERA.cx, CAMERA.fy * y / z + CAMERA.cy
            chances += z > 0 and 20 <= u < 300 and 20 <= v < 220
        out.append(len(found) / max(chances, len(found), 1))
    return out


def test_ratios_are_as_defined() -> None:
    rng = np.random.default_rng(2)
    poses = room.walk(40)[::2]
    points = rng.uniform([-4, -2.5, -6], [4, 2.5, 6], (200, 3))
    observations = np.array(
        [[k, j] for j in range(200) for k in sorted(rng.choice(20, rng.integers(1, 5), replace=False))], np.int32
    )
    ratio = found_ratio(poses, points, observations, CAMERA)
    np.testing.assert_allclose(ratio, by_definition(poses, points, observations))
    assert 0.05 < ratio.min() < 0.25 and (ratio == 1.0).any()


@pytest.mark.parametrize(("found", "expected"), [([3], 1 / 7), ([3, 4], 2 / 8), ([0], 1 / 5), ([9], 1 / 3)])
def test_a_point_ahead_of_a_standing_camera_has_a_chance_in_each_neighbour(found: list[int], expected: float) -> None:
    poses = np.tile(np.eye(4), (10, 1, 1))
    observations = np.array([[k, 0] for k in found], np.int32)
    ratio = found_ratio(poses, np.array([[0.1, 0.0, 3.0]]), observations, CAMERA)
    # Two key-frames before, four after, as far as there are any.
    chances = min(found[-1] + AFTER, 9) - max(found[0] - BEFORE, 0) + 1
    assert ratio[0] == pytest.approx(len(found) / chances)
    assert ratio[0] == pytest.approx(expected)


def test_where_a_point_cannot_show_it_is_not_missed() -> None:
    turned = np.array([se3(so3_exp([0.0, 1.2 * (k > 0), 0.0]), [0.0, 0.0, 0.0]) for k in range(6)])
    once = np.array([[0, 0]], np.int32)
    assert found_ratio(turned, np.array([[0.0, 0.0, 3.0]]), once, CAMERA)[0] == 1.0
    assert len(found_ratio(turned, np.zeros((0, 3)), np.zeros((0, 2), np.int32), CAMERA)) == 0
