"""What ``maslam inspect --json`` prints: the report as plain values."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from maslam.frontend.cameras.description import UnderstoodCamera
    from maslam.frontend.datasets import Problem

    from .report import InspectReport, SequenceReport


def record(report: InspectReport) -> dict[str, Any]:
    """Numbers in the units that their names say; ``problems`` with their severity."""
    return {
        "path": str(report.path),
        "kind": report.kind,
        "frames": sum(sequence.frames for sequence in report.sequences),
        "errors": report.errors,
        "warnings": report.warnings,
        "problems": _problems(report.problems),
        "notes": list(report.notes),
        "sequences": [_sequence(sequence) for sequence in report.sequences],
    }


def _sequence(one: SequenceReport) -> dict[str, Any]:
    camera = one.rig.camera
    return {
        "name": one.name,
        "kind": one.kind,
        "origin": one.origin,
        "frames": one.frames,
        "missing": [asdict(missing) for missing in one.missing],
        "rate_hz": one.rate_hz,
        "duration_s": one.duration_s,
        "start_s": one.start_s,
        "rig": one.rig.kind.value,
        "scale": "metric" if one.rig.metric else "arbitrary",
        "baseline_m": one.rig.baseline_m,
        "camera": {
            "width": camera.width,
            "height": camera.height,
            "fx": camera.fx,
            "fy": camera.fy,
            "cx": camera.cx,
            "cy": camera.cy,
        },
        "calibration": [_understood(camera) for camera in one.understood],
        "stored_size": list(one.stored_size),
        "rectified_here": one.rectified_here,
        "groundtruth_poses": one.groundtruth_poses,
        "groundtruth_frames": one.groundtruth_frames,
        "path_length_m": one.path_length_m,
        "positions": one.positions,
        "decoded": one.decoded,
        "images": one.images,
        "rows": one.rows,
        "depth": one.depth,
        "focal": one.focal,
        "problems": _problems(one.problems),
        "notes": list(one.notes),
    }


def _understood(one: UnderstoodCamera) -> dict[str, Any]:
    c = one.camera
    return {
        "side": one.side,
        "model": c.distortion.value,
        "coefficients": one.coefficients,
        "fx": c.fx,
        "fy": c.fy,
        "cx": c.cx,
        "cy": c.cy,
        "size": None if c.size is None else list(c.size),
        "file": str(one.source),
        "format": one.form,
        "done": one.done,
        "sentence": one.sentence(),
    }


def _problems(problems: Sequence[Problem]) -> list[dict[str, str]]:
    return [{"severity": problem.severity.value, "message": problem.message} for problem in problems]
