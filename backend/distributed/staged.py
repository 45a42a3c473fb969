"""Stages common to every distributed method: units before it, then the cost before, the cost after, acceptance."""

from __future__ import annotations

from abc import abstractmethod

import numpy as np
from numpy.typing import NDArray

from ..central.relaxation import Relaxation
from ..config import SolverConfig
from .local import LocalProblem, scale_stage
from .messages import Decision, Round, SolverStage, Values
from .rounds import Rounds, Separators
from .share import Share, SolverOutcome


class StagedNode(Rounds):
    """Stages SCALE (monocular members only), START and COST; a method adds its own in between."""

    def __init__(self, share: Share, config: SolverConfig) -> None:
        super().__init__(share, Round(SolverStage.SCALE if share.arbitrary_scale else SolverStage.START))
        self._config = config
        self._problem = LocalProblem(share)
        self._warm = config.start == "warm"
        self._scales = dict.fromkeys((share.robot, *share.neighbours), 1.0)
        self._scale: Relaxation | None = None
        self._reached: NDArray[np.bool_] = np.zeros(len(self._problem.nodes), dtype=bool)
        self._sweeps = {SolverStage.ROTATION: 0, SolverStage.POSE: 0}
        self._cost_before = 0.0
        self._before = self._problem.poses[: self._problem.own_count].copy()

    @abstractmethod
    def _after_start(self) -> Round:
        """The method's own first round."""

    def _cost(self) -> float:
        """The robot's part of what must not rise."""
        return self._problem.cost()

    def _enter(self) -> None:
        if self._round.stage is SolverStage.SCALE:
            self._scale = scale_stage(self.share)

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
        if self._round.stage is SolverStage.SCALE:
            assert self._scale is not None
            return self._scale.sweep(1.0)
        return 0.0

    def _say(self, neighbour: int) -> Separators:
        if self._round.stage is SolverStage.START:
            values = self._problem.separator_poses(neighbour)
        else:
            assert self._scale is not None
            values = self._scale.values[0]
            values = values.copy() if np.isfinite(values).all() else values[:0].copy()
        return Values(self.share.robot, neighbour, self._round, values)

    def _receive(self, neighbour: int, message: Separators) -> None:
        assert isinstance(message, Values)
        if not len(message.values):
            return
        if self._round.stage is SolverStage.START:
            self._problem.receive_poses(neighbour, message.values)
        else:
            assert self._scale is not None
            self._scale.values[1 + self.share.neighbours.index(neighbour)] = message.values

    def _found(self) -> tuple[float, tuple[float, ...]]:
        return (self._cost() if self._round.stage in (SolverStage.START, SolverStage.COST) else 0.0), ()

    def _decide(self, change: float, cost: float, numbers: tuple[float, ...]) -> Decision:
        again = self._round.stage is SolverStage.SCALE and change >= self._config.scale_threshold
        return self._decision(again and self._round.sweep + 1 < self._config.scale_sweeps, cost)

    def _decision(self, go_on: bool, cost: float, numbers: tuple[float, ...] = ()) -> Decision:
        return Decision(self.share.robot, self.share.robot, self._round, go_on, cost, numbers)

    def _leave(self, decision: Decision) -> None:
        match self._round.stage:
            case SolverStage.SCALE:
                assert self._scale is not None
                logs = np.nan_to_num(self._scale.values[:, 0, 0])
                self._scales = dict(zip(self._scales, np.exp(logs).tolist(), strict=True))
                self._problem.rescale(self._scales)
                self._round = Round(SolverStage.START)
            case SolverStage.START:
                self._cost_before = decision.cost
                self._before = self._problem.poses[: self._problem.own_count].copy()
                self._round = self._after_start()
            case SolverStage.COST:
                self.outcome = self._finish(decision.cost)

    def _finish(self, cost_after: float) -> SolverOutcome:
        problem = self._problem
        own = problem.nodes[: problem.own_count]
        accepted = cost_after <= self._cost_before
        reason = "accepted" if accepted else f"the cost would rise: {self._cost_before:.6g} to {cost_after:.6g}"
        poses = problem.poses[: problem.own_count] if accepted else self._before
        return SolverOutcome(
            robot=self.share.robot,
            accepted=accepted,
            reason=reason,
            poses={n: poses[k].copy() for k, n in enumerate(own)},
            units=dict(zip(own, np.exp(problem.log_units[: problem.own_count]).tolist(), strict=True)),
            cost_before=self._cost_before,
            cost_after=cost_after if accepted else self._cost_before,
            rotation_sweeps=self._sweeps[SolverStage.ROTATION],
            pose_sweeps=self._sweeps[SolverStage.POSE],
            unreached=tuple(n for k, n in enumerate(own) if not self._reached[k]),
        )
