"""Errors of one sequence's trajectories against the truth: the figures of ``maslam bench vo``."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from maslam.backend.geometry import Array
from maslam.backend.trajectory_error import path_length, relative_error, step_error, trajectory_error
from maslam.frontend.files.trajectory import Trajectory

LENGTHS_M = (10.0, 100.0)


@dataclass(frozen=True, eq=False)
class Aligned:
    """One track beside the truth: ``positions`` after alignment and ``truth`` ``(N, 3)`` metres, ``along_m`` ``(N,)``
    the path driven so far, ``errors_m`` ``(N,)``."""

    positions: Array
    truth: Array
    along_m: Array
    errors_m: Array


@dataclass(frozen=True, eq=False)
class Accuracy:
    """``posed`` frames have a pose and a true one. Tracks have frames of their own: each is aligned by itself, and the
    figures are those of all their poses. ``rpe_percent`` and ``rpe_deg_per_m``: one for each of :data:`LENGTHS_M`,
    NaN where no track is as long. ``scale``: true size over estimated size of the longest track. ``path_m``: the path
    of these frames."""

    posed: int
    with_scale: bool
    path_m: float
    ate_m: float
    ate_mean_m: float
    ate_max_m: float
    rpe_percent: tuple[float, ...]
    rpe_deg_per_m: tuple[float, ...]
    step_m: float
    step_deg: float
    scale: float
    tracks: tuple[Aligned, ...]


def half_frame_ns(stamps_ns: NDArray[np.int64]) -> int:
    """Half the usual time between two frames: poses nearer than this belong to the same moment."""
    return int(np.median(np.diff(stamps_ns))) // 2 if len(stamps_ns) > 1 else 0


def accuracy(
    tracks: Sequence[Trajectory], truth: Trajectory, stamps_ns: NDArray[np.int64], with_scale: bool
) -> Accuracy | None:
    """Errors of ``tracks`` against ``truth`` at the frames of time ``stamps_ns``; each pose is paired with the nearest
    frame and the nearest true pose within half a frame. None where nothing can be paired.

    ``with_scale``: Sim(3) instead of SE(3) alignment, and the relative errors after its scale.
    """
    pairs = [pair for track in tracks if (pair := _paired(track, truth, stamps_ns)) is not None]
    if not pairs:
        return None
    errors = [trajectory_error(est[:, :3, 3], true[:, :3, 3], with_scale) for _, est, true in pairs]
    scaled = [e.T_truth_estimate.transform_poses(est) for e, (_, est, _) in zip(errors, pairs, strict=True)]
    every = np.concatenate([e.errors_m for e in errors])
    percent, turn = [], []
    for length in LENGTHS_M:
        found = [relative_error(est, true, length) for est, (_, _, true) in zip(scaled, pairs, strict=True)]
        counts = [one.count for one in found]
        percent.append(_mean([one.translation_percent for one in found], counts))
        turn.append(_mean([one.rotation_deg_per_m for one in found], counts))
    steps = [step_error(est, true, frames) for est, (frames, _, true) in zip(scaled, pairs, strict=True)]
    counts = [one.count for one in steps]
    _, longest, its_truth = max(pairs, key=lambda pair: len(pair[0]))
    return Accuracy(
        posed=len(every),
        with_scale=with_scale,
        path_m=sum(path_length(true[:, :3, 3]) for _, _, true in pairs),
        ate_m=float(np.sqrt(np.mean(every**2))),
        ate_mean_m=float(every.mean()),
        ate_max_m=float(every.max()),
        rpe_percent=tuple(percent),
        rpe_deg_per_m=tuple(turn),
        step_m=float(np.sqrt(_mean([one.translation_m**2 for one in steps], counts))),
        step_deg=float(np.sqrt(_mean([one.rotation_deg**2 for one in steps], counts))),
        scale=trajectory_error(longest[:, :3, 3], its_truth[:, :3, 3], True).T_truth_estimate.scale,
        tracks=tuple(
            Aligned(est[:, :3, 3], true[:, :3, 3], _along(truth, frames, stamps_ns), e.errors_m)
            for est, (frames, _, true), e in zip(scaled, pairs, errors, strict=True)
        ),
    )


def _paired(
    track: Trajectory, truth: Trajectory, stamps_ns: NDArray[np.int64]
) -> tuple[NDArray[np.int64], Array, Array] | None:
    """Frame numbers, ascending, with the estimated and the true poses ``(N, 4, 4)`` of each."""
    half = half_frame_ns(stamps_ns)
    frames = Trajectory(stamps_ns, np.broadcast_to(np.eye(4), (len(stamps_ns), 4, 4))).nearest(track.stamps_ns, half)
    rows = truth.nearest(track.stamps_ns, half)
    both = np.flatnonzero((frames >= 0) & (rows >= 0))
    # Two poses of one frame, or of one true pose: the first counts.
    both = both[np.minimum(np.diff(frames[both], prepend=-1), np.diff(rows[both], prepend=-1)) > 0]
    return (frames[both], track.poses[both], truth.poses[rows[both]]) if len(both) else None


def _along(truth: Trajectory, frames: NDArray[np.int64], stamps_ns: NDArray[np.int64]) -> Array:
    """Metres of the true path from the first frame of the sequence to each of ``frames``."""
    driven = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(truth.centres, axis=0), axis=1))])
    start = np.interp(stamps_ns[0], truth.stamps_ns, driven)
    return np.interp(stamps_ns[frames], truth.stamps_ns, driven) - start


def _mean(values: Sequence[float], weights: Sequence[int]) -> float:
    """Weighted mean of what has a weight; NaN where nothing has."""
    total = sum(weights)
    return sum(v * w for v, w in zip(values, weights, strict=True) if w) / total if total else float("nan")
