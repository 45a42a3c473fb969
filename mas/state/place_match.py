"""Place matches as an agent knows them, and which of them agree with each other."""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from maslam.backend.geometry import Array, Sim3
from maslam.backend.relpose.alignment import rigid_information, scale_sigma

from ..config import ConsistencyConfig
from ..protocol.ids import MatchId


class MatchOutcome(StrEnum):
    """Outcome of a candidate match."""

    ACCEPTED = "accepted"
    REJECTED = "rejected"
    SKIPPED = "skipped"


class SkipReason(StrEnum):
    """Why a candidate was not verified. It is skipped, not rejected: nobody looked at its geometry.

    ``NOT_VERIFIED``: it was to be, but the contract did not come to its end. ``SAME_IMAGE``: both key-frames are of one
    and the same image, which two agents were given: that it fits itself is no evidence.
    """

    KNOWN = "known already"
    CLOSE_TO_VERIFIED = "close to verified matches"
    CLOSE_TO_ACCEPTED = "close to an accepted match"
    SAME_IMAGE = "same image"
    NOT_VERIFIED = "not verified"


@dataclass(frozen=True, eq=False)
class MatchEnd:
    """One end of a match: its agent's ``track``, the camera in it by odometry ``T_T_C`` ``(4, 4)``, in that agent's own
    unit, and ``way``: how far the agent had travelled by then, same unit."""

    track: int
    T_T_C: Array
    way: float


@dataclass(frozen=True, eq=False)
class Match:
    """A geometrically verified place match, own loops included (then both agents are the same).

    ``T_M_Q``: query camera in match camera, in M's unit; ``information`` ``(6, 6)`` of its rigid part; ``inliers`` of
    the verification; ``depth``: median depth at M, M's unit; ``scale_sigma``: of its log scale, None where both views
    are metric, so that none was estimated.
    """

    id: MatchId
    query: MatchEnd
    match: MatchEnd
    T_M_Q: Sim3
    information: Array
    inliers: int
    depth: float
    scale_sigma: float | None = None

    @classmethod
    def of(
        cls, id: MatchId, query: MatchEnd, match: MatchEnd, T_M_Q: Sim3, full: Array, inliers: int, depth: float
    ) -> Match:
        """The match with its information as verification tells it: ``full`` ``(6, 6)``, or ``(7, 7)`` with the log
        scale's, of which each part gets what is left when the other is not known."""
        if len(full) == 6 or full[6, 6] <= 0:
            return cls(id, query, match, T_M_Q, full[:6, :6], inliers, depth)
        return cls(id, query, match, T_M_Q, rigid_information(full), inliers, depth, scale_sigma(full))

    @property
    def tracks(self) -> tuple[tuple[int, int], tuple[int, int]]:
        """``(agent, track)`` of the match and of the query."""
        return (self.id.match_agent, self.match.track), (self.id.query_agent, self.query.track)

    def joins(self) -> Sim3:
        """``T_M-track_Q-track``: how the query's track stands in the match's, by this match and both odometries."""
        return Sim3.from_se3(self.match.T_T_C) @ self.T_M_Q @ Sim3.from_se3(self.query.T_T_C).inverse()

    def turned(self) -> Match:
        """The same place seen from the other side: query and match swapped; depth and information are kept for
        comparing only."""
        i = self.id
        back = self.T_M_Q.inverse()
        return replace(
            self,
            id=MatchId(i.match_agent, i.match, i.query_agent, i.query),
            query=self.match,
            match=self.query,
            T_M_Q=back,
            depth=self.depth * back.scale,
        )


@dataclass(frozen=True, eq=False)
class ReportedMatch:
    """A place match as its owner tells it with its map: which key-frames, and ``T_M_Q`` in M's unit."""

    id: MatchId
    T_M_Q: Sim3


@dataclass(frozen=True, eq=False)
class _Compared:
    """A match as it is compared with others: turned so that the lower track is the match's. ``joins``: how the query's
    track stands in the match's; ``query`` ``(3,)``: the query camera in its own track; ``way_M``, ``way_Q``: how far
    both had travelled; ``depth``: median at M."""

    id: MatchId
    joins: Sim3
    query: Array
    way_M: float
    way_Q: float
    depth: float


