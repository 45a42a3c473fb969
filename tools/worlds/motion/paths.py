"""From a line on the ground to camera poses: smooth, of bounded curvature, driven slowly round corners, with a little
wobble."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Line = NDArray[np.float64]


@dataclass(frozen=True)
class Gait:
    """Motion of a carrier: ``cruise_mps``; accelerations in m/s2; ``height_m`` of the camera; wobble: deviations of
    the angles (degrees) and of the height (metres), at about ``wobble_hz``;
    ``smooth_m`` rounds the corners of the line; ``turn_dps``: degrees a second at most."""

    cruise_mps: float = 9.0
    lateral_mps2: float = 2.4
    accelerate_mps2: float = 1.6
    brake_mps2: float = 2.2
    height_m: float = 1.65
    wobble_deg: tuple[float, float, float] = (0.30, 0.20, 0.35)
    heave_m: float = 0.012
    wobble_hz: float = 0.9
    smooth_m: float = 2.0
    turn_dps: float = 40.0


WALKING = Gait(1.1, 0.5, 0.6, 0.6, 1.5, (1.2, 1.0, 0.9), 0.02, 0.8, 0.35, 35.0)


def resample(line: Line, step_m: float) -> Line:
    """Points ``step_m`` apart along a polyline ``(k, 2)``."""
    keep = np.concatenate([[True], np.linalg.norm(np.diff(line, axis=0), axis=1) > 1e-9])
    line = line[keep]
    s = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(line, axis=0), axis=1))])
    at = np.arange(0.0, s[-1], step_m)
    return np.stack([np.interp(at, s, line[:, k]) for k in range(2)], axis=1)


def smoothed(values: NDArray[np.float64], sigma: float) -> NDArray[np.float64]:
    """Gaussian smoothing along the first axis, ``sigma`` in samples; the ends go on straight."""
    from scipy.ndimage import gaussian_filter1d

    pad = int(4 * sigma) + 1
    head = 2 * values[0] - values[1 : pad + 1][::-1] if len(values) > pad else np.repeat(values[:1], pad, axis=0)
    tail = 2 * values[-1] - values[-pad - 1 : -1][::-1] if len(values) > pad else np.repeat(values[-1:], pad, axis=0)
    return gaussian_filter1d(np.concatenate([head, values, tail]), sigma, axis=0)[pad : pad + len(values)]


def speeds(curvature: NDArray[np.float64], step_m: float, gait: Gait) -> NDArray[np.float64]:
    """Speed at each point of a line: no faster than cruise, than the corner allows, than the car can gain and lose."""
    v = np.minimum(gait.cruise_mps, np.sqrt(gait.lateral_mps2 / np.maximum(np.abs(curvature), 1e-6)))
    v = np.minimum(v, np.deg2rad(gait.turn_dps) / np.maximum(np.abs(curvature), 1e-6))
    for k in range(1, len(v)):
        v[k] = min(v[k], np.sqrt(v[k - 1] ** 2 + 2 * gait.accelerate_mps2 * step_m))
    for k in range(len(v) - 2, -1, -1):
        v[k] = min(v[k], np.sqrt(v[k + 1] ** 2 + 2 * gait.brake_mps2 * step_m))
    return v


def drive(
    line: Line, frames: int, rate_hz: float, gait: Gait, rng: np.random.Generator, offset_m: float = 0.0
) -> NDArray[np.float64]:
    """Poses ``(frames, 4, 4)`` of a camera carried along ``line`` (x, z) over the ground y = 0.

    ``offset_m`` shifts the line to the right. Raises ValueError when the line is too short for the frames.
    """
    points, heading, seconds = _timed(line, gait, offset_m, rng)
    step = _step(gait)
    times = np.arange(frames) / rate_hz
    if seconds[-1] < times[-1]:
        raise ValueError(
            f"the path of {len(points) * step:.0f} m ends after {seconds[-1]:.1f} s, {times[-1]:.1f} s are asked for"
        )
    s = np.interp(times, seconds, np.arange(len(points), dtype=np.float64))
    x, z, yaw = (np.interp(s, np.arange(len(points)), a) for a in (points[:, 0], points[:, 1], heading))
    knots = max(rate_hz / gait.wobble_hz / 2, 0.5)
    sway = np.stack([_wander(rng, frames, knots) for _ in range(4)])
    pitch, dyaw, roll = (np.deg2rad(d) * w for d, w in zip(gait.wobble_deg, sway[:3], strict=True))
    poses = np.tile(np.eye(4), (frames, 1, 1))
    poses[:, :3, :3] = _rotations(yaw + dyaw, pitch, roll)
    poses[:, :3, 3] = np.stack([x, -gait.height_m + gait.heave_m * sway[3], z], axis=1)
    return poses


def way_at(line: Line, gait: Gait, times: NDArray[np.float64]) -> NDArray[np.float64]:
    """Metres along ``line`` that ``gait`` has covered at ``times`` (seconds), gone on at the mean speed beyond its
    end."""
    points, _, seconds = _timed(line, gait, 0.0, None)
    metres = np.arange(len(points)) * _step(gait)
    return np.interp(times, seconds, metres) + np.maximum(times - seconds[-1], 0) * metres[-1] / seconds[-1]


def _step(gait: Gait) -> float:
    return 0.1 if gait.cruise_mps < 3 else 0.25


def _timed(
    line: Line, gait: Gait, offset_m: float, rng: np.random.Generator | None
) -> tuple[Line, NDArray[np.float64], NDArray[np.float64]]:
    """The smooth line driven, ``offset_m`` to the right and swaying a little where there is an ``rng``; its heading,
    radians from +Z to +X; the time at each of its points."""
    step = _step(gait)
    points = smoothed(resample(line, step), gait.smooth_m / step)
    tangent = np.gradient(points, step, axis=0)
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    if rng is not None:
        aside = offset_m + 0.25 * min(gait.cruise_mps / 9.0, 0.4) * _wander(rng, len(points), 25.0 / step)
        points = points + aside[:, None] * np.stack([tangent[:, 1], -tangent[:, 0]], axis=1)
    heading = smoothed(np.unwrap(np.arctan2(tangent[:, 0], tangent[:, 1])), 0.8 * gait.smooth_m / step)
    v = speeds(np.gradient(heading, step), step, gait)
    return points, heading, np.concatenate([[0.0], np.cumsum(step / (0.5 * (v[1:] + v[:-1])))])


def _rotations(yaw: NDArray, pitch: NDArray, roll: NDArray) -> NDArray[np.float64]:
    """Camera to world: turned by ``yaw`` to the right about down, then ``pitch`` about right, then ``roll`` about
    forward."""
    from scipy.spatial.transform import Rotation

    return Rotation.from_euler("YXZ", np.stack([yaw, pitch, roll], axis=1)).as_matrix()


def _wander(rng: np.random.Generator, n: int, knots: float) -> NDArray[np.float64]:
    """Smooth noise of unit deviation over ``n`` samples that changes over about ``knots`` samples."""
    from scipy.ndimage import gaussian_filter1d

    sigma = max(knots, 0.5)
    raw = gaussian_filter1d(rng.standard_normal(n + int(8 * sigma) + 2), sigma)[int(4 * sigma) : int(4 * sigma) + n]
    return np.clip(raw * np.sqrt(2 * sigma * np.sqrt(np.pi)), -2.5, 2.5)
