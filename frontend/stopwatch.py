"""Processor and wall time by stage, cheap enough to run always."""

from __future__ import annotations

import time
from dataclasses import dataclass
from enum import StrEnum
from threading import Lock


class TimedStage(StrEnum):
    """Stages of the front end's work on an image, in order; every moment belongs to one stage."""

    DECODE = "decode"
    TRACK = "track"
    START = "start"
    RELOCALISE = "relocalise"
    DETECT = "detect"
    MATCH = "match"
    STEREO = "stereo"
    TRIANGULATE = "triangulate"
    ADJUST = "adjust"
    CULL = "cull"
    VIEWS = "views"
    EXPORT = "export"


@dataclass(frozen=True)
class StageTime:
    """Seconds of processor time and of wall time, without those of stages begun within, and how often it ran."""

    cpu_s: float = 0.0
    wall_s: float = 0.0
    count: int = 0


class Stopwatch:
    """One thread uses :meth:`stage`; a stage begun within another stops the outer one's clock. Other threads, whose
    work overlaps, report theirs with :meth:`add`. A start and a stop cost about two microseconds."""

    def __init__(self) -> None:
        self._times: dict[TimedStage, list[float]] = {}
        self.running: _Running | None = None
        self._lock = Lock()

    @property
    def times(self) -> dict[TimedStage, StageTime]:
        """Time measured so far, in the order of :class:`TimedStage`; stages that never ran are left out."""
        with self._lock:
            found = {stage: StageTime(cpu, wall, int(n)) for stage, (cpu, wall, n) in self._times.items()}
        return {stage: found[stage] for stage in TimedStage if stage in found}

    def add(self, stage: TimedStage, cpu_s: float, wall_s: float) -> None:
        """One more run of ``stage``, measured elsewhere."""
        with self._lock:
            entry = self._times.setdefault(stage, [0.0, 0.0, 0.0])
            entry[0] += cpu_s
            entry[1] += wall_s
            entry[2] += 1.0

    def stage(self, stage: TimedStage) -> _Running:
        """``with`` this: time what happens inside; processor time is that of the calling thread."""
        return _Running(self, stage)


class _Running:
    """A stage under way."""

    __slots__ = ("_cpu", "_inner_cpu", "_inner_wall", "_outer", "_stage", "_wall", "_watch")

    def __init__(self, watch: Stopwatch, stage: TimedStage) -> None:
        self._watch, self._stage = watch, stage
        self._inner_cpu = self._inner_wall = self._cpu = self._wall = 0.0
        self._outer: _Running | None = None

    def __enter__(self) -> None:
        self._outer, self._watch.running = self._watch.running, self
        self._cpu, self._wall = time.thread_time(), time.perf_counter()

    def __exit__(self, *_: object) -> None:
        cpu, wall = time.thread_time() - self._cpu, time.perf_counter() - self._wall
        outer = self._watch.running = self._outer
        self._watch.add(self._stage, cpu - self._inner_cpu, wall - self._inner_wall)
        if outer is not None:
            outer._inner_cpu += cpu
            outer._inner_wall += wall
