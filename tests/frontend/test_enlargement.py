"""Small images are enlarged for the odometry, and for nobody else."""

from __future__ import annotations

import numpy as np
import pytest
import room

from maslam.backend.geometry import se3, se3_inverse, transform_points
from maslam.backend.trajectory_error import trajectory_error
from maslam.frontend import enlargement
from maslam.frontend.cameras.models import PinholeCamera, Rig, RigKind
from maslam.frontend.config import OdometryConfig, StereoConfig
from maslam.frontend.enlargement import Enlargement
from maslam.frontend.errors import FrontendError
from maslam.frontend.frames import Frame, PutOff
from maslam.frontend.odometry import Odometry, OdometryResult

SMALL = PinholeCamera(160, 120, 130.0, 130.0, 79.5, 59.5)
WALK = room.walk(24, step_m=0.1, turn_deg=2.0)
SCENE = room.Room(5)


class Words:
    """A vocabulary with one word."""

    def words(self, descriptors: np.ndarray) -> np.ndarray:
        return np.zeros((len(descriptors), 2), dtype=np.int32)


def frame(i: int, kind: RigKind) -> Frame:
    image, depth = SCENE.render(WALK[i], SMALL)
    right = SCENE.render(WALK[i] @ se3(np.eye(3), [room.BASELINE_M, 0, 0]), SMALL)[0]
    return Frame(
        i,
        i * 10**8,
        image,
        right if kind is RigKind.STEREO else None,
        depth if kind is RigKind.RGBD else None,
        name=f"{i}.png",
    )


def tracked(kind: RigKind) -> tuple[OdometryResult, float]:
    config = OdometryConfig(stereo=StereoConfig(estimate_calibration=False))
    odometry = Odometry(Rig(kind, SMALL, room.BASELINE_M if kind is RigKind.STEREO else None), config, Words())
    for i in range(len(WALK)):
        result = odometry.process(frame(i, kind))
        if result.first is not None:
            assert result.first.image.shape == (120, 160), "others see the image as it was"
    finished = odometry.finish()
    if not finished.trajectories:
        return finished, np.inf
    trajectory = finished.trajectories[0]
    truth = WALK[trajectory.stamps_ns // 10**8]
    return finished, trajectory_error(trajectory.centres, truth[:, :3, 3], kind is RigKind.MONO).rmse_m


@pytest.mark.parametrize("kind", RigKind)
def test_a_small_camera_sees_more_and_its_views_are_in_its_own_pixels(
    kind: RigKind, monkeypatch: pytest.MonkeyPatch
) -> None:
    result, error_m = tracked(kind)
    monkeypatch.setattr(enlargement, "_FACTOR", 1)
    as_given, given_error_m = tracked(kind)
    assert len(result.tracks[0].points) > 2 * sum(len(track.points) for track in as_given.tracks)
    assert len(result.trajectories[0]) >= max([0, *map(len, as_given.trajectories)])
    assert error_m < 0.03 and (kind is RigKind.MONO or error_m < 1.2 * given_error_m)
    track, views = result.tracks[0], result.views[0]
    errors = []
    for (k, point), uv in zip(views.observations.tolist(), views.uv, strict=True):
        p = transform_points(se3_inverse(track.poses[k]), track.points[point][None])[0]
        errors.append(np.linalg.norm([130 * p[0] / p[2] + 79.5 - uv[0], 130 * p[1] / p[2] + 59.5 - uv[1]]))
    assert np.median(errors) < 0.5


@pytest.mark.parametrize(
    ("size", "factor"),
    [((160, 120), 2), ((128, 96), 2), ((160, 90), 1), ((96, 64), 1), ((240, 180), 1), ((320, 180), 1), ((752, 480), 1)],
)
def test_which_images_are_enlarged(size: tuple[int, int], factor: int) -> None:
    assert Enlargement.of(PinholeCamera(*size, 100.0, 100.0, 10.0, 10.0)).factor == factor


def test_rays_stay_what_they_are() -> None:
    twice = Enlargement(2)
    camera = twice.rig(Rig(RigKind.MONO, SMALL)).camera
    at = np.array([[0.0, 0.0], [30.5, 99.0], [159.0, 119.0]])
    there = (at + 0.5) * 2 - 0.5  # the centre of a pixel stays its centre
    np.testing.assert_allclose((there - [camera.cx, camera.cy]) / camera.fx, (at - [79.5, 59.5]) / 130.0)
    np.testing.assert_allclose(twice.given_px(there), at)


def test_depth_and_masks_are_repeated_and_damage_is_said() -> None:
    used = np.full((120, 160), True)
    used[7, 9] = False

    def broken() -> np.ndarray:
        raise FrontendError("right.png: damaged")

    image, depth = SCENE.render(WALK[0], SMALL)
    small = Frame(0, 0, image, PutOff(broken), depth, "0.png", used)
    large = Enlargement(2).frame(small)
    assert large.original is small and large.image.shape == (240, 320)
    assert large.used is not None and large.right_used is None and (~large.used).sum() == 4
    assert not large.used[14:16, 18:20].any()
    assert large.depth_m is not None
    np.testing.assert_array_equal(large.depth_m[1::2, ::2], depth)
    large.prepare()
    assert large.right is None and large.problem == "right.png: damaged"
    assert Enlargement(1).frame(small) is small
