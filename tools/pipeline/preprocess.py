"""``maslam preprocess``: a folder of images becomes agent sequences, the SEQS folder of ``docs/architecture.md``.

Each sequence goes through the front end once; the result is kept in ``OUT/frontend`` and used again as long as images,
settings and code are the same. Then it is shared out to agents, and the manifest, written last, marks the folder as
complete.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

from maslam.extensions import name_of

from ..common.errors import ToolError, UsageError, describe
from ..common.folders import check_apart
from ..common.options import read_settings
from ..common.progress import Progress, progress_on
from ..common.text_table import counted
from ..common.writing import writing
from .earlier_result import FRONTEND, begun, check_same_sequences, check_sequences_free, sequences_made_of
from .positions import with_positions
from .preprocess_options import (
    READING,
    RECORDING,
    SECTION,
    SECTIONS,
    PreprocessSettings,
    add_preprocess_arguments,
    settings_from,
)

if TYPE_CHECKING:
    from maslam.descriptors.base import PlaceDescriptor
    from maslam.descriptors.choice import DescriptorLike
    from maslam.frontend.datasets.base import Dataset
    from maslam.mas.sequence import Manifest, SplitEntry


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """``SRC OUT`` and everything that can be set."""
    parser.add_argument(
        "source", metavar="SRC", type=Path, help="images, film or bag; `maslam inspect SRC` shows what is read"
    )
    parser.add_argument(
        "out",
        metavar="OUT",
        type=Path,
        help="for the agent sequences: a new folder, or an earlier result of the same source and settings, which is "
        "gone on with or made anew",
    )
    add_preprocess_arguments(parser)
    parser.add_argument(
        "--config", type=Path, metavar="FILE", help="YAML with settings, `odometry: {...}`, `images: {...}`"
    )
    parser.add_argument("--quiet", action="store_true", help="no progress")
    parser.add_argument("--json", action="store_true", help="print what was made, OUT/manifest.json, as one object")


def main(arguments: argparse.Namespace) -> None:
    """The command."""
    settings = settings_from(arguments, read_settings(arguments.config, SECTIONS))
    with progress_on(quiet=arguments.quiet) as progress:
        manifest = preprocess(arguments.source, arguments.out, settings, progress)
    print(manifest.model_dump_json(indent=2) if arguments.json else summary_line(manifest, arguments.out))


def summary_line(manifest: Manifest, out: Path) -> str:
    """The result in one line."""
    keyframes, frames = (sum(getattr(a, n) for a in manifest.agents) for n in ("keyframes", "frames"))
    agents = counted(len(manifest.agents), "agent")
    return f"{out}: {agents}, {frames} frames, {keyframes} key-frames, scale {manifest.scale}"


def preprocess(source: Path, out: Path, settings: PreprocessSettings, progress: Progress) -> Manifest:
    """Make the SEQS folder ``out`` from the images in ``source``.

    Sequences that cannot be used are reported, noted in the manifest and left out; ``ToolError`` where none is left.
    """
    from maslam.descriptors.choice import load_descriptor
    from maslam.frontend.cameras.models import RigKind
    from maslam.frontend.datasets import ReadingConfig, open_dataset

    from .split import check_shares

    check_apart(source, out)
    check_sequences_free(out)
    model = load_descriptor(settings.model, settings.provider)  # before the work that would be in vain
    rig = RigKind(settings.rig) if settings.rig else None
    readers, kind, reading = settings.readers, settings.dataset, settings.reading or ReadingConfig()
    dataset = open_dataset(source, rig, False, readers, kind, settings.recording, reading)
    if settings.agents is not None and len(dataset.sequences) > 1:
        count = len(dataset.sequences)
        raise UsageError(f"--agents splits one sequence, but {source} holds {count}, one for each agent; leave it out")
    if settings.agents is not None and dataset.sequences:
        check_shares(len(dataset.sequences[0]), settings.agents)
    dataset, positions, lines = with_positions(dataset, settings.positions, None)
    for line in lines:
        progress.say(line)
    made_of = sequences_made_of(dataset.root, _split(settings), _as_set(settings))
    made_of["settings"] |= {"gps": positions} if positions else {}
    if not settings.overwrite:
        check_same_sequences(out, made_of)
    with writing(out), begun(out, made_of):
        return _made(dataset, out, settings, model, progress, positions)


def _made(
    dataset: Dataset,
    out: Path,
    settings: PreprocessSettings,
    model: PlaceDescriptor,
    progress: Progress,
    positions: dict[str, Any],
) -> Manifest:
    """Track the sequences of ``dataset`` that can be used, and write them as agents."""
    from maslam.frontend.kernels import odometry_kernels
    from maslam.mas.sequence import LeftOutEntry

    from ..common.compiling import compile_for
    from ..common.parallel import core_count, run_jobs
    from .agent_folder import plan_agents, stand_in, write_sequences
    from .calibration_notes import corrected
    from .focal_length import refine_guessed
    from .tracking_cache import is_tracked, make_job, take_tracked, track_job
    from .tracking_plan import notes_of, plan_tracking

    store, workers = settings.store or out / FRONTEND, settings.workers or core_count()
    dataset, refined = refine_guessed(dataset, store, progress, workers)
    of = (settings.odometry, settings.model, settings.vocabulary, store, settings.provider)
    plan = plan_tracking(dataset, lambda sequence: make_job(sequence, *of))
    jobs, problems, left_out = plan.jobs, [*plan.problems, *refined], plan.left_out
    refused = [problem.message for problem in dataset.problems] + [f"{e.sequence}: {e.reason}" for e in left_out]
    compile_for(odometry_kernels({job.sequence.rig.kind for job in jobs if not is_tracked(job)}), progress)
    named = {job.sequence.name: (job, len(job.sequence)) for job in jobs}
    outcomes = run_jobs(track_job, named, workers, progress)
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
    split = _split(settings)
    plans = plan_agents(tracked, split)
    if split is not None and len(plans) < split.agents:
        frames = sum(len(sequence) for sequence, _ in tracked)
        made = counted(len(plans), "agent")
        raise ToolError(f"{frames} frames make {made}, not {split.agents}: the others have no key-frame; ask for fewer")
    notes = notes_of(dataset)
    for line in (*(f"note: {note}" for note in notes), *(f"warning: {problem}" for problem in problems)):
        progress.say(line)
    noted = {
        **_as_set(settings),
        "problems": problems,
        "notes": notes,
        **({"gps": positions} if positions else {}),
    }
    return write_sequences(out, dataset, plans, model, split, noted, tuple(left_out))


def _split(settings: PreprocessSettings) -> SplitEntry | None:
    from maslam.mas.sequence import SplitEntry

    return SplitEntry(agents=settings.agents, overlap=settings.overlap) if settings.agents is not None else None


def _named(model: DescriptorLike | str | Path) -> str:
    """The descriptor as it is noted: an object by its class."""
    return str(model) if isinstance(model, str | Path) else name_of(model)


def _as_set(settings: PreprocessSettings) -> dict[str, Any]:
    """For the manifest."""
    return {
        SECTION: settings.odometry.model_dump(mode="json"),
        RECORDING: settings.recording.model_dump(mode="json") if settings.recording else {},
        "rig": settings.rig,
        "dataset": settings.dataset,
        "model": _named(settings.model),
        "provider": settings.provider,
        "vocabulary": str(settings.vocabulary) if settings.vocabulary else None,
        READING: None if settings.reading is None else settings.reading.model_dump(mode="json"),
    }
