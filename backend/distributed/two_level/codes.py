"""Small whole numbers in few bits: Rice's code, which suits numbers that are mostly near 0."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ...errors import BackendError

Steps = NDArray[np.int64]

# No number takes more than so many bits in unary.
_LONGEST = 48
_LARGEST = 1 << 30
# Bits that name a parameter, and how many there are.
_NAME, _SHIFTS = 5, 31


def write_steps(steps: Steps, by_column: bool = False) -> bytes:
    """Whole numbers ``(n, w)`` of either sign as bits, row by row, under the parameter that makes them shortest: one
    for all, or one for each column. Nothing but zeros is no bytes."""
    values = np.clip(steps, -_LARGEST, _LARGEST).astype(np.int64)
    if not values.any():
        return b""
    folded = np.where(values >= 0, 2 * values, -2 * values - 1)
    groups = folded.T if by_column else folded.reshape(1, -1)
    found = np.array([_shortest(g) for g in groups], dtype=np.int64)
    shift = np.broadcast_to(found, folded.shape).ravel()
    flat = folded.ravel()
    high = flat >> shift
    starts = np.concatenate([[0], np.cumsum(high + 1 + shift)]) + _NAME * len(found)
    bits = np.zeros(int(starts[-1]), dtype=np.uint8)
    for k in range(_NAME):
        bits[k : _NAME * len(found) : _NAME] = found >> (_NAME - 1 - k) & 1
    # Unary: as many ones as the high part says, then a zero; then the low part, its highest bit first.
    ones = np.repeat(starts[:-1], high) + np.arange(int(high.sum())) - np.repeat(np.cumsum(high) - high, high)
    bits[ones] = 1
    for k in range(int(shift.max())):
        has = shift > k
        bits[(starts[:-1] + high + 1 + k)[has]] = (flat >> (shift - 1 - k))[has] & 1
    return np.packbits(bits).tobytes()


def read_steps(data: bytes, count: int, width: int, by_column: bool = False) -> Steps:
    """Inverse of :func:`write_steps` for ``(count, width)`` numbers; other bytes raise :class:`BackendError`."""
    out = np.zeros((count, width), dtype=np.int64)
    if not data:
        return out
    bits = np.unpackbits(np.frombuffer(data, dtype=np.uint8))
    groups = width if by_column else 1
    at = _NAME * groups
    if len(bits) < at or not out.size:
        raise BackendError(f"{len(data)} bytes of steps for {count} of {width} numbers")
    shifts = bits[:at].reshape(groups, _NAME) @ (1 << np.arange(_NAME - 1, -1, -1))
    zeros, text = np.flatnonzero(bits == 0), bits.tolist()
    flat = out.reshape(-1)
    for k in range(len(flat)):
        shift = int(shifts[k % width if by_column else 0])
        found = int(np.searchsorted(zeros, at))
        if found >= len(zeros) or zeros[found] - at > _LONGEST or zeros[found] + shift >= len(bits):
            raise BackendError(f"{len(data)} bytes of steps end too early, or are none")
        stop = int(zeros[found])
        low = 0
        for bit in text[stop + 1 : stop + 1 + shift]:
            low = 2 * low + bit
        value = ((stop - at) << shift) + low
        flat[k] = -(value + 1) // 2 if value & 1 else value // 2
        at = stop + 1 + shift
    if len(bits) - at >= 8 or bits[at:].any():
        raise BackendError(f"{len(data)} bytes of steps are more than {count} of {width} numbers take")
    return out


def _shortest(folded: Steps) -> int:
    shifts = np.arange(_SHIFTS)
    unary = folded.ravel()[None, :] >> shifts[:, None]
    lengths = (unary + 1 + shifts[:, None]).sum(axis=1)
    return int(np.argmin(np.where(unary.max(axis=1) > _LONGEST, np.iinfo(np.int64).max, lengths)))
