"""Points of a map that are one place: images show them at one pixel, and none shows them apart.

Odometry makes a point anew where it has lost one, and an agent with depth in each key-frame that finds no known point
near. Results for other programs say which views are of one place.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array
from scipy.spatial import cKDTree

from maslam.backend.components import parts
from maslam.backend.geometry import Array

_SAME_PX = 1.5
"""Views of one image nearer than this are of one place."""
_SAME_DEPTH = 0.05
"""Largest difference in depth of two points that are one, share of the depth: behind an edge lies another place."""


def one_place(
    image: NDArray[np.intp], label: NDArray[np.intp], uv: Array, depth: Array, count: int
) -> NDArray[np.intp]:
    """For each of ``count`` points the first of those that are the same place as it, ``(count,)``.

    View i shows point ``label[i]`` in ``image[i]`` at ``uv[i]``, pixels, ``depth[i]`` in front of the camera; all
    ``(n,)`` but ``uv`` ``(n, 2)``.
    """
    beside = np.zeros((0, 2), dtype=np.intp)
    if len(uv):
        # Images lie far apart along a third axis, so that one search does for all.
        where = np.column_stack([uv, image * (10.0 * _SAME_PX)])
        beside = cKDTree(where).query_pairs(_SAME_PX, output_type="ndarray")
    a, b = depth[beside[:, 0]], depth[beside[:, 1]]
    beside = beside[(np.abs(a - b) < _SAME_DEPTH * np.minimum(a, b))]
    ends = np.sort(label[beside], axis=1)
    pairs, together = np.unique(ends[ends[:, 0] != ends[:, 1]], axis=0, return_counts=True)
    pairs = pairs[together == _common_images(pairs, image, label, count)]
    part = parts(pairs, count)
    first = np.full(count, count)
    np.minimum.at(first, part, np.arange(count))
    return first[part]


def _common_images(
    pairs: NDArray[np.intp], image: NDArray[np.intp], label: NDArray[np.intp], count: int
) -> NDArray[np.intp]:
    """How many images show both points of each pair ``(m, 2)``."""
    shape = count, int(image.max(initial=-1)) + 1
    shown = csr_array((np.ones(len(image), dtype=np.intp), (label, image)), shape=shape)
    return np.asarray(shown[pairs[:, 0]].multiply(shown[pairs[:, 1]]).sum(axis=1)).ravel()
