"""Result of ``maslam bench vo`` for one sequence, as a record for programs and as tables for people."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from maslam.frontend.files.trajectory import Trajectory

from ...common.text_table import aligned
from .accuracy import LENGTHS_M, Accuracy
from .measure import VoMeasurement

OURS = "maslam"


@dataclass(frozen=True)
class Compared:
    """Another system's trajectory: its file's name, the poses, its errors (None where none has a true counterpart)."""

    name: str
    trajectory: Trajectory
    accuracy: Accuracy | None


@dataclass(frozen=True)
class BenchResult:
    """``name`` of the sequence, unique in this benchmark; ``accuracy`` None without ``truth``, and where nothing was
    tracked that has a true pose."""

    name: str
    kind: str
    rig: str
    metric: bool
    frames: int
    files: bool
    truth: bool
    measured: VoMeasurement
    accuracy: Accuracy | None
    compared: tuple[Compared, ...] = ()

    @property
    def tracked(self) -> int:
        """Frames with a pose."""
        return sum(len(track) for track in self.measured.trajectories)


def record(result: BenchResult) -> dict[str, Any]:
    """Plain values for JSON, None where unknown. ``measured_on``: frames that errors are of, each track under its own
    ``alignment``. ``unit_ms``: the reference unit, one OpenCV ORB call on an image of
    the sequence; ``unit_cpu`` and ``unit_wall``: ``cpu_ms`` and ``wall_ms`` (per frame) in multiples of it."""
    measured, times = result.measured, result.measured.times
    unit_ms = 1e3 * times.unit_s
    cpu_ms, wall_ms = 1e3 * times.cpu_s / result.frames, 1e3 * times.wall_s / result.frames
    stages = {name: _rounded(1e3 * spent / result.frames, 4) for name, spent in times.stages_s.items()}
    return {
        "sequence": result.name,
        "dataset": result.kind,
        "rig": result.rig,
        "frames": result.frames,
        "tracked": result.tracked,
        "tracks": len(measured.trajectories),
        "keyframes": int(measured.stats.get("keyframes", 0)),
        "points": int(measured.stats.get("points", 0)),
        **_errors(result.accuracy),
        "cpu_ms": _rounded(cpu_ms, 4),
        "wall_ms": _rounded(wall_ms, 4),
        "unit_ms": _rounded(unit_ms, 4),
        "unit_cpu": _rounded(cpu_ms / unit_ms, 4),
        "unit_wall": _rounded(wall_ms / unit_ms, 4),
        "stages_ms": stages,
        "peak_mb": _rounded(measured.peak_mb, 1),
        "baseline_mb": _rounded(measured.baseline_mb, 1),
        "files": result.files,
        "runs": measured.runs,
        "same_each_run": measured.same,
        "lost": list(measured.lost),
        "unreadable": list(measured.unreadable),
        "compared": [
            {"name": one.name, "frames": result.frames, "tracked": len(one.trajectory), **_errors(one.accuracy)}
            for one in result.compared
        ],
    }


def tables(results: Sequence[BenchResult]) -> str:
    """Accuracy, cost, and cost by stage, one line per sequence."""
    parts = [_accuracy_table(results), _cost_table(results), _stage_table(results)]
    notes = [f"{r.name}: {line}" for r in results for line in (*r.measured.lost, *r.measured.unreadable)]
    notes += [f"{r.name}: not the same poses in each run" for r in results if not r.measured.same]
    notes += [f"{r.name}: no ground truth, errors cannot be known" for r in results if not r.truth]
    return "\n\n".join("\n".join(part) for part in (*parts, notes) if part)


def _errors(accuracy: Accuracy | None) -> dict[str, Any]:
    values: dict[str, float] = {}
    if accuracy is not None:
        values = {
            "path_m": accuracy.path_m,
            "ate_m": accuracy.ate_m,
            "ate_mean_m": accuracy.ate_mean_m,
            "ate_max_m": accuracy.ate_max_m,
            "rpe_frame_m": accuracy.step_m,
            "rpe_frame_deg": accuracy.step_deg,
            "scale": accuracy.scale,
        }
        for k, length in enumerate(LENGTHS_M):
            values[f"rpe_{length:.0f}m_percent"] = accuracy.rpe_percent[k]
            values[f"rpe_{length:.0f}m_deg_per_m"] = accuracy.rpe_deg_per_m[k]
    names = ["path_m", "ate_m", "ate_mean_m", "ate_max_m"]
    names += [f"rpe_{length:.0f}m_{unit}" for length in LENGTHS_M for unit in ("percent", "deg_per_m")]
    names += ["rpe_frame_m", "rpe_frame_deg", "scale"]
    alignment = None if accuracy is None else ("sim3" if accuracy.with_scale else "se3")
    posed = None if accuracy is None else accuracy.posed
    return {
        "alignment": alignment,
        "measured_on": posed,
        **{name: _rounded(values.get(name, math.nan), 6) for name in names},
    }


def _accuracy_table(results: Sequence[BenchResult]) -> list[str]:
    head = ["accuracy", "frames", "tracks", "path", "ATE"]
    head += [f"RPE {length:.0f} m" for length in LENGTHS_M] + ["deg/m", "RPE per frame", "scale", "alignment"]
    rows = [head]
    for result in results:
        tracks = str(len(result.measured.trajectories))
        rows.append([result.name, f"{result.tracked}/{result.frames}", tracks, *_error_cells(result.accuracy)])
        for one in result.compared:
            tracked = f"{len(one.trajectory)}/{result.frames}"
            rows.append([f"  {one.name}", tracked, "", *_error_cells(one.accuracy)])
    return aligned(rows)


def _error_cells(accuracy: Accuracy | None) -> list[str]:
    if accuracy is None:
        return ["-"] * (6 + len(LENGTHS_M))
    return [
        _cell(accuracy.path_m, ".1f", " m"),
        _cell(accuracy.ate_m, ".3f", " m"),
        *(_cell(value, ".3f", " %") for value in accuracy.rpe_percent),
        _cell(accuracy.rpe_deg_per_m[0], ".4f", ""),
        _cell(accuracy.step_m, ".4f", " m"),
        _cell(accuracy.scale, ".4f", ""),
        "Sim(3)" if accuracy.with_scale else "SE(3)",
    ]


def _cost_table(results: Sequence[BenchResult]) -> list[str]:
    rows = [["cost per frame", "CPU", "wall", "ORB call", "CPU / ORB", "wall / ORB", "peak", "at start", "runs"]]
    for result in results:
        found = record(result)
        rows.append(
            [
                result.name,
                *(_cell(found[name], ".1f", " ms") for name in ("cpu_ms", "wall_ms", "unit_ms")),
                *(_cell(found[name], ".2f", " x") for name in ("unit_cpu", "unit_wall")),
                *(_cell(found[name], ".0f", " MB") for name in ("peak_mb", "baseline_mb")),
                str(found["runs"]),
            ]
        )
    return aligned(rows)


def _stage_table(results: Sequence[BenchResult]) -> list[str]:
    names = list(dict.fromkeys(name for result in results for name in result.measured.times.stages_s))
    names = [*(name for name in names if name != "other"), "other"]
    rows = [["CPU by stage, ms", *names]]
    for result in results:
        stages = record(result)["stages_ms"]
        rows.append([result.name, *(_cell(stages.get(name), ".2f", "") for name in names)])
    return aligned(rows)


def _cell(value: float | None, how: str, unit: str) -> str:
    return "-" if value is None or not math.isfinite(value) else f"{value:{how}}{unit}"


def _rounded(value: float, digits: int) -> float | None:
    return round(float(value), digits) if math.isfinite(value) else None
