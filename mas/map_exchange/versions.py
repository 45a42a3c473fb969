"""Editions of one owner's map, as agents hold and sell them."""

from __future__ import annotations

import zlib
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from ..protocol.map_messages import MapPatch
from ..protocol.tensors import MessageError, Tensor
from .coding.map_delta import decode, encode
from .coding.pose_corrections import Bound
from .coding.quantised_map import LatticeMap


class StaleBase(MessageError):
    """Patches that do not fit the copy they came for: the whole map is needed."""


@dataclass(frozen=True, eq=False)
class MapVersion:
    """One edition of a map, and the patches that led to it since the copy was last made whole."""

    map: LatticeMap
    patches: tuple[MapPatch, ...] = ()

    @cached_property
    def whole(self) -> MapPatch:
        """All of the edition, for a buyer who has nothing."""
        return make_patch(None, self.map, encode(None, self.map, Bound())[0])

    def since(self, edition: int) -> tuple[MapPatch, ...]:
        """What brings a copy of ``edition`` (0: none) up to date: the patches since, or the whole map where they are
        not known or would take more bytes."""
        whole = (self.whole,)
        later = tuple(p for p in self.patches if p.base >= edition)
        if not edition or not later or later[0].base != edition:
            return whole
        return min(later, whole, key=lambda patches: sum(p.payload_bytes for p in patches))


def stock_of(owner: int, known: MapVersion | None, patches: tuple[MapPatch, ...]) -> MapVersion:
    """The stock that patches make of what was known; MessageError where they make none."""
    stock = known
    for patch in patches:
        stock = _applied(stock, owner, patch)
    if stock is None:
        raise StaleBase("no patches")
    return stock


def _applied(stock: MapVersion | None, owner: int, patch: MapPatch) -> MapVersion:
    if patch.base and (stock is None or stock.map.edition != patch.base):
        have = "none" if stock is None else f"edition {stock.map.edition}"
        raise StaleBase(f"a patch for edition {patch.base} of agent {owner}'s map, but {have} is here")
    base = stock.map if stock is not None and patch.base else None
    made = decode(owner, patch.edition, patch.frame, patch.unit or 1.0, base, patch.bits)
    old = None if base is None else base.descriptors
    if patch.descriptors is not None:
        new = patch.descriptors.array()
        known = np.zeros((0, 32), dtype=np.uint8) if old is None else old
        if len(known) + len(new) != len(made.depths):
            raise MessageError(f"{len(new)} descriptors for {len(made.depths) - len(known)} points")
        made = replace(made, descriptors=np.concatenate([known, new]))
    if checksum(made) != patch.check:
        raise StaleBase(f"edition {patch.edition} of agent {owner}'s map is not what its owner made")
    return MapVersion(made, (*stock.patches, patch) if stock is not None and patch.base else ())


def checksum(edition: LatticeMap) -> int:
    """CRC-32 of the numbers of an edition."""
    crc = 0
    for part in (edition.keyframes, edition.ticks, edition.poses, edition.counts, edition.cells, edition.depths):
        crc = zlib.crc32(np.ascontiguousarray(part, dtype="<i8").tobytes(), crc)
    return crc


def make_patch(base: LatticeMap | None, made: LatticeMap, bits: bytes) -> MapPatch:
    """The bits that make an edition, with what its holders need to know beside them."""
    known = 0 if base is None else len(base.depths)
    described = None if made.descriptors is None else Tensor.of(made.descriptors[known:], "|u1")
    unit = None if made.unit == 1.0 else made.unit
    number = 0 if base is None else base.edition
    return MapPatch(number, made.edition, made.frame, unit, checksum(made), bits, described)
