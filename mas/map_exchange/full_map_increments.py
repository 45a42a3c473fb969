"""Only what is new of a map in the thesis's form: a point is stored in the camera of the key-frame that saw it first,
so whatever an optimisation does, what was sold with a key-frame once need not be sold again.

The buyer states which key-frames of a map it has; poses and matches come anew, points and descriptors only with the
others. Seller and buyer may hold copies of any age: what counts are key-frames, not versions. A checksum of all points
tells the buyer whether what it put together is what the seller has.
"""

from __future__ import annotations

import zlib
from collections.abc import Iterable
from typing import Any

import numpy as np
from msgspec.structs import replace
from numpy.typing import NDArray

from maslam.backend.geometry import Array

from ..protocol.map_messages import Runs, SubMap, indices_of
from ..protocol.tensors import Tensor
from .map_copy import MapCopy
from .versions import StaleBase


def runs_of(indices: Iterable[int]) -> Runs:
    """Ascending indices as first and count of each run without a gap: a track is one run, however long."""
    values = np.fromiter(indices, dtype=np.int64)
    breaks = np.flatnonzero(np.diff(values) != 1) + 1
    return tuple(n for run in np.split(values, breaks) if len(run) for n in (int(run[0]), len(run)))


def without(submap: SubMap, runs: Runs) -> SubMap:
    """The part of the map that a buyer with these key-frames lacks."""
    keyframes, references = submap.keyframes.array(), submap.references.array()
    known = np.isin(keyframes, indices_of(runs))
    if not known.any():
        return submap
    order, counts = _sorted(references, len(keyframes))
    points, descriptors = submap.points.array()[order], submap.descriptors.array()[order]
    new = ~known[references[order]]
    return replace(
        submap,
        references=Tensor.of(references[order][new], "<i4"),
        points=Tensor.of(points[new], "<f4"),
        descriptors=Tensor.of(descriptors[new], "|u1"),
        known=runs_of(keyframes[known]),
        check=_checksum(counts, points, descriptors),
    )


def completed(submap: SubMap, copy: MapCopy | None) -> SubMap:
    """The whole map, with the points of the copy where the seller left them out; :class:`StaleBase` where the copy
    lacks some, or is not what the seller has."""
    if not submap.known:
        return submap
    keyframes = submap.keyframes.array()
    known = set(indices_of(submap.known).tolist())
    if copy is None or copy.descriptors is None or not known <= copy.rows.keys():
        raise StaleBase(f"points of agent {submap.owner}'s map were left out that are not here")
    row_of = {int(k): row for row, k in enumerate(keyframes) if int(k) in known}
    rows = np.array([row_of.get(int(k), -1) for k in copy.keyframes], dtype=np.int64)[copy.references]
    kept = rows >= 0
    references = np.concatenate([rows[kept], submap.references.array()])
    points = np.concatenate([copy.points_C[kept].astype(np.float32), submap.points.array()])
    descriptors = np.concatenate([copy.descriptors[kept], submap.descriptors.array()])
    order, counts = _sorted(references, len(keyframes))
    if _checksum(counts, points[order], descriptors[order]) != submap.check:
        raise StaleBase(f"the copy of agent {submap.owner}'s map has other points than the seller's")
    return replace(
        submap,
        references=Tensor.of(references[order], "<i4"),
        points=Tensor.of(points[order], "<f4"),
        descriptors=Tensor.of(descriptors[order], "|u1"),
        known=(),
        check=0,
    )


def _sorted(references: NDArray[Any], keyframes: int) -> tuple[NDArray[np.intp], NDArray[np.int64]]:
    """The points' order by key-frame, and how many each has ``(K,)``."""
    return np.argsort(references, kind="stable"), np.bincount(references, minlength=keyframes).astype(np.int64)


def _checksum(counts: NDArray[np.int64], points: Array, descriptors: NDArray[np.uint8]) -> int:
    """CRC-32 of how many points each key-frame has, where they are, and their descriptors."""
    crc = 0
    for part, dtype in ((counts, "<i8"), (points, "<f4"), (descriptors, "|u1")):
        crc = zlib.crc32(np.ascontiguousarray(part, dtype=dtype).tobytes(), crc)
    return crc
