"""The odometry's cost on one sequence, measured in a process of its own (``maslam bench vo``)."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from maslam.frontend.files.trajectory import Trajectory

if TYPE_CHECKING:
    from maslam.frontend.config import OdometryConfig
    from maslam.frontend.datasets import ImageSequence
    from maslam.frontend.odometry import Odometry, OdometryResult
    from maslam.frontend.tracking.pose_log import LostInterval
    from maslam.frontend.vocabulary.vocabulary import Vocabulary

WARM_FRAMES = 60
UNIT_IMAGES = 12
UNIT_FEATURES = 2000
_REPORT_EVERY_S = 1.0  # reporting costs processor time too
WRITE = "write"


@dataclass(frozen=True)
class BenchJob:
    """A measurement: what to run, how often; ``files``: the folder that the five files of each track go to, None = not
    written."""

    sequence: ImageSequence
    odometry: OdometryConfig
    vocabulary: Path | None
    files: Path | None
    runs: int


@dataclass(frozen=True)
class RunTimes:
    """One run over all frames, seconds: processor time of all threads, wall time, processor time by stage (what no
    stage owns is ``other``), and the reference unit ``unit_s``: one ORB call on an image of the sequence."""

    cpu_s: float
    wall_s: float
    unit_s: float
    stages_s: dict[str, float]

    @property
    def cpu_units(self) -> float:
        """Processor time of the run in reference units."""
        return self.cpu_s / self.unit_s


@dataclass(frozen=True)
class VoMeasurement:
    """``trajectories``: every frame with a pose, one per track; ``times``: the run of median cost, counted in reference
    units, of ``runs``; ``same``: all runs gave the same poses, bit by bit. ``baseline_mb``: resident memory before the
    first image (Python, libraries, vocabulary); ``peak_mb`` includes it. ``lost``: gaps and why."""

    trajectories: tuple[Trajectory, ...]
    stats: dict[str, float]
    lost: tuple[str, ...]
    unreadable: tuple[str, ...]
    times: RunTimes
    runs: int
    same: bool
    baseline_mb: float
    peak_mb: float


def measure_job(job: BenchJob, advance: Callable[[int], None]) -> VoMeasurement:
    """Warm up, run, and run again as often as the job says. The peak is that of the first run."""
    from maslam.frontend.vocabulary.vocabulary import Vocabulary

    from ...common.memory import peak_mb, reset_peak, resident_mb

    vocabulary = Vocabulary.load(job.vocabulary)
    baseline = resident_mb()
    _warm_up(job, vocabulary)
    reset_peak()
    times, peak, same = [], 0.0, True
    first: OdometryResult | None = None
    unreadable: list[str] = []
    for run in range(job.runs):
        level = _Throttled(advance, run * len(job.sequence))
        unreadable = []
        result, spent = _run(job, vocabulary, unreadable, level)
        times.append(spent)
        if first is None:
            first, peak = result, peak_mb()
        same &= _equal(first, result)
    assert first is not None
    advance(job.runs * len(job.sequence))
    return VoMeasurement(
        trajectories=tuple(first.trajectories),
        stats={name: float(value) for name, value in first.stats.items()},
        lost=tuple(_gap(gap) for gap in first.lost),
        unreadable=tuple(unreadable),
        times=sorted(times, key=lambda one: one.cpu_units)[len(times) // 2],
        runs=job.runs,
        same=same,
        baseline_mb=baseline,
        peak_mb=peak,
    )


def _gap(gap: LostInterval) -> str:
    return f"{gap.frames} frame{'s'[gap.frames == 1 :]} from {gap.first_ns / 1e9:.3f} s: {gap.reason}"


def _warm_up(job: BenchJob, vocabulary: Vocabulary) -> None:
    """Compile, or load, every kernel on the first frames: it is paid once, not per frame."""
    from maslam.frontend.errors import FrontendError
    from maslam.frontend.odometry import Odometry

    odometry = Odometry(job.sequence.rig, job.odometry, vocabulary)
    for index in range(min(WARM_FRAMES, len(job.sequence))):
        try:
            odometry.process(job.sequence.read(index))
        except FrontendError:
            continue  # the run itself says what is wrong with a frame
    odometry.finish()


def _run(
    job: BenchJob, vocabulary: Vocabulary, unreadable: list[str], advance: Callable[[int], None]
) -> tuple[OdometryResult, RunTimes]:
    """All frames once, from the files to the trajectory; the reference unit before and after.

    Of the two units the smaller counts: other work on the machine only ever lengthens it, and a shorter unit is not
    in our favour. Making tracks into files' content, and looking for views that only the files have, counts only where
    the files are written.
    """
    from maslam.frontend.files.vo_files import write_track
    from maslam.frontend.odometry import Odometry

    from ...pipeline.tracking import follow

    unit_before = unit_s(job.sequence)
    odometry = Odometry(job.sequence.rig, job.odometry, vocabulary)
    wall, cpu = time.perf_counter(), time.process_time()
    for frame, _ in follow(job.sequence, odometry, unreadable):
        advance(frame.index + 1)
    result = odometry.finish()
    written = time.thread_time()
    for number, track in enumerate(result.tracks if job.files is not None else []):
        assert job.files is not None
        write_track(job.files, number, track)
    written = time.thread_time() - written
    cpu, wall = time.process_time() - cpu, time.perf_counter() - wall
    stages, not_counted = _stages(odometry, job.files is not None, written)
    cpu, wall = cpu - not_counted[0], wall - not_counted[1]
    stages["other"] = max(0.0, cpu - sum(stages.values()))
    return result, RunTimes(cpu, wall, min(unit_before, unit_s(job.sequence)), stages)


def _stages(odometry: Odometry, files: bool, written: float) -> tuple[dict[str, float], tuple[float, float]]:
    """Processor time by stage; and processor and wall time of what does not count."""
    from maslam.frontend.stopwatch import StageTime, TimedStage

    times = odometry.stopwatch.times
    stages = {stage.value: spent.cpu_s for stage, spent in times.items()}
    if files:
        return {**stages, WRITE: written}, (0.0, 0.0)
    for_files = [times.get(stage, StageTime()) for stage in (TimedStage.VIEWS, TimedStage.EXPORT)]
    for stage in (TimedStage.VIEWS, TimedStage.EXPORT):
        stages.pop(stage.value, None)
    return stages, (sum(spent.cpu_s for spent in for_files), sum(spent.wall_s for spent in for_files))


def unit_s(sequence: ImageSequence) -> float:
    """Median processor time, seconds, of OpenCV's ORB with 2000 features on left images spread over the sequence."""
    import cv2

    from maslam.frontend.errors import FrontendError

    orb = cv2.ORB.create(UNIT_FEATURES)
    spent: list[float] = []
    for index in np.unique(np.linspace(0, len(sequence) - 1, UNIT_IMAGES).round().astype(int)).tolist():
        try:
            image = next(sequence.frames(index, index + 1)).image  # the left one alone
        except FrontendError:
            continue
        if not spent:
            orb.detectAndCompute(image, None)  # its first call prepares tables
        start = time.thread_time()
        orb.detectAndCompute(image, None)
        spent.append(time.thread_time() - start)
    return float(np.median(spent)) if spent else float("nan")


def _equal(a: OdometryResult, b: OdometryResult) -> bool:
    return len(a.trajectories) == len(b.trajectories) and all(
        np.array_equal(x.stamps_ns, y.stamps_ns) and np.array_equal(x.poses, y.poses)
        for x, y in zip(a.trajectories, b.trajectories, strict=True)
    )


class _Throttled:
    """Tells the level, shifted by ``offset``, once in a while."""

    def __init__(self, advance: Callable[[int], None], offset: int) -> None:
        self._advance, self._offset = advance, offset
        self._reported_s = time.monotonic()

    def __call__(self, level: int) -> None:
        now = time.monotonic()
        if now - self._reported_s >= _REPORT_EVERY_S:
            self._reported_s = now
            self._advance(self._offset + level)
