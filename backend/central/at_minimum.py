"""F's second-order model at its minimum: poses follow unknowns that many edges share, as odometry's lengths."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from ..geometry import Array
from .linear import BlockSystem, pose_blocks
from .similarity_edges import Descended, SimilarityEdges

# Columns solved at a time, and most edges beside the steps whose share of the freedom is computed.
_COLUMNS, _MOST_EDGES = 16, 60
# Newton's steps at most; a step that ends them, as a share of the unknowns' deviation before anything is known.
_ROUNDS, _SETTLED = 6, 1e-3


class SharedUnknowns(Protocol):
    """F's second-order model in unknowns that many edges share, at poses that are best for them."""

    def change(self) -> Array:
        """Newton's step of the unknowns, in their shape."""
        ...


Model = TypeVar("Model", bound=SharedUnknowns)


def refined(
    at: Model,
    values: Array,
    found: Descended,
    minimum: Callable[[Array, Descended], Descended],
    model: Callable[[Array, Descended], Model],
    sigma: float,
) -> tuple[Array, Descended, Model]:
    """Newton's method on shared unknowns alone, from the model ``at`` of ``values`` and ``found``; ``minimum``: the
    poses that F is least at for other values; ``sigma``: the unknowns' deviation before anything is known."""
    for _ in range(_ROUNDS):
        change = at.change()
        values = values + change
        found = minimum(values, found)
        at = model(values, found)
        if np.abs(change).max() < _SETTLED * sigma:
            break
    return values, found, at


class AtMinimum:
    """``edges`` and the poses ``found`` that F is least at, with nodes ``held`` and units ``kept`` ``(n,)``."""

    def __init__(self, edges: SimilarityEdges, found: Descended, held: Sequence[int], kept: NDArray[np.bool_]) -> None:
        self.edges, self.found = edges, found
        n = len(found.poses)
        self._free = np.setdiff1d(np.arange(n), held)
        blocks = self._blocks(kept)
        self._hessian, self.width = blocks[0], blocks[0].shape[1] // 2
        self._system = BlockSystem(edges.ends, *blocks, self._free, np.ones(len(edges.ends), dtype=bool))

    def _blocks(self, kept: NDArray[np.bool_]) -> tuple[Array, Array]:
        e, poses = self.edges, self.found.poses
        if not kept.all():
            return e.blocks(poses, self.found.log_units, kept)
        i, j = e.ends.T
        R = poses[:, :3, :3]
        return pose_blocks(R[i], R[j], e.measured, e.kappa, e.tau)

    def explained(self, cross: Array, robot_of: NDArray[np.intp], count: int) -> Array:
        """What the poses' own moves take off the curvature in ``p`` unknowns of each of ``count`` robots
        ``(count * p, count * p)``. ``cross`` ``(n, w, p)``: second derivatives by a node's pose and its robot's
        unknowns; ``robot_of`` ``(n,)``, -1: of none."""
        p = cross.shape[2]
        rows, cross = robot_of[self._free], cross[self._free, : self.width]
        mine = rows >= 0
        out = np.zeros((count, p, count, p))
        at_once = max(_COLUMNS // p, 1)
        for first in range(0, count, at_once):
            columns = np.arange(first, min(first + at_once, count))
            rhs = cross[:, :, None, :] * (rows[:, None] == columns)[:, None, :, None]
            solved = self._system.solve_for(rhs.reshape(len(rhs), self.width, -1)).reshape(rhs.shape)
            moved = (cross[:, :, :, None, None] * solved[:, :, None]).sum(axis=1)
            np.add.at(out[:, :, columns[0] : columns[-1] + 1], rows[mine], moved[mine])
        whole = out.reshape(count * p, count * p)
        return np.asarray(0.5 * (whole + whole.T))

    def noise(self, steps: NDArray[np.bool_], freedom: int) -> tuple[float, float, float]:
        """Deviations of the residuals of ``steps`` ``(m,)`` over the stated ones; the degrees of freedom that say so;
        and those of the other edges. Each edge has as much of the ``freedom`` as its measurement is not explained by.
        """
        costs = self.edges.costs(self.found.poses, self.found.log_units)
        others = np.flatnonzero(~steps)
        theirs = self._freedom_of(others)
        ours = freedom - theirs
        noise = float(np.sqrt(costs[steps].sum() / ours)) if ours >= 1.0 else float("nan")
        return noise, ours, float(np.sqrt(costs[others].sum() / theirs)) if theirs >= 1.0 else 1.0

    def _freedom_of(self, edges: NDArray[np.intp]) -> float:
        """How much of the degrees of freedom lies in these edges; of many a part stands for all."""
        asked = edges[:: -(-len(edges) // _MOST_EDGES)] if len(edges) else edges
        explained = 0.0
        row = np.full(len(self.found.poses), -1)
        row[self._free] = np.arange(len(self._free))
        rank, w = self.width, self.width
        for k in asked:
            values, vectors = np.linalg.eigh(self._hessian[k])
            root = vectors[:, -rank:] * np.sqrt(np.maximum(values[-rank:], 0.0))
            rhs = np.zeros((len(self._free), w, rank))
            for side, node in enumerate(self.edges.ends[k]):
                if row[node] >= 0:
                    rhs[row[node]] += root[side * w : (side + 1) * w]
            explained += float((rhs * self._system.solve_for(rhs)).sum())
        return (rank * len(asked) - explained) * len(edges) / max(len(asked), 1)


def log_odds(data: Array, wanted: Array, sigma: float, noise: float) -> float:
    """Logarithm of the odds for unknowns of deviation ``sigma`` each against none (Laplace's approximation), with
    residuals of variance ``noise``. ``data`` ``(k, k)``: their curvature in F, poses following; ``wanted`` ``(k,)``:
    it and the prior's, times where F is least."""
    data, wanted = data / noise, wanted / noise
    prior = np.eye(len(data)) / sigma**2
    gain = wanted @ np.linalg.solve(data + prior, wanted)
    return float(0.5 * gain - 0.5 * np.linalg.slogdet(np.eye(len(data)) + data * sigma**2)[1])
