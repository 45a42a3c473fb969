"""Spacing of matches with the same agent: another one is worth its bytes once odometry may have drifted by more than
a match is off."""

from __future__ import annotations

import numpy as np

from ..config import OptimisationConfig
from ..state.place_match import Match

# How many times a match's own noise odometry may have drifted before the next match.
_WORTH = 3.5


def worth_after(earlier: Match, latest: Match, config: OptimisationConfig) -> float:
    """The way until the next match is worth it, as a multiple of that between these two, which join the same tracks.

    How far the later one is off what the earlier one and both odometries say (``apart``), plus what matches are off
    themselves (``noise``), bounds the drift on the way between them. The next match tells something new where this
    drift exceeds a few times the noise. Two matches close together bound nothing: then the multiple stays small.
    Matches that come as expected make the way about twice as long each time; odometry that drifts makes it shorter.
    """
    before = earlier if earlier.tracks == latest.tracks else earlier.turned()
    query = latest.query.T_T_C[:3, 3]
    apart = float(np.linalg.norm(before.joins() @ query - latest.joins() @ query))
    noise = latest.depth * float(np.hypot(_noise(earlier, config), _noise(latest, config)))
    return _WORTH * noise / (apart + noise)


def _noise(match: Match, config: OptimisationConfig) -> float:
    """One sigma of a match's position, as a share of its median depth: what the solver believes."""
    covariance = np.linalg.pinv(match.information, hermitian=True)
    return max(float(np.sqrt(max(np.trace(covariance[:3, :3]) / 3.0, 0.0))) / match.depth, config.match_sigma_depth)