class Agreement:
    """Matches between two tracks, and which of them say the same about how the tracks stand, up to odometry's drift.

    Positions: a match's query camera, placed in M's track once by itself and once by another match, differs by at most
    ``depth_share`` median depths plus ``drift`` times the ways driven between the two; rotations likewise. This is the
    thesis's consistency (3.3) as settled: it compares through ``T_M_Q``, not the two camera centres directly. All is
    relative to depth, so that it holds for any unit.

    With one camera the unit drifts as well: the scales of two matches differ by at most ``scale`` (logarithm) plus
    ``scale_per_depth`` for each median depth of way. Their geometric mean then carries one match's position to the
    other. Where the logarithm drifts evenly by d over a way, that is off by at most a quarter of d times the way (out
    by one scale and back by another): so much more is allowed.

    Rule "earlier" is the predecessor's consistency group instead: a match counts when at least ``min_support`` (its
    value: 2) of those made in the last ``earlier_m`` of the way put the query within ``earlier_apart_m`` of where it
    does; rotations are not compared, and lengths are metres.
    """

    def __init__(self, config: ConsistencyConfig) -> None:
        self.config = config
        self._all: list[_Compared] = []
        self._ok = np.zeros((0, 0), dtype=bool)

    @property
    def ids(self) -> list[MatchId]:
        """All matches, in the order in which they came."""
        return [m.id for m in self._all]

    def add(self, match: Match) -> None:
        """Compare a match with all so far."""
        upright = match if match.tracks[0] <= match.tracks[1] else match.turned()
        query, ways = upright.query.T_T_C[:3, 3], (upright.match.way, upright.query.way)
        self._all.append(_Compared(match.id, upright.joins(), query, *ways, upright.depth))
        n = len(self._all)
        grown = np.ones((n, n), dtype=bool)
        grown[:-1, :-1] = self._ok
        grown[-1, :] = grown[:, -1] = self._agree_with_last()
        self._ok = grown

    def _agree_with_last(self) -> NDArray[np.bool_]:
        last, query, joins = self._all[-1].joins, self._all[-1].query, [m.joins for m in self._all]
        R, t, s = (np.array([getattr(j, name) for j in joins]) for name in ("rotation", "translation", "scale"))
        queries = np.array([m.query for m in self._all])
        way_M, way_Q, depth = np.array([(m.way_M, m.way_Q, m.depth) for m in self._all]).T
        between_M, between_Q = np.abs(way_M - way_M[-1]), np.maximum(s, last.scale) * np.abs(way_Q - way_Q[-1])
        travelled = between_M + between_Q
        deeper = np.maximum(depth, depth[-1])
        by_others = s[:, None] * (R @ query) + t - last @ query
        of_others = s[:, None] * np.einsum("nij,nj->ni", R, queries) + t - last @ queries
        drifted = np.abs(np.log(s / last.scale))
        if self.config.rule == "together" and drifted.any():
            # The way between by a scale between, not by the one at the start.
            between, mean = query - queries, np.sqrt(s * last.scale)
            by_others += (mean - s)[:, None] * np.einsum("nij,nj->ni", R, between)
            of_others += (mean - last.scale)[:, None] * (between @ last.rotation.T)
        apart = np.linalg.norm([by_others, of_others], axis=2).max(axis=0)
        if self.config.rule == "earlier":
            recent = np.abs(way_Q - way_Q[-1]) <= self.config.earlier_m
            return np.asarray(recent & (apart <= self.config.earlier_apart_m))
        cosine = (np.einsum("nij,ij->n", R, last.rotation) - 1.0) / 2.0
        angle = np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0)))
        allowed = self.config.depth_share * deeper + self.config.drift * travelled
        near = apart <= allowed + 0.25 * drifted * np.maximum(between_M, between_Q)
        aligned = angle <= self.config.angle_deg + self.config.angle_deg_per_depth * travelled / deeper
        alike = drifted <= self.config.scale + self.config.scale_per_depth * travelled / deeper
        agree: NDArray[np.bool_] = near & aligned & alike
        agree[-1] = True
        return agree

    def accepted(self) -> set[MatchId]:
        """The largest set in which all agree with each other; none where it is too small.

        Greedy: from each match, in order of how many agree with it, add those that agree with all so far. The order in
        which matches came does not matter, so both owners of a match come to the same set; and a match left out comes
        back when later ones support it.
        """
        if self.config.rule == "earlier":
            return self._by_earlier()
        counts, ids = self._ok.sum(axis=1), self.ids
        order = sorted(range(len(ids)), key=lambda k: (-counts[k], ids[k]))
        best: list[int] = []
        for seed in order:
            if counts[seed] <= len(best):
                break
            clique, fits = [seed], self._ok[seed].copy()
            for k in order:
                if k != seed and fits[k]:
                    clique.append(k)
                    fits &= self._ok[k]
            if len(clique) > len(best):
                best = clique
        return {ids[k] for k in best} if len(best) > self.config.min_support else set()

    def _by_earlier(self) -> set[MatchId]:
        """Those that enough matches before them on the query's way agree with. The order in which they came to be known
        does not matter: the way says which is earlier, and of equals the number."""
        places = [(m.way_Q, m.id) for m in self._all]
        return {
            place[1]
            for k, place in enumerate(places)
            if sum(self._ok[k, j] for j, other in enumerate(places) if other < place) >= self.config.min_support
        }
