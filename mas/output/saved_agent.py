"""What an agent knows at the end of a run, in one file of its folder, so that it can answer in a later run.

Its key-frames are not in it: they are those of its sequence. Its copies of others' maps are, in the compact form; in
the thesis's form, which takes many times as much, they are bought again.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Literal

import msgspec
import numpy as np

from maslam._atomic import write_atomically

from ..agent import Agent
from ..errors import MasError
from ..map_exchange.map_copy import copy_of_version
from ..map_exchange.versions import version_of
from ..protocol.ids import AgentId, FrameId, Index, MatchId, Members
from ..protocol.map_messages import Parcel
from ..protocol.tensors import (
    POSE_WIDTH,
    MessageError,
    Tensor,
    Unit,
    check,
    check_poses,
    check_sim3s,
    pack_poses,
    pack_sim3,
    pack_sim3s,
    unpack_poses,
    unpack_sim3,
    unpack_sim3s,
)
from ..state.agent_state import Piece
from ..state.keyframe import KeyFrame
from ..state.place_match import Match, MatchEnd

SAVED = "agent.msgpack"
_MOST_BYTES = 2**30
# Columns of a match beside its transform: track and length driven of both ends, depth, inliers, sigma of its log scale
# or NaN.
_COLUMNS = 7
_Matches = Annotated[tuple[MatchId, ...], msgspec.Meta(max_length=1_000_000)]


class SavedPiece(msgspec.Struct, frozen=True, array_like=True):
    """See :class:`~..state.agent_state.Piece`."""

    track: Index
    first: Index
    frame: FrameId
    metric: bool


class SavedMatches(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Verified matches, a row each: ``transforms`` ``(m, 8)`` ``T_M_Q``; ``ends`` ``(m, 2, 7)``: cameras of match and
    query in their tracks; ``information`` ``(m, 6, 6)``; ``figures`` ``(m, 7)``: track and length driven of the
    match, of the query, depth, inliers, and the deviation of the log scale (NaN: both are metric)."""

    ids: _Matches
    transforms: Tensor
    ends: Tensor
    information: Tensor
    figures: Tensor

    def __post_init__(self) -> None:
        count = len(self.ids)
        check_sim3s("transforms", self.transforms, count)
        check_poses("ends", self.ends, "<f8", (count, 2))
        check("information", self.information, "<f8", (count, 6, 6))
        figures = check("figures", self.figures, "<f8", (count, _COLUMNS), finite=False)
        if not np.isfinite(figures[:, :-1]).all() or (figures[:, 4:6] <= 0).any():
            raise MessageError("figures: a match without depth or inliers")

    @classmethod
    def of(cls, matches: Sequence[Match]) -> SavedMatches:
        """The rows of these matches."""
        ends = [[m.match.T_T_C, m.query.T_T_C] for m in matches]
        rows = [
            (m.match.track, m.match.way, m.query.track, m.query.way, m.depth, m.inliers, _or_nan(m.scale_sigma))
            for m in matches
        ]
        return cls(
            tuple(m.id for m in matches),
            pack_sim3s([m.T_M_Q for m in matches]),
            pack_poses(np.array(ends).reshape(-1, 2, 4, 4)),
            Tensor.of(np.array([m.information for m in matches]).reshape(-1, 6, 6), "<f8"),
            Tensor.of(np.array(rows).reshape(-1, _COLUMNS), "<f8"),
        )

    def matches(self) -> list[Match]:
        """The matches of these rows."""
        ends, transforms = unpack_poses(self.ends.array()), unpack_sim3s(self.transforms)
        information, figures = self.information.array(), self.figures.array().tolist()
        out = []
        for row, (name, numbers) in enumerate(zip(self.ids, figures, strict=True)):
            track_M, way_M, track_Q, way_Q, depth, inliers, sigma = numbers
            match, query = MatchEnd(int(track_M), ends[row, 0], way_M), MatchEnd(int(track_Q), ends[row, 1], way_Q)
            scale_sigma = None if np.isnan(sigma) else sigma
            out.append(Match(name, query, match, transforms[row], information[row], int(inliers), depth, scale_sigma))
        return out


class SavedCopy(msgspec.Struct, frozen=True, array_like=True):
    """A map copy that was bought, in the compact form."""

    seller: AgentId
    parcel: Parcel


