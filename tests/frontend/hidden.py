"""Something textured that is drawn into rendered frames, and hides a part of them or all."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import room

from maslam.frontend.frames import Frame


def pasted(picture: np.ndarray, texture: np.ndarray, x: float, y: float = 0.0) -> np.ndarray:
    shift = np.array([[1.0, 0.0, x], [0.0, 1.0, y]])
    size = picture.shape[::-1]
    there = cv2.warpAffine(np.ones_like(texture), shift, size) > 0.5
    return np.where(there, np.clip(cv2.warpAffine(texture, shift, size), 0, 255), picture).astype(np.uint8)


def covered(depth: np.ndarray, texture: np.ndarray, x: float, y: float, near_m: float) -> np.ndarray:
    shift = np.array([[1.0, 0.0, x], [0.0, 1.0, y]])
    there = cv2.warpAffine(np.ones_like(texture), shift, depth.shape[::-1]) > 0.5
    return np.where(there, np.float32(near_m), depth)


def side(width: int, height: int) -> np.ndarray:
    """The texture of a thing of so many pixels."""
    grain = np.random.default_rng(9).uniform(0, 255, (height // 4, width // 4))
    return cv2.resize(grain, (width, height), interpolation=cv2.INTER_CUBIC)


def behind(frame: Frame, texture: np.ndarray, x: float, y: float, near_m: float) -> Frame:
    """The frame with a thing at ``near_m`` in front of the camera, its corner at pixel ``x``, ``y``."""
    near = room.CAMERA.fx * room.BASELINE_M / near_m
    right = None if frame.right is None else pasted(frame.right, texture, x - near, y)
    depth = None if frame.depth_m is None else covered(frame.depth_m, texture, x, y, near_m)
    return replace(frame, image=pasted(frame.image, texture, x, y), right=right, depth_m=depth)
