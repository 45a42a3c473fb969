"""The picture of ``maslam bench vo``: paths from above, error along the path, processor time by stage."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ...common.figures import FAINT, INK, TRUTH, colour_of, dress, saved_figure, style_of
from ...common.plane import plane_of
from .accuracy import LENGTHS_M, Accuracy
from .result import OURS, BenchResult

_ROW_INCHES, _BAR_INCHES, _WIDTH_INCHES = 3.4, 0.42, 11.5
_AXES = "xyz"
STAGE_COLOURS = {
    "decode": "#8d99a6",
    "track": "#0072B2",
    "start": "#9ecae1",
    "relocalise": "#6A51A3",
    "detect": "#E69F00",
    "match": "#F0C75E",
    "stereo": "#009E73",
    "triangulate": "#7fc97f",
    "adjust": "#D55E00",
    "cull": "#CC79A7",
    "export": "#8C6D31",
    "write": "#c9a66b",
    "other": "#d5dde4",
}


def draw_bench(results: Sequence[BenchResult], path: Path) -> None:
    """A row for each sequence, then all their costs; the kind of file by the name's ending."""
    heights = [*(_ROW_INCHES for _ in results), 1.2 + _BAR_INCHES * len(results)]
    with saved_figure(path, (_WIDTH_INCHES, sum(heights))) as figure:
        grid = figure.add_gridspec(len(heights), 2, height_ratios=heights, width_ratios=[1, 1.35])
        for row, result in enumerate(results):
            _paths(figure.add_subplot(grid[row, 0]), result)
            _errors(figure.add_subplot(grid[row, 1]), result)
        _costs(figure.add_subplot(grid[len(results), :]), results)


def _systems(result: BenchResult) -> list[tuple[str, Accuracy | None]]:
    return [(OURS, result.accuracy), *((one.name, one.accuracy) for one in result.compared)]


def _paths(axes: Any, result: BenchResult) -> None:
    """The truth, and each system's tracks aligned with it."""
    known = [(name, errors) for name, errors in _systems(result) if errors is not None]
    if known:
        truths = [track.truth for _, errors in known for track in errors.tracks]
        a, b = plane_of(np.concatenate(truths))
        for k, truth in enumerate(known[0][1].tracks):
            label = "truth" if k == 0 else None
            axes.plot(truth.truth[:, a], truth.truth[:, b], color=TRUTH, linewidth=5, label=label)
    else:
        a, b = 0, 2
        for k, trajectory in enumerate(result.measured.trajectories):
            axes.plot(trajectory.centres[:, a], trajectory.centres[:, b], color=colour_of(k), label=f"track {k}")
    for k, (name, errors) in enumerate(_systems(result)):
        for number, track in enumerate(errors.tracks if errors is not None else ()):
            label = name if number == 0 else None
            style = {**style_of(k), "linewidth": 1.8 if k == 0 else 1.3}
            axes.plot(track.positions[:, a], track.positions[:, b], label=label, **style)
            axes.plot(*track.positions[0, [a, b]], "o", color=colour_of(k), markeredgecolor="white", markersize=6)
    axes.set_aspect("equal", adjustable="datalim")
    unit = "m" if known or result.metric else "units of the map"
    title = f"{result.name}: {result.tracked} of {result.frames} frames"
    dress(axes, title, f"{_AXES[a]}, {unit}", f"{_AXES[b]}, {unit}")
    if axes.has_data():
        axes.legend()


def _errors(axes: Any, result: BenchResult) -> None:
    """Error of position along the true path; it breaks between tracks."""
    words = []
    for k, (name, errors) in enumerate(_systems(result)):
        if errors is None:
            continue
        for track in errors.tracks:
            style = {**style_of(k), "linewidth": 1.8 if k == 0 else 1.3}
            axes.plot(track.along_m, track.errors_m, **style)
        known = zip(errors.rpe_percent, LENGTHS_M, strict=True)
        drift = [f"{value:.2f} % / {length:.0f} m" for value, length in known if np.isfinite(value)]
        words.append(f"{name}  ATE {errors.ate_m:.3f} m" + (f", {', '.join(drift)}" if drift else ""))
    for k, line in enumerate(words):
        place = {"xy": (0.015, 0.97 - 0.075 * k), "xycoords": "axes fraction", "va": "top", "fontsize": 8.5}
        axes.annotate(line, color=colour_of(k), fontweight="bold" if k == 0 else "normal", **place)
    if not words:
        note = "nothing to compare with the truth" if result.truth else "no ground truth"
        axes.annotate(note, xy=(0.5, 0.5), xycoords="axes fraction", ha="center", color=FAINT)
    how = "" if result.accuracy is None else f" after {'Sim(3)' if result.accuracy.with_scale else 'SE(3)'} alignment"
    dress(axes, f"error of position{how}", "path driven, m", "m")
    low, high = axes.get_ylim()
    axes.set_ylim(0.0, high + 0.13 * len(words) * (high - min(low, 0.0)))


def _costs(axes: Any, results: Sequence[BenchResult]) -> None:
    """A bar for each sequence in multiples of one ORB call, cut into stages."""
    stages = dict.fromkeys(name for name in STAGE_COLOURS for r in results if name in r.measured.times.stages_s)
    for row, result in enumerate(results):
        times, left = result.measured.times, 0.0
        for name in stages:
            width = times.stages_s.get(name, 0.0) / result.frames / times.unit_s
            label = name if row == 0 else None
            axes.barh(row, width, left=left, height=0.66, color=STAGE_COLOURS[name], label=label, edgecolor="white")
            if width > 0.11:
                ms = 1e3 * times.stages_s[name] / result.frames
                axes.text(left + width / 2, row, f"{ms:.1f}", ha="center", va="center", fontsize=7.5, color=INK)
            left += width
        cpu, wall = (1e3 * spent / result.frames for spent in (times.cpu_s, times.wall_s))
        unit = 1e3 * times.unit_s
        words = f" {cpu / unit:.2f} x  ({cpu:.1f} ms; an ORB call {unit:.1f} ms; wall {wall / unit:.2f} x)"
        axes.text(left, row, words, va="center", fontsize=8.5, color=INK)
    axes.set_yticks(range(len(results)), [result.name for result in results])
    axes.invert_yaxis()
    most = max(result.measured.times.cpu_s / result.frames / result.measured.times.unit_s for result in results)
    axes.set_xlim(0, 1.5 * most)
    dress(
        axes, "processor time per frame by stage (ms in the bars)", "multiples of one ORB call on the same images", ""
    )
    axes.grid(axis="y", visible=False)
    axes.figure.legend(
        *axes.get_legend_handles_labels(),
        ncols=len(stages),
        loc="outside lower center",
        handlelength=1.0,
        columnspacing=1.1,
        handletextpad=0.4,
    )
