"""Every word between agents: typed, versioned, bounded, checked when it comes in. Nothing else travels.

A :class:`Message` is a header and one body. Bodies are the contract net's (Smith 1980, thesis sections 2.1.6 and 3.8;
with confirmation: 2.2.5) and, while an optimisation runs, those of the solver in :mod:`mas.solver_messages`. What an
operation needs travels inside award (the task) and result (the outcome): no work exists without its contract.
"""

from __future__ import annotations

from enum import IntEnum
from typing import Annotated

import msgspec
import numpy as np

from mas.solver_messages import SolverDecision, SolverReport, SolverValues
from mas.tensors import EMPTY_SIM3S, MessageError, Tensor, check, check_points, check_poses, check_sim3, check_sim3s

VERSION = 1

# Bounds of single fields: generous for any real run, small enough that a hostile message cannot fill the memory.
MAX_AGENTS = 4096
MAX_POINTS = 1_000_000
Agent = Annotated[int, msgspec.Meta(ge=0, lt=MAX_AGENTS)]
Index = Annotated[int, msgspec.Meta(ge=0, le=2**31)]
Stamp = Annotated[int, msgspec.Meta(ge=-(2**62), le=2**62)]
Reason = Annotated[str, msgspec.Meta(max_length=200)]
Members = Annotated[tuple[Agent, ...], msgspec.Meta(max_length=MAX_AGENTS)]


class Operation(IntEnum):
    """What a contract is about; the thesis's three operations, place recognition in its two halves."""

    DVPR = 0
    RELPOSE = 1
    DOPT = 2
    MAPMERGE = 3


class ContractId(msgspec.Struct, frozen=True, array_like=True, order=True):
    """The manager's number for one call for proposals."""

    manager: Agent
    number: Index


class MatchId(msgspec.Struct, frozen=True, array_like=True, order=True):
    """A place match: key-frame ``query`` of ``query_agent`` was recognised in ``match`` of ``match_agent``."""

    query_agent: Agent
    query: Index
    match_agent: Agent
    match: Index

    @property
    def agents(self) -> tuple[int, int]:
        return self.query_agent, self.match_agent


class FrameId(msgspec.Struct, frozen=True, array_like=True, order=True):
    """A coordinate frame O: the camera of the first key-frame of one agent's track; its unit is that track's own."""

    agent: Agent
    track: Index


# -- tasks: what an award asks for ------------------------------------------------------------------------------------


class PlaceQuery(msgspec.Struct, frozen=True, array_like=True, tag=1):
    """Which of your key-frames looks most like this one? ``vector`` ``(dim,)`` float32, unit length; ``model``: hash of
    the network that made it."""

    keyframe: Index
    model: Annotated[str, msgspec.Meta(max_length=64)]
    vector: Tensor

    def __post_init__(self) -> None:
        v = check("vector", self.vector, "<f4", (None,))
        if not len(v) or np.abs(v).max() > 1.01 or abs(float(np.linalg.norm(v)) - 1.0) > 1e-2:
            raise ValueError("vector: not of length 1")


class VerifyTask(msgspec.Struct, frozen=True, array_like=True, tag=2):
    """Verify a place match by geometry: the query's map points in its camera, ``(n, 3)`` float32, with ORB descriptors
    ``(n, 32)`` or vocabulary words ``(n,)``; ``T_T_Q``: the query camera in its own track, by
    odometry, and ``way``: how far it had travelled by then."""

    match: MatchId
    track: Index
    stamp_ns: Stamp
    metric: bool
    T_T_Q: Tensor
    way: Annotated[float, msgspec.Meta(ge=0)]
    points: Tensor
    descriptors: Tensor | None
    words: Tensor | None

    def __post_init__(self) -> None:
        n = check_points("points", self.points, None)
        check_poses("T_T_Q", self.T_T_Q, "<f8", ())
        if n > MAX_POINTS or (self.descriptors is None) == (self.words is None):
            raise ValueError(f"points: {n} of them, with exactly one of descriptors and words")
        if self.descriptors is not None:
            check("descriptors", self.descriptors, "|u1", (n, 32))
        if self.words is not None:
            check("words", self.words, "<u2", (n,))


