"""Corners followed without images: points of known position, seen from known poses, with noise."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from maslam.backend.geometry import rotation_angle_deg, se3, se3_inverse, so3_exp
from maslam.frontend.cameras.models import PinholeCamera, Rig, RigKind
from maslam.frontend.config import OdometryConfig
from maslam.frontend.estimation.several_views import SeveralViews
from maslam.frontend.frames import Frame
from maslam.frontend.mapping.range_sensor import Ranging
from maslam.frontend.tracking.first_view import FirstView

Array = NDArray[np.float64]
CAMERA = PinholeCamera(640, 480, 500.0, 500.0, 319.5, 239.5)
CONFIG = OdometryConfig()


def cloud(seed: int, count: int = 200) -> Array:
    """Points ``(count, 3)`` in front of the camera, metres."""
    return np.random.default_rng(seed).uniform([-6, -4, 4], [6, 4, 14], (count, 3))


def plane(seed: int, count: int = 200) -> Array:
    """Points of one slanted plane."""
    points = cloud(seed, count)
    points[:, 2] = 7.0 + 0.35 * points[:, 0] - 0.2 * points[:, 1]
    return points


def path(count: int, turn: Array, step: Array) -> list[Array]:
    """``T_C_W`` of ``count`` views, turn (radians) and step (metres) from one to the next."""
    return [se3_inverse(se3(so3_exp(np.asarray(turn) * k), np.asarray(step) * k)) for k in range(count)]


def project(points: Array, T_C_W: Array) -> Array:
    p = (points @ T_C_W[:3, :3].T + T_C_W[:3, 3]) @ CAMERA.K.T
    return p[:, :2] / p[:, 2:]


def drive(points: list[Array], poses: list[Array], noise_px: float, seed: int) -> tuple[int, SeveralViews]:
    """Follow ``points[k]`` ``(n, 3)`` through the views until a motion is sure: number of the view, and the motion; or
    the last view with its refusal."""
    rng = np.random.default_rng(seed)
    seen = [uv + rng.normal(0, noise_px, uv.shape) for uv in map(project, points, poses)]
    ranging = Ranging(Rig(RigKind.MONO, CAMERA, None), CONFIG.stereo, CONFIG.flow)
    blank = np.zeros((CAMERA.height, CAMERA.width), dtype=np.uint8)
    view, row = FirstView(Frame(0, 0, blank), seen[0], ranging, CONFIG), np.arange(len(seen[0]))
    motion = SeveralViews.refused(0, view.motion().refusal)
    for k, uv in enumerate(seen[1:], 1):
        inside = ((uv[row] > 0) & (uv[row] < [CAMERA.width, CAMERA.height])).all(axis=1)
        view.follow(uv[row], inside)
        row = row[inside]
        motion = view.motion()
        if motion.T_2_1 is not None:
            return k, motion
    return len(seen) - 1, motion


def motion_error_deg(motion: SeveralViews, T_2_1: Array) -> tuple[float, float]:
    """Error of the turn and of the direction of the step, degrees."""
    assert motion.T_2_1 is not None
    found, truth = motion.T_2_1[:3, 3], T_2_1[:3, 3] / np.linalg.norm(T_2_1[:3, 3])
    turn = float(rotation_angle_deg(motion.T_2_1[:3, :3].T @ T_2_1[:3, :3]))
    return turn, float(np.degrees(np.arccos(np.clip(found @ truth, -1.0, 1.0))))
