"""One robot's part: its poses and priors, what it tells of them, and its share in each run of the method."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ...central.origin import OriginPriors, kernel, places_a_part
from ...components import parts
from ...geometry import Sim3
from ...pose_graph.graph import Edge, EdgeKind, NodeId
from ..held import HeldPriors
from ..places import Places
from ..share import JudgedEdge, Share, SolverOutcome
from .alignment import origin_from, sums_of
from .course import Next, PriorSums


class PriorPart:
    """``places`` of own nodes; those ``kept`` ``(n,)`` take part in runs with priors: tied to the anchor by edges, or
    in a piece by itself that its own priors place."""

    def __init__(self, share: Share) -> None:
        self._share = share
        self._nodes = sorted(share.poses)
        self._row = {n: k for k, n in enumerate(self._nodes)}
        poses = np.array([share.poses[n] for n in self._nodes])
        self._start = Places(poses, share.log_units(self._nodes))
        self.places = self._start.copy()
        self.kept = np.ones(len(self._nodes), dtype=bool)
        self._joined = self.kept
        self._priors = OriginPriors.of(share.priors, share.dimension)
        self._rows = np.array([self._row[n] for n in self._priors.nodes], dtype=np.intp)
        self._held: HeldPriors | None = None
        self._before = 0.0
        self._sweeps = np.zeros(2, dtype=np.intp)
        self._judged: dict[int, JudgedEdge] = {}

    # -- what it tells -----------------------------------------------------------------------------------------------

    def tally(self, last: Next | None) -> PriorSums:
        """What goes up the tree; ``last``: what was decided before."""
        used = (self._joined if self._held is None else self.kept)[self._rows]
        priors, rows = self._priors.only(used), self._rows[used]
        places = self.places.at(rows)
        origin, widen = (None, 1.0) if last is None or last.then.without else (last.origin, last.widen)
        largest = 0.0
        if origin is not None and len(priors):
            residual = priors.residuals(places.poses, places.log_units, origin)
            largest = float(np.where(np.isfinite(priors.bound), residual / priors.bound, 0.0).max())
        sums = sums_of(priors, places, origin, widen)
        anchor, first, now = self._share.robot == self._share.anchor, np.zeros(7), np.zeros(7)
        if anchor:
            first, now = self._start.numbers(7)[0], self.places.numbers(7)[0]
        before, self._before = self._before, 0.0
        return PriorSums(sums, before, self._held_cost(), first, now, largest)

    def _held_cost(self) -> float:
        """What the priors held in the last run cost now, as the method sees it."""
        if self._held is None:
            return 0.0
        held = self._held.priors
        places = self.places.at([self._row[n] for n in held.nodes])
        return float((held.residuals(places.poses, places.log_units, self._held.origin) ** 2).sum())

    # -- runs --------------------------------------------------------------------------------------------------------

    def share_of(self, step: Next) -> Share:
        """The share of the next run: as it was without priors, or, from where poses are, with them held."""
        share = replace(self._share, priors=(), positions=False)
        if step.then.without:
            return share
        if self._held is None:
            self._place_pieces(step)
        used = self.kept[self._rows]
        priors, rows = self._priors.only(used), self._rows[used]
        places = self.places.at(rows)
        residual = priors.residuals(places.poses, places.log_units, step.origin)
        priors = priors.weighted(kernel(residual, priors.bound * step.widen))
        nodes = [n for n, k in zip(self._nodes, self.kept, strict=True) if k]
        if not nodes:
            nodes, priors = self._nodes[:1], self._standing(step.origin)
        self._held = HeldPriors(priors, step.origin)
        self._before = self._held_cost()
        return replace(
            share,
            poses={n: self.places.poses[self._row[n]] for n in nodes},
            units={n: float(np.exp(self.places.log_units[self._row[n]])) for n in nodes},
            edges=tuple(self._share.edges[k] for k in self._edges()),
            held=self._held,
            believed=tuple(not self._rejected(k) for k in self._edges()) if self._judged else (),
        )

    def _standing(self, origin: Sim3) -> OriginPriors:
        """Of a robot none of whose nodes takes part: its first one stays where it is."""
        T, one = origin.inverse().transform_poses(self.places.poses[:1]), np.ones(1)
        return OriginPriors((self._nodes[0],), T, one, one, np.zeros((1, 3)), np.full(1, np.inf))

    def _edges(self) -> list[int]:
        """Edges whose own ends take part."""
        rows = ([self._row[n] for n in (e.i, e.j) if n in self._row] for e in self._share.edges)
        return [k for k, own in enumerate(rows) if self.kept[own].all()]

    def _rejected(self, edge: int) -> bool:
        return edge in self._judged and self._judged[edge].rejected

    def take(self, outcome: SolverOutcome) -> None:
        """What a run ended with."""
        alone = self._held is None
        nodes = [n for n in self._nodes if n in outcome.poses]
        if self.kept.any():
            rows = [self._row[n] for n in nodes]
            poses = np.array([outcome.poses[n] for n in nodes])
            self.places.put(rows, Places(poses, np.log([outcome.units[n] for n in nodes])))
        lost = {self._row[n] for n in outcome.unreached}
        if alone and lost:
            self.kept[sorted(lost)] = False
            self._joined = self.kept.copy()
        self._sweeps += outcome.rotation_sweeps, outcome.pose_sweeps
        judged = [k for k in self._edges() if self._share.edges[k].kind is not EdgeKind.ODOMETRY]
        if alone:
            judged = [k for k, e in enumerate(self._share.edges) if e.kind is not EdgeKind.ODOMETRY]
        self._judged |= dict(zip(judged, outcome.judged, strict=False))

    def _place_pieces(self, step: Next) -> None:
        """Pieces that no edge ties to others', with priors enough, go where these say."""
        lost = np.flatnonzero(~self.kept)
        if not len(lost):
            return
        ends = [self._ends(e) for e in self._share.edges]
        own = np.array([pair for pair in ends if len(pair) == 2], dtype=np.intp).reshape(-1, 2)
        label = parts(own, len(self._nodes))
        tied = {int(label[pair[0]]) for pair in ends if len(pair) == 1}
        for piece in sorted(set(label[lost].tolist()) - tied):
            mine = label[self._rows] == piece
            priors, rows = self._priors.only(mine), self._rows[mine]
            if not places_a_part(int(priors.turning.sum()), len(priors)):
                continue
            there = self._laid_on(priors, rows, step.origin.scale != 1.0)
            move, nodes = step.origin @ there.inverse(), np.flatnonzero(label == piece)
            poses = move.transform_poses(self.places.poses[nodes])
            self.places.put(nodes, Places(poses, self.places.log_units[nodes] + np.log(move.scale)))
            self.kept[nodes] = True

    def _laid_on(self, priors: OriginPriors, rows: NDArray[np.intp], free_unit: bool) -> Sim3:
        """Where the frame of the priors lies among a piece's poses; those far off count less from round to round."""
        origin: Sim3 | None = None
        for widen in (1.0, 16.0, 8.0, 4.0, 2.0, 1.0):
            sums = sums_of(priors, self.places.at(rows), origin, widen)
            origin = origin_from(sums, free_unit, self._share.dimension)
        assert origin is not None
        return origin

    def _ends(self, edge: Edge) -> list[int]:
        return [self._row[n] for n in (edge.i, edge.j) if n in self._row]

    # -- the end -----------------------------------------------------------------------------------------------------

    def ended(self, last: Next, outcome: SolverOutcome) -> SolverOutcome:
        """What it all ended with; ``outcome`` of the last run."""
        accepted = last.cost_after <= last.cost_before
        final = self._start.copy()
        if accepted:
            rows = np.flatnonzero(self.kept)
            poses = last.origin.transform_poses(self.places.poses[rows])
            final.put(rows, Places(poses, self.places.log_units[rows] + np.log(last.origin.scale)))
            if self._share.robot == self._share.anchor:
                final.put([0], self._start.at([0]))
        before, after = last.cost_before, last.cost_after
        return replace(
            outcome,
            accepted=accepted,
            reason="accepted" if accepted else f"the cost would rise: {before:.6g} to {after:.6g}",
            poses={n: final.poses[k].copy() for k, n in enumerate(self._nodes)},
            units=dict(zip(self._nodes, np.exp(final.log_units).tolist(), strict=True)),
            cost_before=before,
            cost_after=after if accepted else before,
            rotation_sweeps=int(self._sweeps[0]),
            pose_sweeps=int(self._sweeps[1]),
            unreached=self._lost(),
            judged=tuple(self._judged[k] for k in sorted(self._judged)),
            positions=True,
        )

    def _lost(self) -> tuple[NodeId, ...]:
        return tuple(n for n, k in zip(self._nodes, self.kept, strict=True) if not k)
