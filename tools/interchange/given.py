"""Trajectories of other systems and their images as agent sequences."""

from __future__ import annotations

import math
from collections.abc import Sequence
from contextlib import nullcontext
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from ..common.errors import ToolError, UsageError
from ..common.folders import check_apart
from ..common.progress import Progress
from ..common.writing import writing
from ..pipeline.earlier_result import check_same_sequences
from ..pipeline.positions import with_positions
from ..pipeline.preprocess import all_agents, as_set, open_source, split_of
from ..pipeline.preprocess_options import PreprocessSettings
from ..pipeline.sequences_folder import FRONTEND, begun, check_free, sequences_made_of
from .given_files import read_given, trajectory_files

if TYPE_CHECKING:
    from maslam.descriptors.base import PlaceDescriptor
    from maslam.frontend.datasets.base import Dataset, ImageSequence
    from maslam.frontend.datasets.poses_of_images import GivenPoses
    from maslam.mas.manifest import AgentEntry, Manifest

    from .given_job import GivenJob
    from .given_points import GivenPoints
    from .placed_images import PlacingRules

_IMPORTS = "imports"
"""In the manifest's settings: what was imported, one entry for each command."""
_LONGEST_S = 1e6


@dataclass(frozen=True)
class ImportSettings:
    """Settings of ``maslam import``: ``images``: as of preprocessing them; the rest says how poses go with them."""

    images: PreprocessSettings
    scale: Literal["metric", "arbitrary"] = "metric"
    T_body_camera: str | None = None
    times: Path | None = None
    clock_offset_s: float = 0.0
    bridge_s: float = 0.5
    gap_s: float = 5.0
    topic: str | None = None
    points: Path | None = None
    add: bool = False

    def rules(self) -> PlacingRules:
        """How poses are given to images; :class:`UsageError` for times that make no sense."""
        from .placed_images import PlacingRules

        for name, value in (("bridge", self.bridge_s), ("gap", self.gap_s)):
            if not 0 <= value <= _LONGEST_S:
                raise UsageError(f"--{name} {value}: seconds from 0 are meant")
        if not math.isfinite(self.clock_offset_s) or abs(self.clock_offset_s) > 9e9:
            raise UsageError(f"--clock-offset {self.clock_offset_s}: seconds are meant")
        offset, bridge, gap = (round(1e9 * s) for s in (self.clock_offset_s, self.bridge_s, self.gap_s))
        return PlacingRules(offset, bridge, gap)


def import_given(poses: Path, images: Path, out: Path, settings: ImportSettings, progress: Progress) -> Manifest:
    """Make the SEQS folder ``out`` from the trajectories in ``poses`` and the images in ``images``.

    A sequence that cannot be used is reported, noted in the manifest and left out; :class:`ToolError` where none is
    left, and where ``out`` holds something else.
    """
    settings.rules()  # before any work
    check_apart(images, out)
    if not poses.exists():
        raise ToolError(f"{poses}: no such file or folder")
    check_free(out)
    earlier = _earlier(out, images, settings)
    model, dataset = open_source(images, settings.images)
    _check_model(earlier, model, out)
    files = trajectory_files(poses, [sequence.name for sequence in dataset.sequences])
    before = earlier.settings.get("gps", {}).get("origin") if earlier else None
    metric = settings.scale == "metric"
    dataset, positions, lines = with_positions(dataset, settings.images.positions, metric, before)
    for line in lines:
        progress.say(line)
    made_of = _made_of(dataset, files, settings, earlier, positions)
    if not settings.images.overwrite and earlier is None:
        check_same_sequences(out, made_of)
    # An import that adds leaves the manifest of what was there until it is through.
    with writing(out), begun(out, made_of) if earlier is None else nullcontext():
        return _made(dataset, files, out, settings, model, earlier, progress, made_of["settings"])


