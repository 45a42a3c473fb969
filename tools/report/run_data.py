"""A RUN folder read for its report: trajectories brought into the world's frame, tables as columns."""

from __future__ import annotations

import csv
import json
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from maslam.backend.geometry import Sim3
from maslam.backend.trajectory_error import trajectory_error
from maslam.frontend.files.trajectory import TRUTH_TOLERANCE_NS, Trajectory, read_tum
from maslam.mas.evaluation.ground_truth import MIN_POSES
from maslam.mas.manifest import Manifest, read_manifest
from maslam.mas.output.run_folder import later
from maslam.mas.sequence import GROUNDTRUTH, TRAJECTORY

from ..common.errors import ToolError
from .summary_table import read_summary, read_timing

Array = NDArray[np.float64]


@dataclass(frozen=True)
class AgentData:
    """One agent's results: ``estimate`` in its group's frame; ``copies``: key-frames of each map it holds. All times
    are the images' own, of which ``start_ns`` is the first; ``file_ns``: what they are later than in the files.
    """

    index: int
    name: str
    start_ns: int
    file_ns: int
    estimate: Trajectory
    truth: Trajectory | None
    copies: dict[int, Trajectory]


@dataclass(frozen=True)
class RunData:
    """Contents of a RUN folder that a report shows.

    ``config``: the text of ``config.yaml``; ``matches``, ``traffic``: rows of the CSV files by column; ``timeline``:
    columns ``(T,)``; ``optimised_s``: logical times of the optimisations, seconds.
    """

    folder: Path
    summary: dict[str, Any]
    timing: dict[str, Any]
    manifest: Manifest
    config: str
    agents: list[AgentData]
    matches: list[dict[str, str]]
    timeline: dict[str, Array]
    traffic: list[dict[str, str]]
    optimised_s: list[float]

    @property
    def has_truth(self) -> bool:
        """Whether the ground truth of any agent is known."""
        return any(agent.truth is not None for agent in self.agents)

    @property
    def groups(self) -> list[list[int]]:
        """Agents that share one frame at the end."""
        return [list(group) for group in self.summary["groups"]]

    @cached_property
    def T_world_agent(self) -> list[Sim3]:
        """From each agent's frame to the world: one alignment to the truth for each group, identity where none is
        known.
        """
        transforms = [Sim3.identity()] * len(self.agents)
        for group in self.groups:
            T = self.alignment([(i, self.agents[i].estimate) for i in group])
            for i in group:
                transforms[i] = T
        return transforms

    def is_aligned(self, agent: int) -> bool:
        """Whether the truth says where the agent's frame stands in the world."""
        return self._known[agent]

    @cached_property
    def _known(self) -> list[bool]:
        paired = [0] * len(self.agents)
        for agent in self.agents:
            if agent.truth is not None and len(agent.truth):
                rows = agent.truth.nearest(agent.estimate.stamps_ns, TRUTH_TOLERANCE_NS)
                paired[agent.index] = int((rows >= 0).sum())
        enough = {i: sum(paired[k] for k in group) >= MIN_POSES for group in self.groups for i in group}
        return [enough.get(agent.index, False) for agent in self.agents]

    def unit(self, agent: int) -> str:
        """The unit of length of the agent's positions in :attr:`in_world`: metres, where cameras or the truth give
        them; with one camera alone a unit of its own."""
        group = next(group for group in self.groups if agent in group)
        cameras = {self.manifest.agents[i].camera.kind for i in group}
        metric = self.manifest.scale == "metric" and cameras != {"mono"}
        return "metres" if metric or self.is_aligned(agent) else "arbitrary unit (one camera, no scale)"

    @cached_property
    def in_world(self) -> list[Array]:
        """Positions ``(N, 3)`` of each agent in the world, in its :meth:`unit`."""
        return [T @ agent.estimate.centres for T, agent in zip(self.T_world_agent, self.agents, strict=True)]

    def alignment(self, pieces: Sequence[tuple[int, Trajectory]]) -> Sim3:
        """The one transform that brings all ``pieces`` (an agent, a trajectory of its images) nearest to the truth."""
        estimates, truths = [np.zeros((0, 3))], [np.zeros((0, 3))]
        for index, trajectory in pieces:
            truth = self.agents[index].truth
            if truth is not None and len(truth):
                rows = truth.nearest(trajectory.stamps_ns, TRUTH_TOLERANCE_NS)
                estimates.append(trajectory.centres[rows >= 0])
                truths.append(truth.centres[rows[rows >= 0]])
        estimate, truth_xyz = np.concatenate(estimates), np.concatenate(truths)
        if len(estimate) < MIN_POSES:
            return Sim3.identity()
        # Agents that share coordinates with a metric one are in metres with it.
        metric = any(self.manifest.agents[index].metric for index, _ in pieces)
        return trajectory_error(estimate, truth_xyz, with_scale=not metric).T_truth_estimate

    def position_at(self, agent: int, stamp_ns: int) -> Array | None:
        """Position ``(3,)`` in the world of ``agent`` at ``stamp_ns`` on the source's clock; None without a pose within
        half a second."""
        estimate = self.agents[agent].estimate
        row = int(estimate.nearest(np.array([stamp_ns]), 500_000_000)[0])
        return None if row < 0 else self.in_world[agent][row]

    @cached_property
    def accepted(self) -> list[dict[str, str]]:
        """The rows of ``matches.csv`` that were used."""
        return [row for row in self.matches if row["outcome"] == "accepted"]

    def traffic_matrix(self) -> NDArray[np.int64]:
        """Bytes sent from each agent (row) to each (column)."""
        matrix = np.zeros((len(self.agents), len(self.agents)), dtype=np.int64)
        for row in self.traffic:
            matrix[int(row["sender"]), int(row["recipient"])] += int(row["wire_bytes"])
        return matrix


