"""DBoW2's text form of a vocabulary, as ORB-SLAM2's ``ORBvoc.txt`` has it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from maslam._atomic import write_atomically

from ..errors import FrontendError
from ..files.text_tables import read_text_bytes

_TF_IDF, _L1 = 0, 0
_BLOCK = 50_000
"""Lines read at a time."""


@dataclass(frozen=True)
class TreeArrays:
    """A vocabulary as arrays, the root first: ``parents`` ``(n,)`` int32, ``descriptors`` ``(n, 32)`` uint8,
    ``weights`` ``(n,)`` float64. Nothing of them is checked."""

    branching: int
    depth: int
    parents: NDArray[np.int32]
    descriptors: NDArray[np.uint8]
    weights: NDArray[np.float64]


def write_text(tree: TreeArrays, path: Path) -> None:
    """Header ``k L scoring weighting``, then for nodes 1, 2, ...: parent, 1 for a leaf else 0, 32 bytes, weight."""
    is_leaf = np.bincount(tree.parents[1:], minlength=len(tree.parents)) == 0
    rows = zip(
        tree.parents[1:].tolist(),
        is_leaf[1:].tolist(),
        tree.descriptors[1:].tolist(),
        tree.weights[1:].tolist(),
        strict=True,
    )
    lines = [f"{tree.branching} {tree.depth}  {_L1} {_TF_IDF}"]
    lines += [f"{parent} {leaf:d} {' '.join(map(str, octets))} {weight!r}" for parent, leaf, octets, weight in rows]
    write_atomically(path, "\n".join(lines) + "\n")


def read_text(path: Path) -> TreeArrays:
    """Inverse of :func:`write_text`. Scoring and weighting must be tf-idf and L1, as in every published ORB
    vocabulary."""
    lines = read_text_bytes(path).split(b"\n")
    branching, depth = _header(lines[0], path)
    blocks = [_read_block(lines, first, path) for first in range(1, max(len(lines), 2), _BLOCK)]
    del lines
    number, parents, leaf, octets, weights, wrong = (np.concatenate(columns) for columns in zip(*blocks, strict=True))
    n = len(parents)
    wrong |= (parents < 0) | (parents > np.arange(n)) | ~np.isfinite(weights)
    has_children = np.bincount(parents.clip(0, n), minlength=n + 1)[1:] > 0
    wrong |= leaf & has_children
    for row in np.flatnonzero(wrong)[:1]:
        raise FrontendError(
            f"{path}:{number[row]}: no node of a tree (parent before its child, bytes 0 to 255, no children of a leaf)"
        )
    descriptors = np.concatenate([np.zeros((1, 32), np.uint8), octets])
    ids = np.concatenate([[-1], parents]).astype(np.int32)
    return TreeArrays(branching, depth, ids, descriptors, np.concatenate([[0.0], weights]))


def _read_block(lines: list[bytes], first: int, path: Path) -> tuple[NDArray[Any], ...]:
    """Of the nodes on some lines from ``first`` on: line number, parent, leaf flag, descriptor, weight, and whether a
    byte is none. ORBvoc.txt has a million lines: in one piece, its numbers would take a gigabyte."""
    numbers = [i + 1 for i in range(first, min(first + _BLOCK, len(lines))) if lines[i].strip()]
    bodies, weights = [], []
    for number in numbers:
        head, _, weight = lines[number - 1].strip().rpartition(b" ")
        if head.count(b" ") != 33:
            head = b" ".join(head.split())
            if head.count(b" ") != 33:
                raise FrontendError(
                    f"{path}:{number}: a node has 35 numbers (parent, leaf, 32 bytes, weight), "
                    f"found {head.count(b' ') + 2}"
                )
        bodies.append(head)
        weights.append(weight)
    try:
        table = np.fromstring(b"\n".join(bodies), dtype=np.int64, sep=" ").reshape(len(numbers), 34)
        values = np.array(weights, dtype=np.float64)
    except ValueError:
        raise _broken_line(bodies, weights, numbers, path) from None
    parents, leaf, octets = table[:, 0].copy(), table[:, 1] > 0, table[:, 2:]
    no_byte = np.asarray((octets < 0) | (octets > 255)).any(axis=1)
    return np.array(numbers, dtype=np.int64), parents, leaf, octets.astype(np.uint8), values, np.asarray(no_byte)


def _header(line: bytes, path: Path) -> tuple[int, int]:
    try:
        branching, depth, scoring, weighting = map(int, line.split())
    except ValueError:
        raise FrontendError(
            f"{path}:1: the first line must be four integers (branching, depth, scoring, weighting)"
        ) from None
    if not (2 <= branching <= 20 and 1 <= depth <= 10):
        raise FrontendError(f"{path}:1: branching {branching} (2 to 20) and depth {depth} (1 to 10) cannot be")
    if (scoring, weighting) != (_L1, _TF_IDF):
        raise FrontendError(
            f"{path}:1: scoring {scoring} and weighting {weighting}; only L1 (0) with tf-idf (0) is known"
        )
    return branching, depth


def _broken_line(bodies: list[bytes], weights: list[bytes], numbers: list[int], path: Path) -> FrontendError:
    for body, weight, number in zip(bodies, weights, numbers, strict=True):
        try:
            [int(field) for field in body.split()]
            float(weight)
        except ValueError as error:
            return FrontendError(f"{path}:{number}: not a number: {error}")
    return FrontendError(f"{path}: cannot be read as numbers")
