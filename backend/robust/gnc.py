"""Graduated non-convexity with truncated least squares around the central solver (Yang et al., RA-L 2020).

Odometry is known to be right. The other edges begin with full weight in a problem that is convex, and are turned down
step by step as it becomes truncated least squares. Then every edge is tested against what all others predict, also
those that never took part: what agrees comes back, what does not goes.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from maslam._replaced import replaced

from ..central.costs import cost, edge_cost
from ..central.gtsam_adapter import levenberg_marquardt
from ..central.optimise import polished, two_stage
from ..central.trust_region import anchors
from ..config import CentralConfig, RobustConfig
from ..geometry import Array
from ..pose_graph.graph import EdgeKind, PoseGraph
from .noise import Noise
from .prediction import predicted_distances
from .schedule import first_mu, next_mu, tls_weight

_ROUNDS = 50


@dataclass(frozen=True, eq=False)
class Graduated:
    """``graph``: the solution, its edges with their ``weights`` ``(m,)``; ``noise``: the law of right ones."""

    graph: PoseGraph
    weights: Array
    noise: Noise
    iterations: int


def graduate(
    graph: PoseGraph, candidates: NDArray[np.bool_], noise: Noise, central: CentralConfig, config: RobustConfig
) -> Graduated:
    """Select among the edges that ``candidates`` ``(m,)`` names, then let the others come back.

    ``graph``: with the poses to start from. ``noise``: what is known of it so far.
    """
    search = _GncState(graph, noise, central, config)
    known = np.array([e.kind is EdgeKind.ODOMETRY for e in graph.edges], dtype=bool)
    weights = np.where(known | candidates, 1.0, 0.0)
    search.solve(weights)
    open_ = candidates & ~known
    mu = first_mu(float(search.squared[open_].max(initial=0.0)), search.threshold)
    while mu is not None and search.iterations < config.iterations:
        weights[open_] = tls_weight(search.squared[open_], search.threshold, mu)
        search.solve(weights)
        if np.isin(weights, (0.0, 1.0)).all():
            break
        mu = next_mu(mu)
    seen: set[bytes] = set()
    rows = np.flatnonzero(~known)
    for _ in range(_ROUNDS if len(rows) else 0):
        search.learn_noise(weights)
        # The worst of many right edges is far out: to go, an edge must be too far even for that.
        worst = search.noise.limit((1.0 - config.confidence) / len(rows))
        distances = predicted_distances(search.graph, rows, central)
        weights = _judged(weights, rows, distances, search.threshold, worst)
        if np.array_equal(weights, search.weights) or weights.tobytes() in seen:
            break
        seen.add(weights.tobytes())
        search.solve(weights)
    return Graduated(search.graph, search.weights, search.noise, search.iterations)


def _judged(weights: Array, rows: NDArray[np.intp], distances: Array, back: float, away: float) -> Array:
    """Weights after a look at the edges ``rows``: those within ``back`` come back; of those beyond ``away`` the worst
    go, as the others may only suffer from these.
    """
    out = (weights > 0.5).astype(np.float64)
    believed = weights[rows] > 0.5
    out[rows[~believed & (distances <= back)]] = 1.0
    worst = float(distances[believed].max(initial=0.0))
    out[rows[believed & (distances > max(away, 0.5 * worst))]] = 0.0
    return out


class _GncState:
    """The current solution, its residuals, and the noise they speak of."""

    def __init__(self, graph: PoseGraph, noise: Noise, central: CentralConfig, config: RobustConfig) -> None:
        self.graph, self.noise, self.iterations = graph, noise, 0
        self._central, self._config = replaced(central, start="given", loss="none"), config
        self.squared = squared_residuals(graph, central)
        self.weights = np.ones(len(graph.edges))

    @property
    def threshold(self) -> float:
        """Squared residual, in stated standard deviations, up to which an edge is believed."""
        return self.noise.limit(1.0 - self._config.confidence)

    def solve(self, weights: Array) -> None:
        """Optimise with these weights, from where it is or the chordal solution, which wrong edges mislead less the
        less they weigh.
        """
        self.iterations += 1
        self.weights = weights.copy()
        graph = self.graph.with_weights(weights)
        chordal = two_stage(graph, self._central.cost == "U")
        if cost(chordal, self._central.cost) < cost(graph, self._central.cost):
            graph = chordal
        if self._central.cost == "E":
            self.graph, _ = levenberg_marquardt(graph, self._central)
        else:
            self.graph, _, _ = polished(graph, self._central.cost == "U", self._config.newton_steps)
        self.squared = squared_residuals(self.graph, self._central)

    def learn_noise(self, weights: Array) -> None:
        """From what the believed edges' residuals sum to, beside the freedom they have."""
        a = self.graph.arrays()
        free = len(a.poses) - len(anchors(a))
        freedom = self.noise.full * (int((weights > 0.5).sum()) + len(self.graph.priors) - free)
        if freedom > 0:
            # The residuals of a fit tell the size; the shape stays as found from the cycles.
            mean = self.noise.full * float(weights @ self.squared) / freedom
            self.noise = self.noise.grown(mean, freedom, self._config)


def squared_residuals(graph: PoseGraph, central: CentralConfig) -> Array:
    """Of each edge at full weight ``(m,)``, in standard deviations (units, for cost U), as the cost measures them."""
    whole = graph.with_weights(np.ones(len(graph.edges)))
    per_edge = edge_cost(whole, central.cost)[: len(graph.edges)]
    return per_edge if central.cost == "F" else 2.0 * per_edge