class OptimiseTask(msgspec.Struct, frozen=True, array_like=True, tag=3):
    """Take part in a distributed optimisation of ``members``, with the recipient's ``tracks`` and ``matches``.

    The result is in ``frame``, where one of the anchor's own units is worth ``unit``. ``placements``
    ``(n, 8)``: how the recipient's ``present`` coordinates stand in that frame before optimising, ``T_frame_present``.
    """

    members: Members
    frame: FrameId
    unit: Annotated[float, msgspec.Meta(gt=0)]
    tracks: Annotated[tuple[Index, ...], msgspec.Meta(max_length=4096)]
    matches: Annotated[tuple[MatchId, ...], msgspec.Meta(max_length=100_000)]
    present: Annotated[tuple[FrameId, ...], msgspec.Meta(max_length=4096)]
    placements: Tensor

    def __post_init__(self) -> None:
        check_sim3s("placements", self.placements, len(self.present))


class MapOrder(msgspec.Struct, frozen=True, array_like=True, tag=4):
    """Deliver the maps of these owners, as they stood in the bid."""

    owners: Members


Task = PlaceQuery | VerifyTask | OptimiseTask | MapOrder


# -- outcomes: what a result brings -----------------------------------------------------------------------------------


class PlaceAnswer(msgspec.Struct, frozen=True, array_like=True, tag=1):
    """The nearest key-frame and its Euclidean distance, 0 to 2; None: none to compare with."""

    keyframe: Index | None
    distance: Annotated[float, msgspec.Meta(ge=0, le=2.001)]


class VerifyAnswer(msgspec.Struct, frozen=True, array_like=True, tag=2):
    """The verdict on a match: ``T_M_Q`` (Sim(3)) and ``information`` ``(6, 6)`` where it holds; the match camera in its
    own track by odometry, its way so far and its median depth, so that both sides can judge whether matches agree
    with each other."""

    match: MatchId
    accepted: bool
    reason: Reason
    matches: Index
    inliers: Index
    rmse: float | None
    T_M_Q: Tensor | None
    information: Tensor | None
    track: Index
    stamp_ns: Stamp
    T_T_M: Tensor
    way: Annotated[float, msgspec.Meta(ge=0)]
    depth: Annotated[float, msgspec.Meta(gt=0)]

    def __post_init__(self) -> None:
        check_poses("T_T_M", self.T_T_M, "<f8", ())
        if self.accepted and (self.T_M_Q is None or self.information is None):
            raise ValueError("T_M_Q: an accepted match without its transform or information")
        if self.T_M_Q is not None:
            check_sim3("T_M_Q", self.T_M_Q)
        if self.information is not None:
            matrix = check("information", self.information, "<f8", (6, 6))
            if np.abs(matrix - matrix.T).max() > 1e-6 * max(np.abs(matrix).max(), 1.0):
                raise ValueError("information: not symmetric")


class OptimiseAnswer(msgspec.Struct, frozen=True, array_like=True, tag=3):
    """How the optimisation ended, the same at every member; costs of the whole group."""

    improved: bool
    cost_before: float
    cost_after: float
    sweeps: Index


