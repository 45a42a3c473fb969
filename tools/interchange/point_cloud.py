"""Coloured points as a PLY file."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from maslam.backend.geometry import Array

_FIELDS = [("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("red", "u1"), ("green", "u1"), ("blue", "u1")]
_NAMES = {"<f4": "float", "u1": "uchar"}


def write_points(path: Path, points: Array, colours: NDArray[np.uint8]) -> None:
    """Binary PLY of ``points`` ``(P, 3)`` with ``colours`` ``(P, 3)`` RGB."""
    table = np.zeros(len(points), dtype=_FIELDS)
    table["x"], table["y"], table["z"] = points.T
    table["red"], table["green"], table["blue"] = colours.T
    head = ["ply", "format binary_little_endian 1.0", f"element vertex {len(points)}"]
    head += [f"property {_NAMES[kind]} {name}" for name, kind in _FIELDS]
    path.write_bytes(("\n".join([*head, "end_header"]) + "\n").encode("ascii") + table.tobytes())
