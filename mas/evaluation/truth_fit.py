"""Whether ground truth can be of the images that it came with: odometry's path against it, over the same frames."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from maslam.backend.geometry import Array, se3_inverse
from maslam.backend.trajectory_error import path_length, trajectory_error
from maslam.frontend.files.trajectory import TRUTH_TOLERANCE_NS, Trajectory

from ..sequence import AgentSequence
from .summary import TruthFigures
from .truth_rotations import rotations_fault

_LEAST = 5  # frames with a truth: fewer align with anything
_ALIKE = (0.7, 1.4)  # truth's length over odometry's, and of spreads: good odometry is within a few percent
_STANDS_M = 0.1  # RMS distance from the mean position: below it, noise alone makes the path
# ATE over that distance: 0.1 where odometry drifts badly, near 1 where paths have nothing in common.
_ASTRAY = 1.0 / 3.0
_INVERTED = "the poses may be T_C_W, which map the world to the camera: T_W_C is meant"
_UNITS = {1e3: "millimetres", 1e2: "centimetres", 1e-3: "kilometres"}
_OTHER = "it may be of another recording or clock, or odometry went astray"


def truth_figures(sequences: Sequence[AgentSequence]) -> list[TruthFigures]:
    """Of each agent whose sequence has enough truth to tell."""
    found = []
    for agent, sequence in enumerate(sequences):
        tracks, raw = sequence.track_of(sequence.trajectory.stamps_ns), sequence.trajectory
        pieces = [Trajectory(raw.stamps_ns[tracks == k], raw.poses[tracks == k]) for k in np.unique(tracks)]
        figures = compare(agent, pieces, sequence.groundtruth, sequence.metric)
        found += [figures] if figures is not None else []
    return found


def compare(agent: int, tracks: Sequence[Trajectory], truth: Trajectory | None, metric: bool) -> TruthFigures | None:
    """The longest of an agent's ``tracks`` against ``truth``, whose times are on the same clock; None where that tells
    nothing: too few frames, or both stand.

    Lengths in metres differ where the path's length and how far it spreads both do: noise lengthens a path alone, drift
    bends it. In a unit of its own (not ``metric``) only the shape tells.
    """
    track = max(tracks, key=len, default=None)
    if track is None or truth is None or not len(truth):
        return None
    rows = truth.nearest(track.stamps_ns, TRUTH_TOLERANCE_NS)
    known = rows >= 0
    estimate, poses = track.centres[known], truth.poses[rows[known]]
    centres = poses[:, :3, 3]
    stands = max(_spread(centres), _spread(estimate) if metric else 0.0) < _STANDS_M
    if len(estimate) < _LEAST or stands or not _spread(estimate):
        return None
    fits = _fits(estimate, centres, metric)
    return TruthFigures(
        agent=agent,
        metric=metric,
        frames=len(estimate),
        odometry_m=path_length(estimate),
        truth_m=path_length(centres),
        rmse_m=trajectory_error(estimate, centres, not metric).rmse_m,
        spread_m=_spread(centres),
        fits=fits,
        cause="" if fits else _cause(estimate, poses, metric),
        rotations=rotations_fault(track.poses[known], poses) if fits else "",
    )


def _fits(estimate: Array, truth: Array, metric: bool) -> bool:
    ratios = path_length(truth) / path_length(estimate), _spread(truth) / _spread(estimate)
    alike = any(_ALIKE[0] <= ratio <= _ALIKE[1] for ratio in ratios)
    astray = trajectory_error(estimate, truth, not metric).rmse_m > _ASTRAY * _spread(truth)
    return not astray and (alike or not metric)


def _cause(estimate: Array, poses: Array, metric: bool) -> str:
    """The first change of the truth under which it fits, in words."""
    if metric:
        for factor, unit in _UNITS.items():
            if _fits(estimate, poses[:, :3, 3] / factor, metric):
                return f"the positions may be in {unit}: metres are meant"
    return _INVERTED if _fits(estimate, se3_inverse(poses)[:, :3, 3], metric) else _OTHER


def _spread(positions: Array) -> float:
    """Root mean square distance from their mean; 0 of none."""
    if not len(positions):
        return 0.0
    return float(np.sqrt(np.mean(np.sum((positions - positions.mean(axis=0)) ** 2, axis=1))))
