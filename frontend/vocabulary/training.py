"""Growing a vocabulary: hierarchical k-majority clustering of binary descriptors, seeded, with idf weights of the
leaves."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from maslam._kernels import kernel

from .vocabulary import Vocabulary, hamming, popcount

_CANDIDATES = 4  # seeds tried for each centre


def train_vocabulary(
    images: Sequence[NDArray[np.uint8]],
    rng: np.random.Generator,
    branching: int = 10,
    depth: int = 4,
    iterations: int = 12,
) -> Vocabulary:
    """A vocabulary from the ORB descriptors ``(n_i, 32)`` of many images.

    Each node's descriptors are split in ``branching`` clusters: seeds by greedy k-means++ on squared Hamming
    distance, then at most ``iterations`` rounds of assignment and bitwise majority (Grana et al., k-majority, 2013).
    A node of fewer different descriptors than ``branching`` gets as many children. Leaf weights: ``log(images /
    images with the word)``.
    """
    descriptors = np.ascontiguousarray(np.concatenate(list(images)), dtype=np.uint8)
    if len(descriptors) < branching:
        raise ValueError(f"{len(descriptors)} descriptors are too few for a vocabulary with branching {branching}")
    bits = descriptors.view(np.uint64)
    parents, octets = [np.array([-1])], [np.zeros((1, 32), np.uint8)]
    node_of = np.zeros(len(bits), dtype=np.int64)
    first, count = 0, 1
    for _ in range(depth):
        order = np.argsort(node_of, kind="stable")
        begin = np.searchsorted(node_of[order], np.arange(first, first + count + 1))
        draws = rng.random((count, branching, _CANDIDATES))
        centres, assigned = _split_nodes(bits[order], begin, draws, iterations)
        used = np.zeros((count, branching), dtype=bool)
        slot = np.repeat(np.arange(count), np.diff(begin))
        used[slot, assigned] = True
        new_ids = (np.cumsum(used.ravel()) - 1).reshape(used.shape) + first + count
        node_of[order] = new_ids[slot, assigned]
        parents.append(np.nonzero(used)[0] + first)
        octets.append(centres[used].view(np.uint8).reshape(-1, 32))
        first, count = first + count, int(used.sum())
    tree_parents, tree_octets = _depth_first(np.concatenate(parents), np.concatenate(octets))
    bare = Vocabulary(branching, depth, tree_parents, tree_octets, np.zeros(len(tree_parents)))
    return Vocabulary(branching, depth, tree_parents, tree_octets, _idf(bare, images))


def _idf(vocabulary: Vocabulary, images: Sequence[NDArray[np.uint8]]) -> NDArray[np.float64]:
    seen = np.zeros(len(vocabulary), dtype=np.int64)
    for descriptors in images:
        seen[np.unique(vocabulary.leaves(descriptors))] += 1
    return np.where(seen > 0, np.log(len(images) / np.maximum(seen, 1)), 0.0)


def _depth_first(parents: NDArray[np.int64], octets: NDArray[np.uint8]) -> tuple[NDArray[np.int32], NDArray[np.uint8]]:
    """Renumber as DBoW2 does: the children of a node in one block, then the descendants of the first child, of the
    second, ..."""
    children: list[list[int]] = [[] for _ in parents]
    for node, parent in enumerate(parents.tolist()):
        if parent >= 0:
            children[parent].append(node)
    old_of_new, stack = [0], [0]
    while stack:
        inside = children[stack.pop()]
        old_of_new.extend(inside)
        stack.extend(reversed(inside))
    order = np.array(old_of_new)
    new_of_old = np.empty(len(order), dtype=np.int32)
    new_of_old[order] = np.arange(len(order), dtype=np.int32)
    return np.where(parents[order] >= 0, new_of_old[parents[order]], -1).astype(np.int32), octets[order]


@kernel
def _split_nodes(
    bits: NDArray[np.uint64], begin: NDArray[np.int64], draws: NDArray[np.float64], iterations: int
) -> tuple[NDArray[np.uint64], NDArray[np.int64]]:
    """Clusters of each node's descriptors ``bits[begin[n]:begin[n + 1]]``: centres ``(nodes, k, 4)`` and cluster of
    each descriptor."""
    nodes, k = draws.shape[0], draws.shape[1]
    centres = np.zeros((nodes, k, 4), dtype=np.uint64)
    own = np.zeros(len(bits), dtype=np.int64)
    nearest = np.empty(len(bits), dtype=np.int64)
    ones = np.zeros((k, 256), dtype=np.int64)
    for n in range(nodes):
        first, last = begin[n], begin[n + 1]
        if first == last:
            continue
        used = _seed(bits, first, last, draws, n, centres, nearest)
        for _ in range(iterations):
            if not _assign(bits, first, last, centres, n, used, own):
                break
            _majority(bits, first, last, own, centres, n, used, ones)
        _assign(bits, first, last, centres, n, used, own)
    return centres, own


@kernel
def _seed(
    bits: NDArray[np.uint64],
    first: int,
    last: int,
    draws: NDArray[np.float64],
    n: int,
    centres: NDArray[np.uint64],
    nearest: NDArray[np.int64],
) -> int:
    """First centres of node n, each the best of several drawn by squared distance (greedy k-means++); how many
    different ones."""
    nearest[first:last] = 1 << 20
    pick = min(first + int(draws[n, 0, 0] * (last - first)), last - 1)
    for c in range(draws.shape[1]):
        if c > 0:
            total = 0.0
            for i in range(first, last):
                total += float(nearest[i] * nearest[i])
            if total == 0.0:
                return c
            best = np.inf
            for t in range(draws.shape[2]):
                candidate = _drawn(nearest, first, last, draws[n, c, t] * total)
                cost = 0.0
                for i in range(first, last):
                    d = min(nearest[i], hamming(bits, i, bits, candidate))
                    cost += float(d * d)
                if cost < best:
                    best, pick = cost, candidate
        for j in range(4):
            centres[n, c, j] = bits[pick, j]
        for i in range(first, last):
            nearest[i] = min(nearest[i], hamming(bits, i, bits, pick))
    return draws.shape[1]


@kernel
def _drawn(nearest: NDArray[np.int64], first: int, last: int, target: float) -> int:
    """The row at which the running sum of squared distances passes ``target``."""
    for i in range(first, last):
        target -= float(nearest[i] * nearest[i])
        if target < 0.0:
            return i
    return last - 1


@kernel
def _assign(
    bits: NDArray[np.uint64],
    first: int,
    last: int,
    centres: NDArray[np.uint64],
    n: int,
    used: int,
    own: NDArray[np.int64],
) -> bool:
    """Give each row its nearest centre of node n, of equals the first; whether any changed."""
    changed = False
    for i in range(first, last):
        best, nearest = np.int64(257), 0
        for c in range(used):
            distance = np.int64(0)
            for j in range(4):
                distance += np.int64(popcount(bits[i, j] ^ centres[n, c, j]))
            if distance < best:
                best, nearest = distance, c
        changed = changed or own[i] != nearest
        own[i] = nearest
    return changed


@kernel
def _majority(
    bits: NDArray[np.uint64],
    first: int,
    last: int,
    own: NDArray[np.int64],
    centres: NDArray[np.uint64],
    n: int,
    used: int,
    ones: NDArray[np.int64],
) -> None:
    """Centres of node n become the bitwise majority of their rows; a centre without rows stays."""
    ones[:] = 0
    sizes = np.zeros(used, dtype=np.int64)
    for i in range(first, last):
        sizes[own[i]] += 1
        for j in range(4):
            for b in range(64):
                ones[own[i], 64 * j + b] += np.int64((bits[i, j] >> np.uint64(b)) & np.uint64(1))
    for c in range(used):
        for j in range(4):
            value = np.uint64(0)
            for b in range(64):
                if 2 * ones[c, 64 * j + b] >= sizes[c]:
                    value |= np.uint64(1) << np.uint64(b)
            if sizes[c] > 0:
                centres[n, c, j] = value
