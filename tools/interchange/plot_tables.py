"""All that the report plots, as CSV tables."""

from __future__ import annotations

import csv
import shutil
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from maslam.mas.evaluation.ground_truth import TRUTH_TOLERANCE_NS

from ..common.progress import Progress
from ..report.charts import OPERATIONS
from ..report.run_data import AgentData, RunData
from .export_request import ExportRequest
from .units import agent_records, unit_of

Rows = Iterable[Sequence[Any]]
_XYZ = ("x", "y", "z")


def write_tables(
    folder: Path, data: RunData, members: Sequence[int], request: ExportRequest, tell: Progress
) -> tuple[list[str], dict[str, Any]]:
    """One file a chart or table; positions as the report draws them, laid on the ground truth where it is known."""
    tables: dict[str, tuple[Sequence[str], Rows]] = {
        "trajectories.csv": (
            ["agent", "group", "unit", "on_truth", "stamp_ns", *_XYZ, "truth_x", "truth_y", "truth_z", "error"],
            (row for a in members for row in _trajectory(data, a)),
        ),
        "truth.csv": (["agent", "stamp_ns", *_XYZ], (row for a in members for row in _truth(data.agents[a]))),
        "map_copies.csv": (["holder", "owner", "stamp_ns", *_XYZ], (row for a in members for row in _copies(data, a))),
        "match_links.csv": (
            ["query_agent", "match_agent", *(f"{end}_{k}" for end in ("query", "match") for k in _XYZ)],
            _links(data, members),
        ),
        "errors.csv": (
            ["agent", "path_length_m", "odometry_rmse_m", "ate_rmse_m", "ate_mean_m", "maps_rmse_m", "connected_rmse_m",
             "exploration_percent"],
            (_errors(data.summary, data.agents[a]) for a in members),
        ),
        "bytes.csv": (["operation", "messages", "payload_bytes", "wire_bytes"], _bytes(data.summary)),
        "bytes_between_agents.csv": (["sender", "recipient", "wire_bytes"], _between(data, members)),
        "match_outcomes.csv": (["outcome", "reason", "count"], _outcomes(data.summary)),
        "optimised.csv": (["time_s"], ([moment] for moment in data.optimised_s)),
    }  # fmt: skip
    task = tell.start("tables", len(tables))
    for done, (name, (head, rows)) in enumerate(tables.items()):
        with open(folder / name, "w", newline="", encoding="utf-8") as file:
            table = csv.writer(file, lineterminator="\n")
            table.writerow(head)
            table.writerows([[_cell(value) for value in row] for row in rows])
        tell.advance(task, done + 1)
    for name in ("timeline.csv", "matches.csv", "traffic.csv"):
        shutil.copyfile(data.folder / name, folder / name)
    names = [*tables, "timeline.csv", "matches.csv", "traffic.csv"]
    return [f"{{out}}: {', '.join(names)}"], {"agents": agent_records(data, members), "tables": names}


def _cell(value: Any) -> Any:
    if value is None:
        return ""
    return f"{value:.9g}" if isinstance(value, float) else value


def _trajectory(data: RunData, a: int) -> Rows:
    """Each placed frame; the error to the true position where there is one, in metres."""
    agent, positions = data.agents[a], data.in_world[a]
    group = next(number for number, group in enumerate(data.groups) if a in group)
    laid, stamps = data.is_aligned(a), agent.estimate.stamps_ns
    unit = "metres" if laid else unit_of(data, a)
    at = np.full(len(stamps), -1) if agent.truth is None else agent.truth.nearest(stamps, TRUTH_TOLERANCE_NS)
    for k, stamp in enumerate(stamps.tolist()):
        head = [agent.name, group, unit, int(laid), stamp, *positions[k].tolist()]
        if agent.truth is None or at[k] < 0 or not laid:
            yield [*head, None, None, None, None]
        else:
            true = agent.truth.centres[at[k]]
            yield [*head, *true.tolist(), float(np.linalg.norm(positions[k] - true))]


def _truth(agent: AgentData) -> Rows:
    if agent.truth is not None:
        for stamp, centre in zip(agent.truth.stamps_ns.tolist(), agent.truth.centres.tolist(), strict=True):
            yield [agent.name, stamp, *centre]


def _copies(data: RunData, a: int) -> Rows:
    """The holder's own frames and the maps that it bought, laid together."""
    pieces = [(a, data.agents[a].estimate), *sorted(data.agents[a].copies.items())]
    T = data.alignment(pieces)
    for owner, one in pieces:
        for stamp, centre in zip(one.stamps_ns.tolist(), (T @ one.centres).tolist(), strict=True):
            yield [data.agents[a].name, data.agents[owner].name, stamp, *centre]


def _links(data: RunData, members: Sequence[int]) -> Rows:
    for row in data.accepted:
        agents = [int(row[f"{end}_agent"]) for end in ("query", "match")]
        if not set(agents) <= set(members):
            continue
        ends = [
            data.position_at(a, int(row[f"{end}_stamp_ns"])) for a, end in zip(agents, ("query", "match"), strict=True)
        ]
        if ends[0] is not None and ends[1] is not None:
            yield [*(data.agents[a].name for a in agents), *ends[0].tolist(), *ends[1].tolist()]


def _errors(s: dict[str, Any], agent: AgentData) -> Sequence[Any]:
    ate = s["ate_rmse_m"]
    before = [s["path_length_m"], s["odometry_rmse_m"]]
    columns = [
        *before,
        ate["agents"],
        s["ate_mean_m"]["agents"],
        ate["maps"],
        ate["connected"],
        s["exploration_percent"],
    ]
    return [agent.name, *(column[agent.index] for column in columns)]


def _bytes(s: dict[str, Any]) -> Rows:
    for name in (*OPERATIONS, "total"):
        one = s["traffic"][name]
        yield [name, one["messages"], one["payload_bytes"], one["wire_bytes"]]


def _between(data: RunData, members: Sequence[int]) -> Rows:
    matrix = data.traffic_matrix()
    for i in members:
        for k in members:
            if i != k:
                yield [data.agents[i].name, data.agents[k].name, int(matrix[i, k])]


def _outcomes(s: dict[str, Any]) -> Rows:
    yield ["accepted", "", s["matches"]["accepted"]]
    for outcome in ("rejected", "skipped"):
        for reason, count in s["matches"].get(outcome, {}).items():
            yield [outcome, reason, count]
