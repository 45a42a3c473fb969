"""Spacing of matches with the same agent: another one is worth its bytes once odometry is expected to have drifted by
as much as a match is off.

How fast odometry drifts is measured. Two matches of the same two tracks say twice how these stand to each other; they
differ by the noise of both matches and by what both odometries drifted on the way between. Far apart it is the drift
that counts, close together the noise: so both are found, as shares of what the pose graph states of them.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from itertools import groupby

import numpy as np

from maslam.backend.geometry import Array

from ..config import OptimisationConfig
from ..protocol.ids import MatchId
from ..state.place_match import Match

# Each match is compared with so many before it, and so many matches are looked at, the latest.
_BEFORE, _LATEST = 4, 200
# Before anything is known: shares (variances) of noise and drift, and what they weigh: about as much as so many pairs.
_EXPECTED, _PRIOR = (1.0, 0.3), 1.0
# A pair says no more than that errors are five times as large as stated: one of the two may be wrong.
_MOST = 25.0

WORTH = 0.45
"""The next match is worth it where the variance of drift is so many times that of a match."""


def stated_noise(match: Match, config: OptimisationConfig) -> float:
    """Variance of a match's position (squared length), as the pose graph has it."""
    floor = 3.0 * (config.match_sigma_depth * match.depth) ** 2
    return float(np.trace(_covariance(match)[:3, :3])) + floor


def stated_drift(keyframes: int, way: float, depth: float, config: OptimisationConfig, scaled: bool = False) -> float:
    """Variance of the displacement (squared length) by so many steps of odometry along a straight ``way``, as the pose
    graph has it; ``scaled``: the unit drifts as well."""
    if not keyframes:
        return 0.0
    step = config.odometry_sigma_share * way / keyframes + config.odometry_sigma_depth * depth
    turns = 2.0 * np.radians(config.odometry_sigma_deg) ** 2 + scaled * config.odometry_sigma_scale**2
    return float(keyframes * (3.0 * step**2 + turns * way**2 / 3.0))


@dataclass(eq=False)
class MeasuredDrift:
    """Drift of odometry by an agent's matches with others, as a share of the variance that the pose graph states."""

    config: OptimisationConfig
    _compared: dict[tuple[MatchId, MatchId], tuple[Array, Array]] = field(default_factory=dict)
    _noise: dict[MatchId, float] = field(default_factory=dict)

    def noise(self, match: Match, me: int) -> float:
        """What is stated of a match, in the unit of agent ``me``."""
        if match.id not in self._noise:
            upright = match if match.id.match_agent == me else match.turned()
            self._noise[match.id] = stated_noise(match, self.config) * (upright.depth / match.depth) ** 2
        return self._noise[match.id]

    def share(self, matches: Iterable[Match], me: int) -> float:
        """``matches``: accepted ones of agent ``me``, in any order."""
        upright = [m if m.id.match_agent == me else m.turned() for m in matches if len(set(m.id.agents)) == 2]
        latest = sorted(upright, key=lambda m: (m.tracks, m.id))
        rows, found = [np.sqrt(_PRIOR) * np.eye(2)], [np.sqrt(_PRIOR) * np.array(_EXPECTED)]
        for _, group in groupby(latest, key=lambda m: m.tracks):
            same = list(group)[-_LATEST:]
            pairs = [self._pair(same[j], same[k]) for k in range(len(same)) for j in range(max(k - _BEFORE, 0), k)]
            if pairs:
                stated, apart = (np.array(column) for column in zip(*pairs, strict=True))
                both = stated.sum(axis=1)
                rows.append(stated / both[:, None])
                found.append(np.minimum((apart**2).sum(axis=1) / both, _MOST))
        return float(max(np.linalg.lstsq(np.concatenate(rows), np.concatenate(found))[0][1], 0.0))

    def _pair(self, one: Match, other: Match) -> tuple[Array, Array]:
        """Noise and drift that are stated of two matches, ``(2,)``; how far they are apart, ``(3,)``."""
        key = (one.id, other.id)
        if key not in self._compared:
            self._compared[key] = _compared(one, other, self.config)
        return self._compared[key]


def _compared(one: Match, other: Match, config: OptimisationConfig) -> tuple[Array, Array]:
    query, there = other.query.T_T_C[:3, 3], other.joins()
    moved = there @ query - there @ one.query.T_T_C[:3, 3]
    turn = 2.0 * (float(np.trace(_covariance(one)[3:, 3:])) / 3.0 + np.radians(config.match_sigma_deg) ** 2)
    noise = stated_noise(one, config) + stated_noise(other, config) + turn * float(moved @ moved)
    scaled, ends = one.scale_sigma is not None, ((one.match, other.match, 1.0), (one.query, other.query, there.scale))
    steps = (abs(one.id.match - other.id.match), abs(one.id.query - other.id.query))
    drift = sum(
        stated_drift(n, abs(a.way - b.way) * unit, other.depth, config, scaled)
        for n, (a, b, unit) in zip(steps, ends, strict=True)
    )
    return np.array([noise, drift]), one.joins() @ query - there @ query


def _covariance(match: Match) -> Array:
    return np.asarray(np.linalg.pinv(match.information, hermitian=True), dtype=np.float64)


@dataclass(frozen=True, eq=False)
class DriftAlong:
    """How far odometry is expected to have drifted, against another agent's, along an agent's path since the nearest
    matches with it. ``matched``: own key-frames and the other's, in order; ``noise``: variance of a match;
    ``share``: variance of drift over what is stated; ``step``: metres a key-frame (own unit); ``scaled``: units drift.
    """

    matched: Sequence[tuple[int, int]]
    noise: float
    share: float
    step: float
    depth: float
    config: OptimisationConfig
    scaled: bool = False

    def over(self, mine: int, theirs: int) -> float:
        """Variance over so many own key-frames and so many of the other's, in variances of a match."""
        steps = (stated_drift(n, n * self.step, self.depth, self.config, self.scaled) for n in (mine, theirs))
        return self.share * sum(steps) / self.noise

    def at(self, mine: int, theirs: int) -> float:
        """The same at a pair of key-frames, by the matches before and after it."""
        drifts = [self.over(abs(mine - a), abs(theirs - b)) for a, b in self._beside(mine)]
        return 1.0 / sum(1.0 / drift for drift in drifts) if min(drifts) > 0.0 else 0.0

    def close(self, mine: int, keyframes: int) -> bool:
        """Whether there is a match within so many own key-frames."""
        return any(abs(mine - a) <= keyframes for a, _ in self._beside(mine))

    def _beside(self, mine: int) -> Sequence[tuple[int, int]]:
        """The last match up to an own key-frame, and the first after it."""
        k = bisect_right(self.matched, mine, key=lambda ends: ends[0])
        return self.matched[max(k - 1, 0) : k + 1]
