"""Sweeps with a coarse level: block Gauss-Seidel for what is near, knots along all tracks for what is far.

One sweep of block descent carries a correction from one robot to the next; a city of a hundred needs hundreds. So
before each sweep all robots' knots move together, as the root of the members finds from the forces on them (two-level
Schwarz methods: Smith, Bjorstad, Gropp, 1996), and after it the sweep is mixed with the last two moves such that the
model of F falls most (flexible conjugate gradients). The number of sweeps hardly grows with the number of robots.

The root sees where knots are, how stiff tracks are between them, and where which of them are tied; of a robot that is
not its neighbour no other pose, and no measurement.
"""

from __future__ import annotations

from dataclasses import replace
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from ...components import parts
from ...config import SolverConfig
from ...errors import BackendError
from ..compact import CompactReader
from ..descent_node import DescentNode
from ..messages import Coded, Decision
from ..rounds import Separators
from ..share import Share, SolverOutcome
from ..solver_stage import Round, SolverStage
from .answers import Then, sums_as_bytes, sums_from
from .coded_places import CodedPlaces, close_to, deviations_of, firm_edges
from .leading import Leading
from .part import Part


class Phase(IntEnum):
    """Rounds of the stage, by their ``sweep``: the first two where the coarse level begins; the others in each step."""

    NEIGHBOURS = 0
    LEVEL = 1
    FORCES = 2
    ANSWER = 3
    SWEEP = 4
    SUMS = 5
    WEIGHTS = 6


# Rounds of the start, by their sweep: who needs it exactly, and that.
_ASK, _EXACTLY = 1, 2
_TO_ROOT = (Phase.LEVEL, Phase.FORCES, Phase.SUMS)
_FROM_ROOT = (Phase.ANSWER, Phase.WEIGHTS)


