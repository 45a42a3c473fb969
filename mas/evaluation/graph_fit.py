"""Whether the graphs that agents ended with fit: one for each group of agents in one frame, all their edges in it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from maslam.backend.central.fit import GraphFit, graph_fit
from maslam.backend.central.odometry import corrected_step
from maslam.backend.central.odometry_noise import noise_of_odometry
from maslam.backend.geometry import Sim3
from maslam.backend.pose_graph.graph import Edge, NodeId, PoseGraph

from ..agent import Agent
from ..state.place_match import Match
from ..state.pose_graph import match_edge, odometry_edges
from .ground_truth import groups_of
from .summary import GraphFigures, MisfitFigures


def graph_figures(agents: Sequence[Agent]) -> list[GraphFigures]:
    """The fit of each group's graph that has an edge."""
    graphs = [(group, graph_of([agents[i] for i in group])) for group in groups_of(agents)]
    fits = [(group, graph, _fit(graph)) for group, graph in graphs]
    return [
        GraphFigures(
            agents=group,
            edges=fit.edges,
            cost=fit.cost,
            dof=fit.dof,
            fits=fit.fits,
            worst=[MisfitFigures(ends=[str(m.i), str(m.j)], kind=m.kind.value, cost=m.cost) for m in fit.worst],
            lengths=[agents[i].state.odometry_length for i in group],
            turns_deg_m=[np.degrees(agents[i].state.odometry_turn).tolist() for i in group],
            odometry_sigmas={str(n): x for n, x in noise_of_odometry(graph.poses, graph.edges, graph.metric).items()},
        )
        for group, graph, fit in fits
        if fit.edges
    ]


@dataclass(frozen=True, eq=False)
class GroupGraph:
    """Key-frames and edges of agents in one frame; ``metric``: those that know the metre."""

    poses: dict[NodeId, Sim3]
    edges: tuple[Edge, ...]
    metric: frozenset[int]


def group_fit(agents: Sequence[Agent]) -> GraphFit:
    """Of agents in one frame."""
    return _fit(graph_of(agents))


def _fit(graph: GroupGraph) -> GraphFit:
    rigid = {node: Sim3(S.rotation, S.translation, 1.0).se3() for node, S in graph.poses.items()}
    everyone = all(node.robot in graph.metric for node in graph.poses)
    return graph_fit(PoseGraph(rigid, graph.edges), graph.poses, None if everyone else graph.metric)


def graph_of(agents: Sequence[Agent]) -> GroupGraph:
    """Of agents in one frame: their placed key-frames as each of them has its own, odometry with the lengths and
    headings that were found, and accepted matches."""
    poses: dict[NodeId, Sim3] = {}
    edges: list[Edge] = []
    for state in (agent.state for agent in agents):
        poses.update({NodeId(state.me, index): state.pose(index) for index in state.placed()})
        own = [e for p in state.pieces if p.frame == state.frame for e in odometry_edges(state, p.track)]
        edges += [replace(e, T_i_j=corrected_step(e.T_i_j, state.odometry_length, state.odometry_turn)) for e in own]
    edges += [match_edge(match, agents[0].state.config.optimisation) for match in _used(agents)]
    edges = [e for e in edges if e.i in poses and e.j in poses]
    metric = frozenset(agent.state.me for agent in agents if agent.state.profile.metric)
    return GroupGraph(poses, tuple(edges), metric)


def _used(agents: Sequence[Agent]) -> list[Match]:
    """Matches that their owners accept, without those that the group's others contradict."""
    left_out = {match for agent in agents for match in agent.state.contradicted}
    found = {match.id: match for agent in agents for match in agent.state.accepted_matches()}
    return [match for identity, match in sorted(found.items()) if identity not in left_out]
