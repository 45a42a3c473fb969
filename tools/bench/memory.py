"""``maslam bench memory``: a rendered circuit driven lap after lap; what grows with frames that need not."""

from __future__ import annotations

import json
import math
import tempfile
import time
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from maslam.backend.geometry import se3, so3_exp

from ..common.errors import ToolError, UsageError
from ..common.memory import resident_mb
from ..common.parallel import run_jobs
from ..common.progress import Progress, counter
from ..common.text_table import aligned

if TYPE_CHECKING:
    from maslam.frontend.config import OdometryConfig
    from maslam.frontend.datasets import ImageSequence

SAMPLES = 40
_SETTLED = 0.25  # of the run: libraries and buffers have their size by then
_SHORTEST_LAP = 50  # frames: 4 m from one to the next
_HALF_AXES_M = (40.0, 25.0)


@dataclass(frozen=True)
class MemorySettings:
    """``frames`` to drive on a circuit of ``lap`` rendered frames of ``width`` x ``height`` pixels; ``images``: folder
    for them, None = a temporary one."""

    odometry: OdometryConfig
    frames: int = 10_000
    lap: int = 500
    width: int = 160
    height: int = 120
    rig: str = "stereo"
    seed: int = 0
    images: Path | None = None


@dataclass(frozen=True)
class Sample:
    """After ``frame`` frames: resident memory and of it the maps' (megabytes), what the maps hold, processor time per
    frame since the sample before, frames without a pose so far."""

    frame: int
    resident_mb: float
    map_mb: float
    keyframes: int
    culled: int
    points: int
    numbers: int
    observations: int
    cpu_ms: float
    lost: int


@dataclass(frozen=True)
class MemoryReport:
    """``bytes_per_frame``: slope of resident memory excluding the maps, over the settled part of the run, by Siegel's
    repeated medians: a step that comes once, a library loaded, is no growth. ``ms_growth``: processor time per frame in
    the last quarter over that in the second."""

    samples: tuple[Sample, ...]
    tracks: int

    @property
    def bytes_per_frame(self) -> float:
        """Growth excluding the maps."""
        return 1e6 * self._slope([s.resident_mb - s.map_mb for s in self.samples])

    @property
    def resident_bytes_per_frame(self) -> float:
        """The same with the maps."""
        return 1e6 * self._slope([s.resident_mb for s in self.samples])

    @property
    def ms_growth(self) -> float:
        """Last quarter over second quarter: 1 where a frame costs the same all along."""
        quarters = np.array_split([s.cpu_ms for s in self.samples], 4)
        return float(np.median(quarters[3]) / np.median(quarters[1]))

    def _slope(self, values: list[float]) -> float:
        from scipy.stats import siegelslopes

        first = int(_SETTLED * len(values))
        return float(siegelslopes(values[first:], [s.frame for s in self.samples[first:]])[0])

    def record(self) -> dict[str, Any]:
        """Plain values for JSON."""
        figures = {"bytes_per_frame": self.bytes_per_frame, "resident_bytes_per_frame": self.resident_bytes_per_frame}
        figures["ms_growth"] = self.ms_growth
        rounded = {name: round(value, 3) for name, value in figures.items()}
        return {"tracks": self.tracks, **rounded, "samples": [asdict(sample) for sample in self.samples]}

    def json(self) -> str:
        """The record as JSON text."""
        return json.dumps(self.record(), indent=1)

    def text(self) -> str:
        """For people: about twenty samples and the growth."""
        rows = [
            ["frames", "resident", "maps", "key-frames", "culled", "points", "observations", "CPU per frame", "lost"]
        ]
        for s in self.samples[:: max(1, len(self.samples) // 20)]:
            memory = [f"{s.resident_mb:.1f} MB", f"{s.map_mb:.1f} MB"]
            counts = [str(n) for n in (s.keyframes, s.culled, s.points, s.observations)]
            rows.append([str(s.frame), *memory, *counts, f"{s.cpu_ms:.2f} ms", str(s.lost)])
        last = self.samples[-1]
        notes = [
            f"{last.frame} frames, {last.lost} without a pose; tracks: {self.tracks}",
            f"memory per frame  {self.resident_bytes_per_frame:.0f} bytes, "
            f"excluding the maps {self.bytes_per_frame:.0f} bytes",
            f"time per frame    {self.ms_growth:.2f} x from the second quarter of the run to the last",
        ]
        return "\n".join([*aligned(rows), "", *notes])


def bench_memory(settings: MemorySettings, progress: Progress) -> MemoryReport:
    """Render the circuit, unless it is there, and drive it in a process of its own."""
    from maslam.frontend.datasets import open_dataset

    if math.isnan(resident_mb()):
        raise ToolError("this system does not tell how much memory a process holds: run it on Linux")
    if settings.frames < SAMPLES:
        raise ToolError(f"{settings.frames} frames: at least {SAMPLES} are needed")
    if settings.lap < _SHORTEST_LAP:
        raise UsageError(f"--lap {settings.lap}: at least {_SHORTEST_LAP} frames make a path that can be followed")
    with ExitStack() as stack:
        root = settings.images or Path(stack.enter_context(tempfile.TemporaryDirectory()))
        sequence = open_dataset(_rendered(root, settings, progress)).sequences[0]
        job = _Drive(sequence, settings)
        outcome = run_jobs(_drive, {"driving": (job, settings.frames)}, 1, progress, fresh=True)["driving"]
    if outcome.result is None:
        assert outcome.error is not None
        raise outcome.error
    return outcome.result


def circuit(frames: int) -> NDArray[np.float64]:
    """``(frames, 4, 4)`` ``T_W_C`` round an ellipse at even speed; after the last comes the first."""
    a, b = _HALF_AXES_M
    t = np.linspace(0.0, 2 * np.pi, 20_000)
    driven = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff([a * np.sin(t), -b * np.cos(t)], axis=1)))])
    t = np.interp(np.arange(frames) * driven[-1] / frames, driven, t)
    zero = np.zeros(frames)
    yaw = np.arctan2(a * np.cos(t), b * np.sin(t))
    centres = np.stack([a * np.sin(t), zero, b * (1.0 - np.cos(t))], axis=1)
    return se3(so3_exp(np.stack([zero, yaw, zero], axis=1)), centres)


