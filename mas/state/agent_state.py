"""Knowledge of one agent: its key-frames with their estimated poses, its matches and its group."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import StrEnum
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from maslam.backend.geometry import Array, Sim3, se3_inverse
from maslam.backend.pose_graph.graph import Edge
from maslam.descriptors.codes import Coder

from ..config import MasConfig
from ..errors import MasError
from ..protocol.ids import FrameId, MatchId
from .keyframe import KeyFrame
from .place_match import Agreement, Match


@dataclass(frozen=True)
class Piece:
    """One uninterrupted track as a rigid piece of the agent's graph, until an optimisation bends it.

    ``first``: index of its first key-frame; ``frame``: the coordinates its estimates are in; ``metric``: whether these
    are in metres, as those are that a metric agent has a share in.
    """

    track: int
    first: int
    frame: FrameId
    metric: bool


class Ownership(StrEnum):
    """Agents that keep place vectors of others and answer queries with them: none, each agent those of one cluster, or
    one agent at a time all there are."""

    NONE = "none"
    CLUSTERS = "clusters"
    DIRECTORY = "directory"


@dataclass(frozen=True)
class Profile:
    """Identity of an agent, and the names of the others: all that it gets when it is set up. On a real network it
    knows nobody at first, and meets the others one by one.

    ``model``: hash of the descriptor's network; ``threshold``: its calibrated distance, ``strict_threshold``: the one
    at which appearance alone decides; ``coder``: how place vectors travel, the same for all; ``ownership``: who keeps
    them; ``centres`` ``(k, d)``: of the clusters that have owners, in the numbers that travel, else None;
    ``pixel_deg``: what a pixel of its camera spans, degrees; ``complete``: there are no agents but these. On a real
    network others may know agents that this one has not met.
    """

    me: int
    others: tuple[int, ...]
    metric: bool
    model: str
    threshold: float
    coder: Coder
    ownership: Ownership = Ownership.NONE
    centres: NDArray[np.float32] | None = None
    strict_threshold: float | None = None
    pixel_deg: float = 0.0
    complete: bool = True

    def __post_init__(self) -> None:
        if (self.ownership is Ownership.CLUSTERS) != (self.centres is not None):
            raise MasError(f"agent {self.me}: centres are for owners of clusters, not for ownership {self.ownership}")

    @cached_property
    def everyone(self) -> frozenset[int]:
        """The agent and all others."""
        return frozenset({self.me, *self.others})

    def known(self, members: Iterable[int]) -> tuple[int, ...]:
        """Those of these agents that it knows, in their order."""
        return tuple(a for a in members if a in self.everyone)

    @cached_property
    def language(self) -> int:
        """Code of model and place code that goes with every query: 32 bits of a hash of both."""
        return int.from_bytes(hashlib.sha256(f"{self.model} {self.coder.key}".encode()).digest()[:4], "big")


@dataclass
class AgentState:
    """The mutable state of an agent; changed by the agent and its operations only.

    ``poses``: ``T_F_C`` ``(4, 4)`` of each key-frame in its piece's coordinates; ``units``: what one of the key-frame's
    own units of length is worth there. With one camera the unit drifts on the way, so each key-frame has its own; a
    metric agent's are all 1.
    """

    profile: Profile
    config: MasConfig
    keyframes: list[KeyFrame] = field(default_factory=list)
    poses: list[Array] = field(default_factory=list)
    units: list[float] = field(default_factory=list)
    pieces: list[Piece] = field(default_factory=list)
    travelled: list[float] = field(default_factory=list)
    verified: dict[MatchId, Match] = field(default_factory=dict)
    accepted: set[MatchId] = field(default_factory=set)
    group: set[int] = field(default_factory=set)
    version: int = 0
    distrusted: set[int] = field(default_factory=set)
    contradicted: frozenset[MatchId] = frozenset()
    # By its second key-frame: an odometry edge stays what it was made.
    odometry: dict[int, Edge] = field(default_factory=dict)
    # What others' positions have shown odometry's lengths to be, by track, and how often that has changed.
    lengths: dict[int, float] = field(default_factory=dict)
    length_changes: int = 0
    lengths_settled: bool = True
    # What the last optimisation multiplied all lengths of odometry by, and by how much more it turned it, rad/m.
    odometry_length: float = 1.0
    odometry_turn: Array = field(default_factory=lambda: np.zeros(3))
    _agreements: dict[frozenset[tuple[int, int]], Agreement] = field(default_factory=dict)
    _mine: dict[frozenset[tuple[int, int]], Agreement] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.group.add(self.profile.me)

    @property
    def me(self) -> int:
        """The agent's own number."""
        return self.profile.me

    def meet(self, other: int) -> None:
        """Another agent is there, which this one did not know of."""
        if other != self.me and other not in self.profile.everyone:
            self.profile = replace(self.profile, others=tuple(sorted({*self.profile.others, other})))

    def observe(self, keyframe: KeyFrame) -> None:
        """Add a key-frame: chained rigidly to the one before, in its unit, or the start of a new piece."""
        if keyframe.index != len(self.keyframes):
            raise ValueError(f"agent {self.me}: key-frame {keyframe.index} after {len(self.keyframes)} of them")
        if not self.pieces or self.pieces[-1].track != keyframe.track:
            own = FrameId(self.me, keyframe.track)
            self.pieces.append(Piece(keyframe.track, keyframe.index, own, self.profile.metric))
            self.poses.append(keyframe.T_T_C)
            self.units.append(1.0)
            self.travelled.append(self.travelled[-1] if self.travelled else 0.0)
        else:
            step = self.odometry_step(keyframe)
            self.travelled.append(self.travelled[-1] + float(np.linalg.norm(step[:3, 3])))
            self.poses.append(self.poses[-1] @ stretched(step, self.units[-1]))
            self.units.append(self.units[-1])
        self.keyframes.append(keyframe)
        self.version += 1

    def odometry_step(self, keyframe: KeyFrame) -> Array:
        """``T_previous_this`` ``(4, 4)`` by odometry, own unit; both in one track."""
        return se3_inverse(self.keyframes[keyframe.index - 1].T_T_C) @ keyframe.T_T_C

    def piece_of(self, index: int) -> Piece:
        """The piece a key-frame belongs to."""
        return self.piece(self.keyframes[index].track)

    def piece(self, track: int) -> Piece:
        """The piece made of ``track``; ValueError if the agent has none."""
        for piece in self.pieces:
            if piece.track == track:
                return piece
        raise ValueError(f"agent {self.me} has no track {track}")

    def members(self, track: int) -> range:
        """Indices of the key-frames of one track."""
        piece = self.piece(track)
        later = [p.first for p in self.pieces if p.first > piece.first]
        return range(piece.first, min(later, default=len(self.keyframes)))

    @property
    def frame(self) -> FrameId:
        """The coordinates that most of its key-frames are in (ties: the older piece's)."""
        sizes: dict[FrameId, int] = {}
        for piece in self.pieces:
            sizes[piece.frame] = sizes.get(piece.frame, 0) + len(self.members(piece.track))
        return max(sizes, key=lambda f: sizes[f]) if sizes else FrameId(self.me, 0)

    def depths(self) -> dict[tuple[int, int], float]:
        """Median depth of each track's key-frames, in the units of its coordinates."""
        found = {p.track: [self.depth(i) for i in self.members(p.track)] for p in self.pieces}
        return {(self.me, track): float(np.median(depths)) for track, depths in found.items()}

    def depth(self, index: int) -> float:
        """Median depth of a key-frame, in the units of its coordinates."""
        return self.keyframes[index].depth * self.units[index]

    def placed(self) -> list[int]:
        """Key-frames in :attr:`frame`; the others belong to tracks that no match has joined yet."""
        frame = self.frame
        return [i for p in self.pieces if p.frame == frame for i in self.members(p.track)]

    def pose(self, index: int) -> Sim3:
        """``T_F_C`` with the key-frame's own unit of length as scale."""
        pose = self.poses[index]
        return Sim3(pose[:3, :3], pose[:3, 3], self.units[index])

    def place_again(
        self,
        places: Sequence[Sim3],
        pieces: Sequence[Piece],
        lengths: Mapping[int, float],
        odometry_length: float,
        version: int,
    ) -> None:
        """Stand where it stood at the end of an earlier run: ``places``: each key-frame's pose, with its unit as
        scale; ``version``: how often the state had changed by then."""
        self.poses = [place.se3() for place in places]
        self.units = [1.0 if self.profile.metric else place.scale for place in places]
        self.pieces, self.lengths = list(pieces), dict(lengths)
        self.odometry_length, self.version = odometry_length, version

    # -- matches ------------------------------------------------------------------------------------------------------

    def add_match(self, match: Match) -> list[MatchId]:
        """Remember a verified match; returns the matches that became accepted by it (it among them, or not)."""
        if match.id in self.verified:
            return []
        self.verified[match.id] = match
        pair = frozenset(match.tracks)
        self._agreements.setdefault(pair, Agreement(self.config.consistency)).add(match)
        if match.id.match_agent == self.me != match.id.query_agent:
            self._mine.setdefault(pair, Agreement(self.config.consistency)).add(match)
        return self._accept(pair)

    def distrust(self, other: int, distrusted: bool) -> None:
        """From now on use only those matches with the other that this agent verified itself; or all again."""
        (self.distrusted.add if distrusted else self.distrusted.discard)(other)
        for pair in [p for p in self._agreements if other in {agent for agent, _ in p}]:
            self._accept(pair)

    def agreements_with(self, other: int) -> list[tuple[set[MatchId], list[MatchId]]]:
        """For each pair of tracks with another agent: the matches that agree, and all."""
        pairs = [p for p in sorted(self._agreements, key=sorted) if {a for a, _ in p} == {self.me, other}]
        return [(self._agreeing(p), list(self._agreements[p].ids)) for p in pairs]

    def _accept(self, pair: frozenset[tuple[int, int]]) -> list[MatchId]:
        """Take over what agrees between two tracks; returns what became accepted by it."""
        now = self._agreeing(pair)
        if self.distrusted.intersection(agent for agent, _ in pair):
            now = self._mine[pair].accepted() if pair in self._mine else set()
        before = self.accepted.intersection(self._agreements[pair].ids)
        self.accepted = (self.accepted - before) | now
        self.version += bool(now != before)
        return sorted(now - before)

    def _agreeing(self, pair: frozenset[tuple[int, int]]) -> set[MatchId]:
        """The matches between two tracks that agree with each other. Where all of them were computed by the other
        agent, and contradict what this one computed itself and finds in agreement, it believes itself."""
        found = self._agreements[pair].accepted()
        mine = self._mine.get(pair)
        if mine is None or found.intersection(mine.ids):
            return found
        return mine.accepted() or found

    def accepted_matches(self) -> list[Match]:
        """Sorted by id."""
        return [self.verified[i] for i in sorted(self.accepted)]

    def partners(self) -> list[int]:
        """Agents it has an accepted match with, sorted."""
        return sorted({a for m in self.accepted for a in m.agents} - {self.me})

    def note_length(self, track: int, length: float, changed: bool, most: int) -> None:
        """An optimisation has shown odometry's lengths on a track to be ``length`` times what it said; ``changed``: by
        more than before. After ``most`` changes they count as settled."""
        self.lengths[track] = length
        self.length_changes += int(changed)
        self.lengths_settled = self.lengths_settled and (not changed or self.length_changes > most)

    def note_lengths_settled(self) -> None:
        """An optimisation begins to judge odometry's lengths anew."""
        self.lengths_settled = True

    def join(self, members: Iterable[int]) -> bool:
        """Grow the group; whether it grew."""
        before = len(self.group)
        self.group.update(members)
        return len(self.group) > before


def thinned(rows: NDArray[np.int64], limit: int) -> NDArray[np.int64]:
    """At most ``limit`` of the rows, spread evenly."""
    return rows if len(rows) <= limit else rows[np.linspace(0, len(rows) - 1, limit).astype(np.int64)]


def stretched(transform: Array, factor: float | Array) -> Array:
    """A rigid transform with its translation times ``factor``; of many ``(n, 4, 4)``, factors ``(n, 1)``."""
    out = transform.copy()
    out[..., :3, 3] *= factor
    return out
