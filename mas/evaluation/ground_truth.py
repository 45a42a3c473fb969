"""The ground-truth evaluator: errors of thesis Table 3.2. No agent ever sees any of this."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from maslam.backend.geometry import Array, rotation_angle_deg, se3_inverse
from maslam.backend.trajectory_error import TrajectoryError, connected_error, path_length, trajectory_error
from maslam.frontend.files.trajectory import TRUTH_TOLERANCE_NS, Trajectory

from ..agent import Agent
from ..map_exchange.map_copy import MapCopy
from ..protocol.ids import MatchId
from ..sequence import AgentSequence
from ..state.agent_state import AgentState
from ..state.keyframe import KeyFrame
from ..state.place_match import Match
from ..state.trajectories import frame_trajectory, keyframe_trajectory
from .coverage import FrameName, frame_names, frames_held, frames_read

# Placed frames so many of their usual intervals apart are not on one stretch of the path.
_GAP = 1.5
# Fewer poses than this align perfectly whatever they are.
MIN_POSES = 3

# Under a similarity any trajectory fits a truth that stands still: a scale of 0 and no error.
STANDS_M = 1e-3

# An accepted match is false if its position is off by more than a fifth of the match's median depth (2 m at most,
# where the scene is farther than 10 m) plus 5 % of the cameras' distance, or its rotation by more than 10 degrees.
# RelPose errs by about a hundredth of the depth; a look-alike place is off by a room or a house.
FALSE_M = 2.0
FALSE_DEPTH_SHARE = 0.2
FALSE_SHARE = 0.05
FALSE_DEG = 10.0
# Key-frames before and after one that tell its unit of length.
_AROUND = 10


@dataclass(frozen=True)
class MatchError:
    """Error of an estimated ``T_M_Q`` against ground truth."""

    metres: float
    degrees: float
    allowed_m: float

    @property
    def false(self) -> bool:
        """Whether the match is another place: farther or more turned than a true match can be."""
        return self.metres > self.allowed_m or self.degrees > FALSE_DEG


@dataclass(frozen=True, eq=False)
class _Positions:
    """Positions ``(n, 3)`` at the same times: ``estimate``, in its own coordinates, and ``truth``, metres."""

    estimate: Array
    truth: Array

    def __len__(self) -> int:
        return len(self.estimate)


@dataclass(frozen=True, eq=False)
class _OwnPositions:
    """What was paired last of an agent's own key-frames: while ``state`` and ``version`` are the same, so is this."""

    state: AgentState
    version: int
    paired: _Positions | None


@dataclass(frozen=True, eq=False)
class _CopyPositions:
    """The same of a map copy."""

    copy: MapCopy
    paired: _Positions | None


