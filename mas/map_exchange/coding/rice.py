"""Whole numbers in few bits: Golomb-Rice codes whose parameter follows the numbers (as in JPEG-LS, ITU-T T.87).

Each context keeps the sum and the count of its recent numbers; the next number ``v`` is written as ``v >> k`` in unary
and ``k`` plain bits, with the ``k`` that suits their mean. Nothing but the numbers travels: no tables, no parameters,
so that a delivery of one key-frame is as well coded as one of a thousand.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from maslam._kernels import kernel

from ...protocol.tensors import MessageError

CONTEXTS = 32
# A unary part of this length announces a number in 32 plain bits.
_ESCAPE = 20
_WORD = 32
_LARGEST = 2**32 - 1
# Numbers a context remembers, and the mean it starts from.
_MEMORY = 48
_START = 8


class CodingError(MessageError):
    """Bits that end too early or hold numbers that cannot be."""


class BitWriter:
    """Collects numbers; :attr:`data` are the bytes."""

    def __init__(self) -> None:
        self._state = _fresh()
        self._parts: list[NDArray[np.uint8]] = []

    def put(self, values: ArrayLike, contexts: ArrayLike) -> None:
        """Append numbers, each 0 to 2^32 - 1, under these contexts in turn, over and over."""
        v, c = _whole(values), _whole(contexts)
        if len(v) and (v.min() < 0 or v.max() > _LARGEST):
            raise CodingError(f"numbers from {v.min()} to {v.max()} cannot be coded")
        bits = np.zeros(len(v) * (_ESCAPE + 1 + _WORD), dtype=np.uint8)
        self._parts.append(bits[: _encode(v, c, self._state, bits)])

    def put_signed(self, values: ArrayLike, contexts: ArrayLike) -> None:
        """Append numbers of either sign, of 31 bits."""
        v = np.asarray(values, dtype=np.int64)
        self.put(np.where(v >= 0, 2 * v, -2 * v - 1), contexts)

    @property
    def data(self) -> bytes:
        """All bits so far, the last byte filled with zeros."""
        return np.packbits(np.concatenate([np.zeros(0, dtype=np.uint8), *self._parts])).tobytes()


class BitReader:
    """Reads what a :class:`BitWriter` wrote, in the same order under the same contexts; :class:`BitsError` where the
    bits end too early."""

    def __init__(self, data: bytes) -> None:
        self._state = _fresh()
        self._bits = np.unpackbits(np.frombuffer(data, dtype=np.uint8))
        self._at = 0

    def get(self, contexts: ArrayLike, count: int | None = None) -> NDArray[np.int64]:
        """The next ``count`` numbers (else one for each of the contexts), under these contexts in turn."""
        c = _whole(contexts)
        # A number takes a bit at least: this bounds what a hostile count can ask for.
        if count is not None and count > len(self._bits) - self._at:
            raise CodingError(f"{count} numbers announced in {len(self._bits) - self._at} bits")
        out = np.zeros(c.size if count is None else count, dtype=np.int64)
        self._at = _decode(self._bits, self._at, c, self._state, out)
        if self._at < 0:
            raise CodingError("the bits end too early")
        return out

    def get_signed(self, contexts: ArrayLike, count: int | None = None) -> NDArray[np.int64]:
        """The next numbers of either sign."""
        v = self.get(contexts, count)
        return np.where(v & 1, -(v >> 1) - 1, v >> 1)

    def one(self, context: int, most: int) -> int:
        """The next number, at most ``most``."""
        value = int(self.get(context)[0])
        if value > most:
            raise CodingError(f"{value} where at most {most} can stand")
        return value

    def end(self) -> None:
        """Nothing but the padding of the last byte may be left."""
        if len(self._bits) - self._at >= 8:
            raise CodingError(f"{len(self._bits) - self._at} bits too many")


def _whole(values: ArrayLike) -> NDArray[np.int64]:
    """``(n,)``, one after the other."""
    return np.asarray(values, dtype=np.int64).reshape(-1)


def _fresh() -> NDArray[np.int64]:
    state = np.ones((CONTEXTS, 2), dtype=np.int64)
    state[:, 0] = _START
    return state


@kernel
def _parameter(state, c):  # type: ignore[no-untyped-def]
    k = 0
    while (state[c, 1] << k) < state[c, 0] and k < 31:
        k += 1
    return k


@kernel
def _learn(state, c, v):  # type: ignore[no-untyped-def]
    state[c, 0] += v
    state[c, 1] += 1
    if state[c, 1] >= _MEMORY:
        state[c, 0] >>= 1
        state[c, 1] >>= 1


@kernel
def _encode(values, contexts, state, bits):  # type: ignore[no-untyped-def]
    """Fill ``bits`` (one a byte), return how many."""
    at = turn = 0
    for i in range(len(values)):
        v, c = values[i], contexts[turn]
        turn = (turn + 1) if turn + 1 < len(contexts) else 0
        k = _parameter(state, c)
        unary = min(v >> k, _ESCAPE)
        plain = _WORD if unary == _ESCAPE else k
        for _ in range(unary):
            bits[at] = 1
            at += 1
        at += 1
        for b in range(plain - 1, -1, -1):
            bits[at] = (v >> b) & 1
            at += 1
        _learn(state, c, v)
    return at


@kernel
def _decode(bits, at, contexts, state, out):  # type: ignore[no-untyped-def]
    """Fill ``out``, return where reading stopped; -1 where the bits end too early or make no number."""
    turn = 0
    for i in range(len(out)):
        c = contexts[turn]
        turn = (turn + 1) if turn + 1 < len(contexts) else 0
        k = _parameter(state, c)
        unary = 0
        while at < len(bits) and bits[at] == 1:
            unary += 1
            at += 1
        at += 1
        plain = _WORD if unary == _ESCAPE else k
        if unary > _ESCAPE or at + plain > len(bits):
            return -1
        v = 0
        for _ in range(plain):
            v = (v << 1) | bits[at]
            at += 1
        out[i] = v if unary == _ESCAPE else (unary << k) | v
        _learn(state, c, out[i])
    return at
