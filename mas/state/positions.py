"""Positions measured from outside (GPS): priors of an agent's key-frames, and what they tell of odometry's lengths."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from maslam.backend.distributed.methods import USE_PRIORS
from maslam.backend.geometry import Array, se3
from maslam.backend.pose_graph.graph import Edge, NodeId, Prior

from ..config import OptimisationConfig
from .agent_state import AgentState, stretched

# Fewer positions do not tell odometry's length.
_FEW_FIXES, _LEAST_FIXES = 12, 3
# 1 sigma of the log of odometry's length factor; independent pairs of positions a quarter of a track apart.
_LENGTH_PRIOR, _QUARTERS = 0.02, 3
# Largest log of a length factor learned from others; a change that is worth another optimisation; and how many are.
_MOST_LENGTH, _SETTLED_LENGTH, _LENGTH_CHANGES = 0.06, 0.001, 30


def knows_positions(config: OptimisationConfig) -> bool:
    """Whether the solver that is set uses positions."""
    return config.solver.method in USE_PRIORS and config.positions


def not_used(config: OptimisationConfig, with_positions: bool) -> list[str]:
    """What the solver that is set leaves aside of what was asked for, in a sentence each; ``with_positions``: of which
    agents have any."""
    solver, out = config.solver, []
    if with_positions and solver.method not in USE_PRIORS:
        known = ", ".join(USE_PRIORS)
        out.append(
            f"positions (GPS) are not used: method {solver.method} knows none; optimisation.solver.method {known} do"
        )
    if solver.length_sigma > 0 and (solver.method != "elected" or solver.robust != "none"):
        beside = "" if solver.robust == "none" else f" with robust {solver.robust}"
        out.append(
            "optimisation.solver.length_sigma is not used: lengths of odometry are found by method elected without "
            f"robust selection, not by {solver.method}{beside}"
        )
    return out


def uses_positions(state: AgentState) -> bool:
    """Whether the agent has enough positions for its solver to use."""
    return knows_positions(state.config.optimisation) and sum(len(k.fixes) for k in state.keyframes) >= _LEAST_FIXES


def position_priors(state: AgentState, track: int) -> list[Prior]:
    """The fixes of a track's key-frames, where the solver knows what to do with them."""
    config = state.config.optimisation
    if not knows_positions(config):
        return []
    return [
        Prior(
            NodeId(state.me, index),
            se3(np.eye(3), fix.enu),
            np.diag([*(1.0 / fix.sigma**2), 0.0, 0.0, 0.0]),
            lever=fix.lever,
            bound=config.position_bound,
        )
        for index in state.members(track)
        for fix in state.keyframes[index].fixes
    ]


def within_fixes(state: AgentState, edges: list[Edge], track: int) -> list[Edge]:
    """Odometry's edges with the length that the positions of their track give them. A wrong baseline makes every step
    too long or too short by one share, which errors that differ from step to step do not explain."""
    fixes = [(i, fix) for i in state.members(track) for fix in state.keyframes[i].fixes]
    if not edges or len(fixes) < _FEW_FIXES or not position_priors(state, track) or not state.profile.metric:
        factor = state.lengths.get(track, 1.0)
        return [replace(e, T_i_j=stretched(e.T_i_j, factor)) for e in edges] if factor != 1.0 else edges
    T = np.array([state.keyframes[i].T_T_C for i, _ in fixes])
    points = np.einsum("nij,nj->ni", T[:, :3, :3], np.array([fix.lever for _, fix in fixes])) + T[:, :3, 3]
    factor, doubt = _length_factor(points, np.array([f.enu for _, f in fixes]), np.array([f.sigma for _, f in fixes]))
    if doubt > 0.5 * _LENGTH_PRIOR:
        return edges
    share = state.config.optimisation.odometry_sigma_share
    believed = (share / np.hypot(share, doubt)) ** 2
    out = []
    for edge in edges:
        information = edge.information.copy()
        information[:3, :3] *= believed
        out.append(replace(edge, T_i_j=stretched(edge.T_i_j, factor), information=information))
    return out


def learn_length(state: AgentState, track: int) -> None:
    """Where an optimisation with others' positions leaves a track longer or shorter than odometry had it, the next one
    believes it so. Each takes a share of the way, as all members' odometries pull at each other."""
    members = list(state.members(track))
    apart = max(len(members) // 4, 1)
    if len(members) < 4 * _FEW_FIXES or any(state.keyframes[i].fixes for i in members):
        return
    raw = np.array([state.keyframes[i].T_T_C[:3, 3] for i in members])
    now = np.array([state.poses[i][:3, 3] for i in members])
    own = np.linalg.norm(raw[apart:] - raw[:-apart], axis=1)
    found = np.linalg.norm(now[apart:] - now[:-apart], axis=1)
    far = (own > 0.1 * own.max(initial=0.0)) & (found > 0)
    if not far.any():
        return
    log_length = float(np.clip(np.median(np.log(found[far] / own[far])), -_MOST_LENGTH, _MOST_LENGTH))
    changed = abs(log_length - np.log(state.lengths.get(track, 1.0))) > _SETTLED_LENGTH
    state.note_length(track, float(np.exp(log_length)), changed, _LENGTH_CHANGES)


def _length_factor(points: Array, enu: Array, sigma: Array) -> tuple[float, float]:
    """What odometry's lengths are to be multiplied by, and the standard deviation of its logarithm.

    From displacements between pairs a quarter of the track apart, their median, so that single positions that are off
    do not matter; odometry itself is expected to be right within a few percent.
    """
    apart = max(len(points) // 4, 1)
    own = np.linalg.norm(points[apart:] - points[:-apart], axis=1)
    seen = np.linalg.norm(enu[apart:] - enu[:-apart], axis=1)
    noise = float(np.sqrt(2.0) * np.median(sigma))
    far = (own > 10.0 * noise) & (seen > 0)
    if 2 * far.sum() < len(own):
        return 1.0, np.inf
    bias = float(np.median(np.log(seen[far] / own[far])))
    doubt = noise / float(np.median(own[far])) / np.sqrt(_QUARTERS)
    kept = _LENGTH_PRIOR**2 / (_LENGTH_PRIOR**2 + doubt**2)
    return float(np.exp(kept * bias)), float(doubt * np.sqrt(kept))
