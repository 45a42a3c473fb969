"""``maslam inspect``: what would be read from a folder of images, and what is wrong with it."""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import TYPE_CHECKING

from ..checks.findings import ImageFindings, look_at, samples_of
from ..common.folders import check_file
from ..common.options import add_model_options, build
from .positions_check import PositionsCheck, check_positions, unlike
from .record import record
from .report import InspectReport, SequenceReport

if TYPE_CHECKING:
    from maslam.frontend.cameras.models import RigKind
    from maslam.frontend.datasets import ImageSequence, Problem, ReadingConfig
    from maslam.frontend.recording_config import RecordingConfig

    from ..common.progress import Progress

RECORDING = "recording"


def inspect_dataset(
    path: Path,
    decode_all: bool = False,
    rig: RigKind | None = None,
    progress: Progress | None = None,
    png: Path | None = None,
    recording: RecordingConfig | None = None,
    focal: bool = False,
    reading: ReadingConfig | None = None,
) -> InspectReport:
    """Look at a data set: its files, numbers and images; a sample of the images is decoded, or all of them.

    ``png``: where a picture of each sequence's middle frame goes; ``recording``: what of the source is read; ``focal``:
    estimate each focal length from the images; ``reading``: masks, and how images are understood. Raises
    ``FrontendError`` where there is no sequence to speak of.
    """
    from maslam.frontend.datasets import ReadingConfig, open_dataset

    dataset = open_dataset(path, rig, strict=False, recording=recording, reading=reading or ReadingConfig())
    positions = [check_positions(dataset, sequence) for sequence in dataset.sequences]
    reports = tuple(
        _inspect_sequence(sequence, found, decode_all, progress, focal)
        for sequence, found in zip(dataset.sequences, positions, strict=True)
    )
    if png is not None:
        _write_picture(dataset.sequences, png)
    return InspectReport(Path(path), dataset.kind, reports, (*dataset.problems, *unlike(positions)), dataset.notes)


def _write_picture(sequences: list[ImageSequence], path: Path) -> None:
    import cv2

    from maslam._atomic import write_atomically

    from .picture import draw_sequences

    _, encoded = cv2.imencode(".png", draw_sequences(sequences))
    write_atomically(path, encoded.tobytes())


def _inspect_sequence(
    sequence: ImageSequence, positions: PositionsCheck, decode_all: bool, progress: Progress | None, focal: bool
) -> SequenceReport:
    import numpy as np

    from maslam.frontend.datasets.truth import frames_covered
    from maslam.frontend.files.timestamps import NS_PER_S

    from .focal_check import check_focal

    count = len(sequence)
    chosen = range(count) if decode_all else samples_of(count)
    duration_s = float(sequence.stamps_ns[-1] - sequence.stamps_ns[0]) / NS_PER_S
    intervals = np.diff(sequence.stamps_ns)
    median_s = float(np.median(intervals)) / NS_PER_S if len(intervals) else 0.0
    damaged, sensors = _decode(sequence, chosen, progress)
    focal_line, focal_problems = check_focal(sequence, progress) if focal else ("", [])
    truth = sequence.groundtruth
    steps = np.linalg.norm(np.diff(truth.centres, axis=0), axis=1) if truth is not None else None
    return SequenceReport(
        name=sequence.name,
        kind=sequence.kind,
        frames=count,
        rate_hz=1.0 / median_s if median_s > 0 else 0.0,
        duration_s=duration_s,
        start_s=float(sequence.stamps_ns[0]) / NS_PER_S,
        rig=sequence.rig,
        stored_size=sequence.stored_size,
        rectified_here=sequence.rectifier is not None,
        groundtruth_poses=0 if truth is None else len(truth),
        groundtruth_frames=0 if truth is None else frames_covered(truth, sequence.stamps_ns),
        path_length_m=None if steps is None else float(steps.sum()),
        decoded=len(chosen),
        problems=(*sequence.problems, *positions.problems, *damaged, *sensors.problems, *focal_problems),
        focal=focal_line,
        images=sensors.images,
        rows=sensors.rows,
        depth=sensors.depth,
        missing=sequence.missing,
        understood=sequence.understood,
        origin=sequence.origin,
        notes=(*sequence.notes, *positions.notes),
        positions=positions.line,
    )