class SavedAgent(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """``places`` ``(K, 8)``: poses and units of its key-frames; ``state_version``: how often it had changed; ``used``:
    matches that an optimisation or an update has used; ``sent``: key-frames that each other agent was asked about;
    ``asked``, ``asked_vectors``: key-frames of others that it was asked about as the directory, rows of agent and
    key-frame, and their vectors as they came in the place code ``coder``; ``published``: the last version of its own
    map."""

    format: Literal[1]
    me: AgentId
    state_version: Index
    places: Tensor
    pieces: Annotated[tuple[SavedPiece, ...], msgspec.Meta(max_length=1_000_000)]
    group: Members
    distrusted: Members
    lengths: dict[Index, Unit]
    odometry_length: Unit
    matches: SavedMatches
    used: _Matches
    coder: str
    sent: dict[AgentId, tuple[Index, ...]]
    asked: Tensor
    asked_vectors: Tensor
    copies: tuple[SavedCopy, ...]
    published: Parcel | None

    def __post_init__(self) -> None:
        check_sim3s("places", self.places, len(check("places", self.places, "<f8", (None, POSE_WIDTH + 1))))
        rows = check("asked", self.asked, "<i8", (None, 2))
        check("asked_vectors", self.asked_vectors, "<f4", (len(rows), None))
        if len(rows) and rows.min() < 0:
            raise MessageError("asked: a number below 0")


def saved(agent: Agent) -> SavedAgent:
    """What this agent knows now."""
    state, asked = agent.state, agent.places.asked_about()
    copies = [copy for _, copy in sorted(agent.maps.copies.items()) if copy.map_version is not None]
    published = agent.maps.seller.published
    unused = agent.pending.matches - agent.optimisation.running.updates.considered
    return SavedAgent(
        format=1,
        me=state.me,
        state_version=state.version,
        places=pack_sim3s([state.pose(i) for i in range(len(state.keyframes))]),
        pieces=tuple(SavedPiece(p.track, p.first, p.frame, p.metric) for p in state.pieces),
        group=tuple(sorted(state.group)),
        distrusted=tuple(sorted(state.distrusted)),
        lengths=dict(sorted(state.lengths.items())),
        odometry_length=state.odometry_length,
        matches=SavedMatches.of([state.verified[m] for m in sorted(state.verified)]),
        used=tuple(sorted(state.accepted - unused)),
        coder=f"{state.profile.model} {state.profile.coder.key}",
        sent={a: agent.places.sent_queries.known_to(a) for a in state.profile.others},
        asked=Tensor.of(np.array(asked.keyframes, dtype=np.int64).reshape(-1, 2), "<i8"),
        asked_vectors=Tensor.of(asked.vectors, "<f4"),
        copies=tuple(
            SavedCopy(copy.seller, Parcel(copy.owner, pack_sim3(copy.placement), copy.route[:-1], (version.whole,)))
            for copy in copies
            if (version := copy.map_version) is not None
        ),
        published=None if published is None else Parcel(state.me, None, (), (published.whole,)),
    )


def write_saved(path: Path, agent: Agent) -> None:
    """Write what the agent knows; the same agent gives the same bytes."""
    write_atomically(path, msgspec.msgpack.encode(saved(agent)))


def read_saved(path: Path) -> SavedAgent:
    """What an agent knew; ``MasError`` where the file is missing, damaged or of another version."""
    if not path.is_file():
        raise MasError(f"{path}: missing: a run of an earlier version, or of a network's agent: run it again")
    if path.stat().st_size > _MOST_BYTES:
        raise MasError(f"{path}: {path.stat().st_size >> 20} MiB, {_MOST_BYTES >> 20} at most are read")
    try:
        return msgspec.msgpack.decode(path.read_bytes(), type=SavedAgent)
    except (msgspec.MsgspecError, MessageError, RecursionError) as error:
        raise MasError(f"{path}: damaged, or of another version: {error}") from error


def restore(agent: Agent, keyframes: Sequence[KeyFrame], known: SavedAgent, name: str) -> None:
    """Make a new agent of the key-frames what it was at the end of its run; ``name``: of the file, for errors. It asks
    nothing about these key-frames: it answers."""
    try:
        _restore(agent, keyframes, known)
    except MessageError as error:
        raise MasError(f"{name}: {error}") from error


def _restore(agent: Agent, keyframes: Sequence[KeyFrame], known: SavedAgent) -> None:
    state = agent.state
    places = unpack_sim3s(known.places)
    if len(places) != len(keyframes) or known.me != state.me:
        raise MessageError(f"agent {known.me} with {len(places)} key-frames, its sequence has {len(keyframes)}")
    for keyframe in keyframes:
        state.observe(keyframe)
        agent.candidates.remember(keyframe)
        if keyframe.textured:
            agent.places.sent_queries.remember(keyframe.index)
    if [(p.track, p.first) for p in state.pieces] != [(p.track, p.first) for p in known.pieces]:
        raise MessageError("other tracks than its sequence has")
    if any(m.end_of(state.me)[0] >= len(keyframes) or state.me not in m.agents for m in known.matches.ids):
        raise MessageError("a match of a key-frame that it does not have")
    for match in known.matches.matches():
        state.add_match(match)
    for other in known.distrusted:
        state.distrust(other, True)
    state.join(known.group)
    pieces = [Piece(p.track, p.first, p.frame, p.metric) for p in known.pieces]
    state.place_again(places, pieces, known.lengths, known.odometry_length, known.state_version)
    agent.pending.used(frozenset(known.used))
    if known.coder == f"{state.profile.model} {state.profile.coder.key}":
        agent.places.know(known.sent, known.asked.array().tolist(), known.asked_vectors.array())
    for copy in known.copies:
        version = version_of(copy.parcel.owner, None, copy.parcel.patches)
        placement = unpack_sim3(_placement(copy.parcel))
        route = (*copy.parcel.route, copy.seller)
        agent.maps.keep(copy_of_version(version, placement, route))
    if known.published is not None:
        agent.maps.seller.count_on(version_of(state.me, None, known.published.patches))


def _placement(parcel: Parcel) -> Tensor:
    """Where a copy was placed; :class:`MessageError` where that is missing."""
    if parcel.placement is None:
        raise MessageError(f"a copy of agent {parcel.owner}'s map without a place")
    return parcel.placement


def _or_nan(value: float | None) -> float:
    return float("nan") if value is None else value
