"""What robust selection by the elected agent leaves open, by the names of place matches."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from maslam.backend.distributed.share import SolverOutcome
from maslam.backend.pose_graph.graph import NodeId

from ..protocol.ids import MatchId


@dataclass(frozen=True)
class UndecidedMatches:
    """The ``rejected`` matches hold where ``agents`` are moved against the rest of the group, and the ``kept`` ones
    break then: nothing tells which are wrong."""

    agents: tuple[int, ...]
    kept: tuple[MatchId, ...]
    rejected: tuple[MatchId, ...]


def undecided_matches(outcome: SolverOutcome) -> tuple[UndecidedMatches, ...]:
    """Of an optimisation, as the elected agent alone knows it; none at all others."""
    return tuple(UndecidedMatches(u.robots, _named(u.kept), _named(u.rejected)) for u in outcome.undecided)


def _named(edges: Iterable[tuple[NodeId, NodeId]]) -> tuple[MatchId, ...]:
    return tuple(MatchId(j.robot, j.index, i.robot, i.index) for i, j in edges)
