"""Arrays as they are transmitted: dtype, shape and raw bytes, checked when they arrive."""

from __future__ import annotations

from collections.abc import Sequence
from math import isfinite
from typing import Annotated, Any

import msgspec
import numpy as np
from numpy.typing import ArrayLike, NDArray

from maslam.backend.geometry import Sim3, is_se3, quat_wxyz_from_rotation, rotation_from_quat_wxyz, se3

from ..errors import MasError

Shape = tuple[int | None, ...]


class MessageError(MasError):
    """A message that cannot be believed: too long, of the wrong type, or with values that make no sense.

    Decoding raises it for a peer's; where an agent makes such a message itself, that is its own mistake."""


class Tensor(msgspec.Struct, frozen=True, array_like=True):
    """A numpy array as ``dtype``, ``shape`` and little-endian, C-ordered ``data``."""

    dtype: str
    shape: tuple[int, ...]
    data: bytes

    @classmethod
    def of(cls, array: ArrayLike, dtype: str) -> Tensor:
        """The array's values in ``dtype``, such as ``<f4``."""
        values = np.ascontiguousarray(array, dtype=np.dtype(dtype))
        return cls(dtype, values.shape, values.tobytes())

    def array(self) -> NDArray[Any]:
        """A read-only view of the data; only after :func:`check`."""
        return np.frombuffer(self.data, dtype=np.dtype(self.dtype)).reshape(self.shape)

    @property
    def nbytes(self) -> int:
        """Length of the data."""
        return len(self.data)


def check(name: str, tensor: Tensor, dtype: str, shape: Shape, finite: bool = True) -> NDArray[Any]:
    """The array in ``tensor`` if it is what it must be: ``dtype``, ``shape`` (None: any length), as many bytes as that
    takes, all values finite (unless they need not be). Else :class:`MessageError`."""
    if tensor.dtype != dtype:
        raise MessageError(f"{name}: dtype {tensor.dtype!r}, expected {dtype!r}")
    if len(tensor.shape) != len(shape) or any(
        n < 0 or (want is not None and n != want) for n, want in zip(tensor.shape, shape, strict=True)
    ):
        raise MessageError(f"{name}: shape {tensor.shape}, expected {tuple('n' if s is None else s for s in shape)}")
    count = 1
    for n in tensor.shape:
        count *= n
    if count * np.dtype(dtype).itemsize != len(tensor.data):
        raise MessageError(f"{name}: {len(tensor.data)} bytes do not fill shape {tensor.shape} of {dtype}")
    values = tensor.array()
    if finite and dtype[1] == "f" and not np.isfinite(values).all():
        raise MessageError(f"{name}: NaN or infinity")
    return values


def check_finite(name: str, *values: float) -> None:
    """Bounds of single numbers let NaN through; this does not."""
    if not all(isfinite(value) for value in values):
        raise MessageError(f"{name}: NaN or infinity")


POSE_WIDTH = 7
SIM3_WIDTH = 8
MAX_TRANSLATION = 1e9
MAX_SCALE = 1e6
Unit = Annotated[float, msgspec.Meta(ge=1.0 / MAX_SCALE, le=MAX_SCALE)]
"""One unit of length in another one."""
Length = Annotated[float, msgspec.Meta(ge=0, le=MAX_TRANSLATION)]
Depth = Annotated[float, msgspec.Meta(ge=1.0 / MAX_TRANSLATION, le=MAX_TRANSLATION)]


def pack_poses(poses: ArrayLike, dtype: str = "<f8") -> Tensor:
    """``(..., 4, 4)`` rigid transforms as rows ``tx ty tz qw qx qy qz``."""
    t = np.asarray(poses, dtype=np.float64)
    q = quat_wxyz_from_rotation(t[..., :3, :3]) if t.size else np.zeros((*t.shape[:-2], 4))
    return Tensor.of(np.concatenate([t[..., :3, 3], q], axis=-1), dtype)


def unpack_poses(rows: NDArray[Any]) -> NDArray[np.float64]:
    """Inverse of :func:`pack_poses`."""
    values = np.asarray(rows, dtype=np.float64)
    rotations = rotation_from_quat_wxyz(values[..., 3:]) if values.size else np.zeros((*values.shape[:-1], 3, 3))
    poses = se3(rotations, values[..., :3])
    if not is_se3(poses):
        raise MessageError("a row of poses is not a rigid transform")
    return poses