class TwoLevelNode(DescentNode):
    """Places as block descent does, then sweeps with a coarse level; see :class:`Rounds` for its use."""

    # What goes to the root takes a robot on, though neighbours may lack what went to them before: knots, level, forces.
    _ROUNDS_KEPT = 4

    def __init__(self, share: Share, config: SolverConfig) -> None:
        super().__init__(share, config)
        self._leading: Leading | None = None
        if share.robot == share.members[0]:
            self._leading = Leading(share, self._problem.width, config.two_level_tolerance, config.two_level_sweeps)
        self._then = Then.SWEEP
        self._exact_for: set[int] = set()
        self._begun: Part | None = None
        self._sigmas = deviations_of(self._problem)
        self._bodies: dict[int, bytes] = {}

    @property
    def _placing(self) -> bool:
        """Block descent only places."""
        return self._round.stage is SolverStage.DESCENT

    @property
    def _part(self) -> Part:
        assert self._begun is not None
        return self._begun

    @property
    def _phase(self) -> Phase | None:
        return Phase(self._round.sweep) if self._round.stage is SolverStage.TWO_LEVEL else None

    def _by_tree(self) -> bool:
        return self._phase is None and not self._guessing

    @property
    def _guessing(self) -> bool:
        """Rounds of the start that only find out for whom it must be exact."""
        return self._round.stage is SolverStage.START and not self._warm and self._round.sweep < _EXACTLY

    def _alone(self) -> Decision:
        if self._guessing:
            return super()._alone()
        last = self._phase in (Phase.LEVEL, Phase.WEIGHTS) or (
            self._phase is Phase.ANSWER and self._then is not Then.SWEEP
        )
        return replace(super()._alone(), go_on=not last)

    def _waits_for_lower(self) -> bool:
        return self._phase is Phase.SWEEP if self._phase is not None else super()._waits_for_lower()

    def _receivers(self) -> list[int]:
        if self._asking:
            return [n for n in self.share.neighbours if n > self.share.robot]
        return super()._receivers() if self._phase is None else self._partners(_FROM_ROOT, _TO_ROOT)

    def _awaited(self) -> list[int]:
        if self._asking:
            return [n for n in self.share.neighbours if n < self.share.robot]
        return super()._awaited() if self._phase is None else self._partners(_TO_ROOT, _FROM_ROOT)

    @property
    def _asking(self) -> bool:
        """Lower robots say whether they need the start exactly."""
        return self._guessing and self._round.sweep == _ASK

    def _partners(self, at_root: tuple[Phase, ...], at_others: tuple[Phase, ...]) -> list[int]:
        """Whom a round's messages go to, or come from: neighbours, or in these phases all others, or the root."""
        if self._phase not in (*at_root, *at_others):
            return self.share.neighbours
        if self._leading is not None:
            return list(self.share.members[1:]) if self._phase in at_root else []
        return [self.share.members[0]] if self._phase in at_others else []

    def _follows(self) -> bool:
        return super()._follows() or (self._phase in _FROM_ROOT and self._leading is None)

    def _check(self, message: Separators) -> None:
        far = message.round.stage is SolverStage.TWO_LEVEL and message.sender in self.share.members
        if not isinstance(message, Coded) or not (far or message.sender in self._expected):
            super()._check(message)

    # -- one round ---------------------------------------------------------------------------------------------------

    def _work(self) -> float:
        me, leading = self.share.robot, self._leading
        self._bodies = {}
        match self._phase:
            case None if self._placing:
                return self._place()
            case None:
                return super()._work()
            case Phase.NEIGHBOURS:
                self._begin_level()
                self._bodies = {n: self._part.for_neighbour(n) for n in self.share.neighbours}
            case Phase.LEVEL:
                self._to_root(self._part.for_root())
            case Phase.FORCES:
                self._to_root(self._part.forces())
            case Phase.ANSWER if leading is not None:
                self._bodies = {r: a.encode() for r, a in leading.answers().items()}
                self._then = self._part.take_answer(self._bodies[me])
            case Phase.SWEEP:
                self._part.solve()
                self._bodies = {n: self._part.swept_for(n) for n in self.share.neighbours}
            case Phase.SUMS:
                self._to_root(sums_as_bytes(self._part.sums()))
            case Phase.WEIGHTS if leading is not None:
                self._bodies = dict.fromkeys(self.share.members, sums_as_bytes(leading.weights()))
                self._take_weights_of(self._bodies[me])
            case _:
                pass
        return 0.0

    def _begin_level(self) -> None:
        if self._begun is not None:
            self._begun.renew()
            return
        own = self._problem.own_count
        inner = (self._problem.edges.ends < own).all(axis=1) & firm_edges(self._problem)
        label = parts(self._problem.edges.ends[inner], own)
        self._begun = Part(self._problem, self._descent.placed, label, self._config.two_level_spacing)

    def _place(self) -> float:
        """Own pieces that have become tied; neighbours learn of them, in whole steps, as soon as one is placed."""
        descent, places = self._descent, self._problem.places
        new = descent.place()
        if new or not self._announced:
            self._announced = bool(descent.placed[: self._problem.own_count].any())
            shared = descent.shared
            coded = self._coded(shared)
            places.put(shared[coded.known], coded.places)
            for n, rows in self._problem.sent_rows.items():
                self._bodies[n] = coded.at(np.searchsorted(shared, rows)).encode()
        return float("inf") if new else 0.0

    def _coded(self, rows: NDArray[np.intp]) -> CodedPlaces:
        """Own rows that have a place."""
        known = self._descent.placed[rows] if self._placing else np.ones(len(rows), dtype=bool)
        return CodedPlaces.of(self._problem.places.at(rows), known, self._sigmas, self._problem.width)

    def _to_root(self, body: bytes) -> None:
        root = self.share.members[0]
        if self._leading is not None:
            self._lead(root, body)
        else:
            self._bodies = {root: body}

    def _lead(self, robot: int, body: bytes) -> None:
        assert self._leading is not None
        match self._phase:
            case Phase.LEVEL:
                self._leading.take_part(robot, body)
            case Phase.FORCES:
                self._leading.take_forces(robot, body)
            case _:
                self._leading.take_sums(sums_from(body))

    def _say(self, neighbour: int) -> Separators:
        body = self._bodies.get(neighbour, b"")
        if self._round.stage is SolverStage.START and not self._warm:
            body = self._start_for(neighbour)
        elif self._phase is None and not self._placing:
            return super()._say(neighbour)
        return Coded(self.share.robot, neighbour, self._round, body)

    def _start_for(self, neighbour: int) -> bytes:
        """Where this robot was before, roughly, as most starts are far from any frame of all; exactly where a neighbour
        asks for it."""
        if self._asking:
            return bytes([1]) if close_to(self._problem, neighbour) else b""
        if self._round.sweep == _EXACTLY:
            exactly = self._problem.separator_places(neighbour).astype("<f8").tobytes()
            return exactly if neighbour in self._exact_for else b""
        rows = np.array(self._problem.sent_rows[neighbour], dtype=np.intp)
        return self._coded(rows).encode()

    def _receive(self, neighbour: int, message: Separators) -> None:
        if not isinstance(message, Coded):
            super()._receive(neighbour, message)
            return
        try:
            self._take(neighbour, message)
        except BackendError as error:
            raise BackendError(
                f"robot {neighbour} sent robot {self.share.robot} numbers that do not fit: {error}; do the two hold "
                "different edges between them?"
            ) from error

    def _take(self, neighbour: int, message: Coded) -> None:
        match self._phase:
            case None if self._asking:
                if message.body:
                    self._exact_for.add(neighbour)
            case None if self._round.stage is SolverStage.START and self._round.sweep == _EXACTLY:
                if message.body:
                    rows = len(self._problem.received_rows[neighbour])
                    values = CompactReader(message.body).array(rows * self._problem.width, "<f8")
                    self._problem.receive_places(neighbour, values.reshape(rows, -1))
            case None:
                self._take_places(neighbour, message.body)
            case Phase.NEIGHBOURS:
                self._part.take_neighbour(neighbour, message.body)
            case Phase.SWEEP:
                self._part.take_swept(neighbour, message.body)
            case Phase.ANSWER:
                self._then = self._part.take_answer(message.body)
            case Phase.WEIGHTS:
                self._take_weights_of(message.body)
            case _:
                self._lead(neighbour, message.body)

    def _take_places(self, neighbour: int, body: bytes) -> None:
        rows = np.array(self._problem.received_rows[neighbour], dtype=np.intp)
        coded = CodedPlaces.decode(body, len(rows), self._problem.width)
        self._problem.places.put(rows[coded.known], coded.places)
        if self._placing:
            self._descent.placed[rows[coded.known]] = True

    def _take_weights_of(self, body: bytes) -> None:
        self._part.take_weights(sums_from(body))

    # -- what follows ------------------------------------------------------------------------------------------------

    def _stay(self, decision: Decision) -> None:
        if self._phase is None:
            super()._stay(decision)

    def _enter(self) -> None:
        if self._phase is None:
            super()._enter()

    def _leave(self, decision: Decision) -> None:
        phase = self._phase
        if phase is None:
            super()._leave(decision)
            if self._round.stage is SolverStage.COST:
                self._round = Round(SolverStage.TWO_LEVEL, 0, Phase.NEIGHBOURS)
        elif phase is Phase.ANSWER and self._then.ends:
            self._round = Round(SolverStage.COST)
        else:
            self._sweeps[SolverStage.POSE] += phase is Phase.WEIGHTS
            again = phase is Phase.ANSWER and self._then is Then.AGAIN
            first = Phase.NEIGHBOURS if again else Phase.FORCES
            self._round = Round(SolverStage.TWO_LEVEL, self._round.step + 1, first)

    def _finish(self, cost_after: float) -> SolverOutcome:
        return replace(super()._finish(cost_after), capped=self._part.capped)
