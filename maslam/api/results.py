"""What preprocessing and a run gave, read from their folders when it is asked for."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from pydantic import ValidationError

from maslam.backend.geometry import Sim3, rotation_from_quat_wxyz
from maslam.backend.pose_graph.g2o import read_g2o
from maslam.backend.pose_graph.graph import PoseGraph
from maslam.frontend.files.trajectory import Trajectory, read_tum
from maslam.mas.config import MasConfig
from maslam.mas.evaluation.summary import Coverage, Summary, Timing
from maslam.mas.manifest import AgentEntry, Manifest, read_manifest
from maslam.mas.output.run_folder import later
from maslam.mas.policies.presets import preset
from maslam.mas.sequence import AgentSequence, load_sequences
from maslam.tools.common.errors import ToolError
from maslam.tools.common.options import read_settings
from maslam.tools.report.run_data import RunData, read_run
from maslam.tools.report.summary_table import SUMMARY, TIMING, read_summary, read_timing

from .common import PathLike, changed

_MEASURED = tuple(Timing.model_fields)
"""Of a run of version 0.1 in its summary."""


@dataclass(frozen=True)
class Sequences:
    """A folder of agent sequences, what ``maslam.preprocess`` made of images.

    ``folder``: the five VO files, place vectors and trajectories of each agent; ``manifest``: what was read and set.
    """

    folder: Path
    manifest: Manifest

    @classmethod
    def load(cls, folder: PathLike) -> Sequences:
        """The folder of an earlier preprocessing. ``MaslamError`` where it is none, or was not finished."""
        return cls(Path(folder), read_manifest(Path(folder)))

    @property
    def agents(self) -> tuple[AgentEntry, ...]:
        """Of each agent: name, source sequence, frames, key-frames, camera, where it was lost."""
        return self.manifest.agents

    @property
    def problems(self) -> tuple[str, ...]:
        """What was wrong with the images, a line each; none of it kept the rest from being used."""
        return tuple(str(line) for line in self.manifest.settings.get("problems", ()))

    @property
    def metric(self) -> bool:
        """Whether all agents' lengths are metres; with one camera each track has a unit of its own."""
        return all(agent.metric for agent in self.manifest.agents)

    def read(self) -> list[AgentSequence]:
        """Tracks, place vectors and trajectory of each agent, all in memory."""
        return load_sequences(self.folder)[1]


@dataclass(frozen=True)
class MatchResult:
    """A candidate place match: key-frame ``query`` of agent ``query_agent`` beside key-frame ``match`` of
    ``match_agent``.

    ``time_s``: when it was found, logical time; ``distance``: of the place vectors, 0 to 2, None where nobody compared
    them; ``outcome``: ``accepted``,
    ``rejected`` (checked and failed) or ``skipped`` (not checked), and ``reason`` why; ``same_image``: both key-frames
    are of one and the same image, which is no evidence; ``wider``: beyond the strict distance, while the two were not
    in one frame; ``T_M_Q``: query camera to match camera, None
    where it was not verified; ``error_m`` and ``false`` (an accepted one is wrong) against ground truth, None without.
    """

    time_s: float
    query_agent: int
    query: int
    match_agent: int
    match: int
    distance: float | None
    outcome: str
    reason: str
    T_M_Q: Sim3 | None
    error_m: float | None
    false: bool | None
    same_image: bool = False
    wider: bool = False

    @property
    def accepted(self) -> bool:
        """Whether the agents use it."""
        return self.outcome == "accepted"


@dataclass(frozen=True)
class AgentResult:
    """What one agent ended with. Trajectories are ``T_W_C`` (camera to world; +X right, +Y down, +Z forward), at the
    images' times, nanoseconds; W is common to all agents of a group (``Run.summary.groups``).

    ``trajectory``: every frame that has a place in W; ``truth``: in the frame of the ground truth, None without;
    ``coverage``: how many frames were read, tracked, placed, and which were lost why; None of a run before 0.3.
    """

    folder: Path
    index: int
    trajectory: Trajectory
    truth: Trajectory | None
    coverage: Coverage | None = None
    file_ns: int = 0
    """What the times are later than in the agent's files: those may count from its own start."""

    @property
    def name(self) -> str:
        """``agent_00``, …"""
        return self.folder.name

    @cached_property
    def keyframes(self) -> Trajectory:
        """Key-frames only."""
        return later(read_tum(self.folder / "trajectory_keyframes.tum"), self.file_ns)

    @cached_property
    def graph(self) -> PoseGraph:
        """The agent's pose graph: own key-frames, odometry, matches. ``MaslamError`` where it has none."""
        return read_g2o(self.folder / "graph.g2o")

    @property
    def map_file(self) -> Path:
        """Its map and the maps that it bought, as one point cloud (PLY)."""
        return self.folder / "map.ply"


