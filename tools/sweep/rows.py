"""From summaries to rows: one a run, and one for all seeds of a cell with mean and spread."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, fields
from typing import Any

import numpy as np

from .plan import Cell

_OPERATIONS = ("dvpr", "relpose", "dopt", "mapmerge", "negotiation", "total")


@dataclass(frozen=True)
class Figures:
    """Of one run: ``summary.json`` and ``timing.json``."""

    summary: dict[str, Any]
    timing: dict[str, Any]


@dataclass(frozen=True)
class Row:
    """One run. Errors in metres (means over the agents), MB = 10^6 bytes: ``payload_*`` as published, ``wire_*`` true;
    exploration in percent, and of what connectivity allows; ``reference_*``: the omniscient reference's;
    ``regret_ate``: error over its error, ``regret_bytes``: wire bytes over its bytes. Of map copies: map points per
    key-frame, and the median distance of their points from their owner's. Errors of agents are of ``frames_measured``
    of the frames read, after ``alignment``; ``graphs_fit``: no graph's cost is far above what noise costs. None without
    truth, reference, copies."""

    sequence: str
    agents: int
    preset: str
    seed: int
    keyframes: int
    ate_agents: float | None
    ate_maps: float | None
    odometry: float | None
    payload_dvpr: float
    payload_relpose: float
    payload_dopt: float
    payload_mapmerge: float
    payload_negotiation: float
    payload_total: float
    wire_dvpr: float
    wire_relpose: float
    wire_dopt: float
    wire_mapmerge: float
    wire_negotiation: float
    wire_total: float
    exploration: float
    exploration_of_possible: float | None
    accepted: int
    false_accepted: int | None
    largest_group: int
    points_per_keyframe: float | None
    points_off_m: float | None
    wall_s: float
    reference_ate: float | None
    reference_mb: float | None
    regret_ate: float | None
    regret_bytes: float | None
    frames_read: int | None
    frames_placed: int | None
    frames_measured: int | None
    alignment: str | None
    graphs_fit: bool | None


def row_of(cell: Cell, figures: Figures, reference: Mapping[str, Any] | None) -> Row:
    """A run beside its reference."""
    summary = figures.summary
    traffic = summary["traffic"]
    megabytes = {
        f"{short}_{operation}": traffic[operation][f"{short}_bytes"] / 1e6
        for short in ("payload", "wire")
        for operation in _OPERATIONS
    }
    ate, best = summary["ate_rmse_m"]["mean_agents"], reference["mean_ate_m"] if reference else None
    size = reference["bytes"] / 1e6 if reference else None
    exploration = summary["exploration_percent"]
    copies = summary["map_copies"]
    off = [copy["points_off_m"] for copy in copies if copy["points_off_m"] is not None]
    possible = reference["exploration_percent"] if reference else None
    return Row(
        sequence=cell.sequence,
        agents=cell.agents,
        preset=cell.preset,
        seed=cell.seed,
        keyframes=summary["keyframes"],
        ate_agents=ate,
        ate_maps=summary["ate_rmse_m"]["mean_maps"],
        odometry=summary["odometry_mean_rmse_m"],
        exploration=float(np.mean(exploration)),
        exploration_of_possible=100.0 * float(np.mean(np.divide(exploration, possible))) if possible else None,
        accepted=summary["matches"]["accepted"],
        false_accepted=summary["matches"]["false_accepted"],
        largest_group=max(len(group) for group in summary["groups"]),
        points_per_keyframe=sum(c["points"] for c in copies) / sum(c["keyframes"] for c in copies) if copies else None,
        points_off_m=float(np.median(off)) if off else None,
        wall_s=figures.timing["wall_s"],
        reference_ate=best,
        reference_mb=size,
        regret_ate=ate / best if ate is not None and best else None,
        regret_bytes=megabytes["wire_total"] / size if size else None,
        **_measured(summary),
        **megabytes,
    )


def _measured(summary: dict[str, Any]) -> dict[str, Any]:
    """What errors were measured on; None of a run before it was written."""
    coverage, left_out = summary.get("coverage") or [], summary.get("left_out") or []
    known = [a for a in (summary.get("alignments") or {}).get("agents") or [] if a is not None]
    graphs = summary.get("graphs") or []
    read = sum(c["read"] for c in coverage) + sum(one["frames"] for one in left_out)
    return {
        "frames_read": read if coverage else None,
        "frames_placed": sum(c["placed"] for c in coverage) if coverage else None,
        "frames_measured": sum(a["frames"] for a in known) if known else None,
        "alignment": " or ".join(sorted({a["kind"] for a in known})) or None,
        "graphs_fit": all(graph["fits"] for graph in graphs) if graphs else None,
    }


@dataclass(frozen=True)
class Spread:
    """Mean and half the range over the seeds."""

    mean: float
    half: float

    def text(self, digits: int = 2) -> str:
        """``3.14 ±0.05``; without a spread where there is none to see."""
        spread = f" ±{self.half:.{digits}f}" if self.half >= 0.5 * 10.0**-digits else ""
        return f"{self.mean:.{digits}f}{spread}"


@dataclass(frozen=True)
class Group:
    """All seeds of one sequence, number of agents and preset."""

    sequence: str
    agents: int
    preset: str
    rows: tuple[Row, ...]

    def __getitem__(self, name: str) -> Spread | None:
        """Of one column; None where a run has no value."""
        values = [getattr(row, name) for row in self.rows]
        if any(value is None for value in values):
            return None
        return Spread(float(np.mean(values)), float(np.ptp(values)) / 2)


def grouped(rows: Sequence[Row]) -> list[Group]:
    """In the order of the rows."""
    found: dict[tuple[str, int, str], list[Row]] = {}
    for row in rows:
        found.setdefault((row.sequence, row.agents, row.preset), []).append(row)
    return [Group(*key, tuple(members)) for key, members in found.items()]


def columns() -> list[str]:
    """Names of a row's figures, in order."""
    return [field.name for field in fields(Row)]


def as_record(row: Row) -> dict[str, Any]:
    """For JSON and CSV."""
    return asdict(row)
