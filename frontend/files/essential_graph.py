"""The essential graph of a track: few edges that hold its key-frames together (Mur-Artal et al., ORB-SLAM, 2015,
section III-D; thesis section 2.1.3).

It follows from what the five files hold, so that tracks of other front ends have one too.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from maslam.backend.geometry import product, se3_inverse

from .vo_files import VoTrack

STRONG = 100
"""Map points that two key-frames share for an edge beside the spanning tree: ORB-SLAM's figure."""


@dataclass(frozen=True, eq=False)
class EssentialGraph:
    """E edges between key-frames of one track: ``ends`` ``(E, 2)`` int64 rows of its poses, the lower first, sorted;
    ``T_i_j`` ``(E, 4, 4)`` maps the higher into the lower; ``shared`` ``(E,)`` map points that both see; ``tree``
    ``(E,)`` bool: part of the spanning tree."""

    ends: NDArray[np.int64]
    T_i_j: NDArray[np.float64]
    shared: NDArray[np.int64]
    tree: NDArray[np.bool_]

    def __len__(self) -> int:
        return len(self.ends)


def essential_graph(track: VoTrack, strong: int = STRONG) -> EssentialGraph:
    """Spanning tree, edges of key-frames that follow each other, and those that share at least ``strong`` map points.

    The parent of a key-frame in the tree is the earlier one that shares the most points with it, of equals the latest;
    the one before it where none shares any. Mur-Artal et al., ORB-SLAM, 2015, section III-D.
    """
    shared = shared_points(track)
    wanted = np.triu(shared >= strong, 1)
    k = len(track)
    wanted[np.arange(k - 1), np.arange(1, k)] = True
    parents = np.array([j - 1 - int(np.argmax(shared[j - 1 :: -1, j])) for j in range(1, k)], dtype=np.int64)
    in_tree = np.zeros_like(wanted)
    in_tree[parents, np.arange(1, k)] = True
    ends = np.argwhere(wanted | in_tree).astype(np.int64)
    i, j = ends.T
    T_i_j = product(se3_inverse(track.poses[i]), track.poses[j])
    return EssentialGraph(ends, T_i_j, shared[i, j].astype(np.int64), in_tree[i, j])


def shared_points(track: VoTrack) -> NDArray[np.int64]:
    """``(K, K)``: how many map points each pair of key-frames sees both; the diagonal: how many each sees."""
    from scipy.sparse import csr_array

    keyframe, point = track.observations.T.astype(np.int64)
    ones = np.ones(len(keyframe), dtype=np.int64)
    sees = csr_array((ones, (keyframe, point)), shape=(len(track), max(len(track.points), 1)))
    return np.asarray((sees @ sees.T).toarray(), dtype=np.int64)