class GroundTruthEvaluator:
    """Compares agents with the truth, as far as their sequences have one."""

    def __init__(self, sequences: Sequence[AgentSequence], left_out: int = 0) -> None:
        """``left_out``: frames of sequences from which no agent was made."""
        self.sequences = list(sequences)
        self.read = frames_read(sequences) + left_out
        self._scales: dict[tuple[int, int], float | None] = {}
        self._own_pairs: dict[int, _OwnPositions] = {}
        self._copy_pairs: dict[tuple[int, int], _CopyPositions] = {}  # by holder and owner

    def with_scale(self, agent: int) -> bool:
        """Whether lengths in coordinates that begin with a track of this agent are in a unit of their own, so that
        alignments are similarities."""
        return not self.sequences[agent].metric

    def placed_with_scale(self, state: AgentState) -> bool:
        """The same of the coordinates that the agent's estimates are in now."""
        return self.with_scale(state.frame.agent)

    # -- trajectories -------------------------------------------------------------------------------------------------

    def error_of(self, agent: int, trajectory: Trajectory, with_scale: bool | None = None) -> TrajectoryError | None:
        """ATE of a trajectory of this agent under its own alignment; None without enough truth. ``with_scale``: it is
        in a unit of its own; None: as the agent's odometry."""
        with_scale = self.with_scale(agent) if with_scale is None else with_scale
        return _error(self._paired(agent, trajectory.stamps_ns, trajectory.centres), with_scale)

    def keyframe_error(self, agent: Agent) -> TrajectoryError | None:
        """ATE of the agent's placed key-frames."""
        return _error(self._own_pair(agent), self.placed_with_scale(agent.state))

    def map_error(self, agent: Agent) -> TrajectoryError | None:
        """ATE of own key-frames and all map copies under one alignment."""
        known = self._map_pairs(agent)
        if sum(map(len, known.values())) < MIN_POSES:
            return None
        estimate = np.vstack([p.estimate for p in known.values()])
        truth = np.vstack([p.truth for p in known.values()])
        return _error(_Positions(estimate, truth), self.placed_with_scale(agent.state))

    def copy_errors(self, agent: Agent) -> dict[int, TrajectoryError]:
        """Each map copy's share of that, and the own key-frames'."""
        known = self._map_pairs(agent)
        if sum(map(len, known.values())) < MIN_POSES:
            return {}
        return _connected(known, self.placed_with_scale(agent.state))

    def connected_errors(self, agents: Sequence[Agent]) -> dict[int, TrajectoryError]:
        """Each agent's error under one alignment for all agents in the same coordinates."""
        out: dict[int, TrajectoryError] = {}
        for group in groups_of(agents):
            pairs = {a: self._own_pair(agents[a]) for a in group}
            known = {a: p for a, p in pairs.items() if p is not None and len(p)}
            if sum(map(len, known.values())) >= MIN_POSES:
                out.update(_connected(known, self.placed_with_scale(agents[group[0]].state)))
        return out

    def path_length_m(self, agent: Agent) -> float | None:
        """Length of the true path that the agent's placed frames cover, gaps between them left out; None without
        truth."""
        sequence = self.sequences[agent.state.me]
        truth, stamps = sequence.groundtruth, frame_trajectory(agent.state, sequence).stamps_ns
        if truth is None or len(truth) < 2:
            return None
        rows = np.unique(truth.nearest(stamps, TRUTH_TOLERANCE_NS))
        rows = rows[rows >= 0]
        if len(rows) < 2:
            return 0.0
        usual = float(np.median(np.diff(truth.stamps_ns[rows])))
        runs = np.split(rows, np.flatnonzero(np.diff(truth.stamps_ns[rows]) > _GAP * usual) + 1)
        return float(sum(path_length(truth.centres[run[0] : run[-1] + 1]) for run in runs if len(run) > 1))

    # -- exploration --------------------------------------------------------------------------------------------------

    def exploration_percent(self, agent: Agent) -> float:
        """Frames that have a place in the agent's own map or in a copy that it holds, over all frames read of all
        agents, each frame counted once, however many agents saw it."""
        own = self.sequences[agent.state.me]
        seen = frame_names(own, frame_trajectory(agent.state, own).stamps_ns)
        for owner, copy in sorted(agent.maps.copies.items()):
            seen |= frame_names(self.sequences[owner], frames_held(self.sequences[owner], copy.keyframes))
        return self._percent(seen)

    def share_seen_by(self, agents: Sequence[int]) -> float:
        """Percent of all frames read that these agents have tracked together, each counted once."""
        return self._percent(
            set().union(*(frame_names(s, s.trajectory.stamps_ns) for s in (self.sequences[a] for a in agents)))
        )

    def _percent(self, frames: set[FrameName]) -> float:
        return 100.0 * len(frames) / self.read if self.read else 0.0

    # -- matches ------------------------------------------------------------------------------------------------------

    def match_error(self, match: Match, agents: Sequence[Agent]) -> MatchError | None:
        """The match against the truth, None without; one of one camera is scaled as its track was around it."""
        i = match.id
        ends = ((i.match_agent, i.match), (i.query_agent, i.query))
        if any(k >= len(agents[a].state.keyframes) for a, k in ends):
            return None  # a claim about a key-frame that is not there
        poses = [self._true_pose(a, agents[a].state.keyframes[k].time_ns) for a, k in ends]
        if poses[0] is None or poses[1] is None:
            return None
        T_M_Q = se3_inverse(poses[0]) @ poses[1]
        metres = self._metres(agents[i.match_agent], i.match)
        if metres is None:
            return None
        estimate = match.T_M_Q.translation * metres
        apart = float(np.linalg.norm(estimate - T_M_Q[:3, 3]))
        angle = float(rotation_angle_deg(T_M_Q[:3, :3].T @ match.T_M_Q.rotation))
        allowed = min(FALSE_M, FALSE_DEPTH_SHARE * match.depth * metres) + FALSE_SHARE * float(
            np.linalg.norm(T_M_Q[:3, 3])
        )
        return MatchError(apart, angle, allowed)

    def _metres(self, agent: Agent, index: int) -> float | None:
        """Metres in a key-frame's own unit of length: with one camera each track has one, and it drifts; None where its
        track has too few key-frames around it to tell."""
        me = agent.state.me
        if self.sequences[me].metric:
            return 1.0
        if (me, index) not in self._scales:
            keyframes, track = agent.state.keyframes, agent.state.keyframes[index].track
            near = [k for k in keyframes[max(index - _AROUND, 0) : index + _AROUND + 1] if k.track == track]
            error = self.error_of(me, _trajectory_of(near))
            self._scales[me, index] = None if error is None else error.T_truth_estimate.scale
        return self._scales[me, index]

    # -- pairing ------------------------------------------------------------------------------------------------------

    def _map_pairs(self, agent: Agent) -> dict[int, _Positions]:
        """Own key-frames and map copies, by owner, as far as there is truth."""
        pairs = {agent.state.me: self._own_pair(agent)}
        for owner, copy in sorted(agent.maps.copies.items()):
            pairs[owner] = self._copy_pair(agent.state.me, copy)
        return {a: p for a, p in pairs.items() if p is not None and len(p)}

    def _own_pair(self, agent: Agent) -> _Positions | None:
        state = agent.state
        last = self._own_pairs.get(state.me)
        if last is None or last.state is not state or last.version != state.version:
            trajectory = keyframe_trajectory(state)
            paired = self._paired(state.me, trajectory.stamps_ns, trajectory.centres)
            last = self._own_pairs[state.me] = _OwnPositions(state, state.version, paired)
        return last.paired

    def _copy_pair(self, holder: int, copy: MapCopy) -> _Positions | None:
        last = self._copy_pairs.get((holder, copy.owner))
        if last is None or last.copy is not copy:
            paired = self._paired(copy.owner, self._times(copy), copy.poses[:, :3, 3])
            last = self._copy_pairs[holder, copy.owner] = _CopyPositions(copy, paired)
        return last.paired

    def _times(self, copy: MapCopy) -> NDArray[np.int64]:
        stamps: NDArray[np.int64] = copy.stamps_ns.astype(np.int64)
        return stamps - self.sequences[copy.owner].start_ns

    def _paired(self, agent: int, times_ns: NDArray[np.int64], centres: Array) -> _Positions | None:
        truth = self.sequences[agent].groundtruth
        if truth is None or not len(truth):
            return None
        rows = truth.nearest(times_ns, TRUTH_TOLERANCE_NS)
        known = rows >= 0
        return _Positions(centres[known], truth.centres[rows[known]])

    def _true_pose(self, agent: int, time_ns: int) -> Array | None:
        truth = self.sequences[agent].groundtruth
        if truth is None:
            return None
        row = int(truth.nearest(np.array([time_ns]), TRUTH_TOLERANCE_NS)[0])
        return None if row < 0 else truth.poses[row]


