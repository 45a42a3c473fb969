"""``maslam eval``: the figures of a run (thesis Table 3.2) as a text table or as JSON."""

from __future__ import annotations

import argparse
import json
import math
from pathlib import Path
from typing import Any

from maslam._bounded import Unreadable, read_text

from ..common.errors import ToolError
from ..common.text_table import aligned, counted
from .coverage_table import HEAD, coverage_rows, in_one_frame, lost_lines, percent_text
from .earlier_lines import earlier_lines
from .graph_warnings import graph_lines, odometry_lines
from .measured import keyframes_measured_on, measured_on, odometry_measured_on
from .position_lines import position_lines
from .truth_warnings import truth_lines
from .undecided_warnings import undecided_warnings

SUMMARY = "summary.json"
TIMING = "timing.json"
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
    print(json_of(arguments.run) if arguments.json else table_of(arguments.run))


def json_of(run: Path) -> str:
    """The figures of a finished run as one JSON object: its ``summary.json``."""
    return json.dumps(read_summary(run), indent=2)


def table_of(run: Path) -> str:
    """The figures of a finished run and its time, as text."""
    return table(read_summary(run), read_timing(run))


def read_summary(run: Path) -> dict[str, Any]:
    """``summary.json`` of a finished run; :class:`ToolError` where there is none, or where it is no JSON object."""
    if not run.exists():
        raise ToolError(f"{run}: no such folder")
    if not (run / SUMMARY).is_file():
        raise ToolError(f"{run}: no {SUMMARY}: not the folder of a run, or the run did not finish")
    return _object(run / SUMMARY)


def read_timing(run: Path) -> dict[str, Any]:
    """``wall_s`` and ``realtime_factor`` of a finished run: ``timing.json``; of a run of version 0.1 its summary."""
    return _object(run / TIMING) if (run / TIMING).is_file() else read_summary(run)


def _object(path: Path) -> dict[str, Any]:
    """One JSON object."""
    try:
        content = json.loads(read_text(path))
    except json.JSONDecodeError as error:
        raise ToolError(f"{path}:{error.lineno}: not JSON: {error.msg}") from error
    except (Unreadable, RecursionError) as error:
        raise ToolError(f"{path}: {error}") from error
    if not isinstance(content, dict):
        raise ToolError(f"{path}: expected one object")
    return content


def who_decided(summary: dict[str, Any]) -> str:
    """The preset, and the policy where it is another than the preset's own."""
    from maslam.mas.policies.presets import PRESETS

    policy, preset = summary.get("policy", ""), summary["preset"]
    own = not policy or (preset in PRESETS and PRESETS[preset].policy == policy)
    return f"preset {preset}" if own else f"preset {preset} with policy {policy}"


def table(summary: dict[str, Any], timing: dict[str, Any]) -> str:
    """The figures of Table 3.2 in columns for people."""
    agents, keyframes = counted(summary["agents"], "agent"), counted(summary["keyframes"], "key-frame")
    head = f"{who_decided(summary)}, seed {summary['seed']}, {agents}, {keyframes}"
    warnings = [*truth_lines(summary), *graph_lines(summary), *undecided_warnings(summary)]
    last = [
        *_matches(summary),
        *odometry_lines(summary),
        *position_lines(summary),
        *earlier_lines(summary),
        *warnings,
        _time(timing),
    ]
    parts = [[head], _errors(summary), _coverage(summary), _traffic(summary), last]
    return "\n\n".join("\n".join(part) for part in parts if part)


def _coverage(summary: dict[str, Any]) -> list[str]:
    """Frames read, tracked and placed of each agent, then what was lost and why."""
    rows = coverage_rows(summary)
    return aligned([["", *HEAD], *rows]) + lost_lines(summary) if rows else []


def _errors(summary: dict[str, Any]) -> list[str]:
    """One row per agent: RMSE and mean error of its trajectory, of the maps it holds, in the frame it shares; its
    exploration.
    """
    rmse, mean, exploration = summary["ate_rmse_m"], summary["ate_mean_m"], summary["exploration_percent"]
    metres = [
        summary["odometry_rmse_m"],
        rmse["agents"],
        mean["agents"],
        rmse["maps"],
        rmse["connected"],
        summary["path_length_m"],
    ]
    rows = [["", "odometry", "ATE", "ATE mean", "maps held", "connected", "path", "exploration"]]
    for i in range(summary["agents"]):
        rows.append([f"agent_{i:02d}", *(_metres(column[i]) for column in metres), _percent(exploration[i])])
    rows.append(["mean", *(_metres(_mean(column)) for column in metres), _percent(_mean(exploration))])
    together, of, without = in_one_frame(summary)
    apart = f"; without a place: {', '.join(without)}" if without else ""
    shared = [f"{together} of {of} agents share one frame{apart}"] if of > 1 else []
    known, unit = any(v is not None for v in rmse["agents"]), summary.get("scale") in ("arbitrary", "mixed")
    said = _measured(summary) if known and measured_on(summary) else []
    truth = [] if known else [f"{_why_unknown(summary)}: errors cannot be known"]
    whose = "agents with one camera alone" if summary.get("scale") == "mixed" else "one camera"
    own = [f"{whose}: lengths in their files are in units of their own, not metres"] if unit else []
    return [*aligned(rows), *shared, *said, *truth, *own]


