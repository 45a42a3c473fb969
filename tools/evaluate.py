"""``maslam eval``: the figures of a run (thesis Table 3.2) as a text table or as JSON."""

from __future__ import annotations

import argparse
import json
import math
from pathlib import Path
from typing import Any

from tools.errors import ToolError

SUMMARY = "summary.json"
OPERATIONS = {
    "dvpr": "DVPR data exchange",
    "relpose": "RelPose data exchange",
    "dopt": "decentralised optimisation",
    "mapmerge": "map-merge data exchange",
    "negotiation": "negotiation",
    "total": "total",
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """``RUN``."""
    parser.add_argument("run", metavar="RUN", type=Path, help="folder that `maslam run` or `maslam slam` made")
    parser.add_argument("--json", action="store_true", help="the figures as one JSON object")


def main(arguments: argparse.Namespace) -> None:
    """Print the figures."""
    summary = read_summary(arguments.run)
    print(json.dumps(summary, indent=2) if arguments.json else table(summary))


def read_summary(run: Path) -> dict[str, Any]:
    """``summary.json`` of a finished run."""
    path = run / SUMMARY
    if not path.is_file():
        raise ToolError(f"{run}: no {SUMMARY}: not the folder of a run, or the run did not finish")
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except json.JSONDecodeError as error:
        raise ToolError(f"{path}:{error.lineno}: not JSON: {error.msg}") from error
    if not isinstance(content, dict):
        raise ToolError(f"{path}: expected one object")
    return content


def table(summary: dict[str, Any]) -> str:
    """The figures of Table 3.2 in columns for people."""
    lines = [
        f"preset {summary['preset']}, seed {summary['seed']}, {summary['agents']} agents, {summary['keyframes']} key-frames"
    ]
    return "\n".join([*lines, "", *_errors(summary), "", *_traffic(summary), "", *_matches(summary)])


def _errors(summary: dict[str, Any]) -> list[str]:
    rmse, mean = summary.get("ate_rmse_m") or {}, summary.get("ate_mean_m") or {}
    explored = summary.get("exploration_percent") or []
    agents = max(len(rmse.get("agents") or []), len(explored))
    rows = [["", "ATE", "mean", "maps held", "connected", "explored"]]
    for i in range(agents):
        rows.append(
            [
                f"agent_{i:02d}",
                *(_metres(_at(*column, i)) for column in _columns(rmse, mean)),
                _percent(_at(explored, i)),
            ]
        )
    rows.append(
        [
            "mean",
            _metres(rmse.get("mean_agents")),
            _metres(mean.get("mean_agents")),
            _metres(rmse.get("mean_maps")),
            "",
            _percent(sum(explored) / len(explored) if explored else None),
        ]
    )
    return _aligned(rows)


def _columns(rmse: dict[str, Any], mean: dict[str, Any]) -> list[tuple[Any]]:
    return [(rmse.get("agents"),), (mean.get("agents"),), (rmse.get("maps"),), (rmse.get("connected"),)]


def _traffic(summary: dict[str, Any]) -> list[str]:
    traffic = summary["traffic"]
    rows = [["", "messages", "payload bytes", "wire bytes"]]
    for key, name in OPERATIONS.items():
        one = traffic.get(key, {})
        rows.append([name, *(f"{one.get(column, 0):,}" for column in ("messages", "payload_bytes", "wire_bytes"))])
    return _aligned(rows)


def _matches(summary: dict[str, Any]) -> list[str]:
    matches, solved = summary["matches"], summary["optimisations"]
    false = matches.get("false_accepted")
    rejected = ", ".join(f"{reason} {count}" for reason, count in sorted((matches.get("rejected") or {}).items()))
    return [
        f"matches        {matches['candidates']} candidates, {matches['verified']} verified, {matches['accepted']} accepted"
        + ("" if false is None else f", {false} of them false"),
        *([f"  rejected     {rejected}"] if rejected else []),
        f"optimisations  {solved['count']}, {solved['iterations']} iterations, "
        f"cost {solved['cost_before']:.4g} before, {solved['cost_after']:.4g} after",
        f"time           {summary['wall_s']:.1f} s, {summary['realtime_factor']:.2f} x real time",
    ]


def _at(values: Any, index: int) -> Any:
    return values[index] if isinstance(values, list) and index < len(values) else None


def _metres(value: float | None) -> str:
    return "-" if value is None or not math.isfinite(value) else f"{value:.3f} m"


def _percent(value: float | None) -> str:
    return "-" if value is None else f"{value:.1f} %"


def _aligned(rows: list[list[str]]) -> list[str]:
    widths = [max(len(row[i]) for row in rows) for i in range(len(rows[0]))]
    return [
        "  ".join(
            cell.ljust(w) if i == 0 else cell.rjust(w) for i, (cell, w) in enumerate(zip(row, widths, strict=True))
        )
        for row in rows
    ]
