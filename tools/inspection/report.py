"""What was found in a data set, as values and as lines for people."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from maslam.frontend.cameras.description import UnderstoodCamera
    from maslam.frontend.cameras.models import Rig
    from maslam.frontend.datasets import Problem
    from maslam.frontend.datasets.numbering import MissingImages

_SHOWN_PROBLEMS = 20
_LABEL = {"camera": "calibration", "left": "left camera", "right": "right camera"}


@dataclass(frozen=True)
class SequenceReport:
    """Properties of one sequence. Times in seconds; ``path_length_m`` of the ground truth, None without, which has a
    pose at the time of ``groundtruth_frames``; ``decoded`` frames were tried; ``images``, ``rows`` (stereo) and
    ``depth`` (RGB-D): what the images themselves say; ``focal``: what they say of the focal length, where that was
    asked for; ``missing``: images that the names' numbers lack; ``understood``: each camera as its calibration file
    describes it; ``origin``: what of a recording is read; ``notes``: how its files were understood; ``positions``:
    those measured from outside (GPS) that a run would take."""

    name: str
    kind: str
    frames: int
    rate_hz: float
    duration_s: float
    start_s: float
    rig: Rig
    stored_size: tuple[int, int]
    rectified_here: bool
    groundtruth_poses: int
    groundtruth_frames: int
    path_length_m: float | None
    decoded: int
    problems: tuple[Problem, ...]
    images: str = ""
    rows: str = ""
    depth: str = ""
    focal: str = ""
    missing: tuple[MissingImages, ...] = ()
    understood: tuple[UnderstoodCamera, ...] = ()
    origin: str = ""
    notes: tuple[str, ...] = ()
    positions: str = ""

    def lines(self) -> list[str]:
        """The report of this sequence, a line each."""
        camera = self.rig.camera
        baseline = f", baseline {self.rig.baseline_m:.4f} m" if self.rig.baseline_m is not None else ""
        how = f"rectified here from {self.stored_size[0]}x{self.stored_size[1]}" if self.rectified_here else "as stored"
        truth = "none"
        if self.path_length_m is not None:
            at = f"at {self.groundtruth_frames} of {self.frames} frames"
            truth = f"{self.groundtruth_poses} poses, {self.path_length_m:.1f} m of path, {at}"
        first = [
            f"{self.name} ({self.kind})",
            *([f"  read from     {self.origin}"] if self.origin else []),
            f"  frames        {self.frames}, {self.rate_hz:.2f} a second, {self.duration_s:.2f} s "
            f"from {self.start_s:.3f} s",
            f"  rig           {self.rig.kind}{baseline}; scale {'metric' if self.rig.metric else 'arbitrary'}",
            f"  camera        {camera.width}x{camera.height} px, fx {camera.fx:.2f} fy {camera.fy:.2f} "
            f"cx {camera.cx:.2f} cy {camera.cy:.2f} px, {how}",
            *(f"  {_LABEL[one.side]:13} {one.sentence()}" for one in self.understood),
            f"  ground truth  {truth}",
            *([f"  positions     {self.positions}"] if self.positions else []),
            f"  decoded       {self.decoded} of {self.frames} frames",
            *([f"  images        {self.images}"] if self.images else []),
            *([f"  rows          {self.rows}"] if self.rows else []),
            *([f"  depth         {self.depth}"] if self.depth else []),
            *([f"  focal length  {self.focal}"] if self.focal else []),
            *(f"  note          {note}" for note in self.notes),
        ]
        shown = [f"  {problem.severity.upper():8} {problem.message}" for problem in self.problems[:_SHOWN_PROBLEMS]]
        hidden = len(self.problems) - len(shown)
        return first + shown + ([f"  and {hidden} more problems"] if hidden > 0 else [])


@dataclass(frozen=True)
class InspectReport:
    """Properties of a data set, sequence by sequence; ``problems``: agents that could not be opened; ``notes``: how the
    folder was understood."""

    path: Path
    kind: str
    sequences: tuple[SequenceReport, ...]
    problems: tuple[Problem, ...] = ()
    notes: tuple[str, ...] = ()

    @property
    def errors(self) -> int:
        """Problems that would spoil a run."""
        listed = [problem for sequence in self.sequences for problem in sequence.problems]
        return sum(problem.severity == "error" for problem in (*self.problems, *listed))

    @property
    def warnings(self) -> int:
        """Problems that a run can live with."""
        return len(self.problems) + sum(len(sequence.problems) for sequence in self.sequences) - self.errors

    def lines(self) -> list[str]:
        """The whole report, a line each."""
        frames = sum(sequence.frames for sequence in self.sequences)
        head = f"{self.path}: {self.kind}, {_count(len(self.sequences), 'sequence')}, {_count(frames, 'frame')}"
        verdict = f"{_count(self.errors, 'error')}, {_count(self.warnings, 'warning')}"
        unopened = [f"{problem.severity.upper():8} {problem.message}" for problem in self.problems]
        return [
            head,
            *self.notes,
            *(line for sequence in self.sequences for line in sequence.lines()),
            *unopened,
            verdict,
        ]


def _count(number: int, noun: str) -> str:
    return f"{number} {noun}{'' if number == 1 else 's'}"
