"""An agent's pose graph: what it brings into an optimisation, and how it takes the result over."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from maslam.backend.distributed.share import Share, SolverOutcome
from maslam.backend.geometry import Array, Sim3, se3_inverse
from maslam.backend.pose_graph.graph import Edge, EdgeKind, NodeId, PoseGraph, Prior

from ..config import OptimisationConfig
from ..errors import MasError
from ..protocol.ids import MatchId
from ..protocol.messages import LINK_DTYPE, Bid, Links, PieceTerms
from ..protocol.tasks import OptimiseTask
from ..protocol.tensors import MAX_SCALE, MAX_TRANSLATION, pack_sim3s, unpack_sim3s
from .agent_state import AgentState, Piece, stretched
from .place_match import Match
from .positions import learn_length, position_priors, within_fixes

# 1 sigma of the log scale of a match that says nothing about it.
_UNKNOWN_SCALE = 100.0
# By how much the scale between coordinates that are both in metres may differ from 1, by rounding.
_SAME_UNIT = 1e-6


class UnknownPart(MasError):
    """A task names a track, match or unit that the agent does not have."""


@dataclass(frozen=True, eq=False)
class Adoption:
    """Effect of an optimisation on the agent: key-frame poses before, ``T_F_C`` as Sim(3), and the matches it used;
    ``elsewhere``: those that it left for another one, because they join other tracks; ``borne_out``: False where the
    agent's own odometry says otherwise, so that it kept its poses."""

    before: dict[int, Sim3]
    matches: frozenset[MatchId]
    elsewhere: frozenset[MatchId] = frozenset()
    borne_out: bool = True


@dataclass(frozen=True, eq=False)
class UpdatedPoses:
    """Effect of an update on the agent: key-frame poses before, ``T_F_C`` as Sim(3)."""

    before: dict[int, Sim3]


def terms(state: AgentState, now_ns: int, peer: int | None = None) -> Bid:
    """A bid for an optimisation: the agent's tracks and its accepted matches with the key-frames' present poses;
    peer-to-peer those with ``peer`` only, beside its own loops."""
    around = {state.me, peer} if peer is not None else None
    matches = [m for m in sorted(state.accepted) if around is None or around.issuperset(m.agents)]
    return Bid(
        cost_bytes=0,
        ready_ns=now_ns,
        links=_links(state, matches),
        pieces=tuple(
            PieceTerms(p.track, p.frame, state.profile.metric, p.metric, bool(position_priors(state, p.track)))
            for p in state.pieces
        ),
        peer_to_peer=peer is not None,
    )


def _links(state: AgentState, matches: list[MatchId]) -> Links:
    """Both ends of own loops, the own end of all others."""
    rows: list[tuple[MatchId, int, bool]] = []
    for m in matches:
        ends = ((m.match_agent, m.match, False), (m.query_agent, m.query, True))
        rows += [(m, index, query) for agent, index, query in ends if agent == state.me]
    pieces = [state.piece_of(index) for _, index, _ in rows]
    return Links(
        matches=tuple(m for m, _, _ in rows),
        tracks=tuple(p.track for p in pieces),
        frames=tuple(p.frame for p in pieces),
        query=tuple(query for _, _, query in rows),
        poses=pack_sim3s([state.pose(index) for _, index, _ in rows], LINK_DTYPE),
        transforms=pack_sim3s([state.verified[m].T_M_Q for m, _, query in rows if query], LINK_DTYPE),
    )


