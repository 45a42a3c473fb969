"""Matches of a whole group that contradict each other, and whose reports they are. Pure.

Between two agents lies that agree with each other look like truth. With a third agent, ways round meet: A to B and on
to C must lead where A to C leads. If they do not, and leaving out everything that one agent reported (as the one that
verified it) makes all the rest agree, that agent's reports contradict the others'. Where that holds of several agents,
the one whose reports are fewest is taken; where even those are equal, none of them is believed for now.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from maslam.backend.geometry import Array, Sim3

from ..protocol.ids import MatchId

# Ways round may differ by this share of the ground that the matches cover: far more than odometry drifts, far less
# than a place that is another place. The optimisation, not this test, is for what is smaller.
_TOLERANCE = 0.15
# And by this share of the median depth in any case: matches at one spot cover no ground.
_TOLERANCE_DEPTH = 0.5
# With one camera the unit of length drifts on the way as well. A way round may come back with another scale, up to this
# logarithm; and by as much of the ground positions may differ more.
_TOLERANCE_SCALE = 0.4

Track = tuple[int, int]


class EndLike(Protocol):
    """One end of a match: its track, and its key-frame's pose in that track's coordinates."""

    @property
    def track(self) -> Track:
        """Its agent and the number of the track."""

    @property
    def pose(self) -> Sim3:
        """``T_F_C`` of the key-frame; scale: its own unit there."""


class JointLike(Protocol):
    """A match with both ends."""

    @property
    def match(self) -> EndLike:
        """The key-frame that was recognised."""

    @property
    def query(self) -> EndLike:
        """The key-frame that was asked about."""

    @property
    def T_M_Q(self) -> Sim3:
        """Query camera to match camera, in the unit of the match's key-frame."""

    @property
    def T_Fm_Fq(self) -> Sim3:
        """The query's coordinates in the match's, by this match alone."""


@dataclass(frozen=True)
class _Verdict:
    """``judged``: whether anything hangs together with the judge."""

    kept: int
    agree: bool
    judged: bool


def contradicted(joints: Mapping[MatchId, JointLike], depths: Mapping[Track, float]) -> frozenset[MatchId]:
    """The matches not to be believed; none where all agree, or where no single agent explains why they do not.

    ``depths``: median depth of the judge's own tracks, in the units of their coordinates. What hangs together with
    none of them is not judged, and the judge does not doubt what it verified itself.
    """
    between = {m: j for m, j in sorted(joints.items()) if m.query_agent != m.match_agent}
    if _judge(between, depths).agree:
        return frozenset()
    explained: dict[int, int] = {}
    judge = {agent for agent, _ in depths}
    for reporter in sorted({m.match_agent for m in between} - judge):
        verdict = _judge({m: j for m, j in between.items() if m.match_agent != reporter}, depths)
        if verdict.agree and verdict.judged:
            explained[reporter] = verdict.kept
    best = max(explained.values(), default=0)
    culprits = {reporter for reporter, kept in explained.items() if kept == best}
    return frozenset(m for m in between if m.match_agent in culprits)


def _judge(joints: Mapping[MatchId, JointLike], depths: Mapping[Track, float]) -> _Verdict:
    """Whether all ways round meet: tracks are placed along the strongest ties, then every match is held against
    that."""
    placed, root_of = _place(joints)
    there = {m: placed[j.match.track] @ (j.match.pose @ j.T_M_Q) for m, j in joints.items()}
    by_query = {m: placed[j.query.track] @ j.query.pose for m, j in joints.items()}
    roots = {m: root_of[j.match.track] for m, j in joints.items()}
    floors: dict[Track, float] = {}
    for track in sorted(set(depths) & set(placed)):
        floor = _TOLERANCE_DEPTH * depths[track] * placed[track].scale
        floors[root_of[track]] = max(floor, floors.get(root_of[track], 0.0))
    for root in sorted(floors):
        mine = [m for m in joints if roots[m] == root]
        a = np.array([there[m].translation for m in mine])
        b = np.array([by_query[m].translation for m in mine])
        drifted = np.abs(np.log([there[m].scale / by_query[m].scale for m in mine]))
        ground = max(_extents(joints, mine, placed))
        allowed = np.maximum((_TOLERANCE + drifted) * ground, floors[root])
        if (np.linalg.norm(a - b, axis=1) > allowed).any() or drifted.max() > _TOLERANCE_SCALE:
            return _Verdict(len(joints), agree=False, judged=True)
    return _Verdict(len(joints), agree=True, judged=bool(floors))


def _extents(joints: Mapping[MatchId, JointLike], matches: list[MatchId], placed: Mapping[Track, Sim3]) -> list[float]:
    """Extent of each track's own matched key-frames, by itself: no report of others changes that."""
    centres: dict[Track, list[Array]] = {}
    for match in matches:
        for end in (joints[match].match, joints[match].query):
            centres.setdefault(end.track, []).append(end.pose.translation)
    return [float(np.linalg.norm(np.ptp(c, axis=0))) * placed[t].scale for t, c in sorted(centres.items())]


def _place(joints: Mapping[MatchId, JointLike]) -> tuple[dict[Track, Sim3], dict[Track, Track]]:
    """``T_root_track`` and each track's root, along a spanning forest of the pairs with most matches (Kruskal)."""
    pairs: dict[tuple[Track, Track], list[JointLike]] = {}
    for joint in joints.values():
        pairs.setdefault((joint.match.track, joint.query.track), []).append(joint)
    tracks = sorted({t for pair in pairs for t in pair})
    placed = {t: Sim3.identity() for t in tracks}
    roots = {t: t for t in tracks}
    for (m, q), found in sorted(pairs.items(), key=lambda item: (-len(item[1]), item[0])):
        if roots[m] == roots[q]:
            continue
        T_m_q = placed[m] @ found[0].T_Fm_Fq @ placed[q].inverse()
        old, new = roots[q], roots[m]
        for track in [t for t in tracks if roots[t] == old]:
            placed[track], roots[track] = T_m_q @ placed[track], new
    return placed, roots
