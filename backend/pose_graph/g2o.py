"""g2o files: one file for a graph, or one per robot, in 3-D and 2-D.

Ids are plain numbers of any size, or gtsam symbols (a letter in the top byte says which robot). In a set of files with
plain ids each file is a robot. Planar graphs are held in 3-D, ``dimension`` 2.
"""

from __future__ import annotations

import logging
from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from maslam._atomic import replacing

from ..errors import BackendError
from ..geometry import Array, quat_wxyz_from_rotation, so3_log
from .g2o_copies import check_given_once, copies
from .g2o_ids import Ids, symbol
from .g2o_landmarks import needs_offset, sighting_lines, vertex_lines
from .g2o_lines import PLANAR, G2oLine, Remarks, measurement_of, pose_of, read_lines
from .g2o_sets import SharedEdges, without_the_whole
from .graph import Edge, EdgeKind, NodeId, PoseGraph, Prior, spread_poses

_UNKNOWN_SCALE = 100.0
"""Standard deviation of a log scale that nobody measured."""
log = logging.getLogger(__name__)


def read_g2o(
    paths: Path | Sequence[Path], skipped: list[str] | None = None, notes: list[str] | None = None
) -> PoseGraph:
    """One graph from one file, or from a set with one file per robot.

    Lines are rigid: where nodes have units of length of their own, loops and edges between robots say nothing of them.
    Edges that stand in two files of a set count once, also inverted or in other digits; what stands twice in one file
    counts twice. Nodes without a VERTEX line get their pose from the edges, odometry first. Landmarks are kept beside
    the poses. A line that makes no sense raises :class:`BackendError` with its number; where ``skipped`` is given, it
    is left out and the message is appended there. What else a user should know goes to ``notes``, without them to the
    log.
    """
    files = [paths] if isinstance(paths, Path) else list(paths)
    if not files:
        raise BackendError("no g2o file given")
    check_given_once(files)
    errors: list[BackendError] = []
    remarks = Remarks()
    lines = [line for k, path in enumerate(files) for line in read_lines(k, path, errors, remarks)]
    alike = copies(files, lines)
    lines, found = without_the_whole(files, lines)
    found += alike
    reading = _Reading(Ids([(line.file, line.is_vertex, line.ids) for line in lines]))
    for line in lines:
        try:
            reading.take(line)
        except BackendError as error:
            errors.append(error)
    if errors and skipped is None:
        raise errors[0]
    if skipped is not None:
        skipped += map(str, errors)
    graph = reading.graph(files[0])
    landmarks, of_landmarks = remarks.landmarks.landmarks(reading.ids, {line.file for line in lines}, graph)
    fixed = [(reading.ids.node(*one), one[2]) for one in remarks.fixed]
    held = frozenset(node for node, _ in fixed if node in graph.poses)
    found += [f"{where}: FIX of {node}, of which there is no pose" for node, where in fixed if node not in graph.poses]
    graph = replace(graph, landmarks=landmarks, fixed=held)
    found += of_landmarks + remarks.lines() + reading.shared.lines() + reading.conflicts() + reading.without_vertex()
    if notes is None:
        for note in found:
            log.warning("%s: %s", files[0] if len(files) == 1 else f"{len(files)} files", note)
    else:
        notes += found
    return graph


