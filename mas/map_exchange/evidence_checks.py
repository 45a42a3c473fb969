"""Evidence of place matches about the position of a map copy (thesis section 3.9.3, equations 3.1 to 3.6).

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

from maslam.backend.geometry import Array, Sim3

from ..protocol.ids import MatchId
from ..state.agent_state import AgentState
from .map_copy import MapCopy

# Witnesses of one map that are asked.
ENOUGH = 16
# Matches that must be there to judge a map although none of them is accepted.
_SEVERAL = 3


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
        """Between the two orientations."""
        return _degrees(float(((self.expected.rotation - self.found.rotation) ** 2).sum()))

    @property
    def motion(self) -> Sim3:
        """Rigid motion that aligns the map with this match: its camera moves to where the match puts it."""
        return self.expected @ self.found.inverse()

    def after(self, motion: Sim3) -> Witness:
        """The witness after a motion of the map."""
        return Witness(self.match, self.expected, motion @ self.found)


@dataclass(frozen=True)
class EvidenceStatistics:
    """Statistics of a map's witnesses: number; distance at best, at the median and at worst."""

    matches: int
    least_m: float
    median_m: float
    worst_m: float
    worst_deg: float

    def figures(self) -> dict[str, float | int]:
        """For events."""
        return {
            "matches": self.matches,
            "median_off": round(self.median_m, 4),
            "worst_off": round(self.worst_m, 4),
            "worst_off_deg": round(self.worst_deg, 3),
        }


def witnesses(copy: MapCopy, state: AgentState, others: Mapping[int, MapCopy]) -> list[Witness]:
    """The accepted matches between the map and the agent itself; where there are none, those that came with maps
    between it and other copies. In order of id; of many, :data:`ENOUGH` spread evenly.

    Own matches come first because they were verified here; another map may be wrong itself. Where a share of the
    witnesses must agree, several own matches that were verified and not accepted count as well: that they contradict
    each other is what a bent map looks like.
    """
    own = _between(state.accepted, state.me, copy.owner)
    if not own and state.config.merge.accuracy_share:
        verified = _between(state.verified, state.me, copy.owner)
        own = verified if len(verified) >= _SEVERAL else []
    found = _own(copy, state, _some(sorted(own)))
    return found or _bought(copy, others)


def _between(matches: Iterable[MatchId], one: int, other: int) -> list[MatchId]:
    return [i for i in matches if one in i.agents and other in i.agents]


def _own(copy: MapCopy, state: AgentState, matches: list[MatchId]) -> list[Witness]:
    frame, out = state.frame, []
    for match in matches:
        mine = match.query if match.query_agent == state.me else match.match
        if state.piece_of(mine).frame == frame:
            out.append(_witness(copy, match, state.verified[match].T_M_Q, state.pose(mine)))
    return [w for w in out if w is not None]


def _bought(copy: MapCopy, others: Mapping[int, MapCopy]) -> list[Witness]:
    known: dict[MatchId, Sim3] = {}
    for other in sorted(set(others) - {copy.owner}):
        for match in (*copy.matches_with.get(other, ()), *others[other].matches_with.get(copy.owner, ())):
            known.setdefault(match.id, match.T_M_Q)
    out = []
    for match in _some(sorted(known)):
        queried = match.query_agent == copy.owner
        other, index = (match.match_agent, match.match) if queried else (match.query_agent, match.query)
        row = others[other].rows.get(index)
        if row is not None:
            out.append(_witness(copy, match, known[match], others[other].pose(row)))
    return [w for w in out if w is not None]


def _witness(copy: MapCopy, match: MatchId, T_M_Q: Sim3, camera: Sim3) -> Witness | None:
    """Evidence of a match from a known camera, ``T_O_C``, about a key-frame of the map; None if that is not in it."""
    queried = match.query_agent == copy.owner
    row = copy.rows.get(match.query if queried else match.match)
    if row is None:
        return None
    return Witness(match, camera @ T_M_Q if queried else camera @ T_M_Q.inverse(), copy.pose(row))


def _some(matches: list[MatchId]) -> list[MatchId]:
    if len(matches) <= ENOUGH:
        return matches
    return [matches[i] for i in np.linspace(0, len(matches) - 1, ENOUGH).astype(int)]


def evidence_of(found: Iterable[Witness]) -> EvidenceStatistics | None:
    """None without witnesses."""
    rows = list(found)
    if not rows:
        return None
    off = _distances(rows, Sim3.identity())
    chords = np.array([w.expected.rotation for w in rows]) - np.array([w.found.rotation for w in rows])
    worst = _degrees(float((chords**2).sum(axis=(1, 2)).max()))
    return EvidenceStatistics(len(rows), float(off.min()), float(np.median(off)), float(off.max()), worst)


def best_motion(found: list[Witness]) -> tuple[Sim3, MatchId]:
    """The alignment by that match with which the others agree best (lowest median distance; the first of equals, which
    is the thesis's choice)."""
    scores = [float(np.median(_distances(found, w.motion))) for w in found]
    best = int(np.argmin(np.round(scores, 9)))
    return found[best].motion, found[best].match


def _degrees(squared: float) -> float:
    """The angle between rotation matrices that are ``2 sqrt(2) sin(angle / 2)`` apart, squared."""
    return float(np.degrees(2.0 * np.arcsin(min(np.sqrt(squared / 8.0), 1.0))))


def _distances(found: list[Witness], motion: Sim3) -> Array:
    """``(n,)`` after the map has moved."""
    there = motion @ np.array([w.found.translation for w in found])
    apart: Array = np.linalg.norm(np.array([w.expected.translation for w in found]) - there, axis=1)
    return apart


def tolerance(value_m: float | None, state: AgentState) -> float | None:
    """A setting in metres, in the unit of the agent's coordinates. A monocular agent has no metres: there a tenth of
    the median depth counts as one."""
    if value_m is None or state.profile.metric or not state.keyframes:
        return value_m
    return value_m * 0.1 * float(np.median([state.depth(i) for i in state.placed()]))
