"""g2o files: one file for a graph, or one a robot, in 3-D and 2-D.

Ids are plain numbers, or gtsam symbols (a letter in the top byte says which robot). Planar graphs are held in 3-D,
``dimension`` 2.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from backend.errors import BackendError
from backend.geometry import Array, quat_wxyz_from_rotation, rotation_from_quat_wxyz, se3, so3_exp, so3_log
from backend.graph import Edge, EdgeKind, NodeId, PoseGraph, spread_poses

_SYMBOL_SHIFT = 56
_LETTERS = "abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ"
_IGNORED = ("FIX", "PARAMS")
_UPPER = np.triu_indices(6)
# Rows of a planar measurement (x, y, angle) in the tangent of SE(3), translation first.
_PLANAR = np.ix_([0, 1, 5], [0, 1, 5])
_FIELDS = {"VERTEX_SE3:QUAT": 8, "EDGE_SE3:QUAT": 30, "VERTEX_SE2": 4, "EDGE_SE2": 11}


def read_g2o(paths: Path | Sequence[Path], skipped: list[str] | None = None) -> PoseGraph:
    """One graph from one file, or from a set with one file a robot.

    Edges between robots that stand in both robots' files count once. Nodes without a VERTEX line get their pose from
    the edges, odometry first. A line that makes no sense raises :class:`BackendError` with its number; where
    ``skipped`` is given, it is left out and the message is appended there.
    """
    files = [paths] if isinstance(paths, Path) else list(paths)
    if not files:
        raise BackendError("no g2o file given")
    reading = _Reading()
    for path in files:
        for number, tag, fields in _lines(path):
            try:
                reading.take(path, f"{path}:{number}", tag, fields)
            except BackendError as error:
                if skipped is None:
                    raise
                skipped.append(str(error))
    return reading.graph(files[0])


class _Reading:
    """What has been read so far."""

    def __init__(self) -> None:
        self.poses: dict[NodeId, Array] = {}
        self.edges: list[Edge] = []
        self.shared: dict[tuple[NodeId, NodeId, bytes], Path] = {}
        self.dimensions: set[int] = set()

    def take(self, path: Path, where: str, tag: str, fields: list[str]) -> None:
        values = _numbers(tag, fields, where)
        self.dimensions.add(2 if tag.endswith("SE2") else 3)
        if tag.startswith("VERTEX"):
            self.poses[_node(fields[0], where)] = _pose(values[1:], where)
            return
        edge = _edge(_node(fields[0], where), _node(fields[1], where), values[2:], where)
        if edge.is_separator and self.shared.setdefault((edge.i, edge.j, values.tobytes()), path) != path:
            return
        self.edges.append(edge)

    def graph(self, first: Path) -> PoseGraph:
        if not self.poses and not self.edges:
            raise BackendError(f"{first}: no vertex and no edge in this graph")
        if len(self.dimensions) > 1:
            raise BackendError(f"{first}: 2-D and 3-D lines in one graph")
        return PoseGraph(spread_poses(self.poses, self.edges), tuple(self.edges), self.dimensions.pop())


def write_g2o(path: Path, graph: PoseGraph, plain_ids: bool = False) -> None:
    """All poses and edges of ``graph``; ids are gtsam symbols (readable by gtsam and by the multi-robot tools) or
    plain indices.
    """
    if plain_ids and len(graph.robots) > 1:
        raise BackendError(f"{path}: plain ids cannot tell {len(graph.robots)} robots apart")
    flat = graph.dimension == 2
    with open(path, "w", encoding="ascii") as out:
        for node in graph.nodes:
            tag = "VERTEX_SE2" if flat else "VERTEX_SE3:QUAT"
            out.write(f"{tag} {_id(node, plain_ids)} {_pose_text(graph.poses[node], flat)}\n")
        for e in graph.edges:
            tag, information = ("EDGE_SE2", e.information[_PLANAR]) if flat else ("EDGE_SE3:QUAT", e.information)
            upper = " ".join(f"{v:.12g}" for v in information[np.triu_indices(len(information))])
            out.write(f"{tag} {_id(e.i, plain_ids)} {_id(e.j, plain_ids)} {_pose_text(e.T_i_j, flat)} {upper}\n")


def _lines(path: Path) -> list[tuple[int, str, list[str]]]:
    try:
        text = path.read_text(encoding="ascii", errors="replace")
    except OSError as error:
        raise BackendError(f"{path}: cannot be read: {error.strerror}") from error
    out = []
    for number, line in enumerate(text.splitlines(), 1):
        tag, *fields = line.split() or ["#"]
        if not tag.startswith(("#", *_IGNORED)):
            out.append((number, tag, fields))
    return out


def _numbers(tag: str, fields: list[str], where: str) -> Array:
    if tag not in _FIELDS:
        raise BackendError(f"{where}: unknown line {tag!r}; known are {', '.join(_FIELDS)}")
    if len(fields) != _FIELDS[tag]:
        raise BackendError(f"{where}: {tag} has {_FIELDS[tag]} fields after its name, found {len(fields)}")
    try:
        values = np.array(fields, dtype=np.float64)
    except ValueError as error:
        raise BackendError(f"{where}: not a number: {error}") from error
    if not np.isfinite(values).all():
        raise BackendError(f"{where}: NaN or infinity in the line")
    return values


def _node(text: str, where: str) -> NodeId:
    if not text.isdigit():
        raise BackendError(f"{where}: {text!r} is not a node id (a whole number from 0)")
    number = int(text)
    letter, index = number >> _SYMBOL_SHIFT, number & ((1 << _SYMBOL_SHIFT) - 1)
    if letter == 0:
        return NodeId(0, index)
    # Robots are counted a to z, then A to Z; in ASCII upper case would come first.
    robot = _LETTERS.find(chr(letter)) if letter < 128 else -1
    if robot < 0:
        raise BackendError(f"{where}: id {text} is neither a plain number nor a symbol of a letter and an index")
    return NodeId(robot, index)


def _id(node: NodeId, plain: bool) -> int:
    if plain:
        return node.index
    if node.robot >= len(_LETTERS):
        raise BackendError(f"g2o symbols can name {len(_LETTERS)} robots, not robot {node.robot}")
    return (ord(_LETTERS[node.robot]) << _SYMBOL_SHIFT) | node.index


def _pose(values: Array, where: str) -> Array:
    """From ``x y z qx qy qz qw`` or ``x y angle``."""
    if len(values) == 3:
        return se3(so3_exp([0.0, 0.0, values[2]]), [values[0], values[1], 0.0])
    norm = float(np.linalg.norm(values[3:7]))
    if abs(norm - 1.0) > 0.05:
        raise BackendError(f"{where}: the quaternion's length is {norm:.3f}, expected 1")
    return se3(rotation_from_quat_wxyz(values[[6, 3, 4, 5]]), values[:3])


def _edge(i: NodeId, j: NodeId, values: Array, where: str) -> Edge:
    if i == j:
        raise BackendError(f"{where}: an edge from node {i} to itself")
    information = np.eye(6)
    if len(values) == 9:
        T_i_j = _pose(values[:3], where)
        a, b, c, d, e, f = values[3:]
        information[_PLANAR] = [[a, b, c], [b, d, e], [c, e, f]]
    else:
        T_i_j = _pose(values[:7], where)
        information[_UPPER] = values[7:]
        information = np.triu(information) + np.triu(information, 1).T
    if i.robot != j.robot:
        kind = EdgeKind.SEPARATOR
    else:
        kind = EdgeKind.ODOMETRY if abs(i.index - j.index) == 1 else EdgeKind.LOOP
    return Edge(i, j, T_i_j, information, kind)


def _pose_text(T: Array, flat: bool) -> str:
    if flat:
        return " ".join(f"{v:.12g}" for v in (T[0, 3], T[1, 3], so3_log(T[:3, :3])[2]))
    w, x, y, z = quat_wxyz_from_rotation(T[:3, :3])
    sign = -1.0 if w < 0 else 1.0
    return " ".join(f"{v:.12g}" for v in (*T[:3, 3], sign * x, sign * y, sign * z, sign * w))