class SubMap(msgspec.Struct, frozen=True, array_like=True):
    """A copy of one agent's map, in the seller's coordinates; ``unit``: what the owner's own unit of length is worth
    there.

    ``keyframes`` ``(K,)`` int32 indices; ``stamps_ns`` ``(K,)`` int64; ``poses`` ``(K, 7)`` float64 ``T_F_C``;
    ``references`` ``(P,)`` int32: row of the key-frame that saw the point first; ``points`` ``(P, 3)`` float32 in that
    camera, owner's unit; ``descriptors`` ``(P, 32)``; ``matches``: the owner's accepted ones, with
    ``transforms`` ``(m, 8)``: their ``T_M_Q``.
    """

    owner: Agent
    version: Index
    unit: Annotated[float, msgspec.Meta(gt=0)]
    keyframes: Tensor
    stamps_ns: Tensor
    poses: Tensor
    references: Tensor
    points: Tensor
    descriptors: Tensor
    matches: Annotated[tuple[MatchId, ...], msgspec.Meta(max_length=100_000)]
    transforms: Tensor

    def __post_init__(self) -> None:
        k = len(check("keyframes", self.keyframes, "<i4", (None,)))
        check("stamps_ns", self.stamps_ns, "<i8", (k,))
        check_poses("poses", self.poses, "<f8", (k,))
        references = check("references", self.references, "<i4", (None,))
        check_points("points", self.points, len(references))
        check("descriptors", self.descriptors, "|u1", (len(references), 32))
        if len(references) and (references.min() < 0 or references.max() >= k):
            raise ValueError(f"references: a point refers to a key-frame beyond the {k} there are")
        if k and (np.diff(self.keyframes.array()) <= 0).any():
            raise ValueError("keyframes: not ascending")
        check_sim3s("transforms", self.transforms, len(self.matches))

    @property
    def payload_bytes(self) -> int:
        """Poses, points with descriptors and matches as raw numbers: what the published tables count."""
        parts = (
            self.keyframes,
            self.stamps_ns,
            self.poses,
            self.references,
            self.points,
            self.descriptors,
            self.transforms,
        )
        return sum(p.nbytes for p in parts) + 16 * len(self.matches)


class MapDelivery(msgspec.Struct, frozen=True, array_like=True, tag=4):
    """The maps ordered, all in the seller's coordinates ``frame``; ``ties``: the seller's key-frames that it has
    accepted matches with the buyer for, and ``tie_poses`` ``(n, 8)``: where they stand there, Sim(3), so that a buyer
    with other coordinates can place the maps."""

    frame: FrameId
    ties: Annotated[tuple[Index, ...], msgspec.Meta(max_length=100_000)]
    tie_poses: Tensor
    maps: Annotated[tuple[SubMap, ...], msgspec.Meta(max_length=MAX_AGENTS)]

    def __post_init__(self) -> None:
        check_sim3s("tie_poses", self.tie_poses, len(self.ties))


Outcome = PlaceAnswer | VerifyAnswer | OptimiseAnswer | MapDelivery


# -- terms: what a bid offers -----------------------------------------------------------------------------------------


class Links(msgspec.Struct, frozen=True, array_like=True):
    """Accepted matches as one of their owners holds them, one row for each own end.

    ``poses`` ``(n, 8)``: the owner's key-frames in ``frames`` as it believes now, Sim(3) with the owner's unit as
    scale; ``query``: which rows are the query's end, and for those, in order, ``transforms`` ``(q, 8)``: ``T_M_Q``.
    """

    matches: Annotated[tuple[MatchId, ...], msgspec.Meta(max_length=100_000)] = ()
    tracks: Annotated[tuple[Index, ...], msgspec.Meta(max_length=100_000)] = ()
    frames: Annotated[tuple[FrameId, ...], msgspec.Meta(max_length=100_000)] = ()
    query: Annotated[tuple[bool, ...], msgspec.Meta(max_length=100_000)] = ()
    poses: Tensor = EMPTY_SIM3S
    transforms: Tensor = EMPTY_SIM3S

    def __post_init__(self) -> None:
        n = len(self.matches)
        if not n == len(self.tracks) == len(self.frames) == len(self.query):
            raise ValueError(f"links: {n} matches with other numbers of tracks, frames and ends")
        check_sim3s("poses", self.poses, n)
        check_sim3s("transforms", self.transforms, sum(self.query))


