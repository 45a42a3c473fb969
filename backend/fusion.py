"""Joining maps of points: from one frame to another, duplicates merged."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from .components import parts
from .errors import BackendError
from .geometry import Array


@dataclass(frozen=True, eq=False)
class PointMap:
    """``points`` ``(n, 3)``, ``descriptors`` ``(n, 32)`` uint8 or None, ``owners`` ``(n,)``: the robot each point
    comes from.
    """

    points: Array
    owners: NDArray[np.int32]
    descriptors: NDArray[np.uint8] | None = None

    def __post_init__(self) -> None:
        n = len(self.points)
        if self.points.shape != (n, 3) or self.owners.shape != (n,):
            raise BackendError(
                f"a map needs (n, 3) points and (n,) owners, got {self.points.shape} and {self.owners.shape}"
            )
        if self.descriptors is not None and self.descriptors.shape != (n, 32):
            raise BackendError(f"{n} points need ({n}, 32) descriptors, got {self.descriptors.shape}")


def fuse(maps: Sequence[PointMap], radius: float, max_hamming: int = 50) -> tuple[PointMap, NDArray[np.intp]]:
    """One map of several that stand in one frame: points of different maps that are the same are merged into their
    mean. With it the label ``(n,)`` of each point of all maps in their order: which merged point it became.

    Same: within ``radius`` (in the frame's unit) and, where both maps have descriptors, at most ``max_hamming`` bits
    apart. The first point's owner and descriptor stay; there are descriptors if all maps have them. Order of input
    decides order of output, nothing else.
    """
    labels = _associate(maps, radius, max_hamming)
    return _merged(maps, labels), labels


def _associate(maps: Sequence[PointMap], radius: float, max_hamming: int) -> NDArray[np.intp]:
    """Labels count from 0 in order of first appearance."""
    sizes = [len(m.points) for m in maps]
    if not sum(sizes):
        return np.zeros(0, dtype=np.intp)
    points = np.concatenate([m.points for m in maps])
    number = np.repeat(np.arange(len(maps)), sizes)
    pairs = cKDTree(points).query_pairs(radius, output_type="ndarray")
    pairs = pairs[number[pairs[:, 0]] != number[pairs[:, 1]]]
    described = np.array([m.descriptors is not None for m in maps])[number]
    if described.any():
        blank = np.zeros((0, 32), dtype=np.uint8)
        bits = np.zeros((len(points), 32), dtype=np.uint8)
        bits[described] = np.concatenate([blank if m.descriptors is None else m.descriptors for m in maps])
        apart = np.bitwise_count(bits[pairs[:, 0]] ^ bits[pairs[:, 1]]).sum(axis=1, dtype=np.int64)
        pairs = pairs[(apart <= max_hamming) | ~described[pairs].all(axis=1)]
    pairs = _mutual(pairs, points)
    _, first, inverse = np.unique(parts(pairs, len(points)), return_index=True, return_inverse=True)
    rank = np.empty(len(first), dtype=np.intp)
    rank[np.argsort(first, kind="stable")] = np.arange(len(first))
    return rank[inverse]


def _merged(maps: Sequence[PointMap], labels: NDArray[np.intp]) -> PointMap:
    """Each point the mean of those with its label."""
    maps = [m for m in maps if len(m.points)]
    if not maps:
        return PointMap(np.zeros((0, 3)), np.zeros(0, dtype=np.int32))
    points = np.concatenate([m.points for m in maps])
    owners = np.concatenate([m.owners for m in maps])
    count = np.bincount(labels)
    mean = np.stack([np.bincount(labels, weights=points[:, a]) / count for a in range(3)], axis=1)
    first = np.unique(labels, return_index=True)[1]
    descriptors = [m.descriptors for m in maps if m.descriptors is not None]
    kept = np.concatenate(descriptors)[first] if len(descriptors) == len(maps) else None
    return PointMap(mean, owners[first], kept)


def _mutual(pairs: NDArray[np.intp], points: Array) -> NDArray[np.intp]:
    """Of all close pairs only those in which each is the other's nearest partner: else chains would grow along
    surfaces.
    """
    if not len(pairs):
        return pairs
    distance = np.linalg.norm(points[pairs[:, 0]] - points[pairs[:, 1]], axis=1)
    order = np.lexsort((pairs[:, 1], pairs[:, 0], distance))
    rank = np.arange(len(order))
    best = np.full(len(points), len(order))
    for side in range(2):
        np.minimum.at(best, pairs[order, side], rank)
    mutual = (best[pairs[order, 0]] == rank) & (best[pairs[order, 1]] == rank)
    return pairs[order[mutual]]
