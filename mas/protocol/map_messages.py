"""Maps as they are transmitted: as floating-point numbers (the thesis's form) or as changes of a quantised map, checked
when they arrive."""

from __future__ import annotations

from typing import Annotated, Any, ClassVar

import msgspec
import numpy as np
from numpy.typing import NDArray

from .accounting import Counted
from .ids import MAX_AGENTS, AgentId, FrameId, Index, MatchId, Members, OperationKind
from .tensors import SIM3_WIDTH, MessageError, Tensor, Unit, check, check_points, check_poses, check_sim3, check_sim3s

Runs = Annotated[tuple[Index, ...], msgspec.Meta(max_length=8192)]
"""Ascending key-frame indices, as first and count of each run without a gap."""
_MOST_KEYFRAMES = 1_000_000


def indices_of(runs: Runs) -> NDArray[np.int64]:
    """The indices that runs stand for; :class:`MessageError` where they are none."""
    pairs = np.array(runs, dtype=np.int64).reshape(-1, 2) if len(runs) % 2 == 0 else None
    if pairs is None or (pairs[:, 1] < 1).any() or (pairs[1:, 0] <= pairs[:-1].sum(axis=1)).any():
        raise MessageError(f"runs of key-frames: {runs[:6]} are not ascending pairs of first and count")
    if pairs[:, 1].sum() > _MOST_KEYFRAMES:
        raise MessageError(f"runs of key-frames: more than {_MOST_KEYFRAMES} of them")
    return np.concatenate([np.zeros(0, dtype=np.int64), *(np.arange(a, a + n) for a, n in pairs.tolist())])


class MapOrder(Counted, frozen=True, array_like=True, tag=4):
    """Deliver the maps of these owners, as they stood in the bid. ``versions``: of each, the one that the buyer has, 0
    for none, so that only what is new need come (empty: none of any); ``frame``: the buyer's coordinates; ``known``: in
    the thesis's form, the key-frames of each map that the buyer has, of whatever version (empty: none of any)."""

    belongs_to: ClassVar[OperationKind | None] = OperationKind.MAPMERGE

    owners: Members
    versions: Annotated[tuple[Index, ...], msgspec.Meta(max_length=MAX_AGENTS)] = ()
    frame: FrameId | None = None
    known: Annotated[tuple[Runs, ...], msgspec.Meta(max_length=MAX_AGENTS)] = ()

    def __post_init__(self) -> None:
        if len(set(self.owners)) != len(self.owners):
            raise MessageError("owners: a map that is ordered twice")
        if self.versions and len(self.versions) != len(self.owners):
            raise MessageError(f"versions: {len(self.versions)} of them for {len(self.owners)} owners")
        if self.known and len(self.known) != len(self.owners):
            raise MessageError(f"known: key-frames of {len(self.known)} maps for {len(self.owners)} owners")
        for runs in self.known:
            indices_of(runs)


class SubMap(msgspec.Struct, frozen=True, array_like=True):
    """A copy of one agent's map, in the seller's coordinates; ``unit``: what the owner's own unit of length is worth
    there; ``route``: the agents that sold it before, the owner first.

    ``keyframes`` ``(K,)`` int32 indices; ``stamps_ns`` ``(K,)`` int64; ``poses`` ``(K, 7)`` float64 ``T_F_C``, or
    ``(K, 8)`` Sim(3) where each key-frame has a unit of its own; ``references`` ``(P,)`` int32: row of the key-frame
    that saw the point first; ``points`` ``(P, 3)`` float32 in that camera and its unit; ``descriptors`` ``(P, 32)``;
    ``matches``: the owner's accepted ones, with ``transforms`` ``(m, 8)``: their ``T_M_Q``. ``known``: key-frames whose
    points were left out because the buyer has them, with the checksum ``check`` of all points
    (:mod:`maslam.mas.map_exchange.full_map_increments`).
    """

    owner: AgentId
    version: Index
    unit: Unit
    keyframes: Tensor
    stamps_ns: Tensor
    poses: Tensor
    references: Tensor
    points: Tensor
    descriptors: Tensor
    matches: Annotated[tuple[MatchId, ...], msgspec.Meta(max_length=100_000)]
    transforms: Tensor
    route: Members = ()
    known: Runs = ()
    check: Annotated[int, msgspec.Meta(ge=0, lt=2**32)] = 0

    def __post_init__(self) -> None:
        k = len(check("keyframes", self.keyframes, "<i4", (None,)))
        check("stamps_ns", self.stamps_ns, "<i8", (k,))
        if self.poses.shape[1:] == (SIM3_WIDTH,):
            check_sim3s("poses", self.poses, k)
        else:
            check_poses("poses", self.poses, "<f8", (k,))
        references = check("references", self.references, "<i4", (None,))
        check_points("points", self.points, len(references))
        check("descriptors", self.descriptors, "|u1", (len(references), 32))
        if len(references) and (references.min() < 0 or references.max() >= k):
            raise MessageError(f"references: a point refers to a key-frame beyond the {k} there are")
        if k and ((np.diff(self.keyframes.array()) <= 0).any() or self.keyframes.array()[0] < 0):
            raise MessageError("keyframes: not ascending from 0")
        stamps = self.stamps_ns.array()
        if (stamps[1:] <= stamps[:-1]).any():
            raise MessageError("stamps_ns: not ascending")
        check_sim3s("transforms", self.transforms, len(self.matches))
        self._check_known(references)

    def _check_known(self, references: NDArray[Any]) -> None:
        known = np.isin(self.keyframes.array(), indices := indices_of(self.known))
        if known.sum() != len(indices):
            raise MessageError("known: a key-frame that is not in the map")
        if known[references].any():
            raise MessageError("known: a key-frame whose points are there")

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


