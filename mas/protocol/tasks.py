"""Contents of contracts: the tasks that awards carry and the outcomes that results bring, checked when they come
in."""

from __future__ import annotations

from typing import Annotated, ClassVar

import msgspec
import numpy as np

from maslam.backend.relpose.point_coding import RANGES
from maslam.backend.relpose.verification import DESCRIPTOR_BYTES

from .accounting import Counted
from .ids import (
    MAX_VECTOR_BYTES,
    MAX_VIEW_POINTS,
    AgentId,
    FrameId,
    Index,
    Language,
    MatchId,
    Members,
    OperationKind,
    Reason,
    Recording,
    Stamp,
)
from .map_messages import MapDelivery, MapOrder
from .tensors import (
    MAX_TRANSLATION,
    Depth,
    Length,
    MessageError,
    Tensor,
    check,
    check_finite,
    check_information,
    check_points,
    check_poses,
    check_sim3,
    check_sim3s,
)

# -- tasks: what an award asks for ------------------------------------------------------------------------------------


class PlaceQuery(Counted, frozen=True, array_like=True, tag=1):
    """Which of your key-frames looks most like this one? ``vector``: its place vector, coded
    (:mod:`maslam.descriptors.codes`); ``language``: 32 bits that stand for the network that made it and the code. Who
    uses another refuses the work."""

    belongs_to: ClassVar[OperationKind | None] = OperationKind.DVPR

    keyframe: Index
    language: Language
    vector: Annotated[bytes, msgspec.Meta(min_length=1, max_length=MAX_VECTOR_BYTES)]

    @property
    def payload_bytes(self) -> int:
        """The coded vector; as float32, 4 a number, in the tables."""
        return len(self.vector)


class OwnerQuery(PlaceQuery, frozen=True, array_like=True, tag=5):
    """The same to the owner of the cluster that the vector falls into: whose key-frame of those you were asked about
    looks most like this one? Remember this one, too."""

    @property
    def payload_bytes(self) -> int:
        """The vector, 1 and 4 more to the owner of a cluster."""
        return len(self.vector) + 1 + 4


class VerifyTask(Counted, frozen=True, array_like=True, tag=2):
    """Verify a place match by geometry: the query's map points in its camera, with ORB descriptors ``(n, w)``, whole or
    their first 16 or 8 bytes, or vocabulary words ``(n,)``; ``T_T_Q``: the query camera in its own track, by odometry,
    and ``way``: how far it had travelled by then. ``recording``: 32 bits that stand for the name of the recording that
    the image is of; with the stamp they name the image.

    ``points``: ``(n, 3)`` float32, or ``(n,)`` uint32 codes with their ``ranges`` ``(6,)``
    (:mod:`maslam.backend.relpose.point_coding`). ``more``: points kept back, which the answer may ask for; ``rest``:
    these are they, and the first ones came before.
    """

    belongs_to: ClassVar[OperationKind | None] = OperationKind.RELPOSE

    match: MatchId
    track: Index
    stamp_ns: Stamp
    recording: Recording
    metric: bool
    T_T_Q: Tensor
    way: Length
    points: Tensor
    descriptors: Tensor | None
    words: Tensor | None
    ranges: Tensor | None = None
    more: Index = 0
    rest: bool = False

    def __post_init__(self) -> None:
        n = self._check_points()
        check_finite("way", self.way)
        check_poses("T_T_Q", self.T_T_Q, "<f8", ())
        if n > MAX_VIEW_POINTS or (self.descriptors is None) == (self.words is None):
            raise MessageError(f"points: {n} of them, with exactly one of descriptors and words")
        if self.descriptors is not None:
            check("descriptors", self.descriptors, "|u1", (n, None))
            if self.descriptors.shape[1] not in DESCRIPTOR_BYTES:
                raise MessageError(
                    f"descriptors: {self.descriptors.shape[1]} bytes each, not one of {DESCRIPTOR_BYTES}"
                )
        if self.words is not None:
            check("words", self.words, "<u2", (n,))

    def _check_points(self) -> int:
        """Check the points; return their number."""
        if self.ranges is None:
            return check_points("points", self.points, None)
        ranges = check("ranges", self.ranges, "<f4", (RANGES,))
        if (ranges[:3] > ranges[3:]).any() or np.abs(ranges).max() > MAX_TRANSLATION:
            raise MessageError("ranges: low above high, or too far")
        return len(check("points", self.points, "<u4", (None,)))

    @property
    def parts(self) -> tuple[Tensor, ...]:
        """The tensors that describe the view."""
        return tuple(t for t in (self.points, self.ranges, self.descriptors, self.words) if t is not None)

    @property
    def payload_bytes(self) -> int:
        """1 + 4 + 4, and for each point 12 (4 on the grid) for its position and 32 for its descriptor (less where it is
        cut) or 2 for its word."""
        return 1 + 4 + 4 + sum(part.nbytes for part in self.parts)


