"""Images of two cameras, of one moment each."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def same_moment(
    stamps_ns: NDArray[np.int64], others_ns: NDArray[np.int64], tolerance_ns: int
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Numbers in ``stamps_ns`` and in ``others_ns`` (both ascending) of the images that are nearest to each other in
    time, mutually, and at most ``tolerance_ns`` apart."""
    if not len(stamps_ns) or not len(others_ns):
        return np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.int64)
    to_other, back = _nearest(stamps_ns, others_ns), _nearest(others_ns, stamps_ns)
    mutual = back[to_other] == np.arange(len(stamps_ns))
    kept = np.flatnonzero(mutual & (np.abs(others_ns[to_other] - stamps_ns) <= tolerance_ns))
    return kept, to_other[kept]


def _nearest(stamps_ns: NDArray[np.int64], among_ns: NDArray[np.int64]) -> NDArray[np.int64]:
    after = np.clip(np.searchsorted(among_ns, stamps_ns), 0, len(among_ns) - 1)
    before = np.maximum(after - 1, 0)
    return np.where(stamps_ns - among_ns[before] <= among_ns[after] - stamps_ns, before, after)
