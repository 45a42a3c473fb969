"""Two-view initialisation: right where it can be, refusals with a reason where it cannot."""

from __future__ import annotations

import numpy as np
import pytest
import room

from maslam.backend.geometry import rotation_angle_deg, se3, se3_inverse, so3_exp
from maslam.frontend.cameras.models import RigKind
from maslam.frontend.config import FlowConfig, MonoConfig, OdometryConfig, StereoConfig
from maslam.frontend.estimation.two_view import (
    PointPairs,
    residual_after_rotation,
    score_fundamental,
    score_homography,
    solve_two_views,
)
from maslam.frontend.mapping.range_sensor import Ranging
from maslam.frontend.tracking.initialisation import MetricStarter, MonoStarter

K = np.array([[500.0, 0, 320], [0, 500.0, 240], [0, 0, 1]])
SIGMA = 0.5


def views(points: np.ndarray, T: np.ndarray, noise_px: float = 0.2) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(9)
    out = []
    for pose in (np.eye(4), T):
        p = (points @ pose[:3, :3].T + pose[:3, 3]) @ K.T
        out.append(p[:, :2] / p[:, 2:] + rng.normal(0, noise_px, (len(p), 2)))
    return out[0], out[1]


def cloud(planar: bool, count: int = 300) -> np.ndarray:
    rng = np.random.default_rng(8)
    points = rng.uniform([-3, -2, 4], [3, 2, 12], (count, 3))
    if planar:
        points[:, 2] = 7.0 + 0.35 * points[:, 0] - 0.2 * points[:, 1]
    return points


@pytest.mark.parametrize("planar", [False, True])
def test_motion_and_structure_are_right_up_to_scale(planar: bool) -> None:
    points = cloud(planar)
    T = se3(so3_exp([0.02, -0.06, 0.01]), [-0.8, 0.1, 0.2])
    uv1, uv2 = views(points, T)
    found = solve_two_views(PointPairs(uv1, uv2, K, SIGMA), MonoConfig())
    assert (found.homography_share > 0.45) == planar
    if found.T_2_1 is None:
        # A plane may leave two motions open; then the refusal must say so.
        assert planar and "ambiguous" in found.reason
        return
    assert rotation_angle_deg(found.T_2_1[:3, :3].T @ T[:3, :3]) < 0.5
    direction = found.T_2_1[:3, 3] @ T[:3, 3] / np.linalg.norm(T[:3, 3])
    assert direction > np.cos(np.radians(4.0))
    scale = np.linalg.norm(T[:3, 3])
    error = np.linalg.norm(found.points * scale - points[found.good], axis=1) / points[found.good][:, 2]
    assert np.median(error) < 0.03


def test_pure_rotation_is_refused_with_its_figure() -> None:
    uv1, uv2 = views(cloud(False), se3(so3_exp([0.03, 0.12, 0.02]), [0.0, 0, 0]))
    found = solve_two_views(PointPairs(uv1, uv2, K, SIGMA), MonoConfig())
    assert found.T_2_1 is None and "turned without moving" in found.reason and "px" in found.reason
    assert residual_after_rotation(PointPairs(uv1, uv2, K, SIGMA)) < 0.5


def test_wrong_pairs_do_not_start_a_map() -> None:
    rng = np.random.default_rng(10)
    uv1, uv2 = rng.uniform(0, 480, (200, 2)), rng.uniform(0, 480, (200, 2))
    found = solve_two_views(PointPairs(uv1, uv2, K, SIGMA), MonoConfig())
    assert found.T_2_1 is None and found.reason


def test_scores_prefer_the_model_that_made_the_points() -> None:
    T = se3(so3_exp([0.0, -0.05, 0.0]), [-0.7, 0.05, 0.1])
    uv1, uv2 = views(cloud(True), T, 0.0)
    # Homography of the plane n . p = d, and F = K^-T [t]x R K^-1.
    n, d = np.array([-0.35, 0.2, 1.0]), 7.0
    H = K @ (T[:3, :3] + np.outer(T[:3, 3], n) / d) @ np.linalg.inv(K)
    t = T[:3, 3]
    F = (
        np.linalg.inv(K).T
        @ np.array([[0, -t[2], t[1]], [t[2], 0, -t[0]], [-t[1], t[0], 0]])
        @ T[:3, :3]
        @ np.linalg.inv(K)
    )
    score_h, inlier_h = score_homography(H, PointPairs(uv1, uv2, K, SIGMA))
    score_f, inlier_f = score_fundamental(F, PointPairs(uv1, uv2, K, SIGMA))
    assert inlier_h.all() and inlier_f.all()
    assert score_h == pytest.approx(2 * 5.991 * len(uv1), rel=1e-6) and score_f == pytest.approx(score_h, rel=1e-6)


