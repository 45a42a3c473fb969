"""All textures of a world in one flat array with their mip-maps, so that compiled shading can read any of them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

LEVELS = 14
"""Mip levels kept a texture; level k is the texture averaged over 2^k x 2^k texels."""


@dataclass(frozen=True)
class Atlas:
    """``texels`` flat uint8, RGB interleaved, display-encoded; ``table`` ``(t, LEVELS, 3)``: offset in texels, width,
    height; ``texel_m`` ``(t, 2)``: metres a texel at level 0; ``clamped`` ``(t,)``: outside repeats the border instead
    of the texture; ``materials`` ``(m, 3)``: base, detail and macro texture of each material (-1 = none)."""

    texels: NDArray[np.uint8]
    table: NDArray[np.int64]
    texel_m: NDArray[np.float64]
    clamped: NDArray[np.bool_]
    materials: NDArray[np.int32]


class AtlasBuilder:
    """Collects textures and materials; ``build`` makes the mip-maps and the flat array."""

    def __init__(self) -> None:
        self._levels: list[list[NDArray[np.uint8]]] = []
        self._texel_m: list[tuple[float, float]] = []
        self._clamped: list[bool] = []
        self._materials: list[tuple[int, int, int]] = []

    def texture(self, image: NDArray[np.uint8], width_m: float, height_m: float, clamped: bool = False) -> int:
        """Add ``image`` ``(h, w, 3)`` or ``(h, w)``, which covers ``width_m`` x ``height_m``; sides of repeating
        textures must be powers of two (their mip-maps would not repeat otherwise). Returns its number."""
        if image.ndim == 2:
            image = np.repeat(image[:, :, None], 3, axis=2)
        h, w = image.shape[:2]
        if not clamped and (w & (w - 1) or h & (h - 1)):
            raise ValueError(f"a repeating texture needs sides that are powers of two, not {w}x{h}")
        self._levels.append(_mip_chain(np.ascontiguousarray(image, dtype=np.uint8)))
        self._texel_m.append((width_m / w, height_m / h))
        self._clamped.append(clamped)
        return len(self._levels) - 1

    def material(self, base: int, detail: int = -1, macro: int = -1) -> int:
        """A surface whose albedo is ``base`` times ``detail`` times ``macro`` (both grey, 128 = unchanged). Returns
        its number."""
        self._materials.append((base, detail, macro))
        return len(self._materials) - 1

    def build(self) -> Atlas:
        """All textures with their coarser levels in one array, and the table that finds them."""
        table = np.zeros((len(self._levels), LEVELS, 3), np.int64)
        offset = 0
        for t, levels in enumerate(self._levels):
            for k in range(LEVELS):
                level = levels[min(k, len(levels) - 1)]
                if k < len(levels):
                    table[t, k] = (offset, level.shape[1], level.shape[0])
                    offset += level.shape[0] * level.shape[1]
                else:
                    table[t, k] = table[t, k - 1]
        texels = np.empty((offset, 3), np.uint8)
        for t, levels in enumerate(self._levels):
            for k, level in enumerate(levels):
                texels[table[t, k, 0] : table[t, k, 0] + level.shape[0] * level.shape[1]] = level.reshape(-1, 3)
            levels.clear()
        return Atlas(
            texels.reshape(-1),
            table,
            np.array(self._texel_m, np.float64),
            np.array(self._clamped),
            np.array(self._materials, np.int32).reshape(-1, 3),
        )


def _mip_chain(image: NDArray[np.uint8]) -> list[NDArray[np.uint8]]:
    """Halved by 2x2 means down to one texel (odd sides round down: only clamped textures have them)."""
    import cv2

    levels = [image]
    while max(levels[-1].shape[:2]) > 1 and len(levels) < LEVELS:
        h, w = levels[-1].shape[:2]
        half = cv2.resize(levels[-1], (max(w // 2, 1), max(h // 2, 1)), interpolation=cv2.INTER_AREA)
        levels.append(half.reshape(max(h // 2, 1), max(w // 2, 1), 3))
    return levels
