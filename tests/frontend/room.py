"""A textured box seen from inside, rendered with exact poses and depth: an independent truth for odometry."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from maslam.backend.geometry import se3, se3_inverse, so3_exp
from maslam.frontend.cameras.models import PinholeCamera, Rig, RigKind
from maslam.frontend.frames import Frame

Array = NDArray[np.float64]
CAMERA = PinholeCamera(320, 240, 260.0, 260.0, 159.5, 119.5)
BASELINE_M = 0.2
HALF_SIZE_M = np.array([4.0, 2.5, 6.0])
_TEXEL_M = 0.01


class Room:
    """Walls with smooth random textures of several scales, another one for each wall."""

    def __init__(self, seed: int, half_size_m: Array = HALF_SIZE_M) -> None:
        rng = np.random.default_rng(seed)
        self.half_size_m = half_size_m
        side = int(2 * half_size_m.max() / _TEXEL_M) + 8
        self.textures = []
        for _ in range(6):
            texture = np.zeros((side, side), dtype=np.float32)
            for cell in (4, 9, 24, 70):
                noise = rng.standard_normal((side // cell + 2, side // cell + 2)).astype(np.float32)
                texture += cv2.resize(noise, (side, side), interpolation=cv2.INTER_CUBIC)
            self.textures.append(np.clip(128 + 35 * texture, 0, 255).astype(np.float32))

    def render(self, T_W_C: Array, camera: PinholeCamera = CAMERA) -> tuple[NDArray[np.uint8], NDArray[np.float32]]:
        """Grey image and depth along +Z in metres."""
        u, v = np.meshgrid(np.arange(camera.width, dtype=np.float64), np.arange(camera.height, dtype=np.float64))
        rays = (
            np.stack([(u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, np.ones_like(u)], axis=-1)
            @ T_W_C[:3, :3].T
        )
        centre = T_W_C[:3, 3]
        with np.errstate(divide="ignore"):
            reach = (np.sign(rays) * self.half_size_m - centre) / rays
        axis = np.argmin(np.where(np.isfinite(reach), reach, np.inf), axis=-1)
        depth = np.take_along_axis(reach, axis[..., None], axis=-1)[..., 0]
        hit = centre + rays * depth[..., None]
        image = np.zeros((camera.height, camera.width), dtype=np.float32)
        for k in range(3):
            for sign in (0, 1):
                a, b = [i for i in range(3) if i != k]
                x = ((hit[..., a] + self.half_size_m[a]) / _TEXEL_M).astype(np.float32)
                y = ((hit[..., b] + self.half_size_m[b]) / _TEXEL_M).astype(np.float32)
                colour = cv2.remap(self.textures[2 * k + sign], x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REFLECT)
                on_wall = (axis == k) & ((rays[..., k] > 0) == bool(sign))
                image[on_wall] = colour[on_wall]
        return np.rint(image).astype(np.uint8), depth.astype(np.float32)

    def frame(
        self, index: int, T_W_C: Array, kind: RigKind, rate_hz: float = 10.0, disparity_offset_px: float = 0.0
    ) -> Frame:
        """What a rig of this kind sees; the right camera of a stereo rig may have a principal point that nobody
        told."""
        image, depth = self.render(T_W_C)
        right = None
        if kind is RigKind.STEREO:
            shifted = PinholeCamera(
                CAMERA.width, CAMERA.height, CAMERA.fx, CAMERA.fy, CAMERA.cx - disparity_offset_px, CAMERA.cy
            )
            right = self.render(T_W_C @ se3(np.eye(3), [BASELINE_M, 0, 0]), shifted)[0]
        return Frame(index, round(index * 1e9 / rate_hz), image, right, depth if kind is RigKind.RGBD else None)


def rig(kind: RigKind) -> Rig:
    return Rig(kind, CAMERA, BASELINE_M if kind is RigKind.STEREO else None)


def walk(count: int, step_m: float = 0.06, turn_deg: float = 0.8) -> Array:
    """``(count, 4, 4)`` ``T_W_C`` of a smooth curved walk through the room, first pose inside looking along +Z."""
    poses = []
    for i in range(count):
        yaw = np.radians(turn_deg) * 12.0 * np.sin(i / 12.0)
        x, z = 0.8 * np.sin(i * step_m / 1.2), -3.0 + i * step_m
        poses.append(se3(so3_exp([0.02 * np.sin(i / 5.0), yaw, 0.01 * np.cos(i / 7.0)]), [x, 0.1 * np.sin(i / 6.0), z]))
    return np.stack(poses)


def relative_to_first(poses: Array) -> Array:
    return se3_inverse(poses[0]) @ poses