def check_points(name: str, tensor: Tensor, count: int | None) -> int:
    """``(count, 3)`` float32 positions of a size that geometry can bear; returns how many."""
    points = check(name, tensor, "<f4", (count, 3))
    if len(points) and np.abs(points).max() > MAX_TRANSLATION:
        raise MessageError(f"{name}: a point is farther than {MAX_TRANSLATION:.0e} away")
    return len(points)


def check_poses(name: str, tensor: Tensor, dtype: str, shape: Shape) -> None:
    """Rows as :func:`pack_poses` makes them: unit quaternions, positions of a size that geometry can bear."""
    rows = check(name, tensor, dtype, (*shape, POSE_WIDTH))
    if rows.size and np.abs(rows).max() > MAX_TRANSLATION:
        raise MessageError(f"{name}: a position is farther than {MAX_TRANSLATION:.0e} away")
    if rows.size and np.abs(np.linalg.norm(rows[..., 3:].astype(np.float64), axis=-1) - 1.0).max() > 1e-3:
        raise MessageError(f"{name}: a quaternion's length is not 1")


def pack_sim3s(transforms: Sequence[Sim3], dtype: str = "<f8") -> Tensor:
    """Rows ``tx ty tz qw qx qy qz scale``, ``(n, 8)``."""
    if not transforms:
        return Tensor(dtype, (0, SIM3_WIDTH), b"")
    q = quat_wxyz_from_rotation(np.array([t.rotation for t in transforms]))
    t = np.array([t.translation for t in transforms])
    s = np.array([[t.scale] for t in transforms])
    return Tensor.of(np.concatenate([t, q, s], axis=1), dtype)


def unpack_sim3s(tensor: Tensor) -> list[Sim3]:
    """Inverse of :func:`pack_sim3s`."""
    rows = tensor.array().astype(np.float64)
    if not len(rows):
        return []
    rotations = rotation_from_quat_wxyz(rows[:, 3:7])
    return [Sim3(rotation, row[:3].copy(), float(row[7])) for rotation, row in zip(rotations, rows, strict=True)]


def check_sim3s(name: str, tensor: Tensor, count: int, dtype: str = "<f8") -> None:
    """``count`` rows as :func:`pack_sim3s` makes them."""
    rows = check(name, tensor, dtype, (count, SIM3_WIDTH))
    if not count:
        return
    if np.abs(rows).max() > MAX_TRANSLATION or rows[:, 7].max() > MAX_SCALE or rows[:, 7].min() * MAX_SCALE < 1.0:
        raise MessageError(f"{name}: a scale or position is out of range")
    if np.abs(np.linalg.norm(rows[:, 3:7], axis=1) - 1.0).max() > 1e-3:
        raise MessageError(f"{name}: a quaternion's length is not 1")


def pack_sim3(transform: Sim3) -> Tensor:
    """One row ``(8,)``."""
    row = pack_sim3s([transform])
    return Tensor(row.dtype, (SIM3_WIDTH,), row.data)


def unpack_sim3(tensor: Tensor) -> Sim3:
    """Inverse of :func:`pack_sim3`."""
    return unpack_sim3s(Tensor(tensor.dtype, (1, SIM3_WIDTH), tensor.data))[0]


def check_sim3(name: str, tensor: Tensor) -> None:
    """One row as :func:`pack_sim3` makes it."""
    check(name, tensor, "<f8", (SIM3_WIDTH,))
    check_sim3s(name, Tensor(tensor.dtype, (1, SIM3_WIDTH), tensor.data), 1)


_TRIANGLES = {21: 6, 28: 7}
_MOST_INFORMATION = 1e18


def pack_information(matrix: NDArray[np.float64]) -> Tensor:
    """The upper triangle of a symmetric ``(6, 6)`` or ``(7, 7)`` matrix, float32."""
    return Tensor.of(matrix[np.triu_indices(len(matrix))], "<f4")


def unpack_information(tensor: Tensor) -> NDArray[np.float64]:
    """Inverse of :func:`pack_information`."""
    n = _TRIANGLES[tensor.shape[0]]
    out = np.zeros((n, n))
    out[np.triu_indices(n)] = tensor.array()
    return np.asarray(out + np.triu(out, 1).T)


def check_information(name: str, tensor: Tensor) -> None:
    """A triangle as :func:`pack_information` makes it."""
    numbers = check(name, tensor, "<f4", (None,))
    if len(numbers) not in _TRIANGLES:
        raise MessageError(f"{name}: {tensor.shape[0]} numbers, not a triangle of 21 or 28")
    if np.abs(numbers).max() > _MOST_INFORMATION:
        raise MessageError(f"{name}: more certain than any measurement")