class OptimiseTask(Counted, frozen=True, array_like=True, tag=3):
    """Take part in a distributed optimisation of ``members``, with the recipient's ``tracks`` and ``matches``.

    The result is in ``frame``; ``metric``: in metres. ``placements`` ``(n, 8)``: how the recipient's ``present``
    coordinates stand in that frame before optimising, ``T_frame_present``. ``arbitrary``: members with one camera,
    whose key-frames' units of length are looked for, too. ``positions``: some member brings positions (GPS).
    """

    belongs_to: ClassVar[OperationKind | None] = OperationKind.DOPT

    members: Members
    frame: FrameId
    metric: bool
    tracks: Annotated[tuple[Index, ...], msgspec.Meta(max_length=4096)]
    matches: Annotated[tuple[MatchId, ...], msgspec.Meta(max_length=100_000)]
    present: Annotated[tuple[FrameId, ...], msgspec.Meta(max_length=4096)]
    placements: Tensor
    arbitrary: Members = ()
    positions: bool = False

    def __post_init__(self) -> None:
        check_sim3s("placements", self.placements, len(self.present))
        if not set(self.members).issuperset(self.arbitrary):
            raise MessageError("arbitrary: of an agent that is no member")
        if not self.metric and set(self.arbitrary) != set(self.members):
            raise MessageError("metric: a metric member in coordinates that are not")


Task = PlaceQuery | OwnerQuery | VerifyTask | OptimiseTask | MapOrder


# -- outcomes: what a result brings -----------------------------------------------------------------------------------


class PlaceAnswer(Counted, frozen=True, array_like=True, tag=1):
    """The nearest key-frame and its Euclidean distance, 0 to 2; None: none to compare with."""

    belongs_to: ClassVar[OperationKind | None] = OperationKind.DVPR

    keyframe: Index | None
    distance: Annotated[float, msgspec.Meta(ge=0, le=2.001)]

    @property
    def payload_bytes(self) -> int:
        """Distance and key-frame."""
        return 8 + 4


class EarlierAnswer(Counted, frozen=True, array_like=True, tag=5):
    """Not for the key-frame just asked about, but for another that the manager asked about earlier, ``query``, there is
    now a nearer key-frame here."""

    belongs_to: ClassVar[OperationKind | None] = OperationKind.DVPR

    query: Index
    keyframe: Index
    distance: Annotated[float, msgspec.Meta(ge=0, le=2.001)]

    @property
    def payload_bytes(self) -> int:
        """Distance and two key-frames."""
        return 8 + 4 + 4


class PlaceRedirect(Counted, frozen=True, array_like=True, tag=6):
    """The owner of a cluster: key-frame ``keyframe`` of ``agent`` (the owner itself or any other) is the nearest that
    it was asked about; both None: it was asked about none of others yet."""

    belongs_to: ClassVar[OperationKind | None] = OperationKind.DVPR

    agent: AgentId | None
    keyframe: Index | None
    distance: Annotated[float, msgspec.Meta(ge=0, le=2.001)]

    def __post_init__(self) -> None:
        if (self.agent is None) != (self.keyframe is None):
            raise MessageError("agent: a redirect without its key-frame, or the other way round")

    @property
    def payload_bytes(self) -> int:
        """Distance, key-frame and agent."""
        return 8 + 4 + 1


class VerifyAnswer(Counted, frozen=True, array_like=True, tag=2):
    """The verdict on a match: ``T_M_Q`` (Sim(3)) and, where it holds, ``information`` in float32: the upper triangle
    ``(21,)`` of the 6x6 matrix, ``(28,)`` of the 7x7 one (log scale last) where a scale was estimated; the match camera
    in its own track by odometry, its way so far and its median depth, so that both sides can judge whether matches
    agree with each other; ``keyframes``: how many the match agent has made. ``wants_more``: not decided, the points
    kept back are asked for."""

    belongs_to: ClassVar[OperationKind | None] = OperationKind.RELPOSE

    match: MatchId
    accepted: bool
    reason: Reason
    matches: Index
    inliers: Index
    rmse: Annotated[float, msgspec.Meta(ge=0, le=180)] | None
    T_M_Q: Tensor | None
    information: Tensor | None
    track: Index
    stamp_ns: Stamp
    T_T_M: Tensor
    way: Length
    depth: Depth
    keyframes: Index
    wants_more: bool = False

    def __post_init__(self) -> None:
        check_poses("T_T_M", self.T_T_M, "<f8", ())
        check_finite("rmse, way, depth", self.rmse or 0.0, self.way, self.depth)
        if self.accepted and (self.T_M_Q is None or self.information is None):
            raise MessageError("T_M_Q: an accepted match without its transform or information")
        if self.T_M_Q is not None:
            check_sim3("T_M_Q", self.T_M_Q)
        if self.information is not None:
            check_information("information", self.information)
        if self.accepted and self.wants_more:
            raise MessageError("wants_more: of an accepted match")

    @property
    def payload_bytes(self) -> int:
        """Two vectors of 6 doubles."""
        return 2 * 6 * 8


class OptimiseAnswer(Counted, frozen=True, array_like=True, tag=3):
    """Outcome of an optimisation, the same at every member; costs of the whole group."""

    belongs_to: ClassVar[OperationKind | None] = OperationKind.DOPT

    improved: bool
    cost_before: float
    cost_after: float
    sweeps: Index


Outcome = PlaceAnswer | EarlierAnswer | PlaceRedirect | VerifyAnswer | OptimiseAnswer | MapDelivery
