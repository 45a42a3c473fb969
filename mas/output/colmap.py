"""An agent's fused map as a COLMAP model: ``cameras.bin``, ``images.bin``, ``points3D.bin``.

One camera an agent, one image a key-frame (named for its agent and its time stamp), one 2-D point for each map point of
the key-frame that saw it first. Written without COLMAP: the format is three tables. COLMAP's first pixel has its centre
at (0.5, 0.5), ours at (0, 0).
"""

from __future__ import annotations

import struct
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from maslam.backend.geometry import quat_wxyz_from_rotation, se3_inverse

from ..map_exchange.map_copy import MapCopy
from ..sequence import CameraEntry
from .fused_map import COLOURS, FusedMap

_PINHOLE = 1
_HALF_PX = 0.5
_IMAGE, _COUNT = struct.Struct("<I7dI"), struct.Struct("<Q")
_POINT2D = np.dtype([("xy", "<f8", 2), ("point", "<i8")])


def write_colmap(folder: Path, one: FusedMap, cameras: Mapping[int, CameraEntry]) -> None:
    """Write the model into ``folder``; ``cameras``: of each owner. Translations and points are in the holder's unit."""
    folder.mkdir(parents=True, exist_ok=True)
    owners = [m.owner for m in one.maps]
    (folder / "cameras.bin").write_bytes(_table(len(owners), [_camera(o, cameras[o]) for o in owners]))
    sizes = [len(m.references) for m in one.maps]
    firsts = np.cumsum([0, *[len(m.keyframes) for m in one.maps]])
    labels = np.split(one.labels, np.cumsum(sizes)[:-1])
    images, tracks = [], []
    for copy, mine, first in zip(one.maps, labels, firsts, strict=False):
        order = np.argsort(copy.references, kind="stable")
        images += _images(copy, mine[order], order, int(first), cameras[copy.owner])
        rows = copy.references[order]
        place = np.arange(len(rows)) - np.searchsorted(rows, rows, side="left")
        tracks.append(np.column_stack([mine[order], first + rows + 1, place]))
    (folder / "images.bin").write_bytes(_table(int(firsts[-1]), images))
    (folder / "points3D.bin").write_bytes(_points(one, np.concatenate([np.zeros((0, 3), dtype=np.int64), *tracks])))


def _table(rows: int, parts: list[bytes]) -> bytes:
    return _COUNT.pack(rows) + b"".join(parts)


def _camera(owner: int, c: CameraEntry) -> bytes:
    middle = (c.fx, c.fy, c.cx + _HALF_PX, c.cy + _HALF_PX)
    return struct.pack("<IiQQ4d", owner + 1, _PINHOLE, c.width, c.height, *middle)


def _images(
    copy: MapCopy, labels: NDArray[np.intp], order: NDArray[np.intp], first: int, c: CameraEntry
) -> list[bytes]:
    p = copy.points_C[order]
    xy = p[:, :2] / p[:, 2:] * [c.fx, c.fy] + np.array([c.cx, c.cy]) + _HALF_PX
    table = np.zeros(len(p), dtype=_POINT2D)
    table["xy"], table["point"] = xy, labels + 1
    bounds = np.searchsorted(copy.references[order], np.arange(len(copy.keyframes) + 1))
    T_C_F = se3_inverse(copy.poses)
    poses = np.concatenate([quat_wxyz_from_rotation(T_C_F[:, :3, :3]), T_C_F[:, :3, 3]], axis=1).tolist()
    seen, ends = table.tobytes(), (bounds * table.itemsize).tolist()
    sizes = np.diff(bounds).tolist()
    out = []
    for row, stamp in enumerate(copy.stamps_ns.tolist()):
        name = f"agent_{copy.owner:02d}/{stamp}.png".encode("ascii") + b"\0"
        head = _IMAGE.pack(first + row + 1, *poses[row], copy.owner + 1)
        out += [head, name, _COUNT.pack(sizes[row]), seen[ends[row] : ends[row + 1]]]
    return out


def _points(one: FusedMap, tracks: NDArray[np.int64]) -> bytes:
    """``tracks`` ``(n, 3)``: merged point, image, place in that image. Points of equally long tracks are one table."""
    tracks = tracks[np.argsort(tracks[:, 0], kind="stable")]
    lengths = np.bincount(tracks[:, 0], minlength=len(one.points))
    starts = np.cumsum(lengths) - lengths
    parts = [_COUNT.pack(len(one.points))]
    for length in np.unique(lengths):
        chosen = np.flatnonzero(lengths == length)
        table = np.zeros(
            len(chosen),
            dtype=[
                ("id", "<u8"),
                ("xyz", "<f8", 3),
                ("rgb", "u1", 3),
                ("error", "<f8"),
                ("length", "<u8"),
                ("track", "<u4", (length, 2)),
            ],
        )
        table["id"], table["xyz"], table["length"] = chosen + 1, one.points[chosen], length
        table["rgb"] = COLOURS[one.owners[chosen] % len(COLOURS)]
        table["track"] = tracks[starts[chosen][:, None] + np.arange(length), 1:]
        parts.append(table.tobytes())
    return b"".join(parts)
