"""Block-coordinate descent in agreed rounds, accelerated, with or without graduated non-convexity.

A round is one sweep: every robot takes a block step with its neighbours' separators held, lower robots first, and sends
six bytes per separator. The cost comes down the tree every round, so every member applies the same stop rule to the
same numbers. The best sweep's poses are kept.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ..config import SolverConfig
from ..errors import BackendError
from ..robust.schedule import settled
from .descent import BlockDescent, stepped
from .messages import Decision, Deltas, Values
from .mixing import Mixer, MixingRule
from .places import Places, places_of
from .rounds import Separators
from .selection import Selection
from .share import Share, SolverOutcome
from .solver_stage import Round, SolverStage, as_sent, number_type
from .staged import StagedNode
from .vote import PieceVote, elected_places

# First solve with the edges that the vote names: until the cost falls by less than this share in cost_window sweeps.
_ROUGHLY = 1e-3
# Times that all edges are tested in the solution, at most.
_LOOKS = 8
# F counts squared standard deviations: a smaller fall matters to nobody.
_NOTHING = 1e-9


class DescentNode(StagedNode):
    """Riemannian block-coordinate descent to the optimum of F; see :class:`Rounds` for its use.

    With ``robust="gnc"``: a vote places the robots' pieces (:mod:`maslam.backend.distributed.vote`), step 0 of the
    rounds those that it leaves over; every further step begins with a round that judges edges (its sweep 0) and goes on
    with a few sweeps under the new weights. At the end all edges are tested in the solution, until none changes.
    """

    _descent: BlockDescent

    def __init__(self, share: Share, config: SolverConfig) -> None:
        super().__init__(share, config)
        robust = config.robust == "gnc"
        self._selection = Selection(self._problem, config.gnc_confidence, config.gnc_noise) if robust else None
        self._mixer = Mixer(config.mixed_sweeps, np.zeros((self._problem.own_count, self._problem.width)))
        self._rule = MixingRule()
        self._costs: list[float] = []
        self._best: tuple[float, Places] | None = None
        self._final = self._selection is None
        self._vote: PieceVote | None = None
        self._looks = 0
        self._announced = self._warm
        self._message: Values | Deltas | None = None

    def _after_start(self) -> Round:
        trusted = (
            np.ones(len(self._problem.edges.ends), dtype=bool) if self._selection is None else self._selection.odometry
        )
        bound = None if self._selection is None else self._selection.bound
        self._elsewhere = self._problem.places.copy()
        self._descent = BlockDescent(self._problem, self._warm, trusted, bound)
        self._mixer = Mixer(self._config.mixed_sweeps, self._descent.metric())
        if self._warm:
            self._descent.round_to_numbers(number_type(SolverStage.START))
        if self._selection is not None and not self._warm and not self.share.scaled:
            self._vote = PieceVote(self._problem, self._descent.pieces, self._selection.odometry)
            return Round(SolverStage.VOTE)
        if self._selection is not None and self.share.believed:
            # Solve with what was believed before, then test all edges in the solution.
            self._selection.begin_with(np.array(self.share.believed, dtype=bool))
            self._descent.edge_weights = self._selection.weights
            self._final = True
            return Round(SolverStage.DESCENT, 1, 1)
        return Round(SolverStage.DESCENT, 1 if self._warm and self._selection is not None else 0)

    def _enter(self) -> None:
        if self._round.stage is not SolverStage.DESCENT:
            super()._enter()
            return
        self._costs.clear()
        self._best = None
        self._mixer.restart()
        self._mixer.begin(self._problem.places)

    @property
    def _judging(self) -> bool:
        return self._round.stage is SolverStage.DESCENT and self._round.step > 0 and self._round.sweep == 0

    @property
    def _first_step(self) -> int:
        """Step that begins the schedule: after a vote its edges alone are solved with before."""
        return 1 if self._vote is None else 2

    @property
    def _placing(self) -> bool:
        """Robust: no solving before edges are judged."""
        return self._selection is not None and self._round.step == 0

    def _waits_for_lower(self) -> bool:
        return self._round.stage is SolverStage.DESCENT and not self._judging

    def _receivers(self) -> list[int]:
        return [] if self._judging else super()._receivers()

    def _awaited(self) -> list[int]:
        return [] if self._judging else super()._awaited()

    # -- one sweep ---------------------------------------------------------------------------------------------------

    def _work(self) -> float:
        if self._round.stage is not SolverStage.DESCENT:
            return super()._work()
        if self._judging:
            return self._judge()
        descent, shared = self._descent, self._descent.shared
        public = self._problem.places.at(shared)
        new = descent.place()
        change = 0.0 if self._placing else descent.sweep(self._config.descent_relaxation if self._costs else 1.0)
        me, at = self.share.robot, self._round
        if new or not self._announced:
            self._announced = bool(descent.placed[: self._problem.own_count].any())
            self._message = Values(me, me, at, descent.round_to_numbers(number_type(SolverStage.DESCENT)))
        elif self._placing or not self._announced:
            self._message = Values(me, me, at, np.zeros((0, 6)))
        else:
            self._message = Deltas(me, me, at, *descent.round_to_steps(public))
        return float("inf") if new else change

    def _judge(self) -> float:
        assert self._selection is not None
        if self._final:
            return self._selection.look_again()
        if self._round.step <= self._first_step:
            return self._selection.largest()
        return self._selection.sharpen()

    def _say(self, neighbour: int) -> Separators:
        if self._round.stage is SolverStage.VOTE:
            assert self._vote is not None
            return Values(self.share.robot, neighbour, self._round, self._vote.said(neighbour))
        message = self._message
        if self._round.stage is not SolverStage.DESCENT or message is None:
            return super()._say(neighbour)
        rows = np.searchsorted(self._descent.shared, self._problem.sent_rows[neighbour])
        if isinstance(message, Deltas):
            return replace(message, receiver=neighbour, steps=message.steps[rows])
        known = len(message.values) and np.isfinite(message.values[rows]).any()
        return replace(message, receiver=neighbour, values=message.values[rows] if known else np.zeros((0, 6)))

    def _receive(self, neighbour: int, message: Separators) -> None:
        if self._round.stage is SolverStage.VOTE:
            assert self._vote is not None and isinstance(message, Values)
            self._vote.receive(neighbour, message.values)
            return
        if self._round.stage is not SolverStage.DESCENT:
            super()._receive(neighbour, message)
            return
        rows = np.array(self._problem.received_rows[neighbour], dtype=np.intp)
        places = self._problem.places
        if isinstance(message, Deltas):
            places.put(rows, stepped(places.at(rows), message.scales, message.steps))
        elif isinstance(message, Values) and len(message.values):
            known = np.isfinite(message.values).all(axis=1)
            places.put(rows[known], places_of(message.values[known]))
            self._descent.placed[rows[known]] = True

    def _found(self) -> tuple[float, tuple[float, ...]]:
        if self._round.stage is SolverStage.VOTE:
            assert self._vote is not None and self._selection is not None
            return 0.0, self._vote.found(self._selection.bound)
        if self._round.stage is not SolverStage.DESCENT:
            return super()._found()
        if self._judging:
            return 0.0, ()
        return self._descent.cost(), self._mixer.end(self._problem.places)

    def _together(self, mine: tuple[float, ...], others: Sequence[tuple[float, ...]]) -> tuple[float, ...]:
        if self._round.stage is SolverStage.VOTE:
            return tuple(x for numbers in (mine, *others) for x in numbers)
        return super()._together(mine, others)

    def _cost(self) -> float:
        return super()._cost() if self._selection is None else self._selection.cost()

    # -- what follows ------------------------------------------------------------------------------------------------

    def _decide(self, change: float, cost: float, numbers: tuple[float, ...]) -> Decision:
        if self._round.stage is SolverStage.VOTE:
            assert self._selection is not None
            return self._decision(False, cost, as_sent(elected_places(numbers, self._selection.bound)))
        if self._round.stage is not SolverStage.DESCENT:
            return super()._decide(change, cost, numbers)
        if self._judging:
            return self._decision(not self._final or change > 0.0, change)
        if np.isinf(change):
            return self._decision(self._round.sweep < self._config.descent_sweeps + len(self.share.members), change)
        return self._decision(self._another_sweep([*self._costs, cost]), cost, self._rule.weights(numbers))

    def _another_sweep(self, costs: list[float]) -> bool:
        """The stop rule; ``costs`` of this step's sweeps since all were placed."""
        if self._placing:
            return False
        roughly = self._vote is not None and self._round.step < self._first_step
        if not self._final and not roughly:
            return self._round.sweep < self._config.gnc_sweeps
        window, limit = self._config.cost_window, self._config.descent_sweeps
        if len(costs) <= window:
            return len(costs) < limit
        fall = min(costs[:-window]) - min(costs)
        tolerance = max(_ROUGHLY, self._config.cost_tolerance) if roughly else self._config.cost_tolerance
        return len(costs) < limit and fall > tolerance * min(costs) + _NOTHING

    def _stay(self, decision: Decision) -> None:
        if self._round.stage is not SolverStage.DESCENT:
            return
        if self._judging:
            self._take_weights(decision.cost)
            return
        self._take_cost(decision.cost)
        places = self._problem.places
        if np.isinf(decision.cost):
            self._mixer.restart()
        elif self._best is not None and decision.cost > self._best[0]:
            # A mix that led uphill: back to the best sweep, which every member remembers alike.
            places.put(slice(None), self._best[1])
            self._mixer.restart()
        elif decision.numbers:
            free = places.known
            places.put(free, self._mixer.mix(decision.numbers).at(free))
        self._mixer.begin(places)

    def _take_vote(self, numbers: tuple[float, ...]) -> None:
        """Stand where the vote puts this robot; edges that agree with it are solved with first."""
        assert self._vote is not None and self._selection is not None
        placed = self._vote.adopt(numbers)
        self._descent.placed[: self._problem.own_count] |= placed
        self._selection.begin_with(self._vote.agreeing(self._selection.bound))
        self._descent.edge_weights = self._selection.weights
        self._round = Round(SolverStage.DESCENT, 0)

    def _take_weights(self, found: float) -> None:
        """``found``: the group's largest squared residual, or how undecided its least decided edge is."""
        assert self._selection is not None
        step = self._round.step - self._first_step
        if step == 0:
            self._selection.begin(found)
        if step > 0 and not self._final:
            self._final = settled([found]) or step + 1 >= self._config.gnc_steps
            if self._final:
                self._selection.decide()
        self._descent.edge_weights = self._selection.weights

    def _take_cost(self, cost: float) -> None:
        self._sweeps[SolverStage.POSE] += 1
        if np.isinf(cost):
            self._costs.clear()
            return
        self._costs.append(cost)
        if self._best is None or cost < self._best[0]:
            self._best = (cost, self._problem.places.copy())

    def _leave(self, decision: Decision) -> None:
        if self._round.stage is SolverStage.VOTE:
            self._take_vote(decision.numbers)
            return
        if self._round.stage is not SolverStage.DESCENT:
            super()._leave(decision)
            return
        if self._judging:
            self._end_descent()
            return
        self._take_cost(decision.cost)
        if self._best is not None:
            self._problem.places.put(slice(None), self._best[1])
        if not self._final or (self._selection is not None and self._looks < _LOOKS):
            self._looks += self._final
            self._round = Round(SolverStage.DESCENT, self._round.step + 1)
            return
        self._end_descent()

    def _end_descent(self) -> None:
        # What found no place stays where it was, at its neighbours' side too.
        lost = ~self._descent.placed
        self._problem.places.put(lost, self._elsewhere.at(lost))
        self._reached = self._descent.placed
        self._round = Round(SolverStage.COST)

    def _finish(self, cost_after: float) -> SolverOutcome:
        if not np.isfinite(cost_after):
            raise BackendError("the cost after block descent is not finite")
        capped = len(self._costs) >= self._config.descent_sweeps
        outcome = replace(super()._finish(cost_after), capped=capped)
        return outcome if self._selection is None else replace(outcome, judged=self._selection.judged())
