"""Errors of map copies, against ground truth and against the owner's own map as it stands at the end."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.spatial import cKDTree

from maslam.backend.geometry import Array
from maslam.backend.trajectory_error import TrajectoryError

from ..agent import Agent
from ..map_exchange.map_copy import MapCopy
from ..state.agent_state import AgentState
from .summary import MapCopyFigures

# Key-frames of a copy that are looked at, spread evenly.
_SAMPLE = 8


def map_copies(agents: Sequence[Agent], errors: Sequence[dict[int, TrajectoryError]]) -> list[MapCopyFigures]:
    """Every copy that is held; ``errors``: of each holder's copies by owner, under its alignment."""
    originals = {agent.state.me: Original(agent.state) for agent in agents}
    return [
        MapCopyFigures(
            holder=agent.state.me,
            owner=owner,
            version=copy.version,
            keyframes=len(copy.poses),
            points=len(copy.references),
            ate_rmse_m=each[owner].rmse_m if owner in each else None,
            ate_mean_m=each[owner].mean_m if owner in each else None,
            points_off_m=_in_metres(originals[owner].off(copy, agent.state), agent, each.get(owner)),
        )
        for agent, each in zip(agents, errors, strict=True)
        for owner, copy in sorted(agent.maps.copies.items())
    ]


def _in_metres(off: float | None, holder: Agent, error: TrajectoryError | None) -> float | None:
    """A length in the unit of a holder's frame; None where nothing says how long that unit is."""
    if off is None or holder.state.profile.metric:
        return off
    return None if error is None else off * float(error.T_truth_estimate.scale)


class Original:
    """An agent's own map, to hold copies of it against."""

    def __init__(self, owner: AgentState) -> None:
        self.owner = owner
        self._trees: dict[int, cKDTree] = {}

    def off(self, copy: MapCopy, holder: AgentState) -> float | None:
        """Median distance of a copy's points from where their owner has them, in the unit of their frame; None where
        the two are in different coordinates, or the copy has no points; key-frames that the owner lacks are left out.

        A copied point is the one of the owner's key-frame that is nearest to it in the camera.
        """
        if holder.frame != self.owner.frame:
            return None
        apart: list[Array] = []
        rows = np.linspace(0, len(copy.keyframes) - 1, min(_SAMPLE, len(copy.keyframes))).astype(int)
        for row in [r for r in rows.tolist() if 0 <= copy.keyframes[r] < len(self.owner.keyframes)]:
            copied, tree = copy.points_C[copy.references == row], self._points(int(copy.keyframes[row]))
            if len(copied) and tree.n:
                own = self.owner.pose(int(copy.keyframes[row])) @ tree.data[tree.query(copied)[1]]
                apart.append(np.linalg.norm(copy.pose(row) @ copied - own, axis=1))
        return float(np.median(np.concatenate(apart))) if apart else None

    def _points(self, index: int) -> cKDTree:
        if index not in self._trees:
            self._trees[index] = cKDTree(self.owner.keyframes[index].points_C.astype(np.float64).reshape(-1, 3))
        return self._trees[index]
