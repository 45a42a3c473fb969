"""DBoW2's text form of a vocabulary, as ORB-SLAM2's ``ORBvoc.txt`` has it."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from frontend.errors import FrontendError
from frontend.tables import read_bytes, write_atomically
from frontend.vocabulary import Vocabulary

_TF_IDF, _L1 = 0, 0


def write_text(vocabulary: Vocabulary, path: Path) -> None:
    """Header ``k L scoring weighting``, then for nodes 1, 2, ...: parent, 1 for a leaf else 0, 32 bytes, weight."""
    rows = zip(
        vocabulary.parents[1:].tolist(), vocabulary.is_leaf[1:].tolist(),
        vocabulary.descriptors[1:].tolist(), vocabulary.weights[1:].tolist(),
        strict=True,
    )  # fmt: skip
    lines = [f"{vocabulary.branching} {vocabulary.depth}  {_L1} {_TF_IDF}"]
    lines += [f"{parent} {leaf:d} {' '.join(map(str, octets))} {weight!r}" for parent, leaf, octets, weight in rows]
    write_atomically([(path, "\n".join(lines) + "\n")])


def read_text(path: Path) -> Vocabulary:
    """Inverse of :func:`write_text`. Scoring and weighting must be tf-idf and L1, as in every published ORB
    vocabulary."""
    lines = read_bytes(path).split(b"\n")
    branching, depth = _header(lines[0], path)
    numbers = [i for i, line in enumerate(lines[1:], 2) if line.strip()]
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
    parents = np.concatenate([[-1], table[:, 0]])
    octets = table[:, 2:]
    wrong = (
        (octets < 0).any(axis=1)
        | (octets > 255).any(axis=1)
        | (table[:, 0] < 0)
        | (table[:, 0] > np.arange(len(table)))
    )
    wrong |= ~np.isfinite(values)
    has_children = np.bincount(table[:, 0].clip(0, len(table)), minlength=len(table) + 1)[1:] > 0
    wrong |= (table[:, 1] > 0) & has_children
    for row in np.flatnonzero(wrong)[:1]:
        raise FrontendError(
            f"{path}:{numbers[row]}: no node of a tree (parent before its child, bytes 0 to 255, no children of a leaf)"
        )
    descriptors = np.concatenate([np.zeros((1, 32), np.uint8), octets.astype(np.uint8)])
    try:
        return Vocabulary(branching, depth, parents.astype(np.int32), descriptors, np.concatenate([[0.0], values]))
    except ValueError as error:
        raise FrontendError(f"{path}: not a vocabulary: {error}") from error


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
