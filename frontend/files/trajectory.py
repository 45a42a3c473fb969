"""Stamped poses and the text files people exchange them in: TUM and KITTI."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from maslam._atomic import write_atomically
from maslam.backend.geometry import project_to_so3, quat_wxyz_from_rotation, rotation_from_quat_wxyz, se3

from ..errors import FrontendError
from . import text_tables
from .timestamps import NS_PER_S, read_stamps, seconds_text, stamp_ns_from_s

__all__ = [
    "NS_PER_S",
    "TRUTH_TOLERANCE_NS",
    "Trajectory",
    "read_kitti_poses",
    "read_tum",
    "stamp_ns_from_s",
    "write_kitti_poses",
    "write_tum",
]

TRUTH_TOLERANCE_NS = 20_000_000
"""An estimated pose and a true one belong together within this; ground truth is often sampled at its own times."""
_QUATERNION_TOLERANCE = 0.05  # of its length: rounded digits are fine, a column mixed up is not
_ROTATION_TOLERANCE = 0.02  # of R R^T against the identity: 7-Scenes poses are off by up to a percent


@dataclass(frozen=True)
class Trajectory:
    """``stamps_ns`` ``(N,)`` int64, ascending; ``poses`` ``(N, 4, 4)``: ``T_W_C``, camera to world, in metres or in the
    unit of a monocular track. ``ValueError`` for other shapes, and for stamps that do not ascend."""

    stamps_ns: NDArray[np.int64]
    poses: NDArray[np.float64]

    def __post_init__(self) -> None:
        if self.poses.shape != (len(self.stamps_ns), 4, 4):
            raise ValueError(f"{len(self.stamps_ns)} time stamps but poses of shape {self.poses.shape}")
        if (np.diff(self.stamps_ns) <= 0).any():
            raise ValueError("the time stamps of a trajectory must be ascending")

    def __len__(self) -> int:
        return len(self.stamps_ns)

    def __repr__(self) -> str:
        """Its length and duration; the numbers would fill a page."""
        seconds = (self.stamps_ns[-1] - self.stamps_ns[0]) / 1e9 if len(self) else 0.0
        return f"<Trajectory: {len(self)} poses, {seconds:.1f} s>"

    @property
    def centres(self) -> NDArray[np.float64]:
        """Camera centres in the world, ``(N, 3)``, in the unit of the poses."""
        return self.poses[:, :3, 3]

    def nearest(self, stamps_ns: NDArray[np.int64], tolerance_ns: int) -> NDArray[np.int64]:
        """Index ``(M,)`` of the pose nearest in time to each of ``stamps_ns`` ``(M,)``, -1 where none is within
        ``tolerance_ns``."""
        if not len(self):
            return np.full(len(stamps_ns), -1, dtype=np.int64)
        right = np.clip(np.searchsorted(self.stamps_ns, stamps_ns), 1, max(len(self) - 1, 1))
        right = np.minimum(right, len(self) - 1)
        left = np.maximum(right - 1, 0)
        nearer_left = np.abs(stamps_ns - self.stamps_ns[left]) <= np.abs(self.stamps_ns[right] - stamps_ns)
        best = np.where(nearer_left, left, right)
        return np.where(np.abs(self.stamps_ns[best] - stamps_ns) <= tolerance_ns, best, -1)


def write_tum(path: Path, trajectory: Trajectory) -> None:
    """``time_s tx ty tz qx qy qz qw`` (``T_W_C``) per line; nine decimals of time keep the nanoseconds."""
    q = quat_wxyz_from_rotation(trajectory.poses[:, :3, :3]) if len(trajectory) else np.zeros((0, 4))
    q = np.where(q[:, :1] < 0, -q, q)
    rows = np.concatenate([trajectory.centres, q[:, 1:], q[:, :1]], axis=1).tolist()
    stamps = map(seconds_text, trajectory.stamps_ns.tolist())
    line = "%s" + " %.9f" * 7 + "\n"
    write_atomically(path, "".join(line % (stamp, *row) for stamp, row in zip(stamps, rows, strict=True)))


def read_tum(path: Path) -> Trajectory:
    """``T_W_C`` from lines ``time_s tx ty tz qx qy qz qw``; comment lines start with ``#``.

    :class:`FrontendError` with the line for a broken one, a quaternion whose length is not 1, and times that do not
    ascend.
    """
    values = text_tables.read_table(path, 8, "a TUM line (time tx ty tz qx qy qz qw)")
    stamps = read_stamps(path)
    lengths = np.linalg.norm(values[:, 4:], axis=1)
    for row in np.flatnonzero(np.abs(lengths - 1.0) > _QUATERNION_TOLERANCE)[:1]:
        raise FrontendError(
            f"{path}:{text_tables.row_line(path, row)}: the quaternion's length is {lengths[row]:.3f}, expected 1"
        )
    for row in np.flatnonzero(np.diff(stamps) <= 0)[:1] + 1:
        times = f"from {seconds_text(stamps[row - 1])} s to {seconds_text(stamps[row])} s"
        raise FrontendError(f"{path}:{text_tables.row_line(path, row)}: time does not go on, but {times}")
    return Trajectory(stamps, se3(rotation_from_quat_wxyz(values[:, [7, 4, 5, 6]]), values[:, 1:4]))


def read_kitti_poses(path: Path) -> tuple[NDArray[np.float64] | None, NDArray[np.float64]]:
    """Rows of 12 numbers (3x4 row-major ``T_W_C``), or 13 with a leading time in seconds.

    Returns the times ``(N,)`` in seconds, or None where the file has none, and the poses ``(N, 4, 4)``, each
    rotation made exactly orthonormal: files hold as few as seven digits. :class:`FrontendError` with the line of a
    matrix that is no rotation, and for a file without poses.
    """
    values = text_tables.read_table(path, (12, 13), "a KITTI pose (13 with a time)")
    if not len(values):
        raise FrontendError(f"{path}: no poses in this file")
    matrices = values[:, -12:].reshape(-1, 3, 4)
    times = values[:, 0] if values.shape[1] == 13 else None
    return times, se3(rigid_rotations(matrices[:, :, :3], path), matrices[:, :, 3])


def rigid_rotations(
    rotations: NDArray[np.float64], path: Path, lines: Sequence[int] | None = None
) -> NDArray[np.float64]:
    """The nearest exact rotations ``(N, 3, 3)``; :class:`FrontendError` with the line of one that is none: by
    ``lines``, those of the rows, else the file's data rows are counted."""
    gram = rotations @ np.swapaxes(rotations, -1, -2)
    wrong = (np.abs(gram - np.eye(3)).max(axis=(1, 2)) > _ROTATION_TOLERANCE) | (np.linalg.det(rotations) < 0)
    for row in np.flatnonzero(wrong)[:1]:
        line = text_tables.row_line(path, row) if lines is None else lines[row]
        raise FrontendError(f"{path}:{line}: the 3x3 part of the pose is not a rotation")
    return project_to_so3(rotations)


def write_kitti_poses(path: Path, poses: NDArray[np.float64]) -> None:
    """Rows of 12 numbers, 3x4 row-major ``T_W_C``, of ``poses`` ``(N, 4, 4)``."""
    rows = np.asarray(poses, dtype=np.float64)[:, :3, :].reshape(-1, 12).tolist()
    line = " ".join(["%.12e"] * 12) + "\n"
    write_atomically(path, "".join(line % tuple(row) for row in rows))
