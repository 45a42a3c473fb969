"""The omniscient reference of a run: what one server with all images, all verified matches and a robust central solver
reaches, and the bytes that takes. A policy is judged by its regret against it.

The server gets every key-frame whole, compares it with all key-frames of all agents by exact vectors, verifies every
candidate, keeps the matches that agree with each other, and solves one graph. It knows what the agents know together,
not the truth; only its errors are measured against that.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from maslam._atomic import write_atomically
from maslam.backend.central.optimise import optimise
from maslam.backend.central.similarity import optimise_similarity
from maslam.backend.components import parts
from maslam.backend.config import CentralConfig, SimilarityConfig
from maslam.backend.geometry import Sim3
from maslam.backend.pose_graph.graph import Edge, NodeId, PoseGraph, spread_poses
from maslam.mas.config import MasConfig
from maslam.mas.evaluation.ground_truth import GroundTruthEvaluator
from maslam.mas.manifest import Manifest
from maslam.mas.place_recognition.comparison import match_end, verify, view_of
from maslam.mas.place_recognition.own_loops import candidates_below
from maslam.mas.policies.presets import preset
from maslam.mas.protocol.ids import MatchId
from maslam.mas.sequence import AgentSequence, load_sequences
from maslam.mas.simulation import make_agents
from maslam.mas.state.agent_state import AgentState
from maslam.mas.state.keyframe import keyframes_of
from maslam.mas.state.place_match import Match
from maslam.mas.state.pose_graph import match_edge, odometry_edges
from maslam.mas.state.trajectories import frame_trajectory

from ..common.digests import code_digest, sequences_digest

FILE = "reference.json"
# Bytes of a key-frame sent to the server and back: a place vector of 256 float32, 12 + 32 bytes per map point as
# the published tables count, its pose; and the solved pose back.
_POSE_BYTES, _POINT_BYTES = 48, 44


@dataclass(frozen=True)
class Reference:
    """``made_from``: fingerprint of sequences and code; ``ate_rmse_m``: of each agent's trajectory under its own
    alignment, None without truth; ``groups``: agents that matches join; ``exploration_percent``: what each agent can
    know at most, given these groups; ``bytes``: key-frames to the server and poses back."""

    made_from: str
    ate_rmse_m: list[float | None]
    mean_ate_m: float | None
    groups: list[list[int]]
    exploration_percent: list[float]
    keyframes: int
    candidates: int
    matches: int
    false_matches: int | None
    bytes: int


def reference_of(folder: Path, progress: Callable[[int, int], None] = lambda done, total: None) -> Reference:
    """The reference of a SEQS folder, kept in it as ``reference.json`` and taken from there the next time."""
    path = folder / FILE
    made_from = f"{sequences_digest(folder)} {code_digest('mas', 'backend', 'tools/sweep/reference.py')}"
    if path.is_file():
        stored = json.loads(path.read_text(encoding="utf-8"))
        if stored.get("made_from") == made_from:
            return Reference(**stored)
    made = replace(make_reference(*load_sequences(folder), preset("maslam"), progress), made_from=made_from)
    write_atomically(path, json.dumps(asdict(made), indent=1) + "\n")
    return made


def make_reference(
    manifest: Manifest,
    sequences: Sequence[AgentSequence],
    config: MasConfig,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> Reference:
    """Solve everything at one place. ``config``: of verification, consistency and the graph's weights."""
    agents = make_agents(manifest, sequences, config)
    states = [agent.state for agent in agents]
    for state, sequence in zip(states, sequences, strict=True):
        for keyframe in keyframes_of(sequence):
            state.observe(keyframe)
    pairs = list(_candidates(states, config))
    for done, pair in enumerate(pairs, 1):
        _verify(states, pair)
        progress(done, len(pairs))
    matches = sorted({m.id: m for state in states for m in state.accepted_matches()}.items())
    accepted = [match for _, match in matches]
    groups = _groups(len(states), [match.id for match in accepted])
    _solve(states, accepted)
    evaluator = GroundTruthEvaluator(sequences, sum(entry.frames for entry in manifest.left_out))
    scaled = [_in_own_unit(group, sequences) for s in states for group in groups if s.me in group]
    errors = [
        evaluator.error_of(s.me, frame_trajectory(s, q), unit)
        for s, q, unit in zip(states, sequences, scaled, strict=True)
    ]
    rmse = [None if e is None else float(e.rmse_m) for e in errors]
    known = [e for e in rmse if e is not None]
    wrong = [evaluator.match_error(match, agents) for match in accepted]
    return Reference(
        made_from="",
        ate_rmse_m=rmse,
        mean_ate_m=float(np.mean(known)) if known else None,
        groups=groups,
        exploration_percent=_reachable(evaluator, groups),
        keyframes=sum(len(s.keyframes) for s in states),
        candidates=len(pairs),
        matches=len(accepted),
        false_matches=sum(e.false for e in wrong if e is not None) if any(e is not None for e in wrong) else None,
        bytes=_bytes(states, config),
    )