def share_of(state: AgentState, task: OptimiseTask) -> Share:
    """The agent's part of the group's graph, in the task's coordinates; :class:`UnknownPart` if the task names what it
    does not have."""
    if (state.me in task.arbitrary) == state.profile.metric:
        raise UnknownPart("a unit of its own, where it has the metre, or the other way round")
    strange = set(task.tracks) - {p.track for p in state.pieces}
    if strange:
        raise UnknownPart(f"a track it does not have: {min(strange)}")
    if len(set(task.tracks)) != len(task.tracks) or len(set(task.matches)) != len(task.matches):
        raise UnknownPart("a track or match that is named twice")
    placed = dict(zip(task.present, unpack_sim3s(task.placements), strict=True))
    if state.profile.metric and any(abs(T.scale - 1.0) > _SAME_UNIT for T in placed.values()):
        raise UnknownPart("coordinates in another unit than the metre, which this agent has")
    poses: dict[NodeId, Array] = {}
    units: dict[NodeId, float] = {}
    edges: list[Edge] = []
    priors: list[Prior] = []
    for track in task.tracks:
        T_F_present = placed.get(state.piece(track).frame, Sim3.identity())
        for index in state.members(track):
            poses[NodeId(state.me, index)] = T_F_present.transform_poses(state.poses[index])
            if not state.profile.metric:
                units[NodeId(state.me, index)] = T_F_present.scale * state.units[index]
        edges += within_fixes(state, odometry_edges(state, track), track)
        # Of what came since the bid the others know nothing.
        priors += position_priors(state, track) if task.positions else []
    missing = [m for m in task.matches if m not in state.verified]
    if missing:
        raise UnknownPart(f"a match it does not know: {missing[0]}")
    edges += [match_edge(state.verified[m], state.config.optimisation) for m in task.matches]
    solver = state.config.optimisation.solver
    known = solver.method == "elected" and solver.robust == "none"
    return Share(
        robot=state.me,
        members=task.members,
        poses=poses,
        edges=tuple(edges),
        units=units,
        arbitrary_scale=frozenset(task.arbitrary),
        priors=tuple(priors),
        positions=task.positions,
        length_sigma=solver.length_sigma if known else 0.0,
        heading_sigma=float(np.radians(solver.heading_sigma_deg)) if known and solver.length_sigma > 0 else 0.0,
    )


def believable(poses: Iterable[Array], units: Iterable[float]) -> bool:
    """Whether these are numbers that a map may have: a member's nonsense may have spoilt them."""
    numbers = np.concatenate([np.asarray(T).ravel() for T in poses] or [np.zeros(0)])
    small = np.isfinite(numbers).all() and np.abs(numbers).max(initial=0.0) <= MAX_TRANSLATION
    sizes = np.array(list(units))
    return bool(small and (sizes >= 1.0 / MAX_SCALE).all() and (sizes <= MAX_SCALE).all())


def adopt(
    state: AgentState, task: OptimiseTask, outcome: SolverOutcome, elsewhere: frozenset[MatchId] = frozenset()
) -> Adoption:
    """Take the optimised poses and units over; key-frames that came later are carried along rigidly with the last
    optimised one, in its unit."""
    before = {i: state.pose(i) for i in range(len(state.keyframes))}
    state.note_lengths_settled()
    for track in task.tracks:
        piece = state.piece(track)
        state.pieces[state.pieces.index(piece)] = Piece(track, piece.first, task.frame, task.metric)
        for index in state.members(track):
            node = NodeId(state.me, index)
            if node in outcome.poses:
                state.poses[index] = outcome.poses[node]
                state.units[index] = 1.0 if state.profile.metric else outcome.units[node]
            else:
                _carry(state, index)
        if outcome.positions and outcome.accepted and state.profile.metric:
            learn_length(state, track)
    if outcome.accepted:
        state.odometry_length, state.odometry_turn = outcome.length, np.array(outcome.turn)
    state.version += 1
    return Adoption(before, frozenset(task.matches), elsewhere)


def take_over(
    state: AgentState, tracks: Iterable[int], poses: Mapping[NodeId, Array], log_units: Mapping[NodeId, float]
) -> UpdatedPoses:
    """Take the poses and units over that an update has found; key-frames after them are carried along rigidly."""
    before = {i: state.pose(i) for i in range(len(state.keyframes))}
    for track in tracks:
        for index in state.members(track):
            node = NodeId(state.me, index)
            if node in poses:
                state.poses[index] = poses[node]
                state.units[index] = 1.0 if state.profile.metric else float(np.exp(log_units[node]))
            else:
                _carry(state, index)
    state.version += 1
    return UpdatedPoses(before)


def _carry(state: AgentState, index: int) -> None:
    """A key-frame follows the one before by odometry, in its unit."""
    state.units[index] = state.units[index - 1]
    step = state.odometry_step(state.keyframes[index])
    state.poses[index] = state.poses[index - 1] @ stretched(step, state.units[index])


