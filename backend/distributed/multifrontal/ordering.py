"""The order in which robots eliminate their poses, and which end of an edge between two robots goes on."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import maximum_bipartite_matching


def elimination_order(
    members: Sequence[int], shared: Mapping[tuple[int, int], int], last: int
) -> tuple[tuple[int, ...], int]:
    """All ``members``, ``last`` at the end, and how many poses at most each leaves behind, squared, in all.

    Of the others always the one whose elimination leaves least behind is next. ``shared``: for two robots with edges
    between them, the number of poses at one end of these. Only that is known: what two eliminated robots leave of a
    third is counted twice.
    """
    left: dict[int, dict[int, int]] = {robot: {} for robot in members}
    for (a, b), count in shared.items():
        left[a][b] = left[b][a] = count
    most = {robot: sum(counts.values()) for robot, counts in left.items()}
    order: list[int] = []
    squares = 0
    while len(left) > 1:
        robot = min((r for r in left if r != last), key=lambda r: (sum(left[r].values()), r))
        behind = left.pop(robot)
        squares += sum(behind.values()) ** 2
        for a in behind:
            del left[a][robot]
            for b, count in behind.items():
                if b != a:
                    left[a][b] = min(left[a].get(b, 0) + count, most[b])
        order.append(robot)
    return (*order, *left), squares


def smallest_cover(pairs: Iterable[tuple[int, int]]) -> tuple[set[int], set[int]]:
    """The fewest left and right nodes that every pair ``(left, right)`` has one of (König); right ones in doubt."""
    ends: NDArray[np.intp] = np.array(sorted(set(pairs)), dtype=np.intp).reshape(-1, 2)
    if not len(ends):
        return set(), set()
    lefts, rights = np.unique(ends[:, 0]), np.unique(ends[:, 1])
    i, j = np.searchsorted(lefts, ends[:, 0]), np.searchsorted(rights, ends[:, 1])
    graph = coo_array((np.ones(len(ends)), (i, j)), shape=(len(lefts), len(rights))).tocsr()
    partner_of_right = np.asarray(maximum_bipartite_matching(graph, perm_type="row"))
    partner_of_left = np.full(len(lefts), -1)
    matched = np.flatnonzero(partner_of_right >= 0)
    partner_of_left[partner_of_right[matched]] = matched
    # From unmatched right nodes along alternating paths: right ones reached are not needed, left ones reached are.
    by_right: list[list[int]] = [[] for _ in rights]
    for a, b in zip(i.tolist(), j.tolist(), strict=True):
        by_right[b].append(a)
    left_reached: set[int] = set()
    right_reached = set(np.flatnonzero(partner_of_right < 0).tolist())
    queue = sorted(right_reached)
    while queue:
        for a in by_right[queue.pop()]:
            if a not in left_reached:
                left_reached.add(a)
                b = int(partner_of_left[a])
                if b >= 0 and b not in right_reached:
                    right_reached.add(b)
                    queue.append(b)
    kept = set(range(len(rights))) - right_reached
    return {int(lefts[a]) for a in left_reached}, {int(rights[b]) for b in kept}