def _candidates(states: Sequence[AgentState], config: MasConfig) -> Iterator[MatchId]:
    """Each key-frame with the nearest one of every other agent and with its own nearest old one, where they are near
    enough; a pair of agents is asked in one direction only."""
    vectors = [np.array([k.vector for k in s.keyframes]) for s in states]
    usable = [np.array([k.textured for k in s.keyframes]) for s in states]
    for query, mine in enumerate(vectors):
        for match in range(query + 1):
            if not len(mine) or not len(vectors[match]):
                continue
            distances = np.sqrt(np.maximum(2.0 - 2.0 * mine @ vectors[match].T, 0.0))
            distances[~usable[query]] = np.inf
            distances[:, ~usable[match]] = np.inf
            if query == match:
                distances[_too_young(states[query])] = np.inf
            nearest = distances.argmin(axis=1)
            limit = states[query].profile.threshold
            for row in np.flatnonzero(distances[np.arange(len(mine)), nearest] < limit):
                yield MatchId(query, int(row), match, int(nearest[row]))


def _too_young(state: AgentState) -> NDArray[np.bool_]:
    """Pairs ``(n, n)`` of an agent's own key-frames that are no loop: the other one is not old enough."""
    newest = np.array([candidates_below(state, keyframe) for keyframe in state.keyframes])
    return np.arange(len(newest))[None, :] >= newest[:, None]


def _verify(states: Sequence[AgentState], pair: MatchId) -> None:
    """Verify a candidate; both owners learn a match."""
    asking, asked = states[pair.query_agent], states[pair.match_agent]
    query, match = asking.keyframes[pair.query], asked.keyframes[pair.match]
    if match.is_image(query.recording, query.stamp_ns):  # two agents were given one image: no evidence
        return
    verdict = verify(asked, pair, view_of(asking, query), match)
    if not verdict.accepted or verdict.T_M_Q is None or verdict.information is None:
        return
    ends = match_end(asking, query), match_end(asked, match)
    found = Match(pair, *ends, verdict.T_M_Q, verdict.information, verdict.inliers, match.depth)
    asked.add_match(found)
    if asking is not asked:
        asking.add_match(found)


def _in_own_unit(group: Sequence[int], sequences: Sequence[AgentSequence]) -> bool:
    return not any(sequences[agent].metric for agent in group)


def _solve(states: Sequence[AgentState], accepted: Sequence[Match]) -> None:
    """Poses and units of all states, from one graph."""
    edges: list[Edge] = []
    for state in states:
        for piece in state.pieces:
            edges += odometry_edges(state, piece.track)
    weights = states[0].config.optimisation
    edges += [match_edge(match, weights) for match in accepted]
    start = {NodeId(s.me, k): s.poses[k] for s in states for k in range(len(s.keyframes)) if not accepted}
    poses = spread_poses(start, edges)
    for state in states:
        for index, pose in enumerate(state.poses):
            poses.setdefault(NodeId(state.me, index), pose)
    graph = PoseGraph(poses, tuple(edges))
    metric = frozenset(s.me for s in states if s.profile.metric)
    found: dict[NodeId, Sim3] = {}
    if len(metric) == len(states):
        # One that no other match agrees with is left out already; the loss is for what agrees by chance.
        solved = optimise(
            graph,
            CentralConfig(
                cost="E",
                loss="cauchy",
                length_sigma=weights.solver.length_sigma,
                heading_sigma_deg=weights.solver.heading_sigma_deg,
            ),
        ).graph
        found = {n: Sim3.from_se3(T) for n, T in solved.poses.items()}
    else:
        found = dict(optimise_similarity(graph, SimilarityConfig(), metric).poses)
    for state in states:
        own = [found[NodeId(state.me, index)] for index in range(len(state.keyframes))]
        state.poses, state.units = [S.se3() for S in own], [S.scale for S in own]


def _groups(count: int, matches: Sequence[MatchId]) -> list[list[int]]:
    ends = np.array([m.agents for m in matches], dtype=int).reshape(-1, 2)
    label = parts(ends, count)
    return sorted([np.flatnonzero(label == k).tolist() for k in np.unique(label)])


def _reachable(evaluator: GroundTruthEvaluator, groups: Sequence[Sequence[int]]) -> list[float]:
    """Percent of all frames read that the members of an agent's group have tracked together."""
    shares = dict.fromkeys(range(len(evaluator.sequences)), 0.0)
    for group in groups:
        shares.update(dict.fromkeys(group, evaluator.share_seen_by(group)))
    return [shares[agent] for agent in sorted(shares)]


def _bytes(states: Sequence[AgentState], config: MasConfig) -> int:
    total = 0
    for state in states:
        for keyframe in state.keyframes:
            points = min(len(keyframe.points_C), config.places.max_points)
            total += 4 * len(keyframe.vector) + _POINT_BYTES * points + 2 * _POSE_BYTES
    return total
