"""All sequences of a data set through the front end, several at a time; what it made is kept and used again."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from ..common.errors import ToolError, describe
from ..common.progress import Progress
from .tracking import Tracked
from .tracking_plan import TrackingPlan

if TYPE_CHECKING:
    from maslam.frontend.datasets.base import Dataset, ImageSequence
    from maslam.mas.manifest import LeftOutEntry


@dataclass(frozen=True)
class TrackedSequences:
    """``tracked``: each sequence that could be used, with its result; ``problems``: what its user should know;
    ``left_out``: the others."""

    tracked: list[tuple[ImageSequence, Tracked]]
    problems: list[str]
    left_out: list[LeftOutEntry]


def track_all(
    dataset: Dataset,
    plan: TrackingPlan,
    work: Callable[[Any, Callable[[int], None]], None],
    workers: int,
    progress: Progress,
    ray: str | None = None,
) -> TrackedSequences:
    """Do ``work``, which leaves a job's result in its store, for the jobs of ``plan``; ``ray``: on the Ray cluster of
    this address. :class:`ToolError` where no sequence can be used."""
    from maslam.frontend.kernels import odometry_kernels
    from maslam.mas.manifest import LeftOutEntry

    from ..common.cluster import run_on_cluster
    from ..common.compiling import compile_for
    from ..common.parallel import run_jobs
    from .agent_folder import stand_in
    from .calibration_notes import corrected
    from .tracking_cache import is_tracked, take_tracked

    jobs, problems, left_out = plan.jobs, list(plan.problems), list(plan.left_out)
    refused = [problem.message for problem in dataset.problems] + [f"{e.sequence}: {e.reason}" for e in left_out]
    named = {job.sequence.name: (job, len(job.sequence)) for job in jobs}
    if ray is None:
        compile_for(odometry_kernels({job.sequence.rig.kind for job in jobs if not is_tracked(job)}), progress)
        outcomes = run_jobs(work, named, workers, progress)
    else:
        outcomes = run_on_cluster(work, named, ray, progress)
    errors = {name: outcome.error for name, outcome in outcomes.items() if outcome.error is not None}
    untracked = ["; ".join(filter(None, (f"{n}: {describe(error)}", plan.off.get(n)))) for n, error in errors.items()]
    problems += [f"{name}: {describe(error)}" for name, error in errors.items()]
    left_out += [LeftOutEntry(sequence=n, frames=named[n][1], reason=describe(e)) for n, e in errors.items()]
    tracked = [(job.sequence, take_tracked(job)) for job in jobs if job.sequence.name not in errors]
    problems += [f"{sequence.name}: {line}" for sequence, one in tracked for line in one.unreadable]
    problems += [f"{sequence.name}: {line}" for sequence, _ in tracked if (line := stand_in(sequence))]
    corrections = [(sequence.name, corrected(one.stats, sequence.rig)) for sequence, one in tracked]
    problems += [f"{name}: {correction}" for name, correction in corrections if correction]
    if not tracked:
        why, count = [*refused, *untracked], len(dataset.sequences)
        said = why[0] if len(why) == 1 else f"{dataset.root}: none of {count} sequences can be used: {why[0]}"
        raise ToolError(said) from next(iter(errors.values()), None)
    return TrackedSequences(tracked, problems, left_out)