class PieceTerms(msgspec.Struct, frozen=True, array_like=True):
    """A track that its agent would bring into an optimisation: the coordinates it is in, and its unit there."""

    track: Index
    frame: FrameId
    unit: Annotated[float, msgspec.Meta(gt=0)]


class Offer(msgspec.Struct, frozen=True, array_like=True):
    """A map for sale: whose, which version, how many key-frames."""

    owner: Agent
    version: Index
    keyframes: Index


# -- bodies -----------------------------------------------------------------------------------------------------------


class Call(msgspec.Struct, frozen=True, array_like=True, tag=1):
    """Call for proposals: manager to possible contractors. ``members``: who is asked, where that matters."""

    operation: Operation
    deadline_ns: Stamp
    members: Members = ()


class Bid(msgspec.Struct, frozen=True, array_like=True, tag=2):
    """I can do it: ``cost_bytes`` that the result will take (estimate), by ``ready_ns``; with the state the operation
    needs: ``links`` and ``pieces`` (optimisation), ``offers`` (maps)."""

    cost_bytes: Index
    ready_ns: Stamp
    links: Links = Links()
    pieces: Annotated[tuple[PieceTerms, ...], msgspec.Meta(max_length=4096)] = ()
    offers: Annotated[tuple[Offer, ...], msgspec.Meta(max_length=MAX_AGENTS)] = ()


class Refusal(msgspec.Struct, frozen=True, array_like=True, tag=3):
    """I do not bid."""

    reason: Reason


class Award(msgspec.Struct, frozen=True, array_like=True, tag=4):
    """The bid is taken; here is the task."""

    task: Task


class Rejection(msgspec.Struct, frozen=True, array_like=True, tag=5):
    """The bid is not taken."""

    reason: Reason


class Confirmation(msgspec.Struct, frozen=True, array_like=True, tag=6):
    """The contractor commits itself, only now (contract net with confirmation)."""


class Result(msgspec.Struct, frozen=True, array_like=True, tag=7):
    """The work is done."""

    outcome: Outcome


class Failure(msgspec.Struct, frozen=True, array_like=True, tag=8):
    """The contractor cannot do the work it was awarded."""

    reason: Reason


class Cancel(msgspec.Struct, frozen=True, array_like=True, tag=9):
    """The manager withdraws the contract."""

    reason: Reason


class Begin(msgspec.Struct, frozen=True, array_like=True, tag=10):
    """All members have confirmed: the optimisation starts."""


class GroupNotice(msgspec.Struct, frozen=True, array_like=True, tag=11):
    """These agents are joined by place matches, directly or through others, as far as I know."""

    members: Members


ContractBody = Call | Bid | Refusal | Award | Rejection | Confirmation | Result | Failure | Cancel
Body = ContractBody | Begin | GroupNotice | SolverValues | SolverReport | SolverDecision


class Message(msgspec.Struct, frozen=True, array_like=True):
    """Header and body. ``contract`` is None for notices only."""

    sender: Agent
    recipient: Agent
    contract: ContractId | None
    body: Body
    version: int = VERSION

    def __post_init__(self) -> None:
        if self.version != VERSION:
            raise ValueError(f"version {self.version} of the protocol, expected {VERSION}")


_encoder = msgspec.msgpack.Encoder()
_decoder = msgspec.msgpack.Decoder(Message)


def encode(message: Message) -> bytes:
    """The exact bytes that travel: MessagePack."""
    return _encoder.encode(message)


def decode(data: bytes, max_bytes: int) -> Message:
    """The message in ``data``, or :class:`MessageError` saying what is wrong with it."""
    if len(data) > max_bytes:
        raise MessageError(f"message of {len(data)} bytes, at most {max_bytes} are taken")
    try:
        return _decoder.decode(data)
    except (msgspec.MsgspecError, ValueError, UnicodeDecodeError, OverflowError) as error:
        raise MessageError(f"message of {len(data)} bytes cannot be read: {error}") from error
