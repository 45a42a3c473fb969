"""Ground truth that cannot be of the images, in words: for the console and the report."""

from __future__ import annotations

from collections.abc import Mapping
from html import escape
from typing import Any

from .html import Section


def truth_lines(summary: Mapping[str, Any]) -> list[str]:
    """A warning for each agent whose ground truth odometry contradicts; none where it fits."""
    wrong = [one for one in summary.get("truths") or [] if not one["fits"] or one.get("rotations")]
    return [f"warning: agent_{one['agent']:02d}: {misfit_text(one)}" for one in wrong]


def truth_sections(summary: Mapping[str, Any]) -> list[Section]:
    """The report's part on them; none where all fit."""
    lines = "".join(f"<li>{escape(line)}</li>" for line in truth_lines(summary))
    note = "Errors of these agents, where no line says that they are right, say nothing before this is put right."
    return [Section("Ground truth that does not fit", note, f"<ul>{lines}</ul>")] if lines else []


def misfit_text(one: Mapping[str, Any]) -> str:
    """Both figures of ``TruthFigures`` that differ, and the likely cause; or what is wrong with rotations alone."""
    if one["fits"]:
        return f"the ground truth: {one['rotations']}: errors of positions are right, those of matches are not"
    over = f"over the same {one['frames']} frames"
    if one["metric"]:
        lengths = f"a path of {one['truth_m']:.4g} m, odometry's is {one['odometry_m']:.4g} m {over}"
    else:
        lengths = f"a path of another shape than odometry's {over}"
    return (
        f"the ground truth has {lengths} (ATE {one['rmse_m']:.3g} m, it spreads {one['spread_m']:.3g} m): "
        f"{one['cause']}"
    )