def _error(pair: _Positions | None, with_scale: bool) -> TrajectoryError | None:
    if pair is None or len(pair) < MIN_POSES or _stands(pair.truth, with_scale):
        return None
    return trajectory_error(pair.estimate, pair.truth, with_scale)


def _stands(truth: Array, with_scale: bool) -> bool:
    return with_scale and float(np.ptp(truth, axis=0).max()) < STANDS_M


def _connected(pairs: Mapping[int, _Positions], with_scale: bool) -> dict[int, TrajectoryError]:
    """The error of each under one alignment for all; nothing where that tells nothing."""
    if _stands(np.vstack([p.truth for p in pairs.values()]), with_scale):
        return {}
    estimates, truths = {a: p.estimate for a, p in pairs.items()}, {a: p.truth for a, p in pairs.items()}
    return connected_error(estimates, truths, with_scale)


def _trajectory_of(keyframes: Sequence[KeyFrame]) -> Trajectory:
    """Key-frames of one track as odometry left them."""
    stamps = np.array([k.time_ns for k in keyframes], dtype=np.int64)
    return Trajectory(stamps, np.array([k.T_T_C for k in keyframes]).reshape(-1, 4, 4))


def of_same_image(match: MatchId, agents: Sequence[Agent]) -> bool:
    """Whether both key-frames of a candidate are there, and were made from one and the same image."""
    queries, matches = agents[match.query_agent].state.keyframes, agents[match.match_agent].state.keyframes
    if match.query >= len(queries) or match.match >= len(matches):
        return False
    query = queries[match.query]
    return matches[match.match].is_image(query.recording, query.stamp_ns)


def groups_of(agents: Sequence[Agent]) -> list[list[int]]:
    """Agents whose reference frames are the same, sorted."""
    frames: dict[tuple[int, int], list[int]] = {}
    for agent in agents:
        frame = agent.state.frame
        frames.setdefault((frame.agent, frame.track), []).append(agent.state.me)
    return sorted(frames.values())
