"""The elected robot's work: put the contributions together, solve, and weigh what came of it."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..central.chordal import two_stage_poses
from ..central.linear import edge_costs
from ..central.trust_region import newton
from ..components import parts
from ..geometry import Array
from ..pose_graph.graph import NodeId
from .condense import noise_of
from .contribution import Between, Contribution


@dataclass(frozen=True, eq=False)
class Gathered:
    """The group's solution: ``poses`` of every node that was contributed, ``reached`` those joined to the anchor;
    ``iterations`` of the solver; ``between``: all edges between members, once each; ``noise``: the residuals' standard
    deviation over the stated one.
    """

    poses: Mapping[NodeId, Array]
    reached: frozenset[NodeId]
    iterations: int
    between: tuple[Between, ...]
    noise: float

    def of(self, nodes: Sequence[NodeId]) -> tuple[Array, NDArray[np.bool_]]:
        """Poses ``(n, 4, 4)`` of a member's nodes, and which ``(n,)`` are reached."""
        return np.array([self.poses[n] for n in nodes]), np.array([n in self.reached for n in nodes], dtype=bool)


def solve(contributions: Mapping[int, Contribution]) -> Gathered:
    """F's optimum over what was contributed; the lowest robot's first node stays where it is.

    Edges to robots that contributed nothing are left out.
    """
    members = sorted(contributions)
    nodes = [n for robot in members for n in contributions[robot].graph.nodes]
    row = {n: k for k, n in enumerate(nodes)}
    between = tuple(b for robot in members for b in contributions[robot].between if b.i in row and b.j in row)
    graphs = [contributions[robot].graph for robot in members]
    first = np.cumsum([0, *(len(g.nodes) for g in graphs)])
    ends = [g.ends + start for g, start in zip(graphs, first, strict=False)]
    ends.append(np.array([(row[b.i], row[b.j]) for b in between], dtype=np.intp).reshape(-1, 2))
    ends_all = np.concatenate(ends)
    measured = np.concatenate([*(g.measured for g in graphs), np.array([b.T_i_j for b in between]).reshape(-1, 4, 4)])
    kappa = np.concatenate([*(g.kappa for g in graphs), [b.kappa for b in between]])
    tau = np.concatenate([*(g.tau for g in graphs), [b.tau for b in between]])
    poses = np.tile(np.eye(4), (len(nodes), 1, 1))
    poses[0] = contributions[members[0]].first_pose
    label = parts(ends_all, len(nodes))
    held = np.unique(label, return_index=True)[1].tolist()
    start = two_stage_poses(ends_all, measured, (kappa, tau), poses, 1, held)
    refined = newton(ends_all, measured, (kappa, tau), start, held)
    i, j = ends_all.T
    cost = float(edge_costs(refined.poses[i], refined.poses[j], measured, kappa, tau).sum())
    noise = noise_of(cost, 6 * (len(ends_all) - len(nodes) + len(held)))
    reached = frozenset(n for n, k in row.items() if label[k] == label[0])
    return Gathered(dict(zip(nodes, refined.poses, strict=True)), reached, refined.steps, between, noise)


def cost_between(edges: Iterable[Between], poses: Mapping[NodeId, Array]) -> tuple[float, float]:
    """F over edges between members, and by how much the rounding of their measurements may have changed it, at most.

    Edges whose ends are not both in ``poses`` are left out.
    """
    used = [b for b in edges if b.i in poses and b.j in poses]
    if not used:
        return 0.0, 0.0
    T_i, T_j = np.array([poses[b.i] for b in used]), np.array([poses[b.j] for b in used])
    weights = np.array([b.kappa for b in used]), np.array([b.tau for b in used])
    costs = edge_costs(T_i, T_j, np.array([b.T_i_j for b in used]), *weights)
    off = np.array([b.off for b in used])
    return float(costs.sum()), float((2.0 * np.sqrt(costs) * off + off**2).sum())