def _made_of(
    dataset: Dataset,
    files: dict[str, Path],
    settings: ImportSettings,
    earlier: Manifest | None,
    positions: dict[str, Any],
) -> dict[str, Any]:
    """Source and settings, as the manifest has them."""
    noted: dict[str, Any] = {_IMPORTS: [*_imports(earlier), _as_set(files, dataset.root, settings)]}
    noted |= {"gps": positions} if positions else {}
    return sequences_made_of(dataset.root, split_of(settings.images), {**as_set(settings.images), **noted})


def _made(
    dataset: Dataset,
    files: dict[str, Path],
    out: Path,
    settings: ImportSettings,
    model: PlaceDescriptor,
    earlier: Manifest | None,
    progress: Progress,
    noted: dict[str, Any],
) -> Manifest:
    from maslam.frontend.datasets.base import Problem, Severity

    from ..common.parallel import core_count
    from ..pipeline.agent_folder import write_sequences
    from ..pipeline.focal_length import refine_guessed
    from ..pipeline.track_sequences import track_all
    from ..pipeline.tracking_plan import notes_of, plan_tracking
    from .given_job import track_given_job
    from .given_tracks import agreement_lines

    workers = settings.images.workers or core_count()
    dataset, problems = refine_guessed(dataset, out / FRONTEND, progress, workers)
    taken = {entry.sequence for entry in earlier.agents} if earlier else set()
    names = {sequence.name: _free_name(sequence, dataset.root, taken) for sequence in dataset.sequences}
    jobs: dict[str, GivenJob] = {}
    sequences = []
    for sequence in dataset.sequences:
        try:
            jobs[sequence.name], said = _job(sequence, files[sequence.name], settings, out, names, progress)
            problems += said
            sequences.append(sequence)
        except ToolError as error:
            fault = Problem(Severity.ERROR, str(error).removeprefix(f"{sequence.name}: "))
            sequences.append(replace(sequence, problems=(*sequence.problems, fault)))
    dataset = replace(dataset, sequences=sequences)
    plan = plan_tracking(dataset, lambda sequence: jobs[sequence.name])
    plan = replace(plan, problems=[*plan.problems, *problems])
    done = track_all(dataset, plan, track_given_job, workers, progress)
    split = split_of(settings.images)
    before: Sequence[AgentEntry] = earlier.agents if earlier else ()
    tracked = [(replace(sequence, name=names[sequence.name]), one) for sequence, one in done.tracked]
    plans = all_agents(tracked, split, len(before))
    notes, problems = notes_of(dataset), done.problems
    for sequence, one in done.tracked:
        found, warnings = agreement_lines(sequence.name, one.stats)
        notes, problems = notes + found, problems + warnings
    for line in (*(f"note: {note}" for note in notes), *(f"warning: {problem}" for problem in problems)):
        progress.say(line)
    left = (*(earlier.left_out if earlier else ()), *done.left_out)
    noted = {**noted, "problems": problems, "notes": notes}
    return write_sequences(out, dataset, plans, model, split, noted, left, settings.scale, before)


def _job(
    sequence: ImageSequence,
    file: Path,
    settings: ImportSettings,
    out: Path,
    names: dict[str, str],
    progress: Progress,
) -> tuple[GivenJob, list[str]]:
    """What is to be done for one sequence with its trajectory, and what its user should know of that."""
    from maslam.frontend.errors import FrontendError
    from maslam.frontend.files.extrinsic import read_extrinsic

    from ..pipeline.tracking_cache import make_job
    from .given_job import given_job
    from .placed_images import camera_poses, place_images

    own = settings.images
    try:
        given = read_given(file, sequence, settings.times, settings.topic)
        T_B_C = np.eye(4) if settings.T_body_camera is None else read_extrinsic(settings.T_body_camera)
    except FrontendError as error:
        raise ToolError(str(error)) from error
    if settings.scale == "arbitrary" and sequence.rig.metric:
        raise ToolError(
            f"{sequence.name}: --scale arbitrary with {sequence.rig.kind} images, whose depth is in metres: --rig mono "
            "leaves it out"
        )
    placed = place_images(sequence.name, given, sequence.stamps_ns, settings.rules().of(given))
    mounted = settings.T_body_camera is not None
    placed = replace(placed, poses=camera_poses(placed.poses, T_B_C, sequence.R_rectified_left), mounted=mounted)
    progress.say(f"{sequence.name}: {file.name}: {given.form}, {len(given.trajectory)} poses; {placed.text()}")
    points = None if settings.points is None else _points(settings, sequence, given, len(names) == 1)
    if points is not None:
        progress.say(f"{sequence.name}: {points.text}")
    job = make_job(sequence, own.odometry, own.model, own.vocabulary, out / FRONTEND, own.provider)
    said = [f"{file}: {note}" for note in given.notes]
    return given_job(job, placed, points, names[sequence.name]), [*said, *placed.jumps]


