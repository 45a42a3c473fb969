"""The largest clique of a graph, exactly where it can be had in bounded work."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class Clique:
    """``members``, sorted; ``exact``: no larger one exists (False: the work was bounded and ended first)."""

    members: tuple[int, ...]
    exact: bool


def largest_clique(adjacent: NDArray[np.bool_], work: int = 5_000_000) -> Clique:
    """The largest set of nodes that are all joined to each other in ``adjacent`` ``(n, n)`` (symmetric).

    Branch and bound with greedy colouring (Tomita and Seki, 2003) over bit sets, from a greedy clique; ``work`` bounds
    the nodes coloured, not the time, so the answer is the same every time. Of equally large ones the first found in
    the order of degrees is returned.
    """
    n = len(adjacent)
    if n == 0:
        return Clique((), True)
    # High degrees in the low bits: the greedy clique and the colouring take these first.
    degree = np.asarray(adjacent).sum(axis=1)
    order = np.argsort(-degree, kind="stable")
    joined = np.asarray(adjacent, dtype=bool)[np.ix_(order, order)].copy()
    np.fill_diagonal(joined, False)
    packed = np.packbits(joined, axis=1, bitorder="little")
    search = _CliqueSearch([int.from_bytes(row.tobytes(), "little") for row in packed], work)
    search.run()
    return Clique(tuple(sorted(int(order[k]) for k in search.best)), search.exact)


class _CliqueSearch:
    def __init__(self, neighbours: list[int], work: int) -> None:
        self._neighbours, self._left = neighbours, work
        self.exact = True
        self.best = self._greedy()

    def _greedy(self) -> list[int]:
        """Always the node of highest degree among those joined to all so far."""
        found: list[int] = []
        candidates = (1 << len(self._neighbours)) - 1
        while candidates:
            found.append((candidates & -candidates).bit_length() - 1)
            candidates &= self._neighbours[found[-1]]
        return found

    def run(self) -> None:
        """Depth first, without recursion: a frame holds the clique so far and its candidates in colour order."""
        everything = (1 << len(self._neighbours)) - 1
        stack: list[tuple[list[int], list[int], list[int], int]] = [([], *self._coloured(everything), everything)]
        while stack:
            clique, order, colours, candidates = stack.pop()
            while order:
                if len(clique) + colours[-1] <= len(self.best):
                    break
                if self._left <= 0:
                    self.exact = False
                    return
                v = order.pop()
                colours.pop()
                inside = candidates & self._neighbours[v]
                candidates &= ~(1 << v)
                larger = [*clique, v]
                if inside:
                    stack.append((clique, order, colours, candidates))
                    stack.append((larger, *self._coloured(inside), inside))
                    break
                if len(larger) > len(self.best):
                    self.best = larger

    def _coloured(self, candidates: int) -> tuple[list[int], list[int]]:
        """Candidates in order of a greedy colouring, and their colours: no clique among the first k has more than the
        k-th's.
        """
        order, colours, colour = [], [], 0
        while candidates:
            colour += 1
            free = candidates
            while free:
                lowest = free & -free
                v = lowest.bit_length() - 1
                order.append(v)
                colours.append(colour)
                candidates ^= lowest
                free &= ~(self._neighbours[v] | lowest)
        self._left -= len(order)
        return order, colours