def odometry_edges(state: AgentState, track: int) -> list[Edge]:
    """Edges between key-frames of one track that follow each other, as odometry measured them, own unit: as far as
    odometry knows the same at both."""
    later = state.members(track)[1:]
    for index in later:
        if index not in state.odometry:
            state.odometry[index] = _odometry_edge(state, index)
    return [state.odometry[index] for index in later]


def _odometry_edge(state: AgentState, index: int) -> Edge:
    """The edge from the key-frame before to this one."""
    config, keyframe = state.config.optimisation, state.keyframes[index]
    step = state.odometry_step(keyframe)
    length = float(np.linalg.norm(step[:3, 3]))
    sigma = config.odometry_sigma_share * length + config.odometry_sigma_depth * keyframe.depth
    information = _diagonal(sigma, config.odometry_sigma_deg)
    drift = None if state.profile.metric else config.odometry_sigma_scale
    return Edge(NodeId(state.me, index - 1), NodeId(state.me, index), step, information, scale_sigma=drift)


def match_edge(match: Match, config: OptimisationConfig) -> Edge:
    """The edge of a place match, the same at both owners. Verification knows the noise of points, not that both maps
    are bent: a floor under its sigma keeps one match from outweighing all odometry."""
    floor = _diagonal(config.match_sigma_depth * match.depth, config.match_sigma_deg)
    spread = np.linalg.inv(_definite(match.information)) + np.linalg.inv(floor)
    information = np.linalg.inv(spread)
    scale_sigma = None
    if match.scale_sigma is not None:
        scale_sigma = min(float(np.hypot(match.scale_sigma, config.match_sigma_scale)), _UNKNOWN_SCALE)
    m = match.id
    return Edge(
        NodeId(m.match_agent, m.match),
        NodeId(m.query_agent, m.query),
        match.T_M_Q.se3(),
        0.5 * (information + information.T),
        EdgeKind.LOOP if m.query_agent == m.match_agent else EdgeKind.SEPARATOR,
        scale=match.T_M_Q.scale,
        scale_sigma=scale_sigma,
    )


def own_graph(state: AgentState) -> PoseGraph:
    """The agent's key-frames in its reference frame with odometry and own loops, and edges to others' key-frames
    whose poses follow from the match: for export. Translations are in the frame's unit.

    An edge between two agents stands in the graphs of both, the same numbers. Where one camera takes part only the
    agent of its first node knows that node's unit in the frame: there it stands in that agent's graph alone.
    """
    me, placed = state.me, set(state.placed())
    poses = {NodeId(me, i): state.poses[i] for i in sorted(placed)}
    edges = []
    for piece in state.pieces:
        if piece.frame == state.frame:
            edges += [_in_unit(e, state.units[e.i.index]) for e in odometry_edges(state, piece.track)]
    for match in state.accepted_matches():
        edge = match_edge(match, state.config.optimisation)
        ends = [n for n in (edge.i, edge.j) if n.robot == me]
        if any(n.index not in placed for n in ends):
            continue
        own = ends[0].index
        if edge.i.robot == me:
            edge = _in_unit(edge, state.units[own])
            poses.setdefault(edge.j, poses[edge.i] @ edge.T_i_j)
        elif match.scale_sigma is not None:
            continue
        else:
            poses.setdefault(edge.i, poses[edge.j] @ se3_inverse(edge.T_i_j))
        edges.append(edge)
    return PoseGraph(poses, tuple(edges))


def _in_unit(edge: Edge, unit: float) -> Edge:
    information = edge.information.copy()
    information[:3] /= unit
    information[:, :3] /= unit
    return replace(edge, T_i_j=stretched(edge.T_i_j, unit), information=information, scale=1.0)


def _diagonal(sigma: float, sigma_deg: float) -> Array:
    return np.diag([1.0 / sigma**2] * 3 + [1.0 / np.radians(sigma_deg) ** 2] * 3)


def _definite(information: Array) -> Array:
    """The information with its smallest eigenvalues lifted, so that it can be inverted."""
    values, vectors = np.linalg.eigh(0.5 * (information + information.T))
    values = np.maximum(values, 1e-9 * max(float(values[-1]), 1e-12))
    return (vectors * values) @ vectors.T
