"""Stamped poses and the text files people exchange them in: TUM and KITTI."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from backend.geometry import quat_wxyz_from_rotation, rotation_from_quat_wxyz, se3
from frontend.errors import FrontendError

NS_PER_S = 1_000_000_000


def stamp_ns_from_s(seconds: NDArray[np.float64] | float) -> NDArray[np.int64]:
    """Nearest integer nanoseconds."""
    return np.rint(np.asarray(seconds, dtype=np.float64) * NS_PER_S).astype(np.int64)


@dataclass(frozen=True)
class Trajectory:
    """``stamps_ns`` ``(N,)`` int64, ascending; ``poses`` ``(N, 4, 4)``: ``T_W_C``, camera to world."""

    stamps_ns: NDArray[np.int64]
    poses: NDArray[np.float64]

    def __post_init__(self) -> None:
        if self.poses.shape != (len(self.stamps_ns), 4, 4):
            raise ValueError(f"{len(self.stamps_ns)} time stamps but poses of shape {self.poses.shape}")

    def __len__(self) -> int:
        return len(self.stamps_ns)

    @property
    def centres(self) -> NDArray[np.float64]:
        """Camera centres in the world, ``(N, 3)`` metres."""
        return self.poses[:, :3, 3]

    def nearest(self, stamps_ns: NDArray[np.int64], tolerance_ns: int) -> NDArray[np.int64]:
        """Index of the pose nearest in time to each stamp, -1 where none is within ``tolerance_ns``."""
        if not len(self):
            return np.full(len(stamps_ns), -1, dtype=np.int64)
        right = np.clip(np.searchsorted(self.stamps_ns, stamps_ns), 1, max(len(self) - 1, 1))
        right = np.minimum(right, len(self) - 1)
        left = np.maximum(right - 1, 0)
        nearer_left = np.abs(stamps_ns - self.stamps_ns[left]) <= np.abs(self.stamps_ns[right] - stamps_ns)
        best = np.where(nearer_left, left, right)
        return np.where(np.abs(self.stamps_ns[best] - stamps_ns) <= tolerance_ns, best, -1)


def write_tum(path: Path, trajectory: Trajectory) -> None:
    """``time_s tx ty tz qx qy qz qw`` a line; nine decimals of time keep the nanoseconds."""
    q = quat_wxyz_from_rotation(trajectory.poses[:, :3, :3]) if len(trajectory) else np.zeros((0, 4))
    q = np.where(q[:, :1] < 0, -q, q)
    with open(path, "w", encoding="ascii") as out:
        for stamp, t, (w, x, y, z) in zip(trajectory.stamps_ns.tolist(), trajectory.centres, q, strict=True):
            out.write(f"{stamp // NS_PER_S}.{stamp % NS_PER_S:09d} {t[0]:.9f} {t[1]:.9f} {t[2]:.9f} {x:.9f} {y:.9f} {z:.9f} {w:.9f}\n")


def read_tum(path: Path) -> Trajectory:
    """Inverse of :func:`write_tum`; comment lines start with ``#``. A broken line is an error with its number."""
    stamps: list[int] = []
    rows: list[list[float]] = []
    for number, line in _data_lines(path):
        fields = line.replace(",", " ").split()
        if len(fields) != 8:
            raise FrontendError(f"{path}:{number}: a TUM line has 8 numbers (time tx ty tz qx qy qz qw), found {len(fields)}")
        stamps.append(_decimal_ns(fields[0], path, number))
        rows.append(_floats(fields[1:], path, number))
        if abs(np.linalg.norm(rows[-1][3:]) - 1.0) > 0.05:
            raise FrontendError(f"{path}:{number}: the quaternion's length is {np.linalg.norm(rows[-1][3:]):.3f}, expected 1")
        if len(stamps) > 1 and stamps[-1] <= stamps[-2]:
            raise FrontendError(f"{path}:{number}: time goes back from {stamps[-2] / 1e9:.9f} s to {stamps[-1] / 1e9:.9f} s")
    values = np.array(rows, dtype=np.float64).reshape(-1, 7)
    rotations = rotation_from_quat_wxyz(values[:, [6, 3, 4, 5]]) if len(values) else np.zeros((0, 3, 3))
    return Trajectory(np.array(stamps, dtype=np.int64), se3(rotations, values[:, :3]))


def read_kitti_poses(path: Path) -> tuple[NDArray[np.float64] | None, NDArray[np.float64]]:
    """Rows of 12 numbers (3x4 row-major ``T_W_C``), or 13 with a leading time in seconds.

    Returns the times ``(N,)`` in seconds, or None where the file has none, and the poses ``(N, 4, 4)``.
    """
    rows: list[list[float]] = []
    for number, line in _data_lines(path):
        rows.append(_floats(line.split(), path, number))
        if len(rows[-1]) not in (12, 13) or len(rows[-1]) != len(rows[0]):
            raise FrontendError(f"{path}:{number}: a KITTI pose has 12 numbers (13 with a time), found {len(rows[-1])}")
    if not rows:
        raise FrontendError(f"{path}: no poses in this file")
    values = np.array(rows, dtype=np.float64)
    matrices = values[:, -12:].reshape(-1, 3, 4)
    times = values[:, 0] if values.shape[1] == 13 else None
    return times, se3(matrices[:, :, :3], matrices[:, :, 3])


def write_kitti_poses(path: Path, poses: NDArray[np.float64]) -> None:
    """Rows of 12 numbers, 3x4 row-major ``T_W_C``."""
    with open(path, "w", encoding="ascii") as out:
        for row in np.asarray(poses)[:, :3, :].reshape(-1, 12):
            out.write(" ".join(f"{v:.9e}" for v in row) + "\n")


def _data_lines(path: Path) -> list[tuple[int, str]]:
    try:
        text = path.read_text(encoding="ascii", errors="replace")
    except OSError as error:
        raise FrontendError(f"{path}: cannot be read: {error.strerror}") from error
    return [(i, line) for i, line in enumerate(text.splitlines(), 1) if line.strip() and not line.lstrip().startswith("#")]


def _floats(fields: list[str], path: Path, number: int) -> list[float]:
    try:
        values = [float(f) for f in fields]
    except ValueError as error:
        raise FrontendError(f"{path}:{number}: not a number: {error}") from error
    if not np.isfinite(values).all():
        raise FrontendError(f"{path}:{number}: NaN or infinity in the line")
    return values


def _decimal_ns(text: str, path: Path, number: int) -> int:
    """Seconds as written to exact nanoseconds: a float64 holds only 0.2 microseconds of a present-day Unix time."""
    whole, _, fraction = text.partition(".")
    if whole.lstrip("+-").isdigit() and (not fraction or fraction.isdigit()):
        sign = -1 if whole.startswith("-") else 1
        return int(whole) * NS_PER_S + sign * int((fraction + "0" * 9)[:9])
    return int(stamp_ns_from_s(_floats([text], path, number)[0]))
