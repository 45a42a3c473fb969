"""The owner's side: publishes its map, version after version, each with what is new since the one before."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from ..config import MergeConfig
from ..state.agent_state import AgentState, stretched
from ..state.place_match import Match
from .coding.map_delta import encode, is_prefix
from .coding.point_selection import sellable, well_spread
from .coding.pose_corrections import Bound
from .coding.quantised_map import (
    TICK_NS,
    QuantisedMap,
    Steps,
    empty_map,
    quantised,
    quantised_match,
    quantised_points,
    widened,
)
from .versions import MapVersion, make_patch

# A change of unit below this is none.
_SAME_UNIT = 1e-3


@dataclass(frozen=True, eq=False)
class _KeyframePoints:
    """Points that are sold with one key-frame: ``cells`` ``(n, 2)``, ``depths`` ``(n,)``, ``descriptors``
    ``(n, 32)``."""

    cells: NDArray[np.int64]
    depths: NDArray[np.int64]
    descriptors: NDArray[np.uint8]


@dataclass
class Publisher:
    """The owner's side: makes a version of its own map when there is something to tell."""

    state: AgentState
    published: MapVersion | None = None
    recent: dict[int, QuantisedMap] = field(default_factory=dict)
    """The last two versions."""
    _at_version: int = -1
    _sold: set[int] = field(default_factory=set)

    @property
    def _config(self) -> MergeConfig:
        return self.state.config.merge

    def count_on(self, version: MapVersion) -> None:
        """The next version counts on from this one of an earlier run."""
        self.published, self.recent = version, {version.map.version: version.map}

    def latest(self, closing: bool) -> MapVersion | None:
        """The map to sell now, None while there is none. On the way a new version waits for ``version_keyframes`` new
        key-frames or new coordinates; at the end any change makes one."""
        if self.published is not None and self._at_version == self.state.version:
            return self.published
        placed = self.state.placed()
        if not placed:
            return None
        base = None if self.published is None else self.published.map
        few = base is not None and len(placed) < len(base.keyframes) + self._config.version_keyframes
        if base is not None and few and not closing and self._same_coordinates(base):
            return self.published
        self._at_version = self.state.version
        wanted = self._wanted(placed, base)
        if base is not None and _says_nothing_new(base, wanted):
            return self.published
        continued = base if base is not None and is_prefix(base, wanted) else None
        bits, made = encode(continued, wanted, Bound())
        patch = make_patch(continued, made, bits)
        known = self.published.patches if self.published is not None and continued is not None else ()
        self.published = MapVersion(made, (*known, patch) if continued is not None else ())
        self.recent = {**dict(list(self.recent.items())[-1:]), made.version: made}
        return self.published

    def _same_coordinates(self, base: QuantisedMap) -> bool:
        unit = self._unit()
        return base.frame == self.state.frame and abs(base.unit - unit) <= _SAME_UNIT * unit

    def _unit(self) -> float:
        return self.state.units[self.state.placed()[0]]

    def _wanted(self, placed: list[int], base: QuantisedMap | None) -> QuantisedMap:
        state, unit, config = self.state, self._unit(), self._config
        keyframes = [state.keyframes[i] for i in placed]
        depth = float(np.median([k.depth for k in keyframes]))
        steps = Steps.of(config.point_error, config.pose_error, depth) if base is None else base.steps
        old = empty_map(state.me, state.frame, steps)
        if base is not None and np.array_equal(base.keyframes, placed[: len(base.keyframes)]):
            old = base
        else:
            self._sold = set()
        poses = np.array([stretched(state.poses[i], 1.0 / unit) for i in placed])
        own = np.array([state.units[i] / unit for i in placed])
        drifting = unit != 1.0 or bool((own != 1.0).any()) or (base is not None and base.drifting)
        points = [self._points(i, steps) for i in placed[len(old.keyframes) :]]
        matches = [m for m in state.accepted_matches() if m.id.query_agent == state.me != m.id.match_agent]
        matches = _in_old_order(old, matches)
        names = [(m.id.query, m.id.match_agent, m.id.match) for m in matches]
        return QuantisedMap(
            owner=state.me,
            version=1 if self.published is None else self.published.map.version + 1,
            frame=state.frame,
            unit=unit,
            steps=steps,
            keyframes=np.array(placed, dtype=np.int64),
            ticks=np.array([round(k.stamp_ns / TICK_NS) for k in keyframes], dtype=np.int64),
            poses=quantised(poses, steps, own if drifting else None),
            counts=np.concatenate([old.counts, np.array([len(p.depths) for p in points], dtype=np.int64)]),
            cells=np.concatenate([old.cells, *(p.cells for p in points)]),
            depths=np.concatenate([old.depths, *(p.depths for p in points)]),
            descriptors=self._descriptors(old, points),
            matches=np.array(names, dtype=np.int64).reshape(-1, 3),
            transforms=np.array([quantised_match(m.T_M_Q, steps) for m in matches], dtype=np.int64).reshape(-1, 7),
        )

    def _points(self, index: int, steps: Steps) -> _KeyframePoints:
        """The points that are sold with a key-frame: of those not sold yet."""
        keyframe = self.state.keyframes[index]
        fresh = np.array([i not in self._sold for i in keyframe.point_ids.tolist()], dtype=bool)
        rows = np.flatnonzero(fresh & sellable(keyframe.points_C))
        rows = well_spread(keyframe.points_C, rows, self._config.max_points)
        self._sold.update(keyframe.point_ids[rows].tolist())
        coded = quantised_points(keyframe.points_C[rows], steps)
        return _KeyframePoints(coded.cells, coded.depths, keyframe.descriptors[rows[coded.order]])

    def _descriptors(self, old: QuantisedMap, points: list[_KeyframePoints]) -> NDArray[np.uint8] | None:
        if not self._config.descriptors:
            return None
        first = np.zeros((0, 32), dtype=np.uint8) if old.descriptors is None else old.descriptors
        return np.concatenate([first, *(p.descriptors for p in points)])


def _in_old_order(old: QuantisedMap, matches: list[Match]) -> list[Match]:
    """Matches that the last version had come first, in its order; so that only new ones need travel."""
    rank = {tuple(row): n for n, row in enumerate(old.matches.tolist())}
    return sorted(matches, key=lambda m: (rank.get((m.id.query, m.id.match_agent, m.id.match), len(rank)), m.id))


def _says_nothing_new(base: QuantisedMap, wanted: QuantisedMap) -> bool:
    same = base.frame == wanted.frame and abs(base.unit - wanted.unit) <= _SAME_UNIT * wanted.unit
    if not same or not np.array_equal(base.keyframes, wanted.keyframes):
        return False
    if not np.array_equal(base.matches, wanted.matches):
        return False
    moves = wanted.poses - widened(base.poses, wanted.poses.shape[1])
    return bool(Bound().worst(moves).max(initial=0.0) <= 1.0)