def read_run(folder: Path) -> RunData:
    """Read a finished run; what is missing or broken is an error that names the file."""
    summary = read_summary(folder)
    try:
        manifest = read_manifest(folder)
        starts_ns = [entry.start_ns for entry in manifest.agents]
        own = summary.get("times", "agent") == "agent"
        agents = [_read_agent(folder, i, start_ns, start_ns if own else 0) for i, start_ns in enumerate(starts_ns)]
        timeline = _read_csv(folder / "timeline.csv")
        return RunData(
            folder=folder,
            summary=summary,
            timing=read_timing(folder),
            manifest=manifest,
            config=(folder / "config.yaml").read_text(encoding="utf-8"),
            agents=agents,
            matches=[_of_today(row) for row in _read_csv(folder / "matches.csv")],
            timeline={
                name: np.array([_number(row[name]) for row in timeline]) for name in (timeline[0] if timeline else [])
            },
            traffic=_read_csv(folder / "traffic.csv"),
            optimised_s=_optimised(folder / "events.jsonl"),
        )
    except (KeyError, ValueError) as error:
        raise ToolError(f"{folder}: not a run this version can report on ({type(error).__name__}: {error})") from error


def _read_agent(run: Path, index: int, start_ns: int, file_ns: int) -> AgentData:
    folder = run / f"agent_{index:02d}"
    copies = {
        int(path.stem.removeprefix("agent_")): read_tum(path) for path in sorted((folder / "maps").glob("agent_*.tum"))
    }
    truth = folder / GROUNDTRUTH
    return AgentData(
        index=index,
        name=folder.name,
        start_ns=start_ns,
        file_ns=file_ns,
        estimate=later(read_tum(folder / TRAJECTORY), file_ns),
        truth=later(read_tum(truth), file_ns) if truth.is_file() else None,
        copies=copies,
    )


def _read_csv(path: Path) -> list[dict[str, str]]:
    with open(path, encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def _of_today(match: dict[str, str]) -> dict[str, str]:
    """A row of ``matches.csv`` under today's column names; ``outcome`` was called ``fate`` in version 0.1."""
    return {{"fate": "outcome"}.get(name, name): value for name, value in match.items()}


def _number(text: str) -> float:
    return float(text) if text else float("nan")


def _optimised(path: Path) -> list[float]:
    """Moments at which an optimisation ended, or what it had solved was updated, seconds, each once."""
    with open(path, encoding="utf-8") as file:
        events = [json.loads(line) for line in file]
    return sorted({float(event["time_s"]) for event in events if event["event"] in ("optimised", "updated")})
