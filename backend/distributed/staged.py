"""Stages common to every distributed method: the cost before, the cost after, acceptance."""

from __future__ import annotations

from abc import abstractmethod

import numpy as np
from numpy.typing import NDArray

from ..config import SolverConfig
from .local import LocalProblem
from .messages import Decision, Values
from .rounds import Rounds, Separators
from .share import Share, SolverOutcome
from .solver_stage import Round, SolverStage


class StagedNode(Rounds):
    """Stages START and COST; a method adds its own in between."""

    def __init__(self, share: Share, config: SolverConfig) -> None:
        super().__init__(share, Round(SolverStage.START))
        self._config = config
        self._problem = LocalProblem(share)
        self._warm = config.start == "warm"
        self._reached: NDArray[np.bool_] = np.zeros(len(self._problem), dtype=bool)
        self._sweeps = {SolverStage.ROTATION: 0, SolverStage.POSE: 0}
        self._cost_before = 0.0
        self._before = self._problem.places.at(slice(self._problem.own_count))

    @abstractmethod
    def _after_start(self) -> Round:
        """The method's own first round."""

    def _cost(self) -> float:
        """The robot's part of what must not rise."""
        return self._problem.cost()

    def _enter(self) -> None:
        """Neither stage has anything to set up."""

    def _awaited(self) -> list[int]:
        if self._round.stage is SolverStage.COST:
            return []
        # To count the cost once, the lower of two robots must know the higher one's poses.
        higher_only = self._round.stage is SolverStage.START and not self._warm
        return [n for n in self.share.neighbours if n > self.share.robot or not higher_only]

    def _receivers(self) -> list[int]:
        if self._round.stage is SolverStage.COST:
            return []
        lower_only = self._round.stage is SolverStage.START and not self._warm
        return [n for n in self.share.neighbours if n < self.share.robot or not lower_only]

    def _work(self) -> float:
        return 0.0

    def _say(self, neighbour: int) -> Separators:
        return Values(self.share.robot, neighbour, self._round, self._problem.separator_places(neighbour))

    def _receive(self, neighbour: int, message: Separators) -> None:
        assert isinstance(message, Values)
        if len(message.values):
            self._problem.receive_places(neighbour, message.values)

    def _found(self) -> tuple[float, tuple[float, ...]]:
        return (self._cost() if self._round.stage in (SolverStage.START, SolverStage.COST) else 0.0), ()

    def _decide(self, change: float, cost: float, numbers: tuple[float, ...]) -> Decision:
        return self._decision(False, cost)

    def _decision(self, go_on: bool, cost: float, numbers: tuple[float, ...] = ()) -> Decision:
        return Decision(self.share.robot, self.share.robot, self._round, go_on, cost, numbers)

    def _leave(self, decision: Decision) -> None:
        match self._round.stage:
            case SolverStage.START:
                self._cost_before = decision.cost
                self._before = self._problem.places.at(slice(self._problem.own_count))
                self._round = self._after_start()
            case SolverStage.COST:
                self.outcome = self._finish(decision.cost)

    def _finish(self, cost_after: float) -> SolverOutcome:
        problem = self._problem
        own = problem.nodes[: problem.own_count]
        accepted = cost_after <= self._cost_before
        reason = "accepted" if accepted else f"the cost would rise: {self._cost_before:.6g} to {cost_after:.6g}"
        places = problem.places.at(slice(problem.own_count)) if accepted else self._before
        return SolverOutcome(
            robot=self.share.robot,
            accepted=accepted,
            reason=reason,
            poses={n: places.poses[k].copy() for k, n in enumerate(own)},
            units=dict(zip(own, np.exp(places.log_units).tolist(), strict=True)),
            cost_before=self._cost_before,
            cost_after=cost_after if accepted else self._cost_before,
            rotation_sweeps=self._sweeps[SolverStage.ROTATION],
            pose_sweeps=self._sweeps[SolverStage.POSE],
            unreached=tuple(n for k, n in enumerate(own) if not self._reached[k]),
        )
