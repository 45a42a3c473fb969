"""Plan of an optimisation: from the members' bids to the task of each. Pure."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping, Set
from dataclasses import dataclass

from maslam.backend.geometry import Array, Sim3

from ..protocol.ids import FrameId, MatchId
from ..protocol.messages import Bid, Links
from ..protocol.tasks import OptimiseTask
from ..protocol.tensors import pack_sim3s, unpack_sim3s
from .cycle_consistency import contradicted

Track = tuple[int, int]


@dataclass(frozen=True, eq=False)
class End:
    """One end of a match: its agent's track, the coordinates it is in, and its key-frame there (scale: the
    key-frame's unit)."""

    track: Track
    frame: FrameId
    pose: Sim3


@dataclass(frozen=True, eq=False)
class Joint:
    """A match that both its owners hold."""

    match: End
    query: End
    T_M_Q: Sim3

    @property
    def T_Fm_Fq(self) -> Sim3:
        """The query's coordinates in the match's."""
        return self.match.pose @ self.T_M_Q @ self.query.pose.inverse()


@dataclass(frozen=True)
class Plan:
    """``members``: agents whose tracks matches join, sorted; the first is the anchor. ``tasks``: one for each.
    ``contradicted``: matches left out because the group's other matches say otherwise; ``elsewhere``: those that join
    other tracks, apart from these."""

    members: tuple[int, ...]
    tasks: dict[int, OptimiseTask]
    contradicted: frozenset[MatchId] = frozenset()
    elsewhere: frozenset[MatchId] = frozenset()


def plan(
    manager: int,
    bids: Mapping[int, Bid],
    depths: Mapping[Track, float] | None = None,
    fresh: Set[MatchId] = frozenset(),
) -> Plan:
    """Tasks for the agents whose tracks hang together with the manager's largest set of joined tracks, of those sets
    that hold a ``fresh`` match if any does: tracks that are apart get their turns.

    Only matches that both owners list are used: both must hold the same edges, and who bids peer-to-peer lists those
    with the manager only. All are brought into the lowest coordinates among them (the lowest metric ones, where there
    are any) through the first match that joins theirs (thesis section 3.5): whoever shared them with agents that take
    no part shares them afterwards. So a metric agent is never in coordinates that are not. ``depths``: the manager's
    median depths by track, to judge what contradicts what (:mod:`maslam.mas.optimisation.cycle_consistency`).
    """
    held = _usable(bids)
    wrong = contradicted(held, depths or {})
    joints = {m: j for m, j in held.items() if m not in wrong}
    component = _joined_with(manager, bids, joints, fresh)
    members = tuple(sorted({agent for agent, _ in component}))
    terms = {(a, p.track): p for a, bid in bids.items() for p in bid.pieces}
    in_metres = {terms[t].frame for t in component if terms[t].frame_metric}
    frame = min(in_metres or {terms[t].frame for t in component})
    arbitrary = tuple(a for a in members if not all(terms[t].metric for t in component if t[0] == a))
    inside = {m: j for m, j in joints.items() if j.match.track in component and j.query.track in component}
    placed = _placements(frame, inside, in_metres)
    positions = any(terms[t].positions for t in component)
    tasks = {}
    for agent in members:
        tracks = tuple(sorted(t for a, t in component if a == agent))
        mine = tuple(sorted(m for m in inside if agent in m.agents))
        present = tuple(sorted({terms[agent, t].frame for t in tracks} & set(placed)))
        where = pack_sim3s([placed[f] for f in present])
        metric = frame in in_metres
        tasks[agent] = OptimiseTask(members, frame, metric, tracks, mine, present, where, arbitrary, positions)
    return Plan(members, tasks, wrong, frozenset(set(joints) - set(inside)))


def _usable(bids: Mapping[int, Bid]) -> dict[MatchId, Joint]:
    """Matches that both owners hold."""
    matched: dict[MatchId, End] = {}
    queries: dict[MatchId, tuple[End, Sim3]] = {}
    for agent in sorted(bids):
        links = bids[agent].links or Links()
        transforms = iter(unpack_sim3s(links.transforms))
        ends = zip(links.matches, links.tracks, links.frames, links.query, unpack_sim3s(links.poses), strict=True)
        for match, track, frame, is_query, pose in ends:
            end = End((agent, track), frame, pose)
            if is_query:
                queries[match] = (end, next(transforms))
            else:
                matched[match] = end
    both = sorted(set(matched) & set(queries))
    return {m: Joint(matched[m], *queries[m]) for m in both}


def _joined_with(
    manager: int, bids: Mapping[int, Bid], joints: Mapping[MatchId, Joint], fresh: Set[MatchId]
) -> set[Track]:
    """The largest set of tracks joined by matches that holds a track of the manager (ties: the older track), one with a
    fresh match before all others."""
    tracks = {(a, p.track) for a, bid in bids.items() for p in bid.pieces}
    around: dict[Track, set[Track]] = {t: set() for t in tracks}
    for joint in joints.values():
        a, b = joint.match.track, joint.query.track
        if a in tracks and b in tracks:
            around[a].add(b)
            around[b].add(a)
    new = {j.match.track for m, j in joints.items() if m in fresh}
    best: set[Track] = set()
    for start in sorted(t for t in tracks if t[0] == manager):
        found, queue = {start}, deque([start])
        while queue:
            for neighbour in sorted(around[queue.popleft()] - found):
                found.add(neighbour)
                queue.append(neighbour)
        if (not found.isdisjoint(new), len(found)) > (not best.isdisjoint(new), len(best)):
            best = found
    return best


def _placements(frame: FrameId, joints: Mapping[MatchId, Joint], in_metres: Set[FrameId]) -> dict[FrameId, Sim3]:
    """``T_frame_f`` for every coordinate frame f that matches join to ``frame``; rigid between metric ones."""
    placed = {frame: Sim3.identity()}
    waiting = [j for _, j in sorted(joints.items()) if j.match.frame != j.query.frame]
    grown = True
    while grown:
        grown = False
        for j in waiting:
            here, there = j.match.frame in placed, j.query.frame in placed
            if here and not there:
                new, T_frame_new = j.query, placed[j.match.frame] @ j.T_Fm_Fq
            elif there and not here:
                new, T_frame_new = j.match, placed[j.query.frame] @ j.T_Fm_Fq.inverse()
            else:
                continue
            # A chain over units of agents' own comes back with some scale; metres are metres.
            rigid = T_frame_new.scale != 1.0 and {frame, new.frame} <= in_metres
            placed[new.frame] = _without_scale(T_frame_new, new.pose.translation) if rigid else T_frame_new
            grown = True
    return placed


def _without_scale(T: Sim3, kept: Array) -> Sim3:
    """The rigid transform with the same rotation that moves one point ``(3,)`` to the same place."""
    return Sim3(T.rotation, T @ kept - T.rotation @ kept)
