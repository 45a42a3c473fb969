"""``maslam preprocess``: a folder of images becomes agent sequences, the SEQS folder of ``docs/architecture.md``.

Each sequence goes through the front end once; the result is kept in ``OUT/frontend`` and used again as long as images,
settings and code are the same. Then it is shared out to agents, and the manifest, written last, marks the folder as
complete.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from maslam.extensions import name_of

from ..common.errors import ToolError, UsageError
from ..common.folders import check_apart
from ..common.options import read_settings
from ..common.progress import Progress, progress_on
from ..common.text_table import counted
from ..common.writing import writing
from .earlier_result import check_same_sequences
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
from .sequences_folder import FRONTEND, begun, check_free, sequences_made_of

if TYPE_CHECKING:
    from maslam.descriptors.base import PlaceDescriptor
    from maslam.descriptors.choice import DescriptorLike
    from maslam.frontend.datasets.base import Dataset, ImageSequence
    from maslam.mas.manifest import Manifest, SplitEntry

    from .agent_folder import SharePlan
    from .tracking import Tracked


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


def preprocess(
    source: Path, out: Path, settings: PreprocessSettings, progress: Progress, judged_later: bool = False
) -> Manifest:
    """Make the SEQS folder ``out`` from the images in ``source``. ``judged_later``: a run that follows says of the
    agents what ground truth does not fit; here it is noted only, unless one sequence is several agents.

    Sequences that cannot be used are reported, noted in the manifest and left out; ``ToolError`` where none is left.
    """
    check_apart(source, out)
    check_free(out)
    model, dataset = open_source(source if settings.ray is None else source.resolve(), settings)
    dataset, positions, lines = with_positions(dataset, settings.positions, None)
    for line in lines:
        progress.say(line)
    made_of = sequences_made_of(dataset.root, split_of(settings), as_set(settings))
    made_of["settings"] |= {"gps": positions} if positions else {}
    if not settings.overwrite:
        check_same_sequences(out, made_of)
    with writing(out), begun(out, made_of):
        return _made(dataset, out, settings, model, progress, positions, judged_later)


def open_source(source: Path, settings: PreprocessSettings) -> tuple[PlaceDescriptor, Dataset]:
    """The place descriptor, loaded before work that would be in vain, and the images, which can be shared out."""
    from maslam.descriptors.choice import load_descriptor
    from maslam.frontend.cameras.models import RigKind
    from maslam.frontend.datasets import ReadingConfig, open_dataset

    from .split import check_shares

    model = load_descriptor(settings.model, settings.provider)
    rig = RigKind(settings.rig) if settings.rig else None
    readers, kind, reading = settings.readers, settings.dataset, settings.reading or ReadingConfig()
    dataset = open_dataset(source, rig, False, readers, kind, settings.recording, reading)
    if settings.agents is not None and len(dataset.sequences) > 1:
        count = len(dataset.sequences)
        raise UsageError(f"--agents splits one sequence, but {source} holds {count}, one for each agent; leave it out")
    if settings.agents is not None and dataset.sequences:
        check_shares(len(dataset.sequences[0]), settings.agents)
    return model, dataset


def _made(
    dataset: Dataset,
    out: Path,
    settings: PreprocessSettings,
    model: PlaceDescriptor,
    progress: Progress,
    positions: dict[str, Any],
    judged_later: bool,
) -> Manifest:
    """Track the sequences of ``dataset`` that can be used, and write them as agents."""
    from ..common.parallel import core_count
    from .agent_folder import write_sequences
    from .focal_length import refine_guessed
    from .track_sequences import track_all
    from .tracking_cache import make_job, track_job
    from .tracking_plan import notes_of, plan_tracking

    store, workers = settings.store or out / FRONTEND, settings.workers or core_count()
    store = store if settings.ray is None else store.resolve()  # another machine begins elsewhere
    dataset, refined = refine_guessed(dataset, store, progress, workers)
    of = (settings.odometry, settings.model, settings.vocabulary, store, settings.provider)
    plan = plan_tracking(dataset, lambda sequence: make_job(sequence, *of))
    plan = replace(plan, problems=[*plan.problems, *refined])
    done = track_all(dataset, plan, track_job, workers, progress, settings.ray)
    problems, misfits, split = done.problems, truth_problems(done.tracked), split_of(settings)
    plans = all_agents(done.tracked, split)
    notes = notes_of(dataset)
    said = problems if judged_later and split is None else [*problems, *misfits]
    for line in (*(f"note: {note}" for note in notes), *(f"warning: {problem}" for problem in said)):
        progress.say(line)
    noted = {
        **as_set(settings),
        "problems": [*problems, *misfits],
        "notes": notes,
        **({"gps": positions} if positions else {}),
    }
    return write_sequences(out, dataset, plans, model, split, noted, tuple(done.left_out))


def truth_problems(tracked: Sequence[tuple[ImageSequence, Tracked]]) -> list[str]:
    """A line for each sequence whose ground truth odometry contradicts: it cannot be of these images."""
    from maslam.mas.evaluation.truth_fit import compare

    from ..report.truth_warnings import misfit_text

    lines = []
    for sequence, one in tracked:
        found = compare(0, one.trajectories, sequence.groundtruth, sequence.rig.metric)
        if found is not None and (not found.fits or found.rotations):
            lines.append(f"{sequence.name}: {misfit_text(found.model_dump())}")
    return lines


def all_agents(
    tracked: Sequence[tuple[ImageSequence, Tracked]], split: SplitEntry | None, first: int = 0
) -> list[SharePlan]:
    """The agents to be, numbered from ``first``. :class:`ToolError` where they are fewer than asked for."""
    from .agent_folder import plan_agents

    plans = plan_agents(tracked, split, first)
    if split is not None and len(plans) < split.agents:
        frames = sum(len(sequence) for sequence, _ in tracked)
        made = counted(len(plans), "agent")
        raise ToolError(f"{frames} frames make {made}, not {split.agents}: the others have no key-frame; ask for fewer")
    return plans


def split_of(settings: PreprocessSettings) -> SplitEntry | None:
    """How one sequence is cut into agents; None: not at all."""
    from maslam.mas.manifest import SplitEntry

    return SplitEntry(agents=settings.agents, overlap=settings.overlap) if settings.agents is not None else None


def _named(model: DescriptorLike | str | Path) -> str:
    """The descriptor as it is noted: an object by its class."""
    return str(model) if isinstance(model, str | Path) else name_of(model)


def as_set(settings: PreprocessSettings) -> dict[str, Any]:
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
