"""A member's own judgement of a solution: whether its trajectory is still what its own odometry can have been.

The costs of a group are what its members say, and poses may come from one elected robot: both may be lies. What no
other agent can change are the member's own measurements. A solution corrects odometry, by a few percent of the way or,
where it is poor, by some tens; one that moves key-frames by more than their way from one to the next, or most of them
by a large share of it, is no correction. Who gets such a solution keeps its trajectory.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from maslam.backend.distributed.share import Share, SolverOutcome
from maslam.backend.geometry import Array, se3_inverse
from maslam.backend.pose_graph.graph import NodeId

from ..protocol.tasks import OptimiseTask
from ..state.agent_state import AgentState, stretched

# Steps of odometry that are looked at together: rounding and noise of single steps do not matter.
_WINDOW = 5
# A window may end so far off its odometry, as a share of its way, plus that of the median depth; and at the median of
# all windows.
_MOST, _MOST_MEDIAN = 1.0, 0.25
_DEPTH_SHARE = 0.25
# Likewise its turn, degrees.
_MOST_DEG, _MOST_MEDIAN_DEG = 60.0, 20.0

CLEARLY_WORSE = "own odometry says clearly otherwise"


def judged(state: AgentState, task: OptimiseTask, share: Share, outcome: SolverOutcome) -> SolverOutcome:
    """The outcome, or, where its poses are no correction of the agent's odometry, one that keeps those of ``share``."""
    if not outcome.accepted or not any(_impossible(state, track, outcome) for track in task.tracks):
        return outcome
    units = {n: share.units.get(n, 1.0) for n in share.poses}
    kept = {n: T.copy() for n, T in share.poses.items()}
    refused = replace(outcome, accepted=False, reason=CLEARLY_WORSE, poses=kept, units=units)
    return replace(refused, cost_after=outcome.cost_before, length=1.0)


def _impossible(state: AgentState, track: int, outcome: SolverOutcome) -> bool:
    """Whether the poses of a track are no correction of its odometry."""
    members = [i for i in state.members(track) if NodeId(state.me, i) in outcome.poses]
    if len(members) < 2:
        return False
    nodes = [NodeId(state.me, i) for i in members]
    found = np.array([outcome.poses[n] for n in nodes])
    raw = np.array([state.keyframes[i].T_T_C for i in members])
    off, turned = _off(raw, found, _units(nodes, outcome.units), np.array([state.keyframes[i].depth for i in members]))
    if off.max() > _MOST or turned.max() > _MOST_DEG:
        return True
    return bool(np.median(off) > _MOST_MEDIAN or np.median(turned) > _MOST_MEDIAN_DEG)


def _units(nodes: list[NodeId], units: Mapping[NodeId, float]) -> Array:
    return np.array([units.get(n, 1.0) for n in nodes])


def _off(raw: Array, found: Array, units: Array, depths: Array) -> tuple[Array, Array]:
    """By how much each window's displacement is off its odometry, as a share of what its way allows, and by how many
    degrees its turn: all in the odometry's unit at the window's first key-frame."""
    apart = min(_WINDOW, len(raw) - 1)
    way = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(raw[:, :3, 3], axis=0), axis=1))])
    moved = se3_inverse(raw[:-apart]) @ raw[apart:]
    now = stretched(se3_inverse(found[:-apart]) @ found[apart:], 1.0 / units[:-apart, None])
    allowed = way[apart:] - way[:-apart] + _DEPTH_SHARE * depths[:-apart]
    off = np.linalg.norm(now[:, :3, 3] - moved[:, :3, 3], axis=1) / allowed
    cosine = (np.einsum("nij,nij->n", now[:, :3, :3], moved[:, :3, :3]) - 1.0) / 2.0
    return off, np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0)))
