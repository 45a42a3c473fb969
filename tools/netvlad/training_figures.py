"""Pictures of a place descriptor's making: its training's curves, and what its thresholds were read from."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from maslam.descriptors.card import Calibration, ModelCard, OperatingPoint

from ..common.errors import ToolError
from ..common.figures import FAINT, INK, colour_of, dress, saved_figure

_NOT_VALIDATION = ("step", "loss", "right", "scale")
_MARKS = {"strict": "--", "candidate": ":"}


def training_picture(log: Path, out: Path) -> None:
    """Loss (left) and the validation's recalls (right) over the steps of a training's ``log.jsonl``; a step logged
    twice, before and after a training was taken up again, counts as it was logged last."""
    lines = {int(line["step"]): line for line in _read_log(log)}
    if not lines:
        raise ToolError(f"{log}: nothing is logged yet")
    rows = [lines[step] for step in sorted(lines)]
    names = sorted({name for row in rows for name in row if name not in _NOT_VALIDATION})
    with saved_figure(out, (10.0, 3.6)) as figure:
        loss, right = figure.subplots(1, 2)
        loss.plot([row["step"] for row in rows], [row["loss"] for row in rows], color=colour_of(0), linewidth=1.6)
        dress(loss, "loss (InfoNCE)", "step", "nats")
        loss.set_ylim(bottom=0.0)
        style = {"color": FAINT, "linewidth": 1.0, "label": "pairs of the batch classified correctly"}
        right.plot([row["step"] for row in rows], [row["right"] for row in rows], **style)
        for number, name in enumerate(names):
            known = [row for row in rows if name in row]
            steps, values = [row["step"] for row in known], [row[name] for row in known]
            label = f"{name} {values[-1]:.3f}"
            right.plot(steps, values, "o-", color=colour_of(number), linewidth=1.8, markersize=4, label=label)
        dress(right, "recall@1 on held-out worlds", "step", "")
        right.set_ylim(top=1.005)
        right.legend(loc="lower right")


def draw_calibrations(cards: Sequence[ModelCard], out: Path) -> list[Path]:
    """``calibration_<model>.png`` in folder ``out`` for each card that has the curves; their paths."""
    paths = []
    for card in cards:
        if card.calibration is not None and card.calibration.curve:
            paths.append(out / f"calibration_{card.name}.png")
            calibration_picture(card.calibration, card.name, paths[-1])
    return paths


def calibration_picture(calibration: Calibration, name: str, out: Path) -> None:
    """Precision and recall of the nearest neighbour over the distance up to which it is believed, for each set and for
    all together, with both thresholds. ``name``: of the model."""
    curves = [("all together", calibration.curve), *((one.name, one.curve) for one in calibration.sets)]
    with saved_figure(out, (10.0, 3.9)) as figure:
        precision, recall = figure.subplots(1, 2)
        for number, (label, curve) in enumerate(curves):
            style = {"color": INK if number == 0 else colour_of(number - 1), "linewidth": 2.4 if number == 0 else 1.4}
            distances, values = _columns(curve)
            precision.plot(distances, values[:, 0], label=label, zorder=3 if number == 0 else 2, **style)
            recall.plot(distances, values[:, 1], label=label, zorder=3 if number == 0 else 2, **style)
        points = {"strict": calibration.strict, "candidate": calibration.candidate}
        for axes, which in ((precision, "precision"), (recall, "recall")):
            for kind, point in points.items():
                axes.axvline(point.distance, color=FAINT, linestyle=_MARKS[kind], linewidth=1.1, zorder=1)
                axes.plot(point.distance, getattr(point, which), "o", color=INK, markersize=5, zorder=4)
                _say(axes, kind, point, which)
            axes.set_ylim(0.0, 1.12)
        dress(precision, f"{name}: precision of what is believed", "distance up to which it is believed", "")
        dress(recall, f"recall ({calibration.queries} queries)", "distance up to which it is believed", "")
        figure.legend(
            *precision.get_legend_handles_labels(),
            ncols=len(curves),
            loc="outside lower center",
        )


def _say(axes: Any, kind: str, point: OperatingPoint, which: str) -> None:
    """Both figures of a threshold at the top of its line."""
    text = f"{kind} {point.distance:.3f}\n{which} {getattr(point, which):.3f}"
    axes.annotate(
        text,
        xy=(point.distance, 1.115),
        xytext=(-3, 0),
        textcoords="offset points",
        ha="right",
        va="top",
        fontsize=7.5,
        color=INK,
    )


def _columns(curve: tuple[OperatingPoint, ...]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    rows = np.array([(p.distance, p.precision, p.recall) for p in curve]).reshape(-1, 3)
    return rows[:, 0], rows[:, 1:]


def _read_log(log: Path) -> list[dict[str, float]]:
    if not log.is_file():
        raise ToolError(f"{log}: no such file")
    rows = []
    for number, line in enumerate(log.read_text(encoding="utf-8").splitlines(), 1):
        try:
            row = json.loads(line)
            rows.append({name: float(row[name]) for name in row})
            if not {"step", "loss", "right"} <= row.keys():
                raise ValueError("step, loss and right belong to a line")
        except (ValueError, TypeError, AttributeError) as error:
            raise ToolError(f"{log}:{number}: not a line of a training's log: {error}") from error
    return rows
