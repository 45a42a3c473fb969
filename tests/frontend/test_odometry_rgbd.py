"""RGB-D odometry when the depth camera is another camera beside the one that takes images: rendered, exact truth."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from numpy.typing import NDArray

from maslam.backend.geometry import se3
from maslam.backend.trajectory_error import TrajectoryError, trajectory_error
from maslam.frontend.cameras.depth_registration import DepthRegistration
from maslam.frontend.cameras.models import PinholeCamera, RigKind
from maslam.frontend.config import OdometryConfig
from maslam.frontend.frames import Frame
from maslam.frontend.odometry import Odometry
from maslam.frontend.vocabulary.vocabulary import Vocabulary
from tests.frontend.room import CAMERA, Room, relative_to_first, rig, walk

Array = NDArray[np.float64]
DEPTH_CAMERA = PinholeCamera(320, 240, 290.0, 290.0, 159.5, 119.5)
T_C_D = se3(np.eye(3), [-0.1, 0.0, 0.0])
FRAMES = 60


@cache
def recorded() -> tuple[Array, list[Frame]]:
    """Truth ``(n, 4, 4)`` of the image's camera; frames whose depth is as the depth camera measures it."""
    room, poses = Room(5), walk(FRAMES)
    frames = []
    for i, T_W_C in enumerate(poses):
        image, _ = room.render(T_W_C)
        _, depth = room.render(T_W_C @ T_C_D, DEPTH_CAMERA)
        frames.append(Frame(i, round(i * 1e9 / 10.0), image, None, depth))
    return relative_to_first(poses), frames


def error_of(registration: DepthRegistration | None, depth_scale: float = 1.0) -> tuple[float, TrajectoryError, int]:
    """Error after SE(3) alignment, metres; all of it after Sim(3) alignment; frames that have a pose."""
    odometry = Odometry(rig(RigKind.RGBD), OdometryConfig(), Vocabulary.load(None))
    for frame in recorded()[1]:
        assert frame.depth_m is not None
        depth = (frame.depth_m * depth_scale).astype(np.float32)
        depth = depth if registration is None else registration.register(depth)
        odometry.process(Frame(frame.index, frame.stamp_ns, frame.image, None, depth))
    result = odometry.finish()
    assert len(result.tracks) == 1
    centres, stamps = result.trajectories[0].centres, result.trajectories[0].stamps_ns
    truth = recorded()[0][np.rint(stamps / 1e8).astype(int), :3, 3]
    return trajectory_error(centres, truth, False).rmse_m, trajectory_error(centres, truth, True), len(stamps)


def test_registered_depth_gives_the_path_in_metres_and_depth_as_measured_does_not() -> None:
    error, similar, frames = error_of(DepthRegistration(DEPTH_CAMERA, CAMERA, T_C_D))
    assert frames == FRAMES and error < 0.01
    assert similar.T_truth_estimate.scale == pytest.approx(1.0, abs=0.005)
    assert error_of(None)[0] > 2 * error


def test_a_depth_unit_that_is_off_shows_as_the_path_s_scale_and_as_nothing_else() -> None:
    _, found, frames = error_of(DepthRegistration(DEPTH_CAMERA, CAMERA, T_C_D), 1.05)
    assert frames > 0.9 * FRAMES
    assert found.T_truth_estimate.scale == pytest.approx(1 / 1.05, abs=0.01)
    assert found.rmse_m < 0.02
