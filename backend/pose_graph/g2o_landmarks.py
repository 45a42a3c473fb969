"""Landmark lines of g2o files: read as they stand, written under the ids of the result."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np

from ..errors import BackendError
from ..geometry import Array
from .g2o_ids import Ids, symbol
from .graph import PoseGraph
from .landmarks import Landmark, Sighting, hung
from .node import LETTERS, NodeId

_VERTICES = ("VERTEX_XY", "VERTEX_TRACKXYZ", "VERTEX_POINTXYZ")
_SIGHTINGS = re.compile(r"EDGE_(SE2_(POINT)?XY|SE3_(TRACK|POINT)?XYZ|BEARING_SE2_XY|RANGE_SE2_XY)\w*")
_OTHERS = re.compile(r"EDGE_SE3_PROJECT\w*")
_FIRST_LETTER = "l"


@dataclass(frozen=True)
class LandmarkLine:
    """A line of ``file``, number in a set, of which ``where`` says the name and line; ``fields`` behind its tag."""

    file: int
    where: str
    tag: str
    fields: tuple[str, ...]


@dataclass
class LandmarkLines:
    """Those that were read; ``others``: measurements of a kind that is left out."""

    vertices: list[LandmarkLine] = field(default_factory=list)
    sightings: list[LandmarkLine] = field(default_factory=list)
    others: int = 0

    def take(self, line: LandmarkLine) -> bool:
        """Whether it is of a landmark."""
        if line.tag in _VERTICES:
            self.vertices.append(line)
        elif _SIGHTINGS.fullmatch(line.tag):
            self.sightings.append(line)
        elif _OTHERS.fullmatch(line.tag):
            self.others += 1
        else:
            return False
        return True

    def landmarks(self, ids: Ids, files: set[int], graph: PoseGraph) -> tuple[tuple[Landmark, ...], list[str]]:
        """The landmarks of ``files`` whose poses ``graph`` has, and a sentence of what is done with them."""
        seen: dict[tuple[int, int], list[Sighting]] = {}
        lost = self.others
        for line in self.sightings:
            if line.file not in files:
                continue
            node = ids.node(line.file, _id(line, 0), line.where)
            if node in graph.poses:
                key = self._key(ids, line, 1)
                seen.setdefault(key, []).append(Sighting(line.tag, node, " ".join(line.fields[2:])))
            else:
                lost += 1
        found: dict[tuple[int, int], Landmark] = {}
        for line in self.vertices:
            key = self._key(ids, line, 0)
            if line.file in files and key not in found:
                found[key] = hung(key[1], line.tag, _position(line), seen.pop(key, []), graph.poses)
        lost += sum(map(len, seen.values()))
        kept = sum(len(mark.sightings) for mark in found.values())
        notes = []
        if found or kept:
            what = f"{len(found)} landmarks and {kept} measurements of them"
            how = "which alone are optimised: each goes with the first that sees it"
            notes.append(f"{what} are kept beside the poses, {how}")
        if lost:
            notes.append(f"{lost} measurements of landmarks left out, whose pose, landmark or kind is not known")
        return tuple(found.values()), notes

    @staticmethod
    def _key(ids: Ids, line: LandmarkLine, which: int) -> tuple[int, int]:
        """Plain numbers that each file counts for itself mean other landmarks in other files."""
        return (line.file if ids.own_numbers and not ids.symbols else 0), _id(line, which)


def vertex_lines(graph: PoseGraph, plain: bool) -> Iterator[str]:
    """A line for each landmark, where its pose is now."""
    for mark, name in zip(graph.landmarks, names_of(graph, plain), strict=True):
        numbers = mark.position(graph.poses)[: 2 if mark.tag == "VERTEX_XY" else 3]
        yield f"{mark.tag} {name} " + " ".join(f"{v:.12g}" for v in numbers.tolist())


def sighting_lines(graph: PoseGraph, plain: bool) -> Iterator[str]:
    """A line for each measurement, as it was."""
    for mark, name in zip(graph.landmarks, names_of(graph, plain), strict=True):
        for s in mark.sightings:
            yield f"{s.tag} {s.node.index if plain else symbol(s.node)} {name} {s.rest}".rstrip()


def names_of(graph: PoseGraph, plain: bool) -> list[int]:
    """The landmarks' ids: their own, or, where only the poses get symbols, symbols of a letter that no robot has."""
    if plain or graph.symbols:
        return [mark.name for mark in graph.landmarks]
    used = {robot % len(LETTERS) for robot in graph.robots}
    start = LETTERS.index(_FIRST_LETTER)
    letter = next((k for k in (*range(start, len(LETTERS)), *range(start)) if k not in used), start)
    twice = len({mark.name for mark in graph.landmarks}) < len(graph.landmarks)
    return [symbol(NodeId(letter, k if twice else mark.name)) for k, mark in enumerate(graph.landmarks)]


def needs_offset(graph: PoseGraph) -> bool:
    """Whether a measurement names the sensor's offset."""
    return any(s.tag == "EDGE_SE3_TRACKXYZ" for mark in graph.landmarks for s in mark.sightings)


def _id(line: LandmarkLine, which: int) -> int:
    if len(line.fields) <= which or not re.fullmatch(r"\d+", line.fields[which], re.ASCII):
        raise BackendError(f"{line.where}: {line.tag} names no vertex where one is meant")
    return int(line.fields[which])


def _position(line: LandmarkLine) -> Array:
    count = 2 if line.tag == "VERTEX_XY" else 3
    try:
        numbers = np.array([float(x) for x in line.fields[1:]])
    except ValueError:
        numbers = np.zeros(0)
    if len(numbers) != count or not np.isfinite(numbers).all():
        raise BackendError(f"{line.where}: {line.tag} has {count} numbers after its id")
    return np.append(numbers, np.zeros(3 - count))
