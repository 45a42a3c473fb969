"""``maslam bench vo``: folders of images in, figures out."""

from __future__ import annotations

import json
import re
import tempfile
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from maslam._atomic import write_atomically
from maslam.frontend.files.trajectory import Trajectory

from ...common.errors import ToolError, describe
from ...common.parallel import run_jobs
from ...common.progress import Progress
from .accuracy import Accuracy, accuracy
from .measure import BenchJob, VoMeasurement, measure_job
from .other_systems import assign, read_other
from .result import BenchResult, Compared, record, tables

if TYPE_CHECKING:
    from maslam.frontend.config import OdometryConfig
    from maslam.frontend.datasets import ImageSequence

_ENOUGH_FRAMES, _MOST_RUNS = 300, 5


@dataclass(frozen=True)
class VoSettings:
    """Settings of ``maslam bench vo``. ``runs`` None: as many as it takes to 300 frames, at most 5. ``compare``:
    ``[SEQUENCE=]FILE`` each."""

    odometry: OdometryConfig
    rig: str | None = None
    vocabulary: Path | None = None
    files: bool = False
    runs: int | None = None
    compare: tuple[str, ...] = ()
    out: Path | None = None
    plot: Path | None = None


@dataclass(frozen=True)
class VoReport:
    """Results of the sequences that could be measured; ``failed``: for each of the others the reason, one line."""

    results: tuple[BenchResult, ...]
    failed: tuple[str, ...] = field(default=())

    def json(self) -> str:
        """A list of records, one a sequence, as JSON text."""
        return json.dumps([record(result) for result in self.results], indent=1, allow_nan=False)

    def text(self) -> str:
        """For people: tables."""
        return tables(self.results)


def bench_vo(folders: Sequence[Path], settings: VoSettings, progress: Progress) -> VoReport:
    """Measure every sequence of ``folders``; those that fail are reported and left out, ``ToolError`` where all do."""
    sequences = _open(folders, settings, progress)
    # Read before the work begins: a wrong file is reported now, not after minutes.
    others = {
        name: [(path, *read_other(path, sequences[name].stamps_ns)) for path in paths]
        for name, paths in assign(list(settings.compare), list(sequences)).items()
    }
    for note in [note for found in others.values() for _, _, note in found if note]:
        progress.say(note)
    with ExitStack() as stack:
        keep = settings.out or (Path(stack.enter_context(tempfile.TemporaryDirectory())) if settings.files else None)
        jobs = {name: _job(name, sequence, settings, keep) for name, sequence in sequences.items()}
        steps = {name: (job, job.runs * len(job.sequence)) for name, job in jobs.items()}
        outcomes = run_jobs(measure_job, steps, 1, progress, fresh=True)
    failed = [f"{name}: {describe(outcome.error)}" for name, outcome in outcomes.items() if outcome.error is not None]
    if len(failed) == len(jobs):
        raise ToolError(failed[0]) from next(iter(outcomes.values())).error
    for line in failed:
        progress.say(f"failed: {line}")
    results = tuple(
        _result(name, sequences[name], settings, outcome.result, others[name])
        for name, outcome in outcomes.items()
        if outcome.result is not None
    )
    report = VoReport(results, tuple(failed))
    _keep(report, settings)
    return report


def _open(folders: Sequence[Path], settings: VoSettings, progress: Progress) -> dict[str, ImageSequence]:
    """Every sequence by a name of its own."""
    from maslam.frontend.cameras.models import RigKind
    from maslam.frontend.datasets import open_dataset

    found: list[tuple[str, str, ImageSequence]] = []
    for folder in folders:
        dataset = open_dataset(folder, RigKind(settings.rig) if settings.rig else None)
        label = folder.resolve().name
        for problem in (p for s in dataset.sequences for p in s.problems):
            progress.say(f"{folder}: {problem.severity}: {problem.message}")
        for sequence in dataset.sequences:
            inside = "" if len(dataset.sequences) == 1 else f"/{sequence.name}"
            found.append((label + inside, f"{folder}{inside}", sequence))
    short = [name for name, _, _ in found]
    named = {name if short.count(name) == 1 else path: sequence for name, path, sequence in found}
    if len(named) < len(found):
        raise ToolError("the same folder is given twice")
    return named


def _job(name: str, sequence: ImageSequence, settings: VoSettings, keep: Path | None) -> BenchJob:
    runs = settings.runs or min(_MOST_RUNS, -(-_ENOUGH_FRAMES // len(sequence)))
    files = keep / _as_folder(name) if settings.files and keep is not None else None
    return BenchJob(sequence, settings.odometry, settings.vocabulary, files, runs)


def _as_folder(name: str) -> str:
    """A sequence's name as that of one folder, on every system."""
    return re.sub(r"[/\\:]", "_", name)


def _result(
    name: str,
    sequence: ImageSequence,
    settings: VoSettings,
    measured: VoMeasurement,
    others: Sequence[tuple[Path, Trajectory, str]],
) -> BenchResult:
    truth, stamps, with_scale = sequence.groundtruth, sequence.stamps_ns, not sequence.rig.metric

    def errors(tracks: Sequence[Trajectory]) -> Accuracy | None:
        return accuracy(tracks, truth, stamps, with_scale) if truth is not None else None

    return BenchResult(
        name=name,
        kind=sequence.kind,
        rig=sequence.rig.kind.value,
        metric=sequence.rig.metric,
        frames=len(sequence),
        files=settings.files,
        truth=truth is not None,
        measured=measured,
        accuracy=errors(measured.trajectories),
        compared=tuple(Compared(path.name, other, errors([other])) for path, other, _ in others),
    )


def _keep(report: VoReport, settings: VoSettings) -> None:
    """The pictures, and what ``--out`` keeps; ``bench.json`` last."""
    from maslam.frontend.files.trajectory import write_tum

    from .figure import draw_bench

    if settings.plot is not None:
        draw_bench(report.results, settings.plot)
    if settings.out is not None:
        for result in report.results:
            folder = settings.out / _as_folder(result.name)
            folder.mkdir(parents=True, exist_ok=True)
            for number, trajectory in enumerate(result.measured.trajectories):
                write_tum(folder / f"trajectory_{number}.tum", trajectory)
        draw_bench(report.results, settings.out / "bench.png")
        write_atomically(settings.out / "bench.json", report.json() + "\n")
