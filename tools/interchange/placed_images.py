"""Images with the poses that a trajectory has for their times: taken, interpolated, or left out and counted; and the
tracks that they make."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from maslam.backend.geometry import Array, product, se3, se3_inverse, so3_exp, so3_log
from maslam.frontend.datasets.poses_of_images import GivenPoses
from maslam.frontend.files.trajectory import NS_PER_S

from ..common.errors import ToolError
from ..common.text_table import counted

_SAME_NS = 1_000_000
"""A pose is an image's own within a millisecond: times pass through files with few digits."""
_JUMP = 8.0
"""One step this many times faster than nearly all others, and than those around it, is no motion: the trajectory began
anew there."""
_OTHERS = 0.95


@dataclass(frozen=True)
class PlacingRules:
    """``offset_ns``: added to the trajectory's times; ``bridge_ns``: longest time between two poses that an image's is
    interpolated over; ``gap_ns``: longest time without a pose within a track."""

    offset_ns: int = 0
    bridge_ns: int = NS_PER_S // 2
    gap_ns: int = 5 * NS_PER_S

    def of(self, given: GivenPoses) -> PlacingRules:
        """Those for ``given``: what has no times of its own is not shifted, and nothing is interpolated in it."""
        return self if given.timed else replace(self, offset_ns=0, bridge_ns=0)


@dataclass(frozen=True, eq=False)
class PlacedImages:
    """``rows`` ``(M,)`` ascending: images that have a pose, ``poses`` ``(M, 4, 4)``, ``track`` ``(M,)`` from 0;
    ``own`` images had a pose of their time, ``between`` interpolated ones, out of ``images``; ``jumps``: where tracks
    were cut, for people; ``mounted``: the user says how the camera stands on what the poses are of."""

    rows: NDArray[np.int64]
    poses: Array
    track: NDArray[np.int64]
    own: int
    between: int
    images: int
    jumps: tuple[str, ...]
    mounted: bool = False

    def text(self) -> str:
        """The counts in one line."""
        left = self.images - len(self.rows)
        parts = [f"{self.own} of {counted(self.images, 'image')} at the time of a pose"]
        parts += [f"{self.between} interpolated"] * bool(self.between)
        parts += [f"{left} without a pose"] * bool(left)
        tracks = int(self.track[-1]) + 1
        return ", ".join(parts) + (f", {tracks} tracks" if tracks > 1 else "")


def place_images(name: str, given: GivenPoses, stamps_ns: NDArray[np.int64], rules: PlacingRules) -> PlacedImages:
    """The poses at the images' times ``stamps_ns`` ``(N,)``; :class:`ToolError` where hardly any has one.

    Poses without times of their own have those of the images that they are of: :meth:`PlacingRules.of`.
    """
    path = given.trajectory
    times = path.stamps_ns + rules.offset_ns
    right = np.clip(np.searchsorted(times, stamps_ns), 1, max(len(times) - 1, 1))
    right = np.minimum(right, len(times) - 1)
    left = np.maximum(right - 1, 0)
    nearest = np.where(stamps_ns - times[left] <= times[right] - stamps_ns, left, right)
    own = np.abs(times[nearest] - stamps_ns) <= _SAME_NS
    inside = (times[left] <= stamps_ns) & (stamps_ns <= times[right])
    between = ~own & inside & (times[right] - times[left] <= max(rules.bridge_ns, 0)) & (right > left)
    used = own | between
    if not used.any():
        raise ToolError(f"{name}: no image has a pose: {_spans(stamps_ns, times)}; --clock-offset shifts the poses")
    share = np.where(between, (stamps_ns - times[left]) / np.maximum(times[right] - times[left], 1), 0.0)
    poses = np.where(own[:, None, None], path.poses[nearest], _interpolated(path.poses[left], path.poses[right], share))
    rows = np.flatnonzero(used)
    return _tracked(name, rows, poses[rows], stamps_ns[rows], between[rows], stamps_ns, rules)


def _tracked(
    name: str,
    rows: NDArray[np.int64],
    poses: Array,
    times: NDArray[np.int64],
    between: NDArray[np.bool_],
    all_times: NDArray[np.int64],
    rules: PlacingRules,
) -> PlacedImages:
    """Cut into tracks: where no pose is for long, and where the position jumps."""
    seconds = np.diff(times) / NS_PER_S
    moved = np.linalg.norm(np.diff(poses[:, :3, 3], axis=0), axis=1)
    speed = moved / np.maximum(seconds, 1e-9)
    usual = float(np.quantile(speed, _OTHERS)) if len(speed) else 0.0
    around = np.maximum(np.concatenate([[0.0], speed[:-1]]), np.concatenate([speed[1:], [0.0]]))[: len(speed)]
    jump = speed > _JUMP * np.maximum(np.maximum(usual, around), 1e-12)
    gap = seconds > rules.gap_ns / NS_PER_S
    cuts = np.flatnonzero(jump | gap)
    said = tuple(
        f"{name}: the trajectory jumps by {moved[k]:.3g} in {seconds[k]:.3g} s at image {rows[k + 1]}: a new track"
        if jump[k]
        else f"{name}: no pose for {seconds[k]:.3g} s before image {rows[k + 1]}: a new track"
        for k in cuts.tolist()
    )
    track = np.concatenate([[0], np.cumsum(jump | gap)]).astype(np.int64)
    own, interpolated = int((~between).sum()), int(between.sum())
    return PlacedImages(rows, poses, track, own, interpolated, len(all_times), said)


def _interpolated(a: Array, b: Array, share: Array) -> Array:
    """Between ``a`` and ``b`` ``(N, 4, 4)``: positions on the straight line, rotations at constant speed."""
    step = so3_log(product(np.swapaxes(a[:, :3, :3], 1, 2), b[:, :3, :3]))
    R = product(a[:, :3, :3], so3_exp(share[:, None] * step))
    return se3(R, a[:, :3, 3] + share[:, None] * (b[:, :3, 3] - a[:, :3, 3]))


def _spans(stamps_ns: NDArray[np.int64], times: NDArray[np.int64]) -> str:
    def span(t: NDArray[np.int64]) -> str:
        return f"{t[0] / NS_PER_S:.3f} to {t[-1] / NS_PER_S:.3f} s"

    spacing_s = float(np.median(np.diff(times))) / NS_PER_S if len(times) > 1 else 1.0
    return f"images {span(stamps_ns)}, poses {span(times)}, {spacing_s:.3g} s apart"


def camera_poses(T_W_B: Array, T_B_C: Array, R_rectified: Array | None) -> Array:
    """``T_W_C`` of the rectified camera from the poses given: of the body that carries it at ``T_B_C``, of the camera
    as stored, which ``R_rectified`` ``(3, 3)`` turns into the rectified one."""
    T = product(T_W_B, T_B_C)
    return T if R_rectified is None else product(T, se3_inverse(se3(R_rectified, np.zeros(3))))
