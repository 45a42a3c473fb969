"""Numbers in few bytes: whole numbers of variable length, and poses as whole steps from what both sides can predict."""

from __future__ import annotations

import struct
from collections.abc import Iterable
from math import isfinite

import numpy as np
from numpy.typing import ArrayLike

from ..errors import BackendError
from ..geometry import Array, se3, se3_inverse, so3_exp, so3_log

_NUMBER, _ROUGH, _POSE = struct.Struct("<d"), struct.Struct("<f"), struct.Struct("<6d")
_START = struct.Struct("<6f")
# Bits of a whole number, at most.
_LONGEST = 63
# Steps stay below this, so that they fit with their sign.
_TOO_FAR = 2.0**62


class CompactWriter:
    """Writer that appends numbers to a message, little endian."""

    def __init__(self) -> None:
        self._out = bytearray()

    def bytes(self) -> bytes:
        """The message so far."""
        return bytes(self._out)

    def count(self, value: int) -> None:
        """A whole number from 0, below 2^63: 7 bits per byte."""
        if value >> _LONGEST:
            raise BackendError("a whole number is too large for a message")
        while value > 0x7F:
            self._out.append(value & 0x7F | 0x80)
            value >>= 7
        self._out.append(value)

    def signed(self, value: int) -> None:
        """A whole number: small ones of either sign are short."""
        self.count(2 * value if value >= 0 else -2 * value - 1)

    def number(self, value: float) -> None:
        """A number in double precision: 8 bytes."""
        self._out += struct.pack("<d", value)

    def rough(self, value: float) -> None:
        """In single precision; :class:`BackendError` for one that is too large for it."""
        try:
            self._out += struct.pack("<f", value)
        except OverflowError as error:
            raise BackendError(f"{value:.3g} is too large for a message") from error

    def pose(self, T: Array) -> None:
        """In full."""
        self._out += _POSE.pack(*numbers_of(T))

    def rough_pose(self, numbers: Iterable[float]) -> None:
        """Of a pose's six :func:`numbers_of` it, in single precision."""
        self._out += _START.pack(*numbers)

    def weights(self, *weights: float) -> None:
        """Weights in single precision: 4 bytes each."""
        for weight in weights:
            self.rough(weight)

    def array(self, values: Array, kind: str) -> None:
        """Numbers as numpy's type ``kind`` has them."""
        self._out += np.ascontiguousarray(values, dtype=kind).tobytes()

    def steps(self, values: Iterable[float]) -> None:
        """Whole numbers that come as floating-point ones; :class:`BackendError` for one that is none."""
        for value in values:
            if not abs(value) < _TOO_FAR:
                raise BackendError(f"a step of {value:.3g} is too long for a message")
            self.signed(int(value))


class CompactReader:
    """Reader of :class:`CompactWriter`'s messages; one that ends too early raises :class:`BackendError`."""

    def __init__(self, data: bytes) -> None:
        self._data, self._at = data, 0

    @property
    def empty(self) -> bool:
        """Whether all of the message was read."""
        return self._at >= len(self._data)

    def count(self) -> int:
        """See :meth:`CompactWriter.count`."""
        value = shift = 0
        while True:
            if self.empty:
                raise self._too_short()
            if shift >= _LONGEST:
                raise BackendError("a message has a whole number that is too large")
            byte = self._data[self._at]
            self._at += 1
            value |= (byte & 0x7F) << shift
            shift += 7
            if not byte & 0x80:
                return value

    def signed(self) -> int:
        """See :meth:`CompactWriter.signed`."""
        value = self.count()
        return -(value + 1) // 2 if value & 1 else value // 2

    def number(self) -> float:
        """See :meth:`CompactWriter.number`."""
        return self._numbers(_NUMBER)[0]

    def rough(self) -> float:
        """See :meth:`CompactWriter.rough`."""
        return self._numbers(_ROUGH)[0]

    def pose(self) -> Array:
        """See :meth:`CompactWriter.pose`."""
        return poses_of(self._numbers(_POSE))

    def rough_pose(self) -> tuple[float, ...]:
        """The six numbers of a pose."""
        return self._numbers(_START)

    def weights(self, count: int) -> tuple[float, ...]:
        """See :meth:`CompactWriter.weights`."""
        return tuple(self.rough() for _ in range(count))

    def array(self, count: int, kind: str) -> Array:
        """``count`` finite numbers; see :meth:`CompactWriter.array`."""
        values = np.frombuffer(self._take(count * np.dtype(kind).itemsize), dtype=kind).astype(np.float64)
        if not np.isfinite(values).all():
            raise BackendError("a message has a number that is not finite")
        return values

    def steps(self, count: int) -> list[int]:
        """See :meth:`CompactWriter.steps`."""
        return [self.signed() for _ in range(count)]

    def rest(self) -> bytes:
        """All that was not read yet."""
        return self._take(len(self._data) - self._at)

    def _numbers(self, layout: struct.Struct) -> tuple[float, ...]:
        """Finite numbers."""
        numbers: tuple[float, ...] = layout.unpack(self._take(layout.size))
        if not all(map(isfinite, numbers)):
            raise BackendError("a message has a number that is not finite")
        return numbers

    def _take(self, size: int) -> bytes:
        part = self._data[self._at : self._at + size]
        if len(part) != size:
            raise self._too_short()
        self._at += size
        return part

    def _too_short(self) -> BackendError:
        return BackendError(f"a message of {len(self._data)} bytes ends too early")


def step_sizes(kappa: ArrayLike, tau: ArrayLike, fineness: float) -> Array:
    """Steps ``(..., 6)`` in metres and radians of weights ``(...)``: ``fineness`` of them are one standard deviation of
    F's noise."""
    shift, turn = 1.0 / (np.sqrt(tau) * fineness), 1.0 / (np.sqrt(2.0 * np.asarray(kappa)) * fineness)
    return np.stack([shift] * 3 + [turn] * 3, axis=-1)


def to_steps(T: Array, predicted: Array, sizes: Array) -> Array:
    """Whole steps ``(..., 6)`` from ``predicted`` to ``T`` (both ``(..., 4, 4)``), of ``sizes`` ``(..., 6)``."""
    return np.asarray(np.rint(numbers_of(se3_inverse(predicted) @ T) / sizes))


def from_steps(steps: ArrayLike, predicted: Array, sizes: Array) -> Array:
    """Inverse of :func:`to_steps`, up to half a step."""
    return np.asarray(predicted @ poses_of(np.asarray(steps, dtype=np.float64) * sizes))


def numbers_of(T: Array) -> Array:
    """``(..., 6)`` of poses ``(..., 4, 4)``: position, rotation vector."""
    return np.concatenate([T[..., :3, 3], so3_log(T[..., :3, :3])], axis=-1)


def poses_of(numbers: ArrayLike) -> Array:
    """Inverse of :func:`numbers_of`."""
    v = np.asarray(numbers, dtype=np.float64)
    return se3(so3_exp(v[..., 3:]), v[..., :3])