def _decode(
    sequence: ImageSequence, chosen: range | list[int], progress: Progress | None
) -> tuple[list[Problem], ImageFindings]:
    """Every frame of ``chosen`` that cannot be read (missing files are known already), and what the
    others show."""
    from maslam.frontend.datasets import Problem, Severity
    from maslam.frontend.datasets.stored_image import file_of
    from maslam.frontend.errors import FrontendError

    known = any("missing" in problem.message for problem in sequence.problems)
    looked_at = set(samples_of(len(sequence)))
    refused: list[str] = []
    frames = []
    task = progress.start(f"decoding {sequence.name}", len(chosen)) if progress is not None else 0
    for done, i in enumerate(chosen, 1):
        files = [file_of(images[i]) for images in (sequence.left, sequence.right, sequence.depth) if images]
        if not known or all(file.is_file() for file in files):
            try:
                frame = sequence.read(i)
                if i in looked_at:
                    frames.append(frame)
            except FrontendError as error:
                refused.append(str(error))
        if progress is not None:
            progress.advance(task, done)
    problems = [Problem(Severity.ERROR, line) for line in _counted(refused, len(chosen))]
    return problems, look_at(sequence, frames)


def _counted(refused: list[str], looked_at: int) -> list[str]:
    """Lines of which several differ in the file alone as one, with the first file and their number."""
    alike: dict[str, list[str]] = {}
    for line in refused:
        alike.setdefault(line.partition(": ")[2], []).append(line)
    return [
        lines[0] if len(lines) == 1 else f"{lines[0]} (and {len(lines) - 1} more of {looked_at} looked at)"
        for lines in alike.values()
    ]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the command."""
    from maslam.frontend.datasets.reading_config import ReadingConfig
    from maslam.frontend.recording_config import RecordingConfig

    parser.add_argument(
        "source", metavar="SRC", type=Path, help="a data set, a film or bag, or a folder of agent_00, agent_01, ..."
    )
    parser.add_argument(
        "--rig", choices=("mono", "stereo", "rgbd"), help="read it as this (default: the most that the files allow)"
    )
    parser.add_argument(
        "--png",
        type=Path,
        metavar="FILE",
        help="draw the middle frame, undistorted, with its features; a pair with common rows, or the depth beside it",
    )
    parser.add_argument("--all", action="store_true", help="decode every image, not only a sample")
    parser.add_argument(
        "--focal",
        action="store_true",
        help="estimate the focal length from the images (a minute), and warn where the calibration's is off by 5 %%",
    )
    parser.add_argument("--json", action="store_true", help="print the report as one JSON object")
    add_model_options(parser, RecordingConfig(), RECORDING)
    add_model_options(parser, ReadingConfig(), "images")


def main(arguments: argparse.Namespace) -> int:
    """Print the report; 1 where an error would spoil a run."""
    from maslam.frontend.cameras.models import RigKind
    from maslam.frontend.datasets.reading_config import ReadingConfig
    from maslam.frontend.recording_config import RecordingConfig

    from ..common.progress import progress_on

    rig = RigKind(arguments.rig) if arguments.rig else None
    recording = build(RecordingConfig(), arguments, prefix=RECORDING)
    reading = build(ReadingConfig(), arguments, prefix="images")
    if arguments.png is not None:
        check_file(arguments.png, arguments.source, (".png",))
    with progress_on(quiet=not (arguments.all or arguments.focal)) as progress:
        report = inspect_dataset(
            arguments.source, arguments.all, rig, progress, arguments.png, recording, arguments.focal, reading
        )
    print(json.dumps(record(report), indent=2) if arguments.json else "\n".join(report.lines()))
    if arguments.png is not None and not arguments.json:
        print(f"picture: {arguments.png}")
    return 1 if report.errors else 0
