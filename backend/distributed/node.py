"""The two-stage method at one robot: rotation sweeps, then sweeps on Gauss-Newton steps for the poses.

Synchronous rounds (:mod:`maslam.backend.distributed.rounds`): robots that share no edge work at the same time, and the
result does not depend on the order of messages.
"""

from __future__ import annotations

import numpy as np

from ..central.relaxation import Relaxation
from ..geometry import Array
from .messages import Decision, Values
from .rounds import Separators
from .solver_stage import Round, SolverStage
from .staged import StagedNode

# Gauss-Newton steps where units of length are variables.
_SCALED_STEPS = 3
_SWEPT = (SolverStage.SCALE, SolverStage.ROTATION, SolverStage.POSE)


class Node(StagedNode):
    """Distributed Gauss-Seidel (Choudhary et al., IJRR 2017), Jacobi and over-relaxed; see :class:`Rounds` for its
    use. Where units of length are variables, sweeps over their logarithms come first.
    """

    _stage: Relaxation

    def _after_start(self) -> Round:
        return Round(SolverStage.SCALE if self.share.scaled else SolverStage.ROTATION)

    def _enter(self) -> None:
        if self._round.stage is SolverStage.SCALE:
            self._stage = self._problem.scale_stage(self._warm)
        elif self._round.stage is SolverStage.ROTATION:
            self._stage = self._problem.rotation_stage(self._warm)
        elif self._round.stage is SolverStage.POSE:
            self._stage = self._problem.pose_stage(self._reached, self._warm or self._round.step > 0)
        else:
            super()._enter()

    @property
    def _newton_steps(self) -> int:
        """Units are far from linear: the published single step leaves a tenfold cost."""
        return max(self._config.newton_steps, _SCALED_STEPS) if self.share.scaled else self._config.newton_steps

    def _waits_for_lower(self) -> bool:
        return self._round.stage in _SWEPT and self._config.method != "jor"

    def _work(self) -> float:
        if self._round.stage not in _SWEPT:
            return super()._work()
        change = self._stage.sweep(self._relaxation())
        return change / np.sqrt(max(self._problem.own_count, 1)) if self._config.change == "rms" else change

    def _relaxation(self) -> float:
        # Units of length couple all of a track's positions: over-relaxed sweeps swing for hundreds of rounds there.
        if self._config.method == "dgs" or self.share.scaled:
            return 1.0
        return self._config.relaxation if self._config.method == "sor" else min(self._config.relaxation, 1.0)

    def _decide(self, change: float, cost: float, numbers: tuple[float, ...]) -> Decision:
        limits = {
            SolverStage.SCALE: (self._config.scale_sweeps, self._config.scale_threshold),
            SolverStage.ROTATION: (self._config.rotation_sweeps, self._config.rotation_threshold),
            SolverStage.POSE: (self._config.pose_sweeps, self._config.pose_threshold),
        }
        if self._round.stage not in limits:
            return super()._decide(change, cost, numbers)
        sweeps, threshold = limits[self._round.stage]
        # A later sweep in which poses get their first estimate is never the last: it may be others' turn now.
        spreading = np.isinf(change) and 0 < self._round.sweep < len(self.share.members)
        return self._decision(spreading or (self._round.sweep + 1 < sweeps and change >= threshold), cost)

    def _stay(self, decision: Decision) -> None:
        if self._round.stage in self._sweeps:
            self._sweeps[self._round.stage] += 1

    def _leave(self, decision: Decision) -> None:
        self._stay(decision)
        if self._round.stage is SolverStage.SCALE:
            self._problem.take_log_units(self._stage)
            self._round = Round(SolverStage.ROTATION)
        elif self._round.stage is SolverStage.ROTATION:
            self._reached = self._stage.known()
            self._problem.take_rotations(self._stage)
            self._round = Round(SolverStage.POSE)
        elif self._round.stage is SolverStage.POSE:
            self._problem.take_poses(self._stage)
            last = self._round.step + 1 >= self._newton_steps
            self._round = Round(SolverStage.COST) if last else Round(SolverStage.POSE, self._round.step + 1)
        else:
            super()._leave(decision)

    def _say(self, neighbour: int) -> Separators:
        if self._round.stage not in _SWEPT:
            return super()._say(neighbour)
        rows = self._problem.sent_rows[neighbour]
        values = self._stage.values[rows]
        if self._round.stage is SolverStage.ROTATION:
            values = np.swapaxes(values, 1, 2)
        flat: Array = values.reshape(len(rows), self._width())
        known = flat.copy() if np.isfinite(flat).any() else flat[:0].copy()
        return Values(self.share.robot, neighbour, self._round, known)

    def _receive(self, neighbour: int, message: Separators) -> None:
        if self._round.stage not in _SWEPT:
            super()._receive(neighbour, message)
            return
        assert isinstance(message, Values)
        if not len(message.values):
            return
        rows = self._problem.received_rows[neighbour]
        if self._round.stage is SolverStage.ROTATION:
            self._stage.values[rows] = np.swapaxes(message.values.reshape(-1, 3, 3), 1, 2)
        else:
            self._stage.values[rows] = message.values[:, :, None]