class MapPatch(msgspec.Struct, frozen=True, array_like=True):
    """The change from version ``base`` of an owner's map (0: nothing, so the whole map) to ``version``, as bits
    (:mod:`maslam.mas.map_exchange.coding.map_delta`); ``unit``: what the owner's reference unit is worth in ``frame``;
    None: it is the frame's, and all key-frames have it. ``check``: CRC-32 of the version, so
    that a copy that went wrong is noticed. ``descriptors`` ``(new points, 32)`` where the owner sells them."""

    base: Index
    version: Annotated[int, msgspec.Meta(ge=1, le=2**31)]
    frame: FrameId
    unit: Unit | None
    check: Annotated[int, msgspec.Meta(ge=0, lt=2**32)]
    bits: Annotated[bytes, msgspec.Meta(max_length=2**28)]
    descriptors: Tensor | None = None

    def __post_init__(self) -> None:
        if self.base >= self.version:
            raise MessageError(f"version {self.version} made of version {self.base}")
        if self.descriptors is not None:
            check("descriptors", self.descriptors, "|u1", (None, 32))

    @property
    def payload_bytes(self) -> int:
        """The bits and descriptors."""
        return len(self.bits) + (self.descriptors.nbytes if self.descriptors is not None else 0)


class Parcel(msgspec.Struct, frozen=True, array_like=True):
    """Patches of one owner's map, in order. ``placement``: how the map's coordinates and unit stand in the seller's,
    ``T_seller_map`` ``(8,)``; None: they are the seller's, with the unit of the last patch. ``route``: as in
    :class:`SubMap`."""

    owner: AgentId
    placement: Tensor | None
    route: Members
    patches: Annotated[tuple[MapPatch, ...], msgspec.Meta(min_length=1, max_length=10_000)]

    def __post_init__(self) -> None:
        if self.placement is not None:
            check_sim3("placement", self.placement)

    @property
    def payload_bytes(self) -> int:
        """Bytes of the patches and of the placement, if there is one."""
        return sum(p.payload_bytes for p in self.patches) + (self.placement.nbytes if self.placement is not None else 0)


class MapDelivery(Counted, frozen=True, array_like=True, tag=4):
    """The maps ordered, all in the seller's coordinates ``frame``; ``ties``: the seller's key-frames that it has
    accepted matches with the buyer for, and ``tie_poses`` ``(n, 8)``: where they stand there, Sim(3), so that a buyer
    with other coordinates can place the maps."""

    belongs_to: ClassVar[OperationKind | None] = OperationKind.MAPMERGE

    frame: FrameId
    ties: Annotated[tuple[Index, ...], msgspec.Meta(max_length=100_000)]
    tie_poses: Tensor
    maps: Annotated[tuple[SubMap, ...], msgspec.Meta(max_length=MAX_AGENTS)]
    parcels: Annotated[tuple[Parcel, ...], msgspec.Meta(max_length=MAX_AGENTS)] = ()

    def __post_init__(self) -> None:
        check_sim3s("tie_poses", self.tie_poses, len(self.ties))

    @property
    def payload_bytes(self) -> int:
        """Payload of its maps."""
        return sum(m.payload_bytes for m in self.maps) + sum(p.payload_bytes for p in self.parcels)
