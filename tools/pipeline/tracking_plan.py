"""Which sequences of a data set can be tracked, and what is wrong with it before any is."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

from maslam.mas.manifest import LeftOutEntry

from ..checks.findings import look_at_sample
from .tracking_cache import TrackingJob

if TYPE_CHECKING:
    from maslam.frontend.datasets.base import Dataset, ImageSequence


@dataclass(frozen=True)
class TrackingPlan:
    """A job for each sequence that can be used; all that is wrong with the data; the sequences that cannot be used;
    ``off``: what is said of calibrations that are off, by sequence."""

    jobs: list[TrackingJob]
    problems: list[str]
    left_out: list[LeftOutEntry]
    off: dict[str, str]


def plan_tracking(dataset: Dataset, job_of: Callable[[ImageSequence], TrackingJob]) -> TrackingPlan:
    """Look at a sample of the images of each sequence, and leave out what cannot be used."""
    from maslam.frontend.datasets.base import Severity

    jobs, problems = [], [problem.message for problem in dataset.problems]
    left_out, off = [], {}
    for sequence in dataset.sequences:
        found = list(sequence.problems)
        if not any(problem.severity is Severity.ERROR for problem in found):
            seen = look_at_sample(sequence)
            found += seen.problems
            if seen.off:
                off[sequence.name] = seen.off
        problems += [f"{sequence.name}: {problem.message}" for problem in found]
        fatal = [problem.message for problem in found if problem.severity is Severity.ERROR]
        if fatal:
            left_out.append(LeftOutEntry(sequence=sequence.name, frames=len(sequence), reason="; ".join(fatal)))
        else:
            jobs.append(job_of(sequence))
    return TrackingPlan(jobs, problems, left_out, off)


def notes_of(dataset: Dataset) -> list[str]:
    """How the folder and its images were understood, a line each."""
    return [*dataset.notes, *(f"{one.name}: {note}" for one in dataset.sequences for note in one.notes)]
