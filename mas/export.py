"""Maps of points as PLY files."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from mas.submaps import HeldMap

# Colour-blind-safe colours (Okabe and Ito), one an agent, then again from the start.
COLOURS = np.array(
    [[0, 114, 178], [230, 159, 0], [0, 158, 115], [204, 121, 167],
     [86, 180, 233], [213, 94, 0], [240, 228, 66], [90, 90, 90]],
    dtype=np.uint8,
)  # fmt: skip


def write_map(path: Path, maps: Sequence[HeldMap]) -> None:
    """All maps in the holder's coordinates, each point coloured by its owner."""
    points = np.concatenate([np.zeros((0, 3)), *(m.points() for m in maps)])
    owners = np.concatenate([np.zeros(0, dtype=np.int64), *(np.full(len(m.points()), m.owner) for m in maps)])
    write_ply(path, points, owners)


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
