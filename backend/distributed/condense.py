"""A robot's own graph without what its group does not need: stretches of odometry become one edge each.

What stays are the ends of edges to other robots and of loops, and every ``longest``-th node between. An edge made of
several has the weights that F's law of noise gives it, up to the directions: rotation noise early in a stretch moves
its end sideways, which one translation weight for all directions holds only in the mean. Short stretches lose next to
nothing; ``longest`` 1 condenses nothing.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..central.chordal import two_stage_poses
from ..central.linear import edge_costs, isotropic_weights
from ..central.trust_region import newton
from ..components import first_of_parts, parts
from ..geometry import Array, se3_inverse
from ..pose_graph.graph import Edge, NodeId
from .share import Share


@dataclass(frozen=True, eq=False)
class Condensed:
    """``nodes`` that stay, sorted; edges between them: ``ends`` ``(m, 2)`` rows of these, ``measured`` ``(m, 4, 4)``,
    ``kappa`` and ``tau`` ``(m,)``.
    """

    nodes: list[NodeId]
    ends: NDArray[np.intp]
    measured: Array
    kappa: Array
    tau: Array


class OwnGraph:
    """A robot's own nodes and the edges between them, as arrays."""

    def __init__(self, share: Share) -> None:
        self.nodes = sorted(share.poses)
        self.row = {n: k for k, n in enumerate(self.nodes)}
        self.poses = np.array([share.poses[n] for n in self.nodes])
        own = [e for e in share.edges if e.i.robot == e.j.robot]
        self._dimension = share.dimension
        self._separators = {n for e in share.edges if e.is_separator for n in (e.i, e.j) if n in self.row}
        self.ends = np.array([(self.row[e.i], self.row[e.j]) for e in own], dtype=np.intp).reshape(-1, 2)
        self.measured = np.array([e.T_i_j for e in own]).reshape(-1, 4, 4)
        self.kappa, self.tau = weights_of(own, share.dimension)

    def cost(self, poses: Array) -> float:
        """F over the own edges, of poses ``(n, 4, 4)`` of all own nodes."""
        i, j = self.ends.T
        return float(edge_costs(poses[i], poses[j], self.measured, self.kappa, self.tau).sum())

    def noise(self) -> float:
        """The residuals' standard deviation over the stated one, at the optimum of the own edges; 1 where these close
        no loop.
        """
        used = self.kappa > 0
        ends, measured, weights = self.ends[used], self.measured[used], (self.kappa[used], self.tau[used])
        held = first_of_parts(ends, len(self.poses))
        freedom = 6 * (len(ends) - len(self.poses) + len(held))
        if freedom <= 0:
            return 1.0
        poses = two_stage_poses(ends, measured, weights, self.poses, 2)
        i, j = ends.T
        return noise_of(float(edge_costs(poses[i], poses[j], measured, *weights).sum()), freedom)

    def condensed(self, longest: int) -> Condensed:
        """At most ``longest`` edges made into one."""
        used = self.kappa > 0
        degree = np.bincount(self.ends[used].ravel(), minlength=len(self.nodes))
        following = np.abs(self.ends[:, 0] - self.ends[:, 1]) == 1
        kept = degree != 2
        kept[0] = True
        kept[[self.row[n] for n in self._separators]] = True
        # Loops' ends stay; so what goes has the node before and the node after as its only neighbours.
        kept[self.ends[used & ~following].ravel()] = True
        rows: list[tuple[int, int, list[int]]] = [
            (int(i), int(j), [k]) for k, (i, j) in enumerate(self.ends) if used[k] and kept[i] and kept[j]
        ]
        between = {int(min(p)): k for k, p in enumerate(self.ends) if used[k] and following[k]}
        rows += self._stretches(kept, between, longest)
        stays = np.flatnonzero(kept)
        position = np.full(len(kept), -1)
        position[stays] = np.arange(len(stays))
        merged = [self._merged(i, edges) for i, _, edges in rows]
        return Condensed(
            nodes=[self.nodes[k] for k in stays],
            ends=position[np.array([(i, j) for i, j, _ in rows], dtype=np.intp).reshape(-1, 2)],
            measured=np.array([T for T, _, _ in merged]).reshape(-1, 4, 4),
            kappa=np.array([kappa for _, kappa, _ in merged]),
            tau=np.array([tau for _, _, tau in merged]),
        )

    def _stretches(
        self, kept: NDArray[np.bool_], between: dict[int, int], longest: int
    ) -> list[tuple[int, int, list[int]]]:
        """Start, end and edges of what becomes one edge; marks further nodes in ``kept`` where it would be too long.

        ``between``: by node, its edge to the node after it. What hangs on one end only is left out: it follows.
        """
        first = kept.copy()
        out: list[tuple[int, int, list[int]]] = []
        stretch: list[int] = []
        start = -1
        for n in range(len(kept)):
            if kept[n] or (start >= 0 and len(stretch) == longest):
                if start >= 0 and not (len(stretch) == 1 and first[start] and first[n]):
                    out.append((start, n, stretch))
                kept[n] = True
                start, stretch = n, []
            if n not in between:
                start = -1
            elif start >= 0:
                stretch = [*stretch, between[n]]
        return out

    def _merged(self, start: int, edges: list[int]) -> tuple[Array, float, float]:
        """Measurement and weights of edges in a row from node ``start``: variances add up, and each turn's noise is a
        shift of the end by its distance.
        """
        if len(edges) == 1:
            k = edges[0]
            return self.measured[k], float(self.kappa[k]), float(self.tau[k])
        T, at = np.eye(4), start
        steps = []
        for k in edges:
            i, j = self.ends[k]
            T = T @ (self.measured[k] if i == at else se3_inverse(self.measured[k]))
            at = int(j if i == at else i)
            steps.append(T[:3, 3].copy())
        distance2 = ((T[:3, 3] - np.array(steps)) ** 2).sum(axis=1)
        kappa, tau = self.kappa[edges], self.tau[edges]
        # Variance of the turn about each axis is 1 / (2 kappa); about all of them it moves the end in two directions
        # of three (in the plane: about one axis, in one direction of two).
        share = 1.0 / 3.0 if self._dimension == 3 else 1.0 / 4.0
        return T, float(1.0 / (1.0 / kappa).sum()), float(1.0 / (1.0 / tau + share * distance2 / kappa).sum())

    def completed(self, known: dict[NodeId, Array]) -> tuple[Array, NDArray[np.bool_]]:
        """Poses ``(n, 4, 4)`` of all own nodes that minimise F with the ``known`` ones held, and which ``(n,)`` they
        are tied to; the others keep theirs.
        """
        poses = self.poses.copy()
        held = np.array(sorted(self.row[n] for n in known), dtype=np.intp)
        for n, T in known.items():
            poses[self.row[n]] = T
        used = self.kappa > 0
        ends, measured = self.ends[used], self.measured[used]
        label = parts(ends, len(poses))
        reached = np.isin(label, label[held])
        fixed = sorted({*held.tolist(), *np.flatnonzero(~reached).tolist()})
        if len(fixed) == len(poses):
            return poses, reached
        weights = self.kappa[used], self.tau[used]
        start = two_stage_poses(ends, measured, weights, poses, 1, fixed)
        return newton(ends, measured, weights, start, fixed).poses, reached


def noise_of(cost: float, freedom: int) -> float:
    """Standard deviation of residuals over the stated one, from F and its degrees of freedom; within 1e-4 and 1."""
    return float(np.clip(np.sqrt(cost / freedom), 1e-4, 1.0)) if freedom > 0 else 1.0


def weights_of(edges: list[Edge], dimension: int) -> tuple[Array, Array]:
    """``kappa``, ``tau`` ``(m,)`` of edges, their own ``weight`` multiplied in."""
    kappa, tau = isotropic_weights(np.array([e.information for e in edges]), dimension)
    weight = np.array([e.weight for e in edges])
    return kappa * weight, tau * weight
