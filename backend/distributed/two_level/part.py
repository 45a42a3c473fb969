"""A robot's part: its knots and springs, its sweep, and the moves that are mixed."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ...errors import BackendError
from ...geometry import Array
from ..compact import CompactReader, CompactWriter
from ..local import LocalProblem
from ..places import Places, move, places_of
from .answers import CoarseAnswer, Then, summed
from .block import Block
from .coded_places import by_number, deviations_of, stiffness_of
from .codes import read_steps, write_steps
from .forces import write_forces
from .grounds import grounds_of, write_grounds
from .knots import Hats, carried, gathered, hats_of, weight_bytes, weights_from
from .springs import Knots, SpringEnd, Springs, rounded, write_knots, write_springs
from .tracks import tracks

# Earlier moves that are mixed with the new one.
_DEPTH = 2
# Forces' steps over the coarse level's and a sweep's.
_FORCES = 0.25


class Part:
    """Works on ``problem.places`` in place; ``placed`` ``(n,)``: rows that have a place."""

    def __init__(self, problem: LocalProblem, placed: NDArray[np.bool_], label: NDArray[np.intp], spacing: int) -> None:
        """``label`` ``(own,)``: the piece of its own graph that a pose belongs to."""
        self._problem, self._placed = problem, placed
        own = problem.own_count
        shared = sorted({r for rows in problem.sent_rows.values() for r in rows})
        self._shared = np.array(shared, dtype=np.intp)
        key = np.zeros(own, dtype=bool)
        key[self._shared] = True
        key[problem.given] = True
        key &= placed[:own]
        hats, rows = hats_of(label, key, spacing)
        n = len(problem)
        self._hats = Hats(np.full(n, -1, dtype=np.intp), np.zeros(n))
        self._hats.first[:own], self._hats.weight[:own] = hats.first, hats.weight
        self._rows = rows
        self._centres = np.zeros((len(rows), 3))
        self._sigmas = deviations_of(problem)
        self._group_sigmas = self._sigmas
        self._foreign: dict[tuple[int, int], Array] = {}
        self._block: Block | None = None
        self._moves: list[Array] = []
        self._sweep = np.zeros((n, problem.width))
        self._coarse = np.zeros((n, problem.width))
        self._grid = 0.0
        self._best = problem.places.copy()
        self._share = 1.0
        self.capped = False
        self.renew()

    def renew(self) -> None:
        """The coarse level begins anew where poses are now."""
        self._centres = rounded(self._problem.places.poses[self._rows, :3, 3])
        self._foreign.clear()
        self._moves.clear()
        self._grid = 0.0

    # -- the coarse level's parts ------------------------------------------------------------------------------------

    def for_neighbour(self, neighbour: int) -> bytes:
        """Where the poses shared with it are between which knots, and these knots' centres."""
        hats = self._hats.at(np.array(self._problem.sent_rows[neighbour], dtype=np.intp))
        out = CompactWriter()
        for knot in hats.first.tolist():
            out.count(knot + 1)
        out.array(np.asarray(weight_bytes(hats.weight), dtype=np.float64), "u1")
        out.array(self._centres[_used(hats)], "<f2")
        # What found no place stays where it was.
        lost = np.array(self._problem.sent_rows[neighbour], dtype=np.intp)[hats.first < 0]
        out.array(self._problem.places.at(lost).numbers(self._problem.width), "<f8")
        return out.bytes()

    def take_neighbour(self, neighbour: int, body: bytes) -> None:
        """Inverse of :meth:`for_neighbour`."""
        rows = np.array(self._problem.received_rows[neighbour], dtype=np.intp)
        source = CompactReader(body)
        first = np.array([source.count() - 1 for _ in rows], dtype=np.intp)
        hats = Hats(first, weights_from(source.array(len(rows), "u1").astype(np.uint8)))
        used = _used(hats)
        centres = source.array(3 * len(used), "<f2").reshape(-1, 3)
        lost = rows[first < 0]
        numbers = source.array(len(lost) * self._problem.width, "<f8").reshape(len(lost), self._problem.width)
        if not source.empty:
            raise BackendError("more than the knots of shared poses")
        self._problem.places.put(lost, places_of(numbers))
        self._hats.first[rows], self._hats.weight[rows] = hats.first, hats.weight
        self._foreign |= {(neighbour, k): c for k, c in zip(used.tolist(), centres, strict=True)}

    def for_root(self) -> bytes:
        """Own knots, and the springs that this robot answers for."""
        problem = self._problem
        out = CompactWriter()
        given = self._hats.first[problem.given[0]] if problem.given and self._placed[problem.given[0]] else -1
        out.count(int(given) + 1)
        ends, own = problem.edges.ends, problem.own_count
        first = self._hats.first
        used = self._placed[ends].all(axis=1) & (first[ends] >= 0).all(axis=1)
        along = used & (ends < own).all(axis=1) & (np.abs(ends[:, 1] - ends[:, 0]) == 1)
        stops = np.union1d(self._rows, self._shared)
        linked, links = tracks(
            stops, self._hats.at(stops), self._centres, problem.edges.only(along), problem.places, problem.width
        )
        write_knots(out, Knots(self._centres, linked, links, self._sigmas, len(self._shared)))
        rest = np.flatnonzero(used & ~along & problem.counted)
        write_springs(out, self._springs(rest), problem.share.robot, problem.share.members)
        if problem.share.held is not None:
            write_grounds(out, self._grounds(), self._sigmas)
        return out.bytes()

    def _grounds(self) -> Array:
        """Of own knots, by the priors held."""
        problem = self._problem
        ends = problem.edges.ends[problem.outside]
        rows = ends.min(axis=1)
        points, stiffness = problem.places.poses[rows, :3, 3], stiffness_of(problem)[problem.outside]
        return grounds_of(self._hats.at(rows), self._centres, points, stiffness, problem.width)

    def _springs(self, edges: NDArray[np.intp]) -> Springs:
        """Of some edges; the own end first."""
        problem = self._problem
        ends = problem.edges.ends[edges]
        ends = np.where((ends[:, 0] < problem.own_count)[:, None], ends, ends[:, ::-1])
        a, b = (SpringEnd(problem.robots[r], self._hats.first[r], self._hats.weight[r]) for r in ends.T)
        # An edge is measured in its first node's frame, which carries along what turns at its second node.
        point = problem.places.poses[problem.edges.ends[edges, 1], :3, 3]
        return Springs((a, b), rounded(point), stiffness_of(self._problem)[edges])

    # -- one sweep ---------------------------------------------------------------------------------------------------

    def forces(self) -> bytes:
        """The cost now, and the forces on own knots."""
        problem = self._problem
        self._block = Block(problem, self._placed, self._shared)
        rows = self._shared
        found = gathered(
            self._hats.at(rows),
            self._centres,
            self._block.forces_on_shared(),
            problem.places.at(rows),
            problem.fixed[rows],
        )
        edges = problem.edges.only(problem.counted & self._placed[problem.edges.ends].all(axis=1))
        cost = float(edges.costs(problem.places.poses, problem.places.log_units).sum())
        return write_forces(cost, found, self._centres, self._sigmas, _FORCES * self._grid)

    def take_answer(self, body: bytes) -> Then:
        """What follows; a step of the coarse level moves own poses, and what neighbours' are expected to do."""
        problem, width = self._problem, self._problem.width
        asked = self._asked()
        answer = CoarseAnswer.decode(body, len(self._centres) + len(asked), width)
        places = problem.places
        self.capped = answer.capped
        if answer.then is Then.END_AT_BEST:
            places.put(slice(None), self._best)
        elif answer.then is Then.HALFWAY:
            self._share *= 0.5
            self._put(self._best, self._share * self._moves[-1] if self._moves else None)
        elif answer.then is Then.AGAIN:
            self._best, self._share = places.copy(), 1.0
        elif answer.then is Then.SWEEP:
            if answer.sigmas is not None:
                self._group_sigmas = answer.sigmas
            if self._share < 1.0:
                self._moves.clear()
            self._best, self._share, self._grid = places.copy(), 1.0, answer.grid
            assert answer.steps is not None
            centres = np.concatenate([self._centres, np.array([self._foreign[a] for a in asked]).reshape(-1, 3)])
            unit = by_number(self._group_sigmas, width)
            steps = summed(answer.steps, centres, float(unit[3] / unit[0]))
            self._take_step(steps * (answer.grid * unit), asked)
        return answer.then

    def _take_step(self, steps: Array, asked: list[tuple[int, int]]) -> None:
        problem, places = self._problem, self._problem.places
        self._coarse = np.zeros((len(problem), problem.width))
        rows = self._shared
        self._coarse[rows] = carried(
            self._hats.at(rows), self._centres, steps[: len(self._centres)], places.at(rows), problem.fixed[rows]
        )
        self._coarse[~self._placed] = 0.0
        self._coarse[problem.given] = 0.0
        assert self._block is not None
        own = problem.own_count
        self._coarse[:own] += self._block.follow(self._coarse[:own])
        index = {key: k for k, key in enumerate(asked)}
        theirs = steps[len(self._centres) :]
        for neighbour, rows_ in problem.received_rows.items():
            rows = np.array(rows_, dtype=np.intp)
            known = sorted(k for r, k in asked if r == neighbour)
            if not known:
                continue
            usable = rows[self._usable(rows)]
            hats = self._hats.at(usable)
            table, centres = np.zeros((known[-1] + 1, problem.width)), np.zeros((known[-1] + 1, 3))
            for k in known:
                table[k] = theirs[index[neighbour, k]]
                centres[k] = self._foreign[neighbour, k]
            self._coarse[usable] = carried(hats, centres, table, places.at(usable), problem.fixed[usable])
        self._coarse[~self._placed] = 0.0
        self._sweep = self._coarse.copy()

    def _usable(self, rows: NDArray[np.intp]) -> NDArray[np.bool_]:
        """Neighbours' rows that the coarse level moves: both ends of an edge have a place and go with knots."""
        ends = self._problem.edges.ends
        good = self._placed[ends].all(axis=1) & (self._hats.first[ends] >= 0).all(axis=1)
        return np.isin(rows, ends[good])

    def _asked(self) -> list[tuple[int, int]]:
        """Others' knots that move poses this robot shares edges with, in the root's order."""
        out: set[tuple[int, int]] = set()
        for neighbour, rows_ in self._problem.received_rows.items():
            rows = np.array(rows_, dtype=np.intp)
            hats = self._hats.at(rows[self._usable(rows)])
            for knot, weight in zip(hats.first.tolist(), hats.weight.tolist(), strict=True):
                if weight < 1:
                    out.add((neighbour, knot))
                if weight > 0:
                    out.add((neighbour, knot + 1))
        return sorted(out)

    def solve(self) -> None:
        """Own poses into equilibrium with what is known of the neighbours', shared ones in whole steps."""
        assert self._block is not None
        own = self._problem.own_count
        change = self._block.correction(self._sweep)
        unit = self._unit()
        self._steps = np.rint(change[self._shared] / unit)
        wanted = self._steps * unit
        off = np.zeros(change.shape)
        off[self._shared] = wanted - change[self._shared]
        change += self._block.follow(off)
        change[self._shared] = wanted
        self._sweep[:own] += change

    def swept_for(self, neighbour: int) -> bytes:
        """The steps of the poses shared with it."""
        rows = np.searchsorted(self._shared, self._problem.sent_rows[neighbour])
        return write_steps(self._steps[rows].astype(np.int64))

    def take_swept(self, neighbour: int, body: bytes) -> None:
        """Inverse of :meth:`swept_for`."""
        rows = np.array(self._problem.received_rows[neighbour], dtype=np.intp)
        width = self._problem.width
        steps = read_steps(body, len(rows), width)
        self._sweep[rows] = self._coarse[rows] + steps * self._unit()

    def sums(self) -> tuple[float, ...]:
        """What the root needs to mix this sweep with the moves before; last, its largest turn."""
        assert self._block is not None
        turn = float(np.abs(self._sweep[: self._problem.own_count, 3:6]).max(initial=0.0))
        return (*self._block.sums([self._sweep, *self._moves[-_DEPTH:]]), turn)

    def take_weights(self, weights: tuple[float, ...]) -> None:
        """Move as the root mixes."""
        moves = [self._sweep, *self._moves[-_DEPTH:]]
        if len(weights) != len(moves):
            raise BackendError(f"{len(weights)} weights of {len(moves)} moves")
        mixed = np.zeros(self._sweep.shape)
        for weight, m in zip(weights, moves, strict=True):
            mixed += weight * m
        self._moves = [*self._moves[-_DEPTH + 1 :], mixed]
        self._put(self._best, mixed)

    def _put(self, start: Places, moves: Array | None) -> None:
        places, rows = self._problem.places, np.flatnonzero(self._placed)
        places.put(rows, start.at(rows) if moves is None else move(start.at(rows), moves[rows]))

    def _unit(self) -> Array:
        return self._grid * by_number(self._group_sigmas, self._problem.width)


def _used(hats: Hats) -> NDArray[np.intp]:
    """Knots of any weight, in order."""
    moved = hats.first >= 0
    before, after = hats.first[moved & (hats.weight < 1)], hats.first[moved & (hats.weight > 0)] + 1
    return np.union1d(before, after).astype(np.intp)
