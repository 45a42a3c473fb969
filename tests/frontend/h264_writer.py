"""H.264 as tests need it: pictures whose blocks are stored as they are (I_PCM), or left as in the picture before
(P_Skip), by ITU-T H.264, clauses 7.3 and 9.1; so what a decoder must give is known to the last bit."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

_BLOCK = 16


class Bits:
    """Bits of one unit, most significant first."""

    def __init__(self) -> None:
        self.text: list[str] = []
        self.count = 0

    def u(self, value: int, bits: int) -> None:
        self.text.append(format(value, f"0{bits}b"))
        self.count += bits

    def ue(self, *values: int) -> None:
        """Exp-Golomb codes."""
        for value in values:
            code = format(value + 1, "b")
            self.u(value + 1, 2 * len(code) - 1)

    def samples(self, values: NDArray[np.uint8]) -> None:
        while self.count % 8:
            self.u(0, 1)
        for value in values.ravel().tolist():
            self.u(value, 8)

    def unit(self, head: int) -> bytes:
        """With its start code, end mark, and emulation prevention."""
        self.u(1, 1)
        while self.count % 8:
            self.u(0, 1)
        bits = "".join(self.text)
        out, zeros = bytearray([head]), 0
        for byte in (int(bits[i : i + 8], 2) for i in range(0, len(bits), 8)):
            if zeros >= 2 and byte <= 3:
                out.append(3)
                zeros = 0
            out.append(byte)
            zeros = zeros + 1 if byte == 0 else 0
        return b"\x00\x00\x00\x01" + bytes(out)


def parameters(width: int, height: int) -> bytes:
    """Sequence and picture parameters of a baseline stream; sizes are multiples of 16."""
    sequence = Bits()
    for value in (66, 0, 30):
        sequence.u(value, 8)
    sequence.ue(0, 0, 2, 1)  # number, 4 bits of frame_num, order of output as decoded, one reference
    sequence.u(0, 1)
    sequence.ue(width // _BLOCK - 1, height // _BLOCK - 1)
    sequence.u(0b1000, 4)  # whole frames, no direct inference, no cropping, no usability information
    picture = Bits()
    picture.ue(0, 0)
    picture.u(0, 2)
    picture.ue(0, 0, 0)
    picture.u(0, 3)
    picture.ue(0, 0, 0)
    picture.u(0b100, 3)  # deblocking is controlled, by slices that switch it off
    return sequence.unit(0x67) + picture.unit(0x68)


def key_picture(luma: NDArray[np.uint8], number: int) -> bytes:
    """All blocks as they are."""
    bits = Bits()
    bits.ue(0, 7, 0)
    bits.u(0, 4)
    bits.ue(number % 2)
    bits.u(0, 2)
    bits.ue(0, 1)
    for block in _blocks(luma):
        bits.ue(25)
        _samples(bits, block)
    return bits.unit(0x65)


def changed_picture(luma: NDArray[np.uint8], changed: Sequence[int], number: int) -> bytes:
    """The blocks ``changed``, counted row by row, as in ``luma``, the others as in the picture before; ``number`` of
    pictures since the key picture."""
    bits = Bits()
    bits.ue(0, 5, 0)
    bits.u(number % 16, 4)
    bits.u(0, 3)
    bits.ue(0, 1)
    blocks, last = _blocks(luma), -1
    for i in changed:
        bits.ue(i - last - 1, 30)
        _samples(bits, blocks[i])
        last = i
    if last + 1 < len(blocks):
        bits.ue(len(blocks) - last - 1)
    return bits.unit(0x41)


def luma_of(grey: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Grey levels in video's range, 16 to 235."""
    return np.rint(16.0 + grey * (219.0 / 255.0)).astype(np.uint8)


def _blocks(luma: NDArray[np.uint8]) -> list[NDArray[np.uint8]]:
    height, width = luma.shape
    return [luma[y : y + _BLOCK, x : x + _BLOCK] for y in range(0, height, _BLOCK) for x in range(0, width, _BLOCK)]


def _samples(bits: Bits, block: NDArray[np.uint8]) -> None:
    bits.samples(block)
    bits.samples(np.full(_BLOCK * _BLOCK // 2, 128, np.uint8))
