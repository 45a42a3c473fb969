"""g2o files: one file for a graph, or one per robot, in 3-D and 2-D.

Ids are plain numbers of any size, or gtsam symbols (a letter in the top byte says which robot). In a set of files with
plain ids each file is a robot. Planar graphs are held in 3-D, ``dimension`` 2.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from maslam._atomic import replacing

from ..errors import BackendError
from ..geometry import Array, quat_wxyz_from_rotation, rotation_from_quat_wxyz, se3, so3_exp, so3_log
from .g2o_ids import Ids, symbol
from .graph import Edge, EdgeKind, NodeId, PoseGraph, Prior, spread_poses

_IGNORED = ("#", "FIX", "PARAMS_")
_UNKNOWN_SCALE = 100.0
"""Standard deviation of a log scale that nobody measured."""
_NO_OFFSET = [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]
_UPPER = np.triu_indices(6)
# Rows of a planar measurement (x, y, angle) in the tangent of SE(3), translation first.
_PLANAR = np.ix_([0, 1, 5], [0, 1, 5])
# Numbers after the name; the second is that of ids among them.
_FIELDS = {
    "VERTEX_SE3:QUAT": (8, 1),
    "EDGE_SE3:QUAT": (30, 2),
    "EDGE_SE3_PRIOR": (30, 1),
    "VERTEX_SE2": (4, 1),
    "EDGE_SE2": (11, 2),
    "EDGE_PRIOR_SE2": (10, 1),
}


class _Line(NamedTuple):
    """A line that makes sense by itself: ids as written, and the other numbers."""

    file: int
    where: str
    tag: str
    ids: tuple[int, ...]
    values: Array


def read_g2o(paths: Path | Sequence[Path], skipped: list[str] | None = None) -> PoseGraph:
    """One graph from one file, or from a set with one file per robot.

    Lines are rigid: where nodes have units of length of their own, loops and edges between robots say nothing of them.
    Edges between robots that stand in both robots' files count once; what stands twice in one file counts twice. Nodes
    without a VERTEX line get their pose from the edges, odometry first. A line that makes no sense raises
    :class:`BackendError` with its number; where ``skipped`` is given, it is left out and the message is appended there.
    """
    files = [paths] if isinstance(paths, Path) else list(paths)
    if not files:
        raise BackendError("no g2o file given")
    errors: list[BackendError] = []
    lines = [line for k, path in enumerate(files) for line in _lines(k, path, errors)]
    reading = _Reading(Ids([(line.file, line.tag.startswith("VERTEX"), line.ids) for line in lines]))
    for line in lines:
        try:
            reading.take(line)
        except BackendError as error:
            errors.append(error)
    if errors and skipped is None:
        raise errors[0]
    if skipped is not None:
        skipped += map(str, errors)
    return reading.graph(files[0])


class _Reading:
    """State of the reading so far."""

    def __init__(self, ids: Ids) -> None:
        self.ids = ids
        self.poses: dict[NodeId, Array] = {}
        self.edges: list[Edge] = []
        self.priors: list[Prior] = []
        self.shared: dict[tuple[NodeId, NodeId, bytes], int] = {}
        self.dimensions: set[int] = set()

    def take(self, line: _Line) -> None:
        nodes = [self.ids.node(line.file, i, line.where) for i in line.ids]
        dimension = 2 if line.tag.endswith("SE2") else 3
        if line.tag.startswith("VERTEX"):
            self.poses[nodes[0]] = _pose(line.values, line.where)
        elif len(nodes) == 1:
            T, information = _measurement(line.values, line.where)
            self.priors.append(Prior(nodes[0], T, information))
        else:
            self._take_edge(line, *nodes)
        self.dimensions.add(dimension)

    def _take_edge(self, line: _Line, i: NodeId, j: NodeId) -> None:
        if i == j:
            raise BackendError(f"{line.where}: an edge from node {i} to itself")
        T_i_j, information = _measurement(line.values, line.where)
        between = i.robot != j.robot
        if between and self.shared.setdefault((i, j, line.values.tobytes()), line.file) != line.file:
            return
        self.edges.append(Edge(i, j, T_i_j, information, EdgeKind.SEPARATOR if between else EdgeKind.LOOP))

    def graph(self, first: Path) -> PoseGraph:
        if not self.poses and not self.edges:
            raise BackendError(f"{first}: no vertex and no edge in this graph")
        if len(self.dimensions) > 1:
            raise BackendError(f"{first}: 2-D and 3-D lines in one graph")
        lonely = sorted({p.node for p in self.priors} - set(self.poses) - {n for e in self.edges for n in (e.i, e.j)})
        known = self.poses | {p.node: p.T_O_i for p in self.priors if p.node in lonely}
        edges = [_without_scale(e) for e in _with_odometry(self.edges, known)]
        return PoseGraph(spread_poses(known, edges), tuple(edges), self.dimensions.pop(), tuple(self.priors))


def _without_scale(e: Edge) -> Edge:
    """An SE3 line measures no scale: where nodes have units of their own, a loop or separator leaves them open."""
    return e if e.kind is EdgeKind.ODOMETRY else replace(e, scale_sigma=_UNKNOWN_SCALE)


def _with_odometry(edges: list[Edge], poses: dict[NodeId, Array]) -> list[Edge]:
    """Name as odometry the first edge between two nodes of a robot that follow each other (its indices may have
    gaps).
    """
    nodes = sorted(set(poses) | {n for e in edges for n in (e.i, e.j)})
    rank = {n: k for k, n in enumerate(nodes)}
    seen: set[int] = set()
    out = []
    for e in edges:
        low, high = sorted((rank[e.i], rank[e.j]))
        if e.kind is EdgeKind.LOOP and high - low == 1 and low not in seen:
            seen.add(low)
            e = replace(e, kind=EdgeKind.ODOMETRY)
        out.append(e)
    return out


def write_g2o(path: Path, graph: PoseGraph, plain_ids: bool = False) -> None:
    """All poses and edges of ``graph``; ids are gtsam symbols (readable by gtsam and by the multi-robot tools) or
    plain indices.
    """
    if plain_ids and len(graph.robots) > 1:
        raise BackendError(f"{path}: plain ids cannot tell {len(graph.robots)} robots apart")
    flat = graph.dimension == 2
    with replacing(path) as part, open(part, "w", encoding="ascii", newline="\n") as out:
        tag = "VERTEX_SE2" if flat else "VERTEX_SE3:QUAT"
        for node, pose in zip(graph.nodes, _pose_texts([graph.poses[n] for n in graph.nodes], flat), strict=True):
            out.write(f"{tag} {_id(node, plain_ids)} {pose}\n")
        tag = "EDGE_SE2" if flat else "EDGE_SE3:QUAT"
        for e, pose in zip(graph.edges, _pose_texts([e.T_i_j for e in graph.edges], flat), strict=True):
            pair = f"{_id(e.i, plain_ids)} {_id(e.j, plain_ids)}"
            out.write(f"{tag} {pair} {pose} {_upper_text(e.information, flat)}\n")
        if graph.priors and not flat:
            out.write("PARAMS_SE3OFFSET 0 0 0 0 0 0 0 1\n")
        tag, which = ("EDGE_PRIOR_SE2", "") if flat else ("EDGE_SE3_PRIOR", "0 ")
        for p, pose in zip(graph.priors, _pose_texts([p.T_O_i for p in graph.priors], flat), strict=True):
            out.write(f"{tag} {_id(p.node, plain_ids)} {which}{pose} {_upper_text(p.information, flat)}\n")


def _lines(file: int, path: Path, errors: list[BackendError]) -> list[_Line]:
    try:
        text = path.read_text(encoding="ascii", errors="replace")
    except OSError as error:
        raise BackendError(f"{path}: cannot be read: {error.strerror}") from error
    out = []
    for number, line in enumerate(text.splitlines(), 1):
        tag, *fields = line.split() or ["#"]
        where = f"{path}:{number}"
        if tag == "PARAMS_SE3OFFSET" and [float(v) for v in fields[1:]] != _NO_OFFSET:
            errors.append(BackendError(f"{where}: a sensor's offset from the node's frame is not supported"))
        if tag.startswith(_IGNORED):
            continue
        try:
            out.append(_parsed(file, where, tag, fields))
        except BackendError as error:
            errors.append(error)
    return out


def _parsed(file: int, where: str, tag: str, fields: list[str]) -> _Line:
    if tag not in _FIELDS:
        raise BackendError(f"{where}: unknown line {tag!r}; known are {', '.join(_FIELDS)}")
    count, ids = _FIELDS[tag]
    if len(fields) != count:
        raise BackendError(f"{where}: {tag} has {count} fields after its name, found {len(fields)}")
    for text in fields[:ids]:
        if not text.isdigit():
            raise BackendError(f"{where}: {text!r} is not a node id (a whole number from 0)")
    # g2o's 3-D prior names the sensor's offset after the node; only the node's own frame is known here.
    first = ids + 1 if tag == "EDGE_SE3_PRIOR" else ids
    try:
        values = np.array(fields[first:], dtype=np.float64)
    except ValueError as error:
        raise BackendError(f"{where}: not a number: {error}") from error
    if not np.isfinite(values).all():
        raise BackendError(f"{where}: NaN or infinity in the line")
    return _Line(file, where, tag, tuple(int(text) for text in fields[:ids]), values)


def _id(node: NodeId, plain: bool) -> int:
    return node.index if plain else symbol(node)


def _pose(values: Array, where: str) -> Array:
    """From ``x y z qx qy qz qw`` or ``x y angle``."""
    if len(values) == 3:
        return se3(so3_exp([0.0, 0.0, values[2]]), [values[0], values[1], 0.0])
    norm = float(np.linalg.norm(values[3:7]))
    if abs(norm - 1.0) > 0.05:
        raise BackendError(f"{where}: the quaternion's length is {norm:.3f}, expected 1")
    return se3(rotation_from_quat_wxyz(values[[6, 3, 4, 5]]), values[:3])


def _measurement(values: Array, where: str) -> tuple[Array, Array]:
    """A relative pose and its information, from the numbers after the ids."""
    information = np.eye(6)
    if len(values) == 9:
        a, b, c, d, e, f = values[3:]
        information[_PLANAR] = [[a, b, c], [b, d, e], [c, e, f]]
        return _pose(values[:3], where), information
    information[_UPPER] = values[7:]
    return _pose(values[:7], where), np.triu(information) + np.triu(information, 1).T


def _upper_text(information: Array, flat: bool) -> str:
    shown = information[_PLANAR] if flat else information
    return _numbers_text(shown[np.triu_indices(len(shown))].tolist())


def _pose_texts(poses: Sequence[Array], flat: bool) -> list[str]:
    T = np.array(poses).reshape(-1, 4, 4)
    if flat:
        rows = np.column_stack([T[:, :2, 3], so3_log(T[:, :3, :3])[:, 2]])
    else:
        q = quat_wxyz_from_rotation(T[:, :3, :3])
        q = np.where(q[:, :1] < 0, -1.0, 1.0) * q
        rows = np.column_stack([T[:, :3, 3], q[:, 1:], q[:, 0]])
    return [_numbers_text(row) for row in rows.tolist()]


def _numbers_text(values: Sequence[float]) -> str:
    return " ".join([f"{v:.12g}" for v in values])
