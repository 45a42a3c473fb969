"""A tree of binary words: an ORB descriptor falls to one node a level (Galvez-Lopez and Tardos, DBoW2, T-RO 2012)."""

from __future__ import annotations

from array import array
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
from numba import types
from numba.extending import intrinsic
from numpy.typing import NDArray

from maslam._atomic import write_npz
from maslam._bounded import open_npz
from maslam._kernels import kernel

from ..errors import FrontendError
from .dbow2_text import TreeArrays, read_text, write_text

DEFAULT_PATH = Path(__file__).with_name("vocabulary.npz")
WORD_LEVELS = (3, 4)
"""Levels of the node ids in the five VO files; the root is level 0."""


@dataclass(frozen=True)
class BagOfWords:
    """``words`` ``(n,)`` int32 ascending leaf node ids; ``values`` ``(n,)`` tf-idf weights that sum to 1."""

    words: NDArray[np.int32]
    values: NDArray[np.float64]


class Vocabulary:
    """Nodes numbered as DBoW2 numbers them: 0 is the root, children of one node follow each other, depth first.

    ``parents`` ``(n,)`` int32, -1 for the root, each smaller than the node's own id; ``descriptors`` ``(n, 32)``
    uint8; ``weights`` ``(n,)`` float64, idf of the leaves. A ``ValueError`` where these are no tree.
    """

    def __init__(
        self,
        branching: int,
        depth: int,
        parents: NDArray[np.int32],
        descriptors: NDArray[np.uint8],
        weights: NDArray[np.float64],
    ) -> None:
        n = len(parents)
        if n < 2 or descriptors.shape != (n, 32) or weights.shape != (n,):
            raise ValueError(f"no tree of {n} nodes: descriptors {descriptors.shape}, weights {weights.shape}")
        if parents[0] != -1 or (parents[1:] < 0).any() or (parents[1:] >= np.arange(1, n)).any():
            raise ValueError("a node's parent must come before it, and only the root has none")
        self.branching, self.depth = branching, depth
        self.parents = np.ascontiguousarray(parents, dtype=np.int32)
        self.descriptors = np.ascontiguousarray(descriptors, dtype=np.uint8)
        self.weights = np.where(np.arange(n) > 0, weights, 0.0)
        # Children of one node are made neighbours, so that a descent reads memory in a row, in DBoW2's order.
        self._children = (np.argsort(self.parents[1:], kind="stable") + 1).astype(np.int32)
        counts = np.bincount(self.parents[1:], minlength=n)
        self._begin = np.concatenate([[0], np.cumsum(counts)]).astype(np.int32)
        self._child_bits = self.descriptors[self._children].view(np.uint64)
        self.is_leaf = counts == 0

    def __len__(self) -> int:
        """Number of nodes, the root included."""
        return len(self.parents)

    @property
    def levels(self) -> NDArray[np.int32]:
        """Level of each node ``(n,)``; the root's is 0."""
        levels = np.zeros(len(self), dtype=np.int32)
        for node in range(1, len(self)):
            levels[node] = levels[self.parents[node]] + 1
        return levels

    @classmethod
    def load(cls, path: Path | None = None) -> Vocabulary:
        """A vocabulary of our own binary form (``.npz``) or of DBoW2's text form (any other name); None: the one
        shipped. :class:`FrontendError` for a file that is broken or no tree."""
        path = DEFAULT_PATH if path is None else Path(path)
        tree = _load_npz(path) if path.suffix == ".npz" else read_text(path)
        try:
            return cls(tree.branching, tree.depth, tree.parents, tree.descriptors, tree.weights)
        except ValueError as error:
            raise FrontendError(f"{path}: not a vocabulary: {error}") from error

    def save(self, path: Path) -> None:
        """Write our own binary form, or with a name that does not end in ``.npz`` DBoW2's text form."""
        if path.suffix != ".npz":
            return write_text(
                TreeArrays(self.branching, self.depth, self.parents, self.descriptors, self.weights), path
            )
        arrays = {
            "format": np.array(1),
            "branching": np.array(self.branching),
            "depth": np.array(self.depth),
            "parents": self.parents,
            "descriptors": self.descriptors,
            "weights": self.weights.astype(np.float32),
        }
        return write_npz(path, arrays, compressed=True)

    def words(self, descriptors: NDArray[np.uint8]) -> NDArray[np.int32]:
        """Node ids ``(N, 2)`` at level 3 and level 4 of ORB descriptors ``(N, 32)``; where the tree ends above a
        level, the leaf's."""
        return self._descend(descriptors, np.array(WORD_LEVELS))

    def leaves(self, descriptors: NDArray[np.uint8]) -> NDArray[np.int32]:
        """Leaf node ids ``(N,)``: the words proper."""
        return self._descend(descriptors, np.array([self.depth + 1]))[:, 0]

    def bag(self, descriptors: NDArray[np.uint8]) -> BagOfWords:
        """The tf-idf vector of an image's descriptors ``(N, 32)``; empty where none has a weight."""
        words, counts = np.unique(self.leaves(descriptors), return_counts=True)
        values = np.asarray(counts * self.weights[words], dtype=np.float64)
        weighty = np.flatnonzero(values > 0)
        return BagOfWords(words[weighty], values[weighty] / values[weighty].sum())

    def _descend(self, descriptors: NDArray[np.uint8], levels: NDArray[np.int64]) -> NDArray[np.int32]:
        rows = np.ascontiguousarray(descriptors, dtype=np.uint8)
        if rows.ndim != 2 or rows.shape[1] != 32:
            raise ValueError(f"ORB descriptors are (N, 32) bytes, got {rows.shape}")
        return _descend(rows.view(np.uint64), self._begin, self._children, self._child_bits, levels)


