"""What a run has made of the map of an earlier one: who stands in it, how far off, and how far the map has moved."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from maslam.backend.geometry import Array, Sim3
from maslam.backend.trajectory_error import trajectory_error
from maslam.frontend.files.trajectory import TRUTH_TOLERANCE_NS

from ..agent import Agent
from ..sequence import AgentSequence
from ..state.trajectories import keyframe_trajectory
from .earlier_figures import EarlierFigures
from .ground_truth import MIN_POSES, groups_of


class EarlierMap:
    """The agents of an earlier run as they are before the later one begins. Of several maps it is the one of most
    agents."""

    def __init__(self, agents: Sequence[Agent], sequences: Sequence[AgentSequence], metric: bool) -> None:
        """``agents``: all of the earlier run's; ``sequences``: of all agents; ``metric``: lengths in its map are
        metres."""
        self._sequences, self._metric = list(sequences), metric
        self._count = len(agents)
        self._group = max(groups_of(agents), key=len)
        self.frame = agents[self._group[0]].state.frame
        self._before = self._errors(agents)
        self._centres = self._placed(agents)

    def figures(self, agents: Sequence[Agent]) -> EarlierFigures:
        """At the end; ``agents``: all of the later run."""
        now = self._placed(agents)
        same = [(self._centres[i], now[i]) for i in sorted(self._centres.keys() & now.keys())]
        apart = [np.linalg.norm(a - b) for a, b in same]
        return EarlierFigures(
            agents=self._count,
            frame=(self.frame.agent, self.frame.track),
            in_frame=[a.state.me for a in agents[self._count :] if a.state.keyframes and a.state.frame == self.frame],
            ate_rmse_m=self._errors(agents),
            before_rmse_m=self._before,
            moved=float(np.sqrt(np.mean(np.square(apart)))) if apart else None,
        )

    def _placed(self, agents: Sequence[Agent]) -> dict[tuple[int, int], Array]:
        """Centres of the earlier key-frames in the frame, by agent and index."""
        states = [agents[a].state for a in self._group if agents[a].state.frame == self.frame]
        return {(s.me, i): s.poses[i][:3, 3] for s in states for i in s.placed()}

    def _errors(self, agents: Sequence[Agent]) -> list[float | None]:
        """Of each agent, where the earlier ones tell how the frame stands to the truth."""
        pairs = [self._paired(agent) if agent.state.frame == self.frame else None for agent in agents]
        known = [pair for a in self._group if (pair := pairs[a]) is not None]
        if not known:
            return [None] * len(agents)
        estimate, truth = (np.concatenate([p[k] for p in known]) for k in range(2))
        if len(estimate) < MIN_POSES or np.ptp(truth, axis=0).max() == 0:
            return [None] * len(agents)
        T_truth_F = trajectory_error(estimate, truth, not self._metric).T_truth_estimate
        return [None if pair is None else _rmse(T_truth_F, *pair) for pair in pairs]

    def _paired(self, agent: Agent) -> tuple[Array, Array]:
        """Centres ``(n, 3)`` of placed key-frames, and where they truly were."""
        truth, placed = self._sequences[agent.state.me].groundtruth, keyframe_trajectory(agent.state)
        if truth is None or not len(truth):
            return np.zeros((0, 3)), np.zeros((0, 3))
        rows = truth.nearest(placed.stamps_ns, TRUTH_TOLERANCE_NS)
        return placed.centres[rows >= 0], truth.centres[rows[rows >= 0]]


def _rmse(T_truth_F: Sim3, estimate: Array, truth: Array) -> float | None:
    apart = np.linalg.norm(T_truth_F @ estimate - truth, axis=1) if len(estimate) else None
    return None if apart is None else float(np.sqrt((apart**2).mean()))
