"""Trajectories and ground truth as evo reads them: TUM and KITTI files."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from maslam.frontend.files.trajectory import NS_PER_S, Trajectory, write_kitti_poses, write_tum
from maslam.mas.evaluation.ground_truth import TRUTH_TOLERANCE_NS

from ..common.errors import ToolError
from ..common.progress import Progress
from ..common.text_table import counted
from ..report.run_data import AgentData, RunData
from .export_request import ExportRequest
from .units import METRES, agent_records, unit_of

_APART_NS = 10 * NS_PER_S
"""Between the agents of a team's file: each keeps its own time steps, and no two share a moment."""


def write_evo(
    folder: Path, data: RunData, members: Sequence[int], request: ExportRequest, tell: Progress
) -> tuple[list[str], dict[str, Any]]:
    """``agent_00.tum``, ``agent_00_truth.tum``, the same poses as KITTI rows; ``group_00.tum`` of agents that share a
    frame, one after the other, for one alignment of them all."""
    if not any(len(data.agents[a].estimate) for a in members):
        raise ToolError(f"{data.folder}: no frame has a place, so there is no trajectory to export")
    task, lines = tell.start("trajectories", len(members)), []
    for done, a in enumerate(members):
        agent = data.agents[a]
        scale = "" if unit_of(data, a) == METRES else "s"
        if len(agent.estimate):
            lines.append(_write_agent(folder, agent, scale))
        else:
            lines.append(f"left out: {agent.name}: no frame of it has a place")
        tell.advance(task, done + 1)
    for number, group in enumerate(data.groups):
        inside = [a for a in group if a in members and len(data.agents[a].estimate)]
        if len(inside) > 1:
            lines += _write_group(folder, f"group_{number:02d}", data, inside)
    return lines, {"agents": agent_records(data, members)}


def _write_agent(folder: Path, agent: AgentData, scale: str) -> str:
    write_tum(folder / f"{agent.name}.tum", agent.estimate)
    estimate, truth = paired(agent)
    write_kitti_poses(folder / f"{agent.name}_kitti.txt", (estimate if len(truth) else agent.estimate).poses)
    head = f"{{out}}/{agent.name}.tum: {counted(len(agent.estimate), 'pose')}"
    if agent.truth is None or not len(agent.truth):
        return f"{head}, no ground truth"
    write_tum(folder / f"{agent.name}_truth.tum", agent.truth)
    if not len(truth):
        return f"{head}, none with ground truth within {TRUTH_TOLERANCE_NS / 1e6:.0f} ms"
    write_kitti_poses(folder / f"{agent.name}_truth_kitti.txt", truth.poses)
    name = f"{{out}}/{agent.name}"
    return f"{head}, {len(truth)} with ground truth\n  evo_ape tum {name}_truth.tum {name}.tum -a{scale}"


def _write_group(folder: Path, name: str, data: RunData, inside: Sequence[int]) -> list[str]:
    """Agents one after the other in time, so that evo takes them for one trajectory; only poses with ground truth."""
    parts = [paired(data.agents[a]) for a in inside]
    parts = [part for part in parts if len(part[1])]
    if len(parts) < 2:
        return []
    files, start_ns = {"": [], "_truth": []}, 0  # type: dict[str, list[Trajectory]], int
    for estimate, truth in parts:
        by_ns = start_ns - int(estimate.stamps_ns[0])
        for ending, one in (("", estimate), ("_truth", truth)):
            files[ending].append(Trajectory(estimate.stamps_ns + by_ns, one.poses))
        start_ns += int(np.ptp(estimate.stamps_ns)) + _APART_NS
    for ending, several in files.items():
        stamps = np.concatenate([t.stamps_ns for t in several])
        write_tum(folder / f"{name}{ending}.tum", Trajectory(stamps, np.concatenate([t.poses for t in several])))
    names = ", ".join(data.agents[a].name for a in inside)
    scale = "" if unit_of(data, inside[0]) == METRES else "s"
    return [
        f"{{out}}/{name}.tum: {names}, which share a frame, one after the other on a clock of their own",
        f"  evo_ape tum {{out}}/{name}_truth.tum {{out}}/{name}.tum -a{scale}",
    ]


def paired(agent: AgentData) -> tuple[Trajectory, Trajectory]:
    """The poses that have a true one at their moment, and the true ones, each at its own time; none without truth."""
    estimate, truth = agent.estimate, agent.truth
    if truth is None:
        return _rows(estimate, np.zeros(len(estimate), dtype=bool)), _rows(
            estimate, np.zeros(len(estimate), dtype=bool)
        )
    at = truth.nearest(estimate.stamps_ns, TRUTH_TOLERANCE_NS)
    _, first = np.unique(at, return_index=True)  # a true pose serves one moment
    kept = np.zeros(len(at), dtype=bool)
    kept[first] = True
    kept &= at >= 0
    return _rows(estimate, kept), Trajectory(truth.stamps_ns[at[kept]], truth.poses[at[kept]])


def _rows(trajectory: Trajectory, kept: np.ndarray) -> Trajectory:
    return Trajectory(trajectory.stamps_ns[kept], trajectory.poses[kept])
