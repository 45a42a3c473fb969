"""Place matches as an agent knows them, and which of them agree with each other."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from enum import StrEnum

import numpy as np

from backend.geometry import Array, Sim3, rotation_angle_deg
from mas.config import ConsistencyConfig
from mas.messages import MatchId


class Fate(StrEnum):
    """What became of a candidate match."""

    ACCEPTED = "accepted"
    REJECTED = "rejected"


@dataclass(frozen=True, eq=False)
class Match:
    """A geometrically verified place match, own loops included (then both agents are the same).

    ``T_M_Q``: query camera in match camera, in M's unit; ``T_T_Q``, ``T_T_M`` ``(4, 4)``: the two cameras by odometry
    in their tracks, each in its own unit; ``way_Q``, ``way_M``: how far the two agents had
    travelled by then; ``depth``: median depth at M, M's unit; ``information`` ``(6, 6)`` of
    ``T_M_Q``.
    """

    id: MatchId
    query_track: int
    match_track: int
    T_M_Q: Sim3
    information: Array
    inliers: int
    T_T_Q: Array
    T_T_M: Array
    way_Q: float
    way_M: float
    depth: float

    @property
    def tracks(self) -> tuple[tuple[int, int], tuple[int, int]]:
        """``(agent, track)`` of the match and of the query."""
        return (self.id.match_agent, self.match_track), (self.id.query_agent, self.query_track)

    def joins(self) -> Sim3:
        """``T_M-track_Q-track``: how the query's track stands in the match's, by this match and both odometries."""
        return Sim3.from_se3(self.T_T_M) @ self.T_M_Q @ Sim3.from_se3(self.T_T_Q).inverse()

    def turned(self) -> Match:
        """The same place seen from the other side: query and match swapped; depth and information are kept for
        comparing only."""
        i = self.id
        back = self.T_M_Q.inverse()
        swapped = MatchId(i.match_agent, i.match, i.query_agent, i.query)
        return replace(
            self, id=swapped, query_track=self.match_track, match_track=self.query_track, T_M_Q=back,
            T_T_Q=self.T_T_M, T_T_M=self.T_T_Q, way_Q=self.way_M, way_M=self.way_Q, depth=self.depth * back.scale,
        )  # fmt: skip


def agree(a: Match, b: Match, config: ConsistencyConfig) -> bool:
    """Whether two matches between the same two tracks say the same about how the tracks stand, up to odometry's drift.

    Positions: b's query camera, placed in M's track once by a and once by b, differs by at most ``depth_share``
    median depths plus ``drift`` times the ways driven between the matches; rotations likewise. This is the thesis's
    consistency (3.3) as settled: it compares through ``T_M_Q``, not the two camera centres directly. All relative to
    depth, so that it holds for any unit.
    """
    by_a, by_b = a.joins(), b.joins()
    query = b.T_T_Q[:3, 3]
    apart = float(np.linalg.norm(by_a @ query - by_b @ query))
    travelled = abs(a.way_M - b.way_M) + by_b.scale * abs(a.way_Q - b.way_Q)
    depth = max(a.depth, b.depth)
    angle = float(rotation_angle_deg(by_a.rotation.T @ by_b.rotation))
    return (
        apart <= config.depth_share * depth + config.drift * travelled
        and angle <= config.angle_deg + config.angle_deg_per_depth * travelled / depth
    )


def consistent(matches: Iterable[Match], config: ConsistencyConfig) -> set[MatchId]:
    """The largest set of matches that all agree with each other, for each two tracks; none where it is too small.

    Greedy: from each match, in order of how many agree with it, add those that agree with all so far. Both owners of
    a match hold the same matches and come to the same set. A match left out comes back when later ones support it.
    """
    groups: dict[tuple[tuple[int, int], tuple[int, int]], list[tuple[MatchId, Match]]] = {}
    for match in sorted(matches, key=lambda m: m.id):
        upright = match if match.tracks[0] <= match.tracks[1] else match.turned()
        groups.setdefault(upright.tracks, []).append((match.id, upright))
    accepted: set[MatchId] = set()
    for group in groups.values():
        best = _largest_agreeing([upright for _, upright in group], config)
        if len(best) > config.min_support:
            accepted.update(group[k][0] for k in best)
    return accepted


def _largest_agreeing(group: list[Match], config: ConsistencyConfig) -> list[int]:
    """Rows of the largest set found."""
    n = len(group)
    ok = np.eye(n, dtype=bool)
    for i in range(n):
        for j in range(i + 1, n):
            ok[i, j] = ok[j, i] = agree(group[i], group[j], config) and agree(group[j], group[i], config)
    best: list[int] = []
    for seed in sorted(range(n), key=lambda k: (-int(ok[k].sum()), k)):
        if int(ok[seed].sum()) <= len(best):
            break
        clique = [seed]
        for k in sorted(range(n), key=lambda k: (-int(ok[k].sum()), k)):
            if k != seed and ok[k, clique].all():
                clique.append(k)
        if len(clique) > len(best):
            best = clique
    return sorted(best)
