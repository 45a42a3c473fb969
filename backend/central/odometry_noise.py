"""Whether odometry is as good as its edges state, by what loops and matches say.

Over k steps odometry displaced the camera by what its edges add up to; the optimised poses say by how much it did. The
difference has the covariance of the k edges less that of the optimised poses, which are not independent of them (the
residual of a least-squares estimate). Both are sums over windows of k steps; the root of their ratio is 1 where the
stated deviations are right, 2 where errors are twice as large. Where a bias remains it grows with k.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..components import first_of_parts
from ..geometry import Array, Sim3, se3_inverse, skew
from ..pose_graph.graph import Edge, NodeId
from .linear import BlockSystem
from .odometry_steps import steps_of
from .similarity_edges import SimilarityEdges, edges_of

SPANS = (1, 10, 50)
# Windows of each length, at most; the least degrees of freedom of a graph that tells anything.
_WINDOWS, _LEAST_FREEDOM = 60, 12
# Of the edges' covariance: what the poses leave must be more than rounding.
_LEAST_SHARE = 1e-4


def noise_of_odometry(
    places: Mapping[NodeId, Sim3], edges: Sequence[Edge], metric: frozenset[int], dimension: int = 3
) -> Mapping[int, float]:
    """By number of steps (of :data:`SPANS`), errors of the displacement by odometry of ``metric`` robots over the
    stated ones; without those that nothing tells.

    ``places`` ``S_O_i`` fit the ``edges`` (the scale is a node's unit), whose odometry has the lengths that were found.
    """
    nodes = sorted(places)
    row = {n: k for k, n in enumerate(nodes)}
    edges = [e for e in edges if e.weight > 0]
    ends = np.array([(row[e.i], row[e.j]) for e in edges], dtype=np.intp).reshape(-1, 2)
    held = first_of_parts(ends, len(nodes))
    kept = np.array([n.robot in metric for n in nodes], dtype=bool)
    freedom = 6 * (len(edges) - len(nodes) + len(held))
    robot_of = np.array([n.robot if n.robot in metric else -1 for n in nodes], dtype=np.intp)
    known = edges_of(edges, ends, dimension)
    solved = _Solved(known, np.array([places[n].se3() for n in nodes]), held)
    steps = np.flatnonzero(steps_of(ends, robot_of, 1, 1.0).robot >= 0)
    if freedom < _LEAST_FREEDOM or not len(steps):
        return {}
    kept[held] = True
    log_units = np.log(np.array([places[n].scale for n in nodes]))
    free = np.setdiff1d(np.arange(len(nodes)), held)
    blocks = known.blocks(solved.poses, log_units, kept)
    system = BlockSystem(ends, *blocks, free, np.ones(len(ends), dtype=bool))
    place = np.full(len(nodes), -1)
    place[free] = np.arange(len(free))
    after = {int(ends[k].min()): int(k) for k in steps}
    out = {}
    for span in SPANS:
        starts = [a for a in sorted(after) if all(a + k in after for k in range(span))][:: max(1, span // 2)]
        starts = starts[:: max(1, -(-len(starts) // _WINDOWS))]
        sums = np.array([_window(solved, system, place, [after[a + k] for k in range(span)], a) for a in starts])
        if len(sums) and sums[:, 1].sum() > _LEAST_SHARE * sums[:, 2].sum():
            out[span] = float(np.sqrt(sums[:, 0].sum() / sums[:, 1].sum()))
    return out


@dataclass(frozen=True, eq=False)
class _Solved:
    """A graph's ``edges`` and the ``poses`` ``(n, 4, 4)`` that fit them; nodes ``held`` were given."""

    edges: SimilarityEdges
    poses: Array
    held: Sequence[int]


def _window(
    solved: _Solved, system: BlockSystem, row: NDArray[np.intp], edges: list[int], start: int
) -> tuple[float, float, float]:
    """Of one window: the squared difference of the displacement by odometry and by the poses; its expectation; and the
    trace of odometry's own covariance."""
    e, at = solved.edges, [np.eye(4)]
    for n, k in enumerate(edges, start):
        T = e.measured[k] if e.ends[k, 0] == n else se3_inverse(e.measured[k])
        at.append(at[-1] @ T)
    end, last = at[-1][:3, 3], start + len(edges)
    lever2 = ((end - np.array(at[1:])[:, :3, 3]) ** 2).sum(axis=1)
    stated = float((3.0 / e.tau[edges] + lever2 / e.kappa[edges]).sum())
    R = solved.poses[start, :3, :3]
    moved = R.T @ (solved.poses[last, :3, 3] - solved.poses[start, :3, 3])
    rhs = np.zeros((len(system.solved), system.width, 3))
    if row[last] >= 0:
        rhs[row[last], :3] = R
    if row[start] >= 0:
        rhs[row[start], :3] = -R
        rhs[row[start], 3:6] = skew(moved).T
    known = float((rhs * system.solve_for(rhs)).sum())
    return float(((moved - end) ** 2).sum()), stated - known, stated