def _points(settings: ImportSettings, sequence: ImageSequence, given: GivenPoses, single: bool) -> GivenPoints:
    """The given points of a sequence, each scan with its own pose."""
    from .given_points import GivenPoints, points_file, read_points, scans_of
    from .placed_images import place_images

    assert settings.points is not None
    if sequence.rig.metric:
        raise ToolError(
            f"--points with {sequence.rig.kind} images, whose depth is measured: --rig mono takes points instead"
        )
    path = points_file(settings.points, sequence.name, single)
    scans = scans_of(path)
    if scans is None:
        return read_points(path, sequence)
    files, stamps = scans
    rules = settings.rules() if given.timed else replace(settings.rules(), offset_ns=0)
    placed = place_images(f"scans in {path}", given, stamps, rules)
    text = f"{path.name}: {len(placed.rows)} of {len(files)} scans with a pose"
    used = tuple(files[k] for k in placed.rows)
    return GivenPoints(text, np.zeros((0, 3)), None, used, placed.poses, stamps[placed.rows])


def _earlier(out: Path, images: Path, settings: ImportSettings) -> Manifest | None:
    """The agents that ``out`` holds and keeps."""
    from maslam.mas.manifest import MANIFEST, read_manifest

    if not settings.add or not (out / MANIFEST).is_file():
        return None
    earlier = read_manifest(out)
    if earlier.split is not None or settings.images.agents is not None:
        raise UsageError("--add: agents cut from one sequence (--agents) and others cannot be in one folder")
    if any(one.get("images") == str(images.resolve()) for one in _imports(earlier)):
        raise ToolError(f"{out}: holds the agents of {images} already; --overwrite without --add makes it anew")
    return earlier


def _check_model(earlier: Manifest | None, model: PlaceDescriptor, out: Path) -> None:
    if earlier is not None and earlier.descriptor.sha256 != model.sha256:
        raise ToolError(
            f"{out}: made with place descriptor {earlier.descriptor.name}, not {model.name}; --model chooses"
        )


def _free_name(sequence: ImageSequence, root: Path, taken: set[str]) -> str:
    """A name that no other agent's sequence has: agents know recordings by it."""
    name = sequence.name
    if name in taken:
        name = (
            f"{root.resolve().name}_{name}" if root.resolve().name != name else f"{root.resolve().parent.name}_{name}"
        )
    plain, number = name, 2
    while name in taken:
        name, number = f"{plain}_{number}", number + 1
    taken.add(name)
    return name


def _imports(earlier: Manifest | None) -> list[dict[str, Any]]:
    return list(earlier.settings.get(_IMPORTS, [])) if earlier else []


def _as_set(files: dict[str, Path], root: Path, settings: ImportSettings) -> dict[str, Any]:
    """For the manifest."""
    return {
        "images": str(root.resolve()),
        "poses": {name: str(path) for name, path in sorted(files.items())},
        "scale": settings.scale,
        "T_body_camera": settings.T_body_camera,
        "clock_offset_s": settings.clock_offset_s,
        "bridge_s": settings.bridge_s,
        "gap_s": settings.gap_s,
        "points": None if settings.points is None else str(settings.points),
        "settings": as_set(settings.images),
    }
