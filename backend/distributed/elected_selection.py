"""Robust selection at the elected robot: it has the group's graph, so central selection decides, and verdicts go back.

With the solution each member gets a number for each of its loops and separators: the residual, with a negative sign
where the edge is rejected. What is rejected takes no part, and counts in the costs as it stood before. What nothing in
the graph decides stands in the elected robot's own outcome.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ..central.similarity_edges import SimilarityEdges
from ..config import CentralConfig, RobustConfig, SolverConfig
from ..errors import BackendError
from ..geometry import Array
from ..pose_graph.graph import Edge, EdgeKind, NodeId, PoseGraph
from ..robust.gnc import squared_residuals
from ..robust.select import optimise_robustly
from .contribution import Contribution
from .elected import ElectedNode
from .share import JudgedEdge, Share, UndecidedEdges

_VERDICT = "<f4"


class SelectingNode(ElectedNode):
    """An elected group in which the elected robot selects among loops and separators; see :class:`ElectedNode`."""

    def __init__(self, share: Share, config: SolverConfig) -> None:
        if config.elected_longest > 1 or share.scaled:
            what = f"elected_longest {config.elected_longest}" if not share.scaled else "units of length of their own"
            raise BackendError(f"robust selection by an elected robot judges rigid edges one by one, not with {what}")
        super().__init__(share, config)
        row = self._own.row
        # Edges of weight 0 are not contributed; odometry, which joins a node to the next, is not judged.
        given = [k for k, e in enumerate(share.edges) if e.weight > 0]
        loops = [k for k in given if not share.edges[k].is_separator and not _along(row, share.edges[k])]
        ties = sorted((k for k in given if share.edges[k].is_separator), key=lambda k: _name_of(share.edges[k]))
        self._judged_rows = [*loops, *ties]
        own = [k for k, e in enumerate(share.edges) if not e.is_separator]
        self._loop_rows = np.searchsorted(own, loops)
        self._verdicts: dict[int, Array] = {}
        self._mine_judged = np.zeros(0)
        self._undecided: tuple[UndecidedEdges, ...] = ()

    def _believed(self, given: Mapping[int, Contribution]) -> Mapping[int, Contribution]:
        dimension, confidence = self.share.dimension, self._config.gnc_confidence
        found = selected(given, dimension, RobustConfig(confidence=confidence))
        self._verdicts, self._undecided = found.verdicts, found.undecided
        return found.believed

    def _to_say(self, robot: int, solution: bytes) -> bytes:
        return self._verdicts[robot].astype(_VERDICT).tobytes() + solution

    def _take_verdicts(self, body: bytes) -> bytes:
        size = np.dtype(_VERDICT).itemsize * len(self._judged_rows)
        if len(body) < size:
            raise BackendError(f"robot {self.share.robot} was sent verdicts on fewer edges than it has")
        self._mine_judged = np.frombuffer(body[:size], dtype=_VERDICT).astype(np.float64)
        if np.isnan(self._mine_judged).any():
            raise BackendError(f"robot {self.share.robot} was sent a verdict that is no number")
        return body[size:]

    def _own_cost(self, poses: Array, log_units: Array) -> float:
        own = self._own
        if self.leader == self.share.robot:
            self._mine_judged = self._verdicts[self.share.robot].astype(_VERDICT).astype(np.float64)
        rejected = np.zeros(len(own.edges.ends), dtype=bool)
        rejected[self._loop_rows] = np.signbit(self._mine_judged[: len(self._loop_rows)])
        before = own.edges.only(rejected).costs(own.poses, own.log_units).sum()
        return float(own.edges.only(~rejected).costs(poses, log_units).sum() + before)

    def _end(self, accepted: bool, before: float, after: float, iterations: int, flags: int) -> None:
        super()._end(accepted, before, after, iterations, flags)
        assert self.outcome is not None
        verdicts = dict(zip(self._judged_rows, self._mine_judged.tolist(), strict=False))
        judged = tuple(
            JudgedEdge(e.i, e.j, float(not np.signbit(verdicts.get(k, 0.0))), abs(verdicts.get(k, 0.0)))
            for k, e in enumerate(self.share.edges)
            if e.kind is not EdgeKind.ODOMETRY
        )
        undecided = self._undecided if self.leader == self.share.robot else ()
        self.outcome = replace(self.outcome, judged=judged, undecided=undecided)


@dataclass(frozen=True, eq=False)
class SelectedContributions:
    """The contributions that are ``believed``; for each member the ``verdicts`` on its judged edges, own loops as
    contributed, then separators by their ends; what is ``undecided``."""

    believed: dict[int, Contribution]
    verdicts: dict[int, Array]
    undecided: tuple[UndecidedEdges, ...]


def selected(given: Mapping[int, Contribution], dimension: int, config: RobustConfig) -> SelectedContributions:
    """The contributions without what central selection (PCM, then GNC) rejects."""
    nodes = [n for c in given.values() for n in c.graph.nodes]
    known, edges = set(nodes), []
    whose: list[tuple[int, bool, int]] = []
    for robot, c in given.items():
        for k, (i, j) in enumerate(c.graph.edges.ends.tolist()):
            kind = EdgeKind.ODOMETRY if abs(i - j) == 1 else EdgeKind.LOOP
            edges.append(_edge((c.graph.nodes[i], c.graph.nodes[j]), c.graph.edges, k, kind, dimension))
            whose.append((robot, True, k))
        for k, pair in enumerate(c.between.nodes):
            if pair[0] in known and pair[1] in known:
                edges.append(_edge(pair, c.between.edges, k, EdgeKind.SEPARATOR, dimension))
                whose.append((robot, False, k))
    graph = PoseGraph({n: np.eye(4) for n in nodes}, tuple(edges), dimension)
    found = optimise_robustly(graph, "pcm+gnc", CentralConfig(), config)
    residuals = np.sqrt(squared_residuals(found.graph, CentralConfig()))
    signed = np.where(found.weights > 0.5, residuals, -residuals)
    keep: dict[tuple[int, bool], NDArray[np.bool_]] = {}
    for robot, c in given.items():
        keep[robot, True] = np.ones(len(c.graph.edges.ends), dtype=bool)
        keep[robot, False] = np.ones(len(c.between.nodes), dtype=bool)
    for (robot, inside, k), weight in zip(whose, found.weights.tolist(), strict=True):
        keep[robot, inside][k] = weight > 0.5
    believed = {
        robot: replace(
            c,
            graph=replace(c.graph, edges=c.graph.edges.only(keep[robot, True])),
            between=c.between.only(keep[robot, False].tolist()),
        )
        for robot, c in given.items()
    }
    verdicts = {robot: _verdicts_of(robot, edges, signed) for robot in given}
    undecided = (UndecidedEdges(u.robots, _ends(edges, u.kept), _ends(edges, u.rejected)) for u in found.undecided)
    return SelectedContributions(believed, verdicts, tuple(undecided))


def _ends(edges: list[Edge], rows: Iterable[int]) -> tuple[tuple[NodeId, NodeId], ...]:
    return tuple((edges[k].i, edges[k].j) for k in rows)


def _verdicts_of(robot: int, edges: list[Edge], signed: Array) -> Array:
    """Of one member's judged edges among all."""
    loops = [k for k, e in enumerate(edges) if e.kind is EdgeKind.LOOP and e.i.robot == robot]
    ties = [k for k, e in enumerate(edges) if e.is_separator and robot in (e.i.robot, e.j.robot)]
    return np.asarray(signed[[*loops, *sorted(ties, key=lambda k: _name_of(edges[k]))]])


def _name_of(e: Edge) -> tuple[NodeId, NodeId, float]:
    """What tells an edge from others at both its owners; two between the same nodes by what they measure, roughly."""
    return e.i, e.j, round(float(e.T_i_j[0, 3]), 2)


def _along(row: Mapping[NodeId, int], e: Edge) -> bool:
    """Whether an own edge joins a node to the next: odometry, to who sees no kinds."""
    return abs(row[e.i] - row[e.j]) == 1


def _edge(ends: tuple[NodeId, NodeId], edges: SimilarityEdges, k: int, kind: EdgeKind, dimension: int) -> Edge:
    """With an information matrix whose weights in F are those that were sent."""
    turn = edges.kappa[k] * (2.0 if dimension == 3 else 1.0)
    return Edge(*ends, edges.measured[k], np.diag([edges.tau[k]] * 3 + [turn] * 3), kind)