def _measured(summary: dict[str, Any]) -> list[str]:
    """What each column of errors was measured on: ATE, odometry, the others."""
    odometry = odometry_measured_on(summary)
    others = [*([f"odometry {odometry}"] if odometry else []), *keyframes_measured_on(summary)]
    return [f"errors {measured_on(summary)}", *(f"  {line}" for line in others)]


def _traffic(summary: dict[str, Any]) -> list[str]:
    traffic = summary["traffic"]
    rows = [["", "messages", "payload bytes", "wire bytes"]]
    for key, name in OPERATIONS.items():
        one = traffic.get(key, {})
        rows.append([name, *(f"{one.get(column, 0):,}" for column in ("messages", "payload_bytes", "wire_bytes"))])
    return aligned(rows)


def _why_unknown(summary: dict[str, Any]) -> str:
    """Why there are no errors."""
    from maslam.mas.evaluation.ground_truth import STANDS_M

    lengths = [length for length in summary["path_length_m"] if length is not None]
    if not lengths:
        return "no ground truth"
    placed = any(one["placed"] for one in summary.get("coverage", []))
    if placed and max(lengths) < STANDS_M:
        return "by its ground truth the camera stands"
    return "no frame has both a place and a true one"


def _matches(summary: dict[str, Any]) -> list[str]:
    matches, solved = summary["matches"], summary["optimisations"]
    false = matches.get("false_accepted")
    others = {kind: _by_reason(matches.get(kind) or {}) for kind in ("rejected", "skipped")}
    counts = (
        f"{counted(matches['candidates'], 'candidate')}, {matches['verified']} verified, {matches['accepted']} accepted"
    )
    doubt = (
        "  all false      does the ground truth turn as the cameras do (the quaternion's order, inverse, other axes)?"
    )
    return [
        f"matches        {counts}" + ("" if false is None else f", {false} of them false"),
        *([doubt] if false and false == matches["accepted"] else []),
        *(f"  {kind:<13}{reasons}" for kind, reasons in others.items() if reasons),
        *_same_image(matches.get("same_image", 0)),
        *_wider(matches),
        f"optimisations  {solved['count']}, {solved['iterations']} iterations, "
        f"cost {solved['cost_before']:.4g} before, {solved['cost_after']:.4g} after"
        + _updates(solved.get("updates", 0)),
    ]


def _updates(count: int) -> str:
    """Said only where there are any."""
    return f"; {counted(count, 'update')} with later matches" if count else ""


def _same_image(count: int) -> list[str]:
    """Said only where it happens: agents of one recording that share images."""
    return (
        [f"  {'same image':<13}{counted(count, 'pair')} of one image seen by two agents, no evidence"] if count else []
    )


def _wider(matches: dict[str, Any]) -> list[str]:
    """Said only where it happens: candidates that only agents apart from each other look at."""
    count = matches.get("wider", 0)
    tried = f"{counted(count, 'pair')} beyond the strict distance verified, {matches.get('wider_accepted', 0)} accepted"
    if bytes_ := matches.get("wider_traffic", {}).get("wire_bytes"):
        tried += f", {bytes_:,} of the bytes"
    return [f"  {'wider search':<13}{tried}"] if count else []


def _by_reason(counts: dict[str, int]) -> str:
    return ", ".join(f"{reason} {count}" for reason, count in sorted(counts.items()))


def _time(timing: dict[str, Any]) -> str:
    return f"time           {timing['wall_s']:.1f} s, {timing['realtime_factor']:.2f} x real time"


def _mean(values: list[float | None]) -> float | None:
    known = [value for value in values if value is not None]
    return sum(known) / len(known) if known else None


def _metres(value: float | None) -> str:
    return "-" if value is None or not math.isfinite(value) else f"{value:.3f} m"


def _percent(value: float | None) -> str:
    return "-" if value is None else percent_text(value)


def why_text(row: dict[str, str]) -> str:
    """Why a match of ``matches.csv`` has its outcome: the reason, and its figures where they are more than that."""
    reason, figures = (
        word if word not in (row["outcome"], "accepted") else "" for word in (row["reason"], row["detail"])
    )
    if figures.startswith(reason):
        return figures
    return f"{reason}: {figures}" if figures else reason
