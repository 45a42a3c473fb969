"""Does a held map stand where place matches say? (thesis section 3.9.3, equations 3.1 to 3.6)

The thesis compares the centres of the two matched cameras (3.3), although those may stand metres apart. Here, as
``T_M_Q`` maps the query camera into the match camera, ``T_O_M @ T_M_Q`` is compared with ``T_O_Q``; and equation 3.4,
which is misprinted, becomes ``T_O_M' = T_O_Q @ T_M_Q^-1`` where the match is in the map, ``T_O_Q' = T_O_M @ T_M_Q``
where the query is. The other poses follow by their relative poses, forwards and backwards (3.5, 3.6): that is one rigid
motion of the whole map.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np

from backend.geometry import Array, Sim3, rotation_angle_deg
from mas.identities import MatchId
from mas.maps.held import HeldMap
from mas.state import AgentState


@dataclass(frozen=True, eq=False)
class Witness:
    """A place match that tells where a key-frame of a map stands: ``expected`` by the match from a known camera,
    ``found`` as the map has it; both in the holder's coordinates, with the owner's unit as scale."""

    match: MatchId
    expected: Sim3
    found: Sim3

    @property
    def metres(self) -> float:
        """Between the two positions."""
        return float(np.linalg.norm(self.expected.translation - self.found.translation))

    @property
    def degrees(self) -> float:
        return float(rotation_angle_deg(self.expected.rotation.T @ self.found.rotation))

    @property
    def motion(self) -> Sim3:
        """What lays the map on this match: its camera onto where the match says, all others rigidly with it."""
        return self.expected @ self.found.inverse()

    def after(self, motion: Sim3) -> Witness:
        """The same when the map has moved."""
        return Witness(self.match, self.expected, motion @ self.found)


@dataclass(frozen=True)
class Standing:
    """How a map stands to its witnesses: how many, how far off at best, at the median and at worst."""

    matches: int
    least_m: float
    median_m: float
    worst_m: float
    worst_deg: float


def witnesses(held: HeldMap, state: AgentState, others: Mapping[int, HeldMap]) -> list[Witness]:
    """All accepted matches between the map and the agent itself, then those that either map brought along between it
    and other held maps, in order of id."""
    placed = set(state.placed())
    own = {m.id: m.T_M_Q for m in state.accepted_matches() if held.owner in m.id.agents and state.me in m.id.agents}
    bought: dict[MatchId, Sim3] = {}
    for other in sorted(set(others) - {held.owner}):
        for match, T_M_Q in (*held.matches, *others[other].matches):
            if set(match.agents) == {held.owner, other}:
                bought.setdefault(match, T_M_Q)
    out = []
    for match, T_M_Q in (*sorted(own.items()), *sorted(bought.items())):
        queried = match.query_agent == held.owner
        theirs = match.query if queried else match.match
        known, index = (match.match_agent, match.match) if queried else (match.query_agent, match.query)
        row = held.rows.get(theirs)
        if row is None:
            continue
        if known == state.me:
            camera = state.pose(index) if index in placed else None
        else:
            at = others[known].rows.get(index)
            camera = None if at is None else others[known].pose(at)
        if camera is not None:
            expected = camera @ T_M_Q if queried else camera @ T_M_Q.inverse()
            out.append(Witness(match, expected, held.pose(row)))
    return out


def standing(found: Iterable[Witness]) -> Standing | None:
    """None without witnesses."""
    rows = list(found)
    if not rows:
        return None
    off = np.array([w.metres for w in rows])
    worst = max(w.degrees for w in rows)
    return Standing(len(rows), float(off.min()), float(np.median(off)), float(off.max()), worst)


def best_motion(found: list[Witness]) -> tuple[Sim3, MatchId]:
    """The alignment by that match with which the others agree best (lowest median distance; the first of equals, which
    is the thesis's choice)."""
    scores = [float(np.median(_distances(found, w.motion))) for w in found]
    best = int(np.argmin(np.round(scores, 9)))
    return found[best].motion, found[best].match


def _distances(found: list[Witness], motion: Sim3) -> Array:
    return np.array([w.after(motion).metres for w in found])


def tolerance(value_m: float | None, state: AgentState) -> float | None:
    """A setting in metres, in the unit of the agent's coordinates. A monocular agent has no metres: there a tenth of
    the median depth counts as one."""
    if value_m is None or state.profile.metric or not state.keyframes:
        return value_m
    placed = state.placed()
    depth = float(np.median([state.keyframes[i].depth * state.piece_of(i).unit for i in placed]))
    return value_m * 0.1 * depth
