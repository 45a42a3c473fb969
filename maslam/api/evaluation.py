"""How good a result is."""

from __future__ import annotations

from typing import overload

from maslam.backend.trajectory_error import TrajectoryError, trajectory_error
from maslam.frontend.files.trajectory import TRUTH_TOLERANCE_NS, Trajectory
from maslam.mas.evaluation.ground_truth import MIN_POSES
from maslam.mas.evaluation.summary import Summary
from maslam.tools.common.errors import ToolError

from .common import PathLike, on_one_thread
from .results import Run


@overload
def evaluate(result: Run | PathLike) -> Summary: ...
@overload
def evaluate(result: Trajectory, truth: Trajectory, *, with_scale: bool = False) -> TrajectoryError: ...
@on_one_thread
def evaluate(
    result: Run | PathLike | Trajectory, truth: Trajectory | None = None, *, with_scale: bool = False
) -> Summary | TrajectoryError:
    """Figures of a run, or the error of one trajectory against the truth.

    Args:
        result: a run or its folder: all figures of ``summary.json``, as ``maslam eval`` shows them. Or a trajectory.
        truth: of a trajectory: true poses ``T_W_C`` on the same clock; poses within 20 ms of each other are one moment.
        with_scale: align by Sim(3) instead of SE(3): for one camera, whose unit of length is its own.

    Returns:
        Of a run :class:`maslam.Summary`; of a trajectory :class:`maslam.TrajectoryError`: position errors after one
        least-squares alignment (ATE), metres of the truth.

    Raises:
        MaslamError: no finished run; fewer than three poses that have a true one.
    """
    if not isinstance(result, Trajectory):
        return (result if isinstance(result, Run) else Run.load(result)).summary
    if truth is None:
        raise ToolError("evaluate: a trajectory is compared with the truth; give both")
    rows = truth.nearest(result.stamps_ns, TRUTH_TOLERANCE_NS)
    paired = rows >= 0
    if paired.sum() < MIN_POSES:
        within_ms = TRUTH_TOLERANCE_NS / 1e6
        raise ToolError(
            f"evaluate: {int(paired.sum())} of {len(result)} poses have a true one within {within_ms:.0f} ms; "
            f"{MIN_POSES} are needed"
        )
    return trajectory_error(result.centres[paired], truth.centres[rows[paired]], with_scale)
