"""An agent's maps joined into one, and maps of points as PLY files."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from maslam.backend.fusion import PointMap, fuse
from maslam.backend.geometry import Array

from ..map_exchange.map_copy import MapCopy

# Points of two maps are the same within this share of the median depth: a few pixels, a stereo depth's error.
_SAME_POINT = 0.01

# Colour-blind-safe colours (Okabe and Ito), one an agent, then again from the start.
COLOURS = np.array(
    [[0, 114, 178], [230, 159, 0], [0, 158, 115], [204, 121, 167],
     [86, 180, 233], [213, 94, 0], [240, 228, 66], [90, 90, 90]],
    dtype=np.uint8,
)  # fmt: skip


@dataclass(frozen=True, eq=False)
class FusedMap:
    """An agent's own map and its copies as one: ``maps``, all points of these in order, and the merged ``points``
    ``(m, 3)`` with ``owners`` ``(m,)`` in its coordinates; ``labels`` ``(n,)``: which merged point each became."""

    maps: tuple[MapCopy, ...]
    points: Array
    owners: NDArray[np.int32]
    labels: NDArray[np.intp]


def fused(maps: Sequence[MapCopy]) -> FusedMap:
    """Duplicates among an agent's maps merged (:mod:`maslam.backend.fusion`): closer than a hundredth of the median
    depth and, where both have descriptors, alike."""
    parts = [PointMap(m.points(), np.full(len(m.references), m.owner, dtype=np.int32), m.descriptors) for m in maps]
    depths = np.concatenate([np.zeros(0), *(m.points_C[:, 2] * m.units[m.references] for m in maps)])
    radius = _SAME_POINT * float(np.median(depths)) if len(depths) else 1.0
    one, labels = fuse(parts, radius)
    return FusedMap(tuple(maps), one.points, one.owners, labels)


def write_map(path: Path, one: FusedMap) -> None:
    """The fused map in the holder's coordinates, each point coloured by its (first) owner."""
    write_ply(path, one.points, one.owners)


def write_ply(path: Path, points: ArrayLike, owners: ArrayLike) -> None:
    """Binary PLY: ``x y z`` float32, ``red green blue`` by owner, ``agent`` uint16."""
    xyz, agent = np.asarray(points, dtype=np.float32).reshape(-1, 3), np.asarray(owners, dtype=np.int64)
    fields = [
        ("x", "<f4"),
        ("y", "<f4"),
        ("z", "<f4"),
        ("red", "u1"),
        ("green", "u1"),
        ("blue", "u1"),
        ("agent", "<u2"),
    ]
    table = np.zeros(len(xyz), dtype=fields)
    table["x"], table["y"], table["z"] = xyz.T
    table["red"], table["green"], table["blue"] = COLOURS[agent % len(COLOURS)].T
    table["agent"] = agent
    names = {"<f4": "float", "u1": "uchar", "<u2": "ushort"}
    head = ["ply", "format binary_little_endian 1.0", f"element vertex {len(xyz)}"]
    head += [f"property {names[kind]} {name}" for name, kind in fields]
    with open(path, "wb") as out:
        out.write(("\n".join([*head, "end_header"]) + "\n").encode("ascii"))
        out.write(table.tobytes())
