"""Error of odometry alone, on the frames that the agents' error is of."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from maslam.frontend.files.trajectory import Trajectory

from ..agent import Agent
from ..sequence import AgentSequence
from .ground_truth import GroundTruthEvaluator
from .summary import MeasuredOn


@dataclass(frozen=True)
class OdometryError:
    """``rmse_m`` of positions, metres, and what it was measured ``on``."""

    rmse_m: float
    on: MeasuredOn


def odometry_error(agent: Agent, sequence: AgentSequence, evaluator: GroundTruthEvaluator) -> OdometryError | None:
    """Error of the placed frames as odometry left them; None without enough truth.

    Odometry does not say how one track stands to another: each has an alignment of its own, over which the errors of
    all frames are taken together. A track of fewer poses than align is left out.
    """
    raw, state = sequence.trajectory, agent.state
    tracks = sequence.track_of(raw.stamps_ns)
    errors = []
    for piece in state.pieces:
        if piece.frame == state.frame:
            frames = tracks == piece.track
            errors.append(evaluator.error_of(state.me, Trajectory(raw.stamps_ns[frames], raw.poses[frames])))
    known = [error for error in errors if error is not None]
    if not known:
        return None
    apart = np.concatenate([error.errors_m for error in known])
    on = MeasuredOn(
        kind="SE(3)" if sequence.metric else "Sim(3)",
        scale=float(max(known, key=lambda error: len(error.errors_m)).T_truth_estimate.scale),
        frames=len(apart),
        tracks=len(known),
    )
    return OdometryError(float(np.sqrt(np.mean(apart**2))), on)