@dataclass(frozen=True)
class Run:
    """A finished run of the multi-agent system: its ``folder``, and what stands in it as values."""

    folder: Path
    summary: Summary

    @classmethod
    def load(cls, folder: PathLike) -> Run:
        """The folder of an earlier run. ``MaslamError`` where it is none, or was not finished."""
        folder = Path(folder)
        figures = {name: value for name, value in read_summary(folder).items() if name not in _MEASURED}
        try:
            return cls(folder, Summary.model_validate(figures))
        except ValidationError as error:
            raise _foreign(folder / SUMMARY, error) from None

    @cached_property
    def timing(self) -> Timing:
        """What it took on this machine."""
        figures = read_timing(self.folder)
        try:
            return Timing.model_validate({name: figures.get(name) for name in _MEASURED})
        except ValidationError as error:
            raise _foreign(self.folder / TIMING, error) from None

    @cached_property
    def config(self) -> MasConfig:
        """Everything that was set; ``maslam.run(..., preset=run.config)`` repeats it."""
        path = self.folder / "config.yaml"
        content = read_settings(path)
        return changed(preset(str(content.get("preset"))), content, path)

    @property
    def manifest(self) -> Manifest:
        """What was run: source, agents, cameras, scale."""
        return self._data.manifest

    @cached_property
    def agents(self) -> tuple[AgentResult, ...]:
        """What each agent ended with."""
        coverage: list[Coverage | None] = [*self.summary.coverage] or [None] * len(self._data.agents)
        return tuple(
            AgentResult(self.folder / agent.name, agent.index, agent.estimate, agent.truth, covered, agent.file_ns)
            for agent, covered in zip(self._data.agents, coverage, strict=True)
        )

    @property
    def trajectories(self) -> tuple[Trajectory, ...]:
        """Of each agent, every frame that has a place: see :class:`AgentResult`."""
        return tuple(agent.trajectory for agent in self.agents)

    @property
    def positions_in_truth(self) -> tuple[NDArray[np.float64], ...]:
        """Of each agent ``(N, 3)``, metres: its trajectory laid on the ground truth, each group by one alignment
        (SE(3), with one camera Sim(3)); without ground truth as in its own frame, in that frame's unit."""
        return tuple(self._data.in_world)

    @cached_property
    def matches(self) -> tuple[MatchResult, ...]:
        """Every candidate place match and what became of it."""
        return tuple(_match(row) for row in self._data.matches)

    @property
    def timeline(self) -> dict[str, NDArray[np.float64]]:
        """Columns of ``timeline.csv``, a value for each step: ``time_s``, ``accepted_matches``, ``dvpr_wire_bytes``,
        ``ate_rmse_m_agent_00``, …; NaN where there is none."""
        return self._data.timeline

    @property
    def report(self) -> Path | None:
        """The page that ``maslam slam`` or ``maslam report`` made, None without."""
        page = self.folder / "report" / "index.html"
        return page if page.is_file() else None

    @cached_property
    def _data(self) -> RunData:
        return read_run(self.folder)


def _foreign(path: Path, error: ValidationError) -> ToolError:
    first = error.errors()[0]
    where = ".".join(str(part) for part in first["loc"])
    return ToolError(f"{path}: not of this version: {where}: {first['msg'].lower()}")


def _match(row: dict[str, str]) -> MatchResult:
    return MatchResult(
        time_s=float(row["time_s"]),
        query_agent=int(row["query_agent"]),
        query=int(row["query_keyframe"]),
        match_agent=int(row["match_agent"]),
        match=int(row["match_keyframe"]),
        distance=float(row["distance"]) if row["distance"] else None,
        outcome=row["outcome"],
        reason=row["reason"],
        T_M_Q=_transform(row),
        error_m=float(row["error_m"]) if row["error_m"] else None,
        false=row["false"] == "1" if row["false"] else None,
        same_image=row.get("same_image") == "1",
        wider=row.get("wider") == "1",
    )


def _transform(row: dict[str, str]) -> Sim3 | None:
    if not row["scale"]:
        return None
    rotation = rotation_from_quat_wxyz([float(row[name]) for name in ("qw", "qx", "qy", "qz")])
    return Sim3(rotation, np.array([float(row[name]) for name in ("tx", "ty", "tz")]), float(row["scale"]))