def _load_npz(path: Path) -> TreeArrays:
    try:
        with open_npz(path) as data:
            version = int(data["format"])
            if version != 1:
                raise FrontendError(
                    f"{path}: a vocabulary file of format {version}; this version of maslam reads format 1"
                )
            weights = data["weights"].astype(np.float64)
            return TreeArrays(int(data["branching"]), int(data["depth"]), data["parents"], data["descriptors"], weights)
    except OSError as error:
        raise FrontendError(f"{path}: cannot be read as a vocabulary: {error}") from error
    except (KeyError, ValueError) as error:
        raise FrontendError(f"{path}: not a vocabulary: {error}") from error


class WordIndex:
    """Key-frames by the words they contain: candidates for relocalisation without comparing with every key-frame."""

    def __init__(self) -> None:
        self._count = 0
        self._holders: dict[int, tuple[array[int], array[float]]] = {}  # packed: it grows with every key-frame

    def __len__(self) -> int:
        return self._count

    def add(self, bag: BagOfWords) -> int:
        """Number of the key-frame that this bag becomes, counting from 0."""
        for word, value in zip(bag.words.tolist(), bag.values.tolist(), strict=True):
            numbers, values = self._holders.setdefault(word, (array("q"), array("d")))
            numbers.append(self._count)
            values.append(value)
        self._count += 1
        return self._count - 1

    def most_similar(self, bag: BagOfWords, count: int) -> list[tuple[int, float]]:
        """At most ``count`` key-frames that share words, with their L1 scores, best first; equal scores by number."""
        pairs = zip(bag.words.tolist(), bag.values.tolist(), strict=True)
        known = [(self._holders[word], value) for word, value in pairs if word in self._holders]
        numbers = np.fromiter(chain.from_iterable(held[0] for held, _ in known), dtype=np.int64)
        theirs = np.fromiter(chain.from_iterable(held[1] for held, _ in known), dtype=np.float64)
        lengths = np.array([len(held[0]) for held, _ in known], dtype=np.int64)
        mine = np.repeat(np.array([value for _, value in known]), lengths)
        shared = 0.5 * (mine + theirs - np.abs(mine - theirs))
        scores = np.bincount(numbers, shared, minlength=self._count)
        best = np.argsort(-scores, kind="stable")[:count]
        return [(int(i), float(scores[i])) for i in best if scores[i] > 0]


@intrinsic
def popcount(typing_context: Any, bits: Any) -> Any:
    """Number of ones in a uint64: one machine instruction."""

    def codegen(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.ctpop(arguments[0])

    return types.uint64(types.uint64), codegen


@kernel
def hamming(a: NDArray[np.uint64], i: int, b: NDArray[np.uint64], j: int) -> np.int64:
    """Differing bits of row i of ``a`` ``(n, 4)`` and row j of ``b`` ``(m, 4)``."""
    total = np.int64(0)
    for k in range(4):
        total += np.int64(popcount(a[i, k] ^ b[j, k]))
    return total


@kernel
def _descend(
    rows: NDArray[np.uint64],
    begin: NDArray[np.int32],
    children: NDArray[np.int32],
    child_bits: NDArray[np.uint64],
    levels: NDArray[np.int64],
) -> NDArray[np.int32]:
    """Node ``(N, len(levels))`` reached at each of the ascending ``levels``; the nearest child is taken, of equals
    the first."""
    out = np.empty((len(rows), len(levels)), dtype=np.int32)
    for i in range(len(rows)):
        node, level = 0, 0
        for k in range(len(levels)):
            while level < levels[k] and begin[node] < begin[node + 1]:
                best, nearest = np.int64(257), 0
                for c in range(begin[node], begin[node + 1]):
                    distance = hamming(rows, i, child_bits, c)
                    if distance < best:
                        best, nearest = distance, c
                node = children[nearest]
                level += 1
            out[i, k] = node
    return out
