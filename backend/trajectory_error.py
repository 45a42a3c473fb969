"""Errors of estimated trajectories against the truth: ATE, connected ATE, RPE over sub-path lengths.

ATE is the position error after one least-squares alignment (Umeyama): SE(3) for metric trajectories, Sim(3) for
monocular ones. The thesis calls it "average trajectory error" and the field "absolute"; both RMSE and mean are given
(thesis section 3.10).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .errors import BackendError
from .geometry import Array, Sim3, rotation_angle_deg, se3_inverse, umeyama


@dataclass(frozen=True, eq=False)
class TrajectoryError:
    """Position errors after alignment, metres of the truth.

    ``errors_m`` ``(N,)`` for each pose; ``T_truth_estimate`` the alignment: truth = ``T_truth_estimate @ estimate``.
    """

    rmse_m: float
    mean_m: float
    max_m: float
    errors_m: Array
    T_truth_estimate: Sim3


@dataclass(frozen=True, eq=False)
class RelativeError:
    """Relative pose error over sub-paths of one length (KITTI odometry's measure).

    ``translation_percent``: mean position drift as a share of the length; ``rotation_deg_per_m``; ``count`` sub-paths
    (0: the trajectory is shorter than ``length_m`` and both means are NaN).
    """

    length_m: float
    translation_percent: float
    rotation_deg_per_m: float
    count: int


@dataclass(frozen=True, eq=False)
class StepError:
    """Relative pose error from one frame to the next: RMSE of position and of angle, over ``count`` steps (0: both are
    NaN)."""

    translation_m: float
    rotation_deg: float
    count: int


def trajectory_error(estimate: Array, truth: Array, with_scale: bool) -> TrajectoryError:
    """ATE of ``estimate`` ``(N, 3)`` against ``truth`` ``(N, 3)``, paired row by row, N >= 1."""
    estimate, truth = _checked(estimate, truth)
    alignment = umeyama(truth, estimate, with_scale)
    return aligned_error(estimate, truth, alignment)


def aligned_error(estimate: Array, truth: Array, T_truth_estimate: Sim3) -> TrajectoryError:
    """The same with the alignment given, so that several trajectories can share one."""
    estimate, truth = _checked(estimate, truth)
    errors = np.linalg.norm(T_truth_estimate @ estimate - truth, axis=1)
    rmse = float(np.sqrt(np.mean(errors**2)))
    return TrajectoryError(rmse, float(errors.mean()), float(errors.max()), errors, T_truth_estimate)


def connected_error(
    estimates: Mapping[int, Array], truths: Mapping[int, Array], with_scale: bool
) -> dict[int, TrajectoryError]:
    """One alignment for a whole group of connected agents (the predecessor's connected ATE), then each agent's errors
    under it.

    ``estimates`` and ``truths``: agent to ``(N, 3)`` positions in the group's common frame, and in the world.
    """
    agents = sorted(estimates)
    if not agents:
        return {}
    everything = np.vstack([estimates[a] for a in agents]), np.vstack([truths[a] for a in agents])
    alignment = trajectory_error(*everything, with_scale).T_truth_estimate
    return {a: aligned_error(estimates[a], truths[a], alignment) for a in agents}


def relative_error(estimate: Array, truth: Array, length_m: float) -> RelativeError:
    """RPE of poses ``estimate`` and ``truth`` ``(N, 4, 4)`` ``T_W_C`` over all sub-paths of ``length_m`` metres of
    the truth.

    A sub-path from pose i ends at the first pose at least ``length_m`` farther along the true path (as KITTI's tool
    does, but from every pose). Drift is divided by the nominal length.
    """
    steps = np.linalg.norm(np.diff(truth[:, :3, 3], axis=0), axis=1)
    along = np.concatenate([[0.0], np.cumsum(steps)])
    ends = np.searchsorted(along, along + length_m - 1e-9)
    starts = np.flatnonzero(ends < len(along))
    if not len(starts):
        return RelativeError(length_m, float("nan"), float("nan"), 0)
    error = _step_errors(estimate, truth, starts, ends[starts])
    drift = np.linalg.norm(error[:, :3, 3], axis=1).mean() / length_m
    turn = rotation_angle_deg(error[:, :3, :3]).mean() / length_m
    return RelativeError(length_m, 100.0 * float(drift), float(turn), len(starts))


def step_error(estimate: Array, truth: Array, frames: NDArray[np.int64]) -> StepError:
    """RPE per frame of poses ``(N, 4, 4)`` ``T_W_C`` that belong to the frames numbered ``frames`` ``(N,)``, ascending;
    steps over a gap do not count."""
    starts = np.flatnonzero(np.diff(frames) == 1)
    if not len(starts):
        return StepError(float("nan"), float("nan"), 0)
    error = _step_errors(estimate, truth, starts, starts + 1)
    shift, turn = np.linalg.norm(error[:, :3, 3], axis=1), rotation_angle_deg(error[:, :3, :3])
    return StepError(float(np.sqrt(np.mean(shift**2))), float(np.sqrt(np.mean(turn**2))), len(starts))


def _step_errors(estimate: Array, truth: Array, starts: NDArray[np.int64], ends: NDArray[np.int64]) -> Array:
    """``(n, 4, 4)``: how the estimated steps differ from the true ones, in the frame of the true end."""
    true_step = se3_inverse(truth[starts]) @ truth[ends]
    return se3_inverse(true_step) @ (se3_inverse(estimate[starts]) @ estimate[ends])


def path_length(positions: Array) -> float:
    """Length of the polyline through ``(N, 3)`` positions."""
    return float(np.linalg.norm(np.diff(np.asarray(positions, dtype=np.float64), axis=0), axis=1).sum())


def _checked(estimate: Array, truth: Array) -> tuple[Array, Array]:
    estimate, truth = np.asarray(estimate, dtype=np.float64), np.asarray(truth, dtype=np.float64)
    if estimate.shape != truth.shape or estimate.ndim != 2 or estimate.shape[1] != 3:
        raise BackendError(
            f"trajectory error needs two (N, 3) arrays of the same length, got {estimate.shape} and {truth.shape}"
        )
    if not len(estimate):
        raise BackendError("trajectory error of an empty trajectory: no pose has a true counterpart")
    if not (np.isfinite(estimate).all() and np.isfinite(truth).all()):
        raise BackendError("trajectory error: NaN or infinity among the positions")
    return estimate, truth
