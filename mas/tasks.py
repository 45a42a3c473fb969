"""What contracts are about: the tasks that awards carry and the outcomes that results bring, checked when they come
in."""

from __future__ import annotations

from typing import Annotated

import msgspec
import numpy as np

from backend.quantise import RANGES
from backend.verification import DESCRIPTOR_BYTES
from mas.identities import (
    MAX_AGENTS,
    MAX_POINTS,
    MAX_VECTOR_BYTES,
    Agent,
    FrameId,
    Index,
    MatchId,
    Members,
    Reason,
    Stamp,
)
from mas.tensors import (
    MAX_TRANSLATION,
    TRIANGLE,
    Tensor,
    check,
    check_points,
    check_poses,
    check_sim3,
    check_sim3s,
)

# -- tasks: what an award asks for ------------------------------------------------------------------------------------


class PlaceQuery(msgspec.Struct, frozen=True, array_like=True, tag=1):
    """Which of your key-frames looks most like this one? ``vector`` ``(bytes,)``: its place vector in ``code``
    (:mod:`descriptors.codes`); ``model``: the first digits of the hash of the network that made it. Who speaks another
    code or model refuses the work."""

    keyframe: Index
    model: Annotated[str, msgspec.Meta(max_length=64)]
    code: Annotated[str, msgspec.Meta(min_length=1, max_length=32)]
    vector: Tensor

    def __post_init__(self) -> None:
        count = len(check("vector", self.vector, "|u1", (None,)))
        if not 0 < count <= MAX_VECTOR_BYTES:
            raise ValueError(f"vector: {count} bytes, expected 1 to {MAX_VECTOR_BYTES}")


class VerifyTask(msgspec.Struct, frozen=True, array_like=True, tag=2):
    """Verify a place match by geometry: the query's map points in its camera, with ORB descriptors ``(n, w)``, whole or
    their first 16 or 8 bytes, or vocabulary words ``(n,)``; ``T_T_Q``: the query camera in its own track, by odometry,
    and ``way``: how far it had travelled by then.

    ``points``: ``(n, 3)`` float32, or ``(n,)`` uint32 codes with their ``ranges`` ``(6,)`` (:mod:`backend.quantise`).
    ``more``: points kept back, which the answer may ask for; ``rest``: these are they, and the first ones came before.
    """

    match: MatchId
    track: Index
    stamp_ns: Stamp
    metric: bool
    T_T_Q: Tensor
    way: Annotated[float, msgspec.Meta(ge=0)]
    points: Tensor
    descriptors: Tensor | None
    words: Tensor | None
    ranges: Tensor | None = None
    more: Index = 0
    rest: bool = False

    def __post_init__(self) -> None:
        n = self._check_points()
        check_poses("T_T_Q", self.T_T_Q, "<f8", ())
        if n > MAX_POINTS or (self.descriptors is None) == (self.words is None):
            raise ValueError(f"points: {n} of them, with exactly one of descriptors and words")
        if self.descriptors is not None:
            check("descriptors", self.descriptors, "|u1", (n, None))
            if self.descriptors.shape[1] not in DESCRIPTOR_BYTES:
                raise ValueError(f"descriptors: {self.descriptors.shape[1]} bytes each, not one of {DESCRIPTOR_BYTES}")
        if self.words is not None:
            check("words", self.words, "<u2", (n,))

    def _check_points(self) -> int:
        """How many there are."""
        if self.ranges is None:
            return check_points("points", self.points, None)
        ranges = check("ranges", self.ranges, "<f4", (RANGES,))
        if (ranges[:3] > ranges[3:]).any() or np.abs(ranges).max() > MAX_TRANSLATION:
            raise ValueError("ranges: low above high, or too far")
        return len(check("points", self.points, "<u4", (None,)))

    @property
    def parts(self) -> tuple[Tensor, ...]:
        """What it takes to describe the view."""
        return tuple(t for t in (self.points, self.ranges, self.descriptors, self.words) if t is not None)


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
    """The verdict on a match: ``T_M_Q`` (Sim(3)) and ``information``, the upper triangle ``(21,)`` of the 6x6 matrix in
    float32, where it holds; the match camera in its own track by odometry, its way so far and its median depth, so that
    both sides can judge whether matches agree with each other. ``wants_more``: not decided, the points kept back are
    asked for."""

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
    wants_more: bool = False

    def __post_init__(self) -> None:
        check_poses("T_T_M", self.T_T_M, "<f8", ())
        if self.accepted and (self.T_M_Q is None or self.information is None):
            raise ValueError("T_M_Q: an accepted match without its transform or information")
        if self.T_M_Q is not None:
            check_sim3("T_M_Q", self.T_M_Q)
        if self.information is not None:
            check("information", self.information, "<f4", (TRIANGLE,))
        if self.accepted and self.wants_more:
            raise ValueError("wants_more: of an accepted match")


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