class _Reading:
    """State of the reading so far."""

    def __init__(self, ids: Ids) -> None:
        self.ids = ids
        self.vertices: dict[NodeId, dict[int, Array]] = {}
        self.edges: list[Edge] = []
        self.priors: list[Prior] = []
        self.shared = SharedEdges()
        self.dimensions: dict[int, str] = {}
        self._moved: dict[NodeId, None] = {}
        self._named: dict[NodeId, str] = {}

    def take(self, line: G2oLine) -> None:
        nodes = [self.ids.node(line.file, i, line.where) for i in line.ids]
        dimension = 2 if line.tag.endswith("SE2") else 3
        if line.is_vertex:
            self._take_vertex(line, nodes[0])
        elif len(nodes) == 1:
            T, information = measurement_of(line.values, line.where)
            self.priors.append(Prior(nodes[0], T, information))
            self._named.setdefault(nodes[0], f"{line.where}: a prior of vertex {line.ids[0]}")
        else:
            self._take_edge(line, *nodes)
        self.dimensions.setdefault(dimension, line.where)

    def _take_vertex(self, line: G2oLine, node: NodeId) -> None:
        """The first of a file counts, as in g2o."""
        pose = pose_of(line.values, line.where)
        first = self.vertices.setdefault(node, {}).setdefault(line.file, pose)
        if not np.allclose(first, pose, rtol=1e-4, atol=1e-4):
            self._moved[node] = None

    def _take_edge(self, line: G2oLine, i: NodeId, j: NodeId) -> None:
        if i == j:
            raise BackendError(f"{line.where}: an edge from node {i} to itself")
        T_i_j, information = measurement_of(line.values, line.where)
        for node, written in zip((i, j), line.ids, strict=True):
            if node not in self._named:
                self._named[node] = f"{line.where}: an edge to vertex {written}"
        edge = Edge(i, j, T_i_j, information, EdgeKind.SEPARATOR if i.robot != j.robot else EdgeKind.LOOP)
        if self.shared.is_new(line, edge):
            self.edges.append(edge)

    def without_vertex(self) -> list[str]:
        """A sentence where edges and priors are of nodes of which no file has the pose, though the files have poses."""
        missing = [node for node in self._named if node not in self.vertices] if self.vertices else []
        if not missing:
            return []
        more = f"; {len(missing) - 1} more like this" if len(missing) > 1 else ""
        return [f"{self._named[missing[0]]}, which no VERTEX line gives: its pose is taken from there{more}"]

    def conflicts(self) -> list[str]:
        """A sentence where a file gives a node two poses."""
        nodes = list(self._moved)
        if not nodes:
            return []
        shown = ", ".join(map(str, nodes[:3])) + (f" and {len(nodes) - 3} more" if len(nodes) > 3 else "")
        return [f"{len(nodes)} nodes stand twice in a file, in different places; the first counts: {shown}"]

    def _poses(self) -> dict[NodeId, Array]:
        """Of each node the pose in its robot's own file, which holds most nodes of the robot: another robot's file may
        have it in a frame of its own."""
        held = Counter((file, node.robot) for node, files in self.vertices.items() for file in files)
        return {
            node: files[min(files, key=lambda file: (-held[file, node.robot], file))]
            for node, files in self.vertices.items()
        }

    def graph(self, first: Path) -> PoseGraph:
        if not self.vertices and not self.edges:
            raise BackendError(f"{first}: no vertex and no edge in this graph")
        if len(self.dimensions) > 1:
            raise BackendError(
                f"{self.dimensions[2]}: a 2-D line, and {self.dimensions[3]} is a 3-D one of the same graph"
            )
        if self.edges and not any(e.information.any() for e in self.edges):
            raise BackendError(f"{first}: no edge has information: every information matrix is zero")
        poses = self._poses()
        lonely = sorted({p.node for p in self.priors} - set(poses) - {n for e in self.edges for n in (e.i, e.j)})
        known = poses | {p.node: p.T_O_i for p in self.priors if p.node in lonely}
        edges = [_without_scale(e) for e in _with_odometry(self.edges, known)]
        spread = spread_poses(known, edges)
        return PoseGraph(spread, tuple(edges), next(iter(self.dimensions)), tuple(self.priors), self.ids.symbols)


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
        out.writelines(f"{line}\n" for line in vertex_lines(graph, plain_ids))
        out.writelines(f"FIX {_id(node, plain_ids)}\n" for node in sorted(graph.fixed))
        tag = "EDGE_SE2" if flat else "EDGE_SE3:QUAT"
        for e, pose in zip(graph.edges, _pose_texts([e.T_i_j for e in graph.edges], flat), strict=True):
            pair = f"{_id(e.i, plain_ids)} {_id(e.j, plain_ids)}"
            out.write(f"{tag} {pair} {pose} {_upper_text(e.information, flat)}\n")
        if (graph.priors or needs_offset(graph)) and not flat:
            out.write("PARAMS_SE3OFFSET 0 0 0 0 0 0 0 1\n")
        out.writelines(f"{line}\n" for line in sighting_lines(graph, plain_ids))
        tag, which = ("EDGE_PRIOR_SE2", "") if flat else ("EDGE_SE3_PRIOR", "0 ")
        for p, pose in zip(graph.priors, _pose_texts([p.T_O_i for p in graph.priors], flat), strict=True):
            out.write(f"{tag} {_id(p.node, plain_ids)} {which}{pose} {_upper_text(p.information, flat)}\n")


def _id(node: NodeId, plain: bool) -> int:
    return node.index if plain else symbol(node)


def _upper_text(information: Array, flat: bool) -> str:
    shown = information[PLANAR] if flat else information
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