def starter() -> MonoStarter:
    config = OdometryConfig()
    return MonoStarter(Ranging(room.rig(RigKind.MONO), config.stereo, config.flow), config)


def offered(poses: np.ndarray) -> list[str]:
    start, scene = starter(), room.Room(11)
    reasons = []
    for i, pose in enumerate(poses):
        outcome = start.offer(scene.frame(i, pose, RigKind.MONO))
        if outcome.segment is not None:
            return [*reasons, "started"]
        reasons.append(outcome.reason)
    return reasons


def test_rendered_views_start_when_the_camera_moves() -> None:
    reasons = offered(room.walk(30))
    assert reasons[-1] == "started"
    assert all(reasons[:-1])


def test_static_and_rotating_rendered_views_never_start_and_say_why() -> None:
    here = room.walk(1)[0]
    static = offered(np.tile(here, (6, 1, 1)))
    assert all(reason.startswith("the camera stands still: ") for reason in static[1:])
    turning = np.stack([here @ se3(so3_exp([0, 0.02 * i, 0]), [0, 0, 0]) for i in range(12)])
    reasons = offered(turning)
    assert "started" not in reasons
    assert any("turned without moving" in reason for reason in reasons)


def test_an_image_without_corners_is_refused() -> None:
    camera = room.CAMERA
    frame = room.Room(12).frame(0, room.walk(1)[0], RigKind.MONO)
    blank = type(frame)(0, 0, np.full((camera.height, camera.width), 50, dtype=np.uint8))
    assert "features in the image" in starter().offer(blank).reason


def test_a_metric_rig_starts_at_once_and_names_a_missing_right_image() -> None:
    config = OdometryConfig()
    scene, pose = room.Room(13), room.walk(1)[0]
    start = MetricStarter(Ranging(room.rig(RigKind.STEREO), StereoConfig(), FlowConfig()), config)
    frame = scene.frame(0, pose, RigKind.STEREO)
    assert "right image" in start.offer(type(frame)(0, 0, frame.image)).reason
    assert start.offer(frame).segment is not None


def test_a_single_wall_starts_a_map_only_where_it_leaves_no_doubt() -> None:
    """Rendered: along a slanted wall two motions explain two views alike, and the frames say so until several views
    have told the camera's from the other; sideways before a wall one is left at once."""
    slanted = np.stack([se3(so3_exp([0, 0.3, 0]), [-1.5 + 0.05 * i, 0, 2.0 + 0.03 * i]) for i in range(14)])
    start, scene, doubts = starter(), room.Room(11), 0
    for i, pose in enumerate(slanted):
        outcome = start.offer(scene.frame(i, pose, RigKind.MONO))
        if outcome.segment is not None:
            break
        doubts += outcome.refusal.kind == "two motions fit the points"
    assert doubts >= 4 and outcome.segment is not None
    second = outcome.segment.map.keyframes[1].T_C_W
    expected = (se3_inverse(pose) @ slanted[0])[:3, 3]
    assert second[:3, 3] @ expected / np.linalg.norm(second[:3, 3]) / np.linalg.norm(expected) > np.cos(np.radians(2.0))
    assert rotation_angle_deg(second[:3, :3]) < 0.1
    sideways = np.stack([se3(np.eye(3), [-1.0 + 0.06 * i, 0, 1.0]) for i in range(14)])
    start, scene = starter(), room.Room(11)
    for i, pose in enumerate(sideways):
        outcome = start.offer(scene.frame(i, pose, RigKind.MONO))
        if outcome.segment is not None:
            break
        assert any(char.isdigit() for char in outcome.reason) or i == 0, outcome.reason
    assert outcome.segment is not None
    first, second = (outcome.segment.map.keyframes[k] for k in (0, 1))
    motion = second.T_C_W[:3, 3] / np.linalg.norm(second.T_C_W[:3, 3])
    np.testing.assert_allclose(motion, [-1.0, 0.0, 0.0], atol=0.01)
    assert rotation_angle_deg(second.T_C_W[:3, :3]) < 0.1 and first.frame_index == 0
