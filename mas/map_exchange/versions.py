"""Versions of one owner's map, as agents keep and sell them."""

from __future__ import annotations

import zlib
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from ..protocol.map_messages import MapPatch
from ..protocol.tensors import MessageError, Tensor
from .coding.map_delta import decode, encode
from .coding.pose_corrections import Bound
from .coding.quantised_map import QuantisedMap


class StaleBase(MessageError):
    """Patches that do not fit the copy they came for: the whole map is needed."""


@dataclass(frozen=True, eq=False)
class MapVersion:
    """One version of a map, and the patches that led to it since the copy was last made whole."""

    map: QuantisedMap
    patches: tuple[MapPatch, ...] = ()

    @cached_property
    def whole(self) -> MapPatch:
        """All of the version, for a buyer who has nothing."""
        return make_patch(None, self.map, encode(None, self.map, Bound())[0])

    def since(self, version: int) -> tuple[MapPatch, ...]:
        """Patches that bring a copy of ``version`` (0: none) up to date: those since, or the whole map where they are
        not known or would take more bytes."""
        whole = (self.whole,)
        later = tuple(p for p in self.patches if p.base >= version)
        if not version or not later or later[0].base != version:
            return whole
        return min(later, whole, key=lambda patches: sum(p.payload_bytes for p in patches))


def version_of(owner: int, known: MapVersion | None, patches: tuple[MapPatch, ...]) -> MapVersion:
    """The version that patches make of what was known; MessageError where they make none."""
    made = known
    for patch in patches:
        made = _applied(made, owner, patch)
    if made is None:
        raise StaleBase("no patches")
    return made


def _applied(known: MapVersion | None, owner: int, patch: MapPatch) -> MapVersion:
    if patch.base and (known is None or known.map.version != patch.base):
        have = "none" if known is None else f"version {known.map.version}"
        raise StaleBase(f"a patch for version {patch.base} of agent {owner}'s map, but {have} is here")
    base = known.map if known is not None and patch.base else None
    made = decode(owner, patch.version, patch.frame, patch.unit, base, patch.bits)
    old = None if base is None else base.descriptors
    if patch.descriptors is not None:
        new = patch.descriptors.array()
        before = np.zeros((0, 32), dtype=np.uint8) if old is None else old
        if len(before) + len(new) != len(made.depths):
            raise MessageError(f"{len(new)} descriptors for {len(made.depths) - len(before)} points")
        made = replace(made, descriptors=np.concatenate([before, new]))
    if checksum(made) != patch.check:
        raise StaleBase(f"version {patch.version} of agent {owner}'s map is not what its owner made")
    return MapVersion(made, (*known.patches, patch) if known is not None and patch.base else ())


def checksum(version: QuantisedMap) -> int:
    """CRC-32 of the numbers of a version."""
    crc = 0
    for part in (version.keyframes, version.ticks, version.poses, version.counts, version.cells, version.depths):
        crc = zlib.crc32(np.ascontiguousarray(part, dtype="<i8").tobytes(), crc)
    return crc


def make_patch(base: QuantisedMap | None, made: QuantisedMap, bits: bytes) -> MapPatch:
    """The bits that make a version, with what its holders need to know beside them."""
    known = 0 if base is None else len(base.depths)
    described = None if made.descriptors is None else Tensor.of(made.descriptors[known:], "|u1")
    unit = made.unit if made.drifting else None
    number = 0 if base is None else base.version
    return MapPatch(number, made.version, made.frame, unit, checksum(made), bits, described)
