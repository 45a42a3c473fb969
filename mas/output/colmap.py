"""An agent's fused map as a COLMAP model: ``cameras.bin``, ``images.bin``, ``points3D.bin``.

One camera an agent, one image a key-frame (under its file's name), one 2-D point for each view of a map point: where
the owner's front end has found the point in that image. Written without COLMAP: the format is three tables. COLMAP's
first pixel has its centre at (0.5, 0.5), ours at (0, 0).
"""

from __future__ import annotations

import struct
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from maslam.backend.geometry import Array, quat_wxyz_from_rotation, se3_inverse

from ..map_exchange.map_copy import MapCopy
from ..sequence import CameraEntry
from .fused_map import COLOURS, FusedMap
from .sightings import MapOwner, Sightings, project, sightings

_PINHOLE = 1
_HALF_PX = 0.5
_IMAGE, _COUNT = struct.Struct("<I7dI"), struct.Struct("<Q")
_POINT2D = np.dtype([("xy", "<f8", 2), ("point", "<i8")])


def write_colmap(folder: Path, one: FusedMap, owners: Mapping[int, MapOwner]) -> None:
    """Write the model into ``folder``. Translations and points are in the holder's unit.

    ``owners``: what is known of each map's owner. Without its key-frames a point has the view of the map only; without
    its images' names an image is called by agent and stamp.
    """
    folder.mkdir(parents=True, exist_ok=True)
    cameras = [_camera(m.owner, owners[m.owner].camera) for m in one.maps]
    (folder / "cameras.bin").write_bytes(_table(len(cameras), cameras))
    firsts = np.cumsum([0, *[len(m.keyframes) for m in one.maps]])
    labels = np.split(one.labels, np.cumsum([len(m.references) for m in one.maps])[:-1])
    images, tracks, errors = [], [np.zeros((0, 3), dtype=np.int64)], [np.zeros(0)]
    for copy, mine, first in zip(one.maps, labels, firsts, strict=False):
        owner = owners[copy.owner]
        seen = _once(sightings(copy, owner), mine)
        images += _images(copy, mine, seen, int(first), owner.images)
        place = np.arange(len(seen.rows)) - np.searchsorted(seen.rows, seen.rows, side="left")
        tracks.append(np.column_stack([mine[seen.points], first + seen.rows + 1, place]))
        errors.append(_off(copy, seen, one.points[mine[seen.points]], owner.camera))
    (folder / "images.bin").write_bytes(_table(int(firsts[-1]), images))
    (folder / "points3D.bin").write_bytes(_points(one, np.concatenate(tracks), np.concatenate(errors)))


def _once(seen: Sightings, labels: NDArray[np.intp]) -> Sightings:
    """An image sees a merged point once, whichever of its points was first."""
    _, first = np.unique(np.column_stack([seen.rows, labels[seen.points]]), axis=0, return_index=True)
    kept = np.sort(first)
    return Sightings(seen.rows[kept], seen.points[kept], seen.uv[kept])


def _off(copy: MapCopy, seen: Sightings, points: Array, camera: CameraEntry) -> Array:
    """Distance, pixels, between each view and the projection of its point ``(n, 3)``, holder's coordinates; that of
    the image's diagonal behind the camera."""
    T_C_F = se3_inverse(copy.poses)[seen.rows]
    points_C = np.einsum("nij,nj->ni", T_C_F[:, :3, :3], points) + T_C_F[:, :3, 3]
    off = np.full(len(points), float(np.hypot(camera.width, camera.height)))
    ahead = points_C[:, 2] > 0
    off[ahead] = np.linalg.norm(project(points_C[ahead], camera) - seen.uv[ahead], axis=1)
    return off


def _table(rows: int, parts: list[bytes]) -> bytes:
    return _COUNT.pack(rows) + b"".join(parts)


def _camera(owner: int, c: CameraEntry) -> bytes:
    middle = (c.fx, c.fy, c.cx + _HALF_PX, c.cy + _HALF_PX)
    return struct.pack("<IiQQ4d", owner + 1, _PINHOLE, c.width, c.height, *middle)


def _images(
    copy: MapCopy,
    labels: NDArray[np.intp],
    seen: Sightings,
    first: int,
    names: Sequence[str],
) -> list[bytes]:
    table = np.zeros(len(seen.uv), dtype=_POINT2D)
    table["xy"], table["point"] = seen.uv + _HALF_PX, labels[seen.points] + 1
    bounds = np.searchsorted(seen.rows, np.arange(len(copy.keyframes) + 1))
    T_C_F = se3_inverse(copy.poses)
    poses = np.concatenate([quat_wxyz_from_rotation(T_C_F[:, :3, :3]), T_C_F[:, :3, 3]], axis=1).tolist()
    views, ends = table.tobytes(), (bounds * table.itemsize).tolist()
    sizes = np.diff(bounds).tolist()
    out = []
    for row, (index, stamp) in enumerate(zip(copy.keyframes.tolist(), copy.stamps_ns.tolist(), strict=True)):
        own = names[index] if 0 <= index < len(names) else f"agent_{copy.owner:02d}/{stamp}.png"
        head = _IMAGE.pack(first + row + 1, *poses[row], copy.owner + 1)
        out += [head, own.encode() + b"\0", _COUNT.pack(sizes[row]), views[ends[row] : ends[row + 1]]]
    return out


def _points(one: FusedMap, tracks: NDArray[np.int64], errors: Array) -> bytes:
    """``tracks`` ``(n, 3)``: merged point, image, place in that image; ``errors`` ``(n,)`` pixels. Points of equally
    long tracks are one table."""
    off = np.bincount(tracks[:, 0], errors, minlength=len(one.points))
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
        table["error"] = off[chosen] / max(length, 1)
        table["rgb"] = COLOURS[one.owners[chosen] % len(COLOURS)]
        table["track"] = tracks[starts[chosen][:, None] + np.arange(length), 1:]
        parts.append(table.tobytes())
    return b"".join(parts)
