"""Trajectories of other systems and their images as agent sequences."""

from __future__ import annotations

import math
import re
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
from ..pipeline.earlier_result import begun, check_same_sequences, check_sequences_free, sequences_made_of
from ..pipeline.positions import NO_POSITIONS, PositionSettings, with_positions

if TYPE_CHECKING:
    from maslam.descriptors.base import PlaceDescriptor
    from maslam.descriptors.choice import DescriptorLike
    from maslam.frontend.config import OdometryConfig
    from maslam.frontend.datasets.base import Dataset, ImageSequence
    from maslam.frontend.datasets.readers import ReaderLike
    from maslam.frontend.files.other_trajectories import OtherTrajectory
    from maslam.mas.sequence import AgentEntry, LeftOutEntry, Manifest, SplitEntry

    from ..pipeline.tracking import Tracked
    from .placed_images import PlacingRules

BAGS = (".bag", ".mcap", ".db3")
_FILES = (".txt", ".tum", ".csv", ".kitti", ".npy", *BAGS)
_IMPORTS = "imports"
"""In the manifest's settings: what was imported, one entry for each command."""
_LONGEST_S = 1e6


@dataclass(frozen=True)
class ImportSettings:
    """Settings of ``maslam import``: the options of the command line."""

    odometry: OdometryConfig
    scale: Literal["metric", "arbitrary"] = "metric"
    T_body_camera: str | None = None
    times: Path | None = None
    clock_offset_s: float = 0.0
    bridge_s: float = 0.5
    gap_s: float = 5.0
    topic: str | None = None
    agents: int | None = None
    overlap: int = 0
    rig: str | None = None
    dataset: str | None = None
    readers: tuple[ReaderLike, ...] = ()
    model: DescriptorLike | str | Path = "default"
    provider: str = "CPU"
    vocabulary: Path | None = None
    add: bool = False
    overwrite: bool = False
    positions: PositionSettings = NO_POSITIONS

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
    left.
    """
    from maslam.descriptors.choice import load_descriptor
    from maslam.frontend.cameras.models import RigKind
    from maslam.frontend.datasets import open_dataset
    from maslam.mas.sequence import SplitEntry

    rules = settings.rules()
    check_apart(images, out)
    if not poses.exists():
        raise ToolError(f"{poses}: no such file or folder")
    earlier = _earlier(out, images, settings)
    model = load_descriptor(settings.model, settings.provider)
    _check_model(earlier, model, out)
    rig = RigKind(settings.rig) if settings.rig else None
    dataset = open_dataset(images, rig, strict=False, readers=settings.readers, kind=settings.dataset)
    if settings.agents is not None and len(dataset.sequences) > 1:
        raise UsageError(f"--agents splits one sequence, but {images} holds {len(dataset.sequences)}; leave it out")
    files = trajectory_files(poses, [sequence.name for sequence in dataset.sequences])
    before = earlier.settings.get("gps", {}).get("origin") if earlier else None
    dataset, positions, lines = with_positions(dataset, settings.positions, settings.scale == "metric", before)
    for line in lines:
        progress.say(line)
    noted: dict[str, Any] = {_IMPORTS: [*_imports(earlier), _as_set(files, dataset.root, settings)]}
    noted |= {"gps": positions} if positions else {}
    split = SplitEntry(agents=settings.agents, overlap=settings.overlap) if settings.agents else None
    made_of = sequences_made_of(dataset.root, split, noted)
    if not settings.add and not settings.overwrite:
        check_same_sequences(out, made_of)
    with writing(out), nullcontext() if earlier else begun(out, made_of):
        return _made(dataset, files, out, settings, rules, model, earlier, progress, split, noted)


def _made(
    dataset: Dataset,
    files: dict[str, Path],
    out: Path,
    settings: ImportSettings,
    rules: PlacingRules,
    model: PlaceDescriptor,
    earlier: Manifest | None,
    progress: Progress,
    split: SplitEntry | None,
    noted: dict[str, Any],
) -> Manifest:
    from maslam.frontend.datasets.base import Severity
    from maslam.frontend.vocabulary.vocabulary import Vocabulary
    from maslam.mas.sequence import LeftOutEntry

    from ..pipeline.agent_folder import plan_agents, write_sequences

    vocabulary = Vocabulary.load(settings.vocabulary)
    problems = [problem.message for problem in dataset.problems]
    tracked: list[tuple[ImageSequence, Tracked]] = []
    left_out: list[LeftOutEntry] = []
    errors: list[Exception] = []
    taken = {entry.sequence for entry in earlier.agents} if earlier else set()
    for sequence in dataset.sequences:
        problems += [f"{sequence.name}: {problem.message}" for problem in sequence.problems]
        fatal = [problem.message for problem in sequence.problems if problem.severity is Severity.ERROR]
        try:
            if fatal:
                raise ToolError("; ".join(fatal))
            done = _import_one(sequence, files[sequence.name], settings, rules, vocabulary, model, progress)
        except ToolError as error:
            errors.append(error)
            left_out.append(LeftOutEntry(sequence=sequence.name, frames=len(sequence), reason=str(error)))
            continue
        problems += done[1]
        tracked.append((replace(sequence, name=_free_name(sequence, dataset.root, taken)), done[0]))
    if not tracked:
        raise ToolError(str(errors[0]) if errors else f"{dataset.root}: no images that can be used") from None
    problems += [entry.reason for entry in left_out]
    for problem in problems:
        progress.say(f"warning: {problem}")
    before: Sequence[AgentEntry] = earlier.agents if earlier else ()
    plans = plan_agents(tracked, split, len(before))
    left = (*(earlier.left_out if earlier else ()), *left_out)
    manifest = write_sequences(
        out, dataset, plans, model, split, {**noted, "problems": problems}, left, settings.scale, before
    )
    return manifest


def _import_one(
    sequence: ImageSequence,
    file: Path,
    settings: ImportSettings,
    rules: PlacingRules,
    vocabulary: Any,
    model: PlaceDescriptor,
    progress: Progress,
) -> tuple[Tracked, list[str]]:
    """One sequence with its trajectory, and what its user should know."""
    from functools import partial

    from maslam.frontend.errors import FrontendError
    from maslam.frontend.files.extrinsic import read_extrinsic

    from .given_tracks import track_given
    from .placed_images import camera_poses, place_images

    try:
        given = read_poses(file, settings)
        T_B_C = np.eye(4) if settings.T_body_camera is None else read_extrinsic(settings.T_body_camera)
    except FrontendError as error:
        raise ToolError(str(error)) from error
    if settings.scale == "arbitrary" and sequence.rig.metric:
        raise ToolError(
            f"{sequence.name}: --scale arbitrary with {sequence.rig.kind} images, whose depth is in metres: --rig mono "
            "leaves it out"
        )
    placed = place_images(sequence.name, given, sequence.stamps_ns, rules)
    placed = replace(placed, poses=camera_poses(placed.poses, T_B_C, sequence.R_rectified_left))
    progress.say(f"{sequence.name}: {file.name}: {given.form}, {len(given.trajectory)} poses; {placed.text()}")
    task = progress.start(sequence.name, len(sequence))
    done = track_given(sequence, placed, settings.odometry, vocabulary, model, partial(progress.advance, task))
    progress.advance(task, len(sequence))
    for note in done.notes:
        progress.say(note)
    repeated = [f"{file}: {given.repeated} poses of a time given before are left out"] * bool(given.repeated)
    return done.tracked, [*repeated, *placed.jumps, *done.warnings, *done.tracked.unreadable]


def read_poses(file: Path, settings: ImportSettings) -> OtherTrajectory:
    """The trajectory in a text file, an array or a bag."""
    if file.suffix in BAGS or (file.is_dir() and (file / "metadata.yaml").is_file()):
        from .bag_poses import read_bag_poses

        return read_bag_poses(file, settings.topic)
    from maslam.frontend.files.other_trajectories import read_other_trajectory

    return read_other_trajectory(file, settings.times)


def trajectory_files(poses: Path, names: Sequence[str]) -> dict[str, Path]:
    """The trajectory of each sequence: ``poses`` itself for a single one, else the file in that folder named after it.

    :class:`ToolError` where one has none, or several.
    """
    if poses.is_file() or (poses / "metadata.yaml").is_file():
        if len(names) != 1:
            raise ToolError(
                f"{poses}: one trajectory for {len(names)} sequences ({', '.join(names[:4])}); name a folder with one "
                "for each"
            )
        return {names[0]: poses}
    found = sorted(p for p in poses.rglob("*") if p.is_file() and p.suffix in _FILES)
    if len(names) == 1 and len(found) == 1:
        return {names[0]: found[0]}
    return {name: _file_of(poses, name, found) for name in names}


def _file_of(poses: Path, name: str, found: Sequence[Path]) -> Path:
    word = re.compile(rf"(?<![0-9a-zA-Z]){re.escape(name)}(?![0-9a-zA-Z])")
    exact = [p for p in found if p.stem == name]
    hits = exact or [p for p in found if word.search(p.relative_to(poses).as_posix())]
    if len(hits) == 1:
        return hits[0]
    if hits:
        raise ToolError(f"{poses}: several trajectories for {name}: {', '.join(p.name for p in hits[:4])}; leave one")
    raise ToolError(f"{poses}: no trajectory for {name}; name it {name}.txt")


def _earlier(out: Path, images: Path, settings: ImportSettings) -> Manifest | None:
    """The agents that ``out`` holds and keeps; refuses somebody else's files."""
    from maslam.mas.sequence import MANIFEST, read_manifest

    check_sequences_free(out)
    if not settings.add or not (out / MANIFEST).is_file():
        return None
    earlier = read_manifest(out)
    if earlier.split is not None or settings.agents is not None:
        raise UsageError("--add: agents cut from one sequence (--agents) and others cannot be in one folder")
    if any(one.get("images") == str(images.resolve()) for one in _imports(earlier)):
        raise ToolError(f"{out}: holds the agents of {images} already; leave out --add to make it anew")
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
        "rig": settings.rig,
        "odometry": settings.odometry.model_dump(mode="json"),
    }
