"""Connected parts of a graph of numbered nodes."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components


def parts(ends: NDArray[np.intp], count: int) -> NDArray[np.intp]:
    """Label ``(count,)`` of the connected part that each node belongs to, by the edges' ``ends`` ``(m, 2)``."""
    joined = coo_array((np.ones(len(ends)), (ends[:, 0], ends[:, 1])), shape=(count, count))
    return np.asarray(connected_components(joined, directed=False)[1])


def first_of_parts(ends: NDArray[np.intp], count: int) -> list[int]:
    """The first node of each connected part of a graph of ``count`` nodes."""
    first: NDArray[np.intp] = np.unique(parts(ends, count), return_index=True)[1]
    return sorted(first.tolist())
