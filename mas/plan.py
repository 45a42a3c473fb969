"""Who optimises what together: from the members' bids to each one's task. Pure."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass

from backend.geometry import Sim3
from mas.messages import Bid, FrameId, Link, MatchId, OptimiseTask
from mas.tensors import pack_sim3, unpack_sim3

Track = tuple[int, int]


@dataclass(frozen=True)
class Plan:
    """``members``: agents whose tracks matches join, sorted; the first is the anchor. ``tasks``: one for each."""

    members: tuple[int, ...]
    tasks: dict[int, OptimiseTask]


def plan(manager: int, bids: Mapping[int, Bid]) -> Plan:
    """Tasks for the agents whose tracks hang together with the manager's largest set of joined tracks.

    Only matches that both owners list are used: both must hold the same edges. Coordinates that differ are aligned with
    the anchor's through the first such match (thesis section 3.5), so that the optimisation starts with all agents in
    one frame.
    """
    links = _usable(bids)
    component = _joined_with(manager, bids, links)
    members = tuple(sorted({agent for agent, _ in component}))
    anchor = min(component)
    terms = {(a, p.track): p for a, bid in bids.items() for p in bid.pieces}
    frame, unit = terms[anchor].frame, terms[anchor].unit
    inside = {m: ends for m, ends in links.items() if all(_track(m, e) in component for e in ends)}
    placed = _placements(frame, inside)
    tasks = {}
    for agent in members:
        tracks = tuple(sorted(t for a, t in component if a == agent))
        mine = tuple(sorted(m for m in inside if agent in m.agents))
        frames = sorted({terms[agent, t].frame for t in tracks})
        where = tuple((f, pack_sim3(placed[f])) for f in frames if f in placed)
        tasks[agent] = OptimiseTask(members, frame, unit, tracks, mine, where)
    return Plan(members, tasks)


def _usable(bids: Mapping[int, Bid]) -> dict[MatchId, tuple[Link, Link]]:
    """Matches that both owners hold: the match's link, then the query's."""
    held: dict[MatchId, dict[tuple[int, int], Link]] = {}
    for agent in sorted(bids):
        for link in bids[agent].links:
            own = (agent, _own_keyframe(link, agent))
            held.setdefault(link.match, {})[own] = link
    usable = {}
    for m in sorted(held):
        match_end, query_end = held[m].get((m.match_agent, m.match)), held[m].get((m.query_agent, m.query))
        if match_end is not None and query_end is not None and query_end.T_M_Q is not None:
            usable[m] = (match_end, query_end)
    return usable


def _own_keyframe(link: Link, agent: int) -> int:
    """Which end of the match this link describes; an own loop has a link for each end, told apart by ``T_M_Q``."""
    m = link.match
    if m.query_agent == m.match_agent:
        return m.query if link.T_M_Q is not None else m.match
    return m.query if m.query_agent == agent else m.match


def _track(match: MatchId, end: Link) -> Track:
    return (match.query_agent if end.T_M_Q is not None else match.match_agent), end.track


def _joined_with(manager: int, bids: Mapping[int, Bid], links: Mapping[MatchId, tuple[Link, Link]]) -> set[Track]:
    """The largest set of tracks joined by links that holds a track of the manager (ties: the older track)."""
    tracks = {(a, p.track) for a, bid in bids.items() for p in bid.pieces}
    around: dict[Track, set[Track]] = {t: set() for t in tracks}
    for match, (match_end, query_end) in links.items():
        a, b = _track(match, match_end), _track(match, query_end)
        if a in tracks and b in tracks:
            around[a].add(b)
            around[b].add(a)
    best: set[Track] = set()
    for start in sorted(t for t in tracks if t[0] == manager):
        found, queue = {start}, deque([start])
        while queue:
            for neighbour in sorted(around[queue.popleft()] - found):
                found.add(neighbour)
                queue.append(neighbour)
        if len(found) > len(best):
            best = found
    return best


def _placements(frame: FrameId, links: Mapping[MatchId, tuple[Link, Link]]) -> dict[FrameId, Sim3]:
    """``T_frame_f`` for every coordinate frame f that links join to ``frame``."""
    placed = {frame: Sim3.identity()}
    grown = True
    while grown:
        grown = False
        for _, (match_end, query_end) in sorted(links.items()):
            if (match_end.frame in placed) == (query_end.frame in placed) or query_end.T_M_Q is None:
                continue
            T_Fm_Fq = unpack_sim3(match_end.pose) @ unpack_sim3(query_end.T_M_Q) @ unpack_sim3(query_end.pose).inverse()
            if match_end.frame in placed:
                placed[query_end.frame] = placed[match_end.frame] @ T_Fm_Fq
            else:
                placed[match_end.frame] = placed[query_end.frame] @ T_Fm_Fq.inverse()
            grown = True
    return placed
