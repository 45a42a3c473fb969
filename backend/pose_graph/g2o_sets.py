"""Sets of g2o files: what several of them say of the same edge, and a file that holds all the others again."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

from ..errors import BackendError
from ..geometry import Array, se3_inverse, so3_log
from .g2o_ids import SYMBOL_SHIFT
from .g2o_lines import G2oLine
from .graph import Edge, NodeId

_NEAR = 2e-3
"""Measurements of the same two nodes that differ by less, in metres or as a share of the length and in radians, are one
measurement in other digits: two looks at a place never agree so well."""
_DIGITS = 1e-3
"""As a share of its numbers: a line of a robot's file that stands in another file in other digits."""
_SHOWN = 3
_EVERYTHING = re.compile(
    r"(.*[_-])?(full|all|whole|central(ised|ized)?|merged|joint|combined)(.*graph.*|[_-].*)?", re.I
)


@dataclass
class _Known:
    """An edge as first read: ``T`` maps the second of its nodes (in sorted order) to the first."""

    file: int
    T: Array
    values: bytes
    also_in: set[int] = field(default_factory=set)


class SharedEdges:
    """Edges of a set, each of which counts once however many files hold it: as it is, in other digits, or inverted."""

    def __init__(self) -> None:
        self._known: dict[tuple[NodeId, NodeId], list[_Known]] = {}
        self._again: dict[tuple[NodeId, NodeId], None] = {}
        self._apart: dict[tuple[NodeId, NodeId], None] = {}
        self._twice: dict[tuple[NodeId, NodeId], None] = {}

    def is_new(self, line: G2oLine, edge: Edge) -> bool:
        """Whether no other file holds this edge. What stands twice in one file is two measurements."""
        i, j = edge.i, edge.j
        pair, T = ((i, j), edge.T_i_j) if i < j else ((j, i), se3_inverse(edge.T_i_j))
        here = self._known.setdefault(pair, [])
        others = [one for one in here if one.file != line.file and line.file not in one.also_in]
        values = line.values.tobytes()
        same = next((one for one in others if _near(one.T, T)), None)
        if same is not None:
            same.also_in.add(line.file)
            if same.values != values:
                self._again[pair] = None
            return False
        if any(one.file == line.file and _near(one.T, T) for one in here):
            self._twice[pair] = None
        if others:
            self._apart[pair] = None
        here.append(_Known(line.file, T, values))
        return True

    def lines(self) -> list[str]:
        """A sentence for each thing that a user should know."""
        out = []
        if self._again:
            what = f"{len(self._again)} edges stand in two files in other digits or from the other end, counted once"
            out.append(f"{what}: {_listed(list(self._again))}")
        if self._twice:
            what = f"{len(self._twice)} edges stand twice in one file (the same, in other digits or from the other end)"
            out.append(
                f"{what}, and count twice; leave one line of each if that is not meant: {_listed([*self._twice])}"
            )
        if self._apart:
            what = f"{len(self._apart)} pairs of nodes have different edges in two files, all of which count"
            out.append(f"{what}: {_listed(list(self._apart))}")
        return out


def _near(a: Array, b: Array) -> bool:
    far = np.linalg.norm(a[:3, 3] - b[:3, 3]) > _NEAR * max(1.0, float(np.linalg.norm(a[:3, 3])))
    return not far and float(np.linalg.norm(so3_log(a[:3, :3].T @ b[:3, :3]))) <= _NEAR


def _listed(pairs: Sequence[tuple[NodeId, NodeId]]) -> str:
    more = f" and {len(pairs) - _SHOWN} more" if len(pairs) > _SHOWN else ""
    return ", ".join(f"{i} - {j}" for i, j in pairs[:_SHOWN]) + more


def without_the_whole(files: Sequence[Path], lines: list[G2oLine]) -> tuple[list[G2oLine], list[str]]:
    """The lines without those of a file that holds all that the other files hold, and a note of it.

    Data sets of several robots come with the joint graph beside the robots' files, often under ids of its own; read
    along, it would count every measurement twice. :class:`BackendError` where such a file holds more than the others
    do, or is named like one and cannot be compared.
    """
    if len(files) < 3:
        return lines, []
    for k, path in enumerate(files):
        inside = [line for line in lines if line.file == k]
        outside = [line for line in lines if line.file != k]
        if _holds(inside, outside):
            if _nodes(inside) > _nodes(outside):
                raise BackendError(
                    f"{path}: holds all that the other files hold, and more; read it alone, or not at all"
                )
            return outside, [f"{path} left out: it holds all of the other files again"]
    named = [path for path in files if _EVERYTHING.fullmatch(path.stem)]
    numbered = [path for path in files if path not in named]
    if named and len(numbered) > 1:
        raise BackendError(
            f"{named[0]}: named like a joint graph beside robots' files; read it alone, or name the others"
        )
    return lines, []


def _nodes(lines: Sequence[G2oLine]) -> int:
    """Nodes, by their vertices where there are any. Plain ids of two files may mean two nodes."""
    vertices = [line for line in lines if line.is_vertex] or lines
    return len({(number, -1 if number >> SYMBOL_SHIFT else line.file) for line in vertices for number in line.ids})


def _holds(inside: Sequence[G2oLine], outside: Sequence[G2oLine]) -> bool:
    """Whether every edge of ``outside``, several files, stands in ``inside``, whatever the ids there."""
    mine, theirs = _measured(inside), _measured(_distinct(outside))
    if len({line.file for line in outside if len(line.ids) == 2}) < 2 or _nodes(inside) < _nodes(outside):
        return False
    if not len(mine) or not len(theirs) or mine.shape[1] != theirs.shape[1]:
        return False
    digits = _DIGITS * (1.0 + np.abs(theirs).max(axis=1))
    here = cKDTree(mine).query_ball_point(theirs, digits, return_length=True)
    return bool((here >= cKDTree(theirs).query_ball_point(theirs, digits, return_length=True)).all())


def _distinct(lines: Iterable[G2oLine]) -> list[G2oLine]:
    """One line of those that two files hold of the same edge, from whichever end."""
    return list({(min(line.ids), max(line.ids), _rounded(line)): line for line in lines}.values())


def _rounded(line: G2oLine) -> float:
    """About the length of the way, which both ends measure alike."""
    return float(f"{np.linalg.norm(line.values[: 2 if len(line.values) == 9 else 3]):.3g}")


def _measured(lines: Iterable[G2oLine]) -> Array:
    """The relative poses ``(m, 3)`` or ``(m, 7)`` of edges as they are written."""
    rows = []
    for line in lines:
        if len(line.ids) == 2:
            values = line.values[: 3 if len(line.values) == 9 else 7].copy()
            values[3:] *= np.sign(values[6]) if len(values) == 7 and values[6] else 1.0
            rows.append(values)
    return np.array(rows).reshape(len(rows), -1) if rows else np.zeros((0, 7))