def _rendered(root: Path, settings: MemorySettings, progress: Progress) -> Path:
    """The images of one lap, in even light."""
    from maslam.frontend.cameras.models import RigKind
    from maslam.frontend.files.trajectory import write_kitti_poses

    from ..worlds.config import RenderConfig
    from ..worlds.dataset import render_dataset
    from ..worlds.rendering.sensor import SensorConfig

    root.mkdir(parents=True, exist_ok=True)
    write_kitti_poses(root / "circuit.txt", circuit(settings.lap))
    config = RenderConfig(
        poses_file=root / "circuit.txt",
        agents=1,
        frames=min(settings.lap, settings.frames),
        seed=settings.seed,
        width=settings.width,
        height=settings.height,
        rig=RigKind(settings.rig),
        cheap=True,
        light_change=0.0,
        sensor=SensorConfig(exposure_drift=0.0),
    )
    images = root / "images"
    from ..common.compiling import COMPILING

    count = counter(progress, "rendering a lap")
    render_dataset(config, images, count, compiling=counter(progress, COMPILING))
    return images


@dataclass(frozen=True)
class _Drive:
    sequence: ImageSequence
    settings: MemorySettings


def _drive(job: _Drive, advance: Callable[[int], None]) -> MemoryReport:
    """Lap after lap: every frame is decoded again, and is a new moment."""
    from maslam.frontend.odometry import Odometry
    from maslam.frontend.vocabulary.vocabulary import Vocabulary

    sequence, frames = job.sequence, job.settings.frames
    step_ns = int(np.median(np.diff(sequence.stamps_ns)))
    odometry = Odometry(sequence.rig, job.settings.odometry, Vocabulary.load(None))
    at = set(np.linspace(0, frames, SAMPLES + 1).round().astype(int)[1:].tolist())
    samples: list[Sample] = []
    done = lost = 0
    cpu, since = time.process_time(), 0
    while done < frames:
        for frame in sequence.frames(stop=min(len(sequence), frames - done)):
            result = odometry.process(frame.at(done, done * step_ns))
            done, lost = done + 1, lost + (result.T_W_C is None)
            if done in at:
                samples.append(_sample(odometry, done, 1e3 * (time.process_time() - cpu) / (done - since), lost))
                advance(done)
                cpu, since = time.process_time(), done
    return MemoryReport(tuple(samples), len(odometry.maps))


def _sample(odometry: Any, frame: int, cpu_ms: float, lost: int) -> Sample:
    from maslam.frontend.mapping.memory_footprint import EMPTY, footprint

    held = sum((footprint(map_) for map_ in odometry.maps), EMPTY)
    return Sample(
        frame=frame,
        resident_mb=resident_mb(),
        map_mb=held.bytes / 1e6,
        keyframes=held.keyframes,
        culled=held.culled,
        points=held.points,
        numbers=held.numbers,
        observations=held.observations,
        cpu_ms=cpu_ms,
        lost=lost,
    )
