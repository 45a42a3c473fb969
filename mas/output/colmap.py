"""An agent's fused map as a COLMAP model: ``cameras.bin``, ``images.bin``, ``points3D.bin``.

One camera an agent, that of its image files; one image a key-frame, under its file's name; one 2-D point for each view
of a map point, where the owner's front end has found it in that image. Written without COLMAP: the format is three
tables. COLMAP's first pixel has its centre at (0.5, 0.5), ours at (0, 0).
"""

from __future__ import annotations

import struct
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from maslam.backend.geometry import Array, product, quat_wxyz_from_rotation, se3_inverse
from maslam.backend.refitting import refit_points

from ..manifest import CameraEntry
from ..map_exchange.map_copy import MapCopy
from .fused_map import COLOURS, FusedMap
from .one_place import one_place
from .sightings import MapOwner, Sightings, sightings
from .stored_camera import colmap_model, stored_pixels, turn_to_stored

_HALF_PX = 0.5
_IMAGE, _COUNT = struct.Struct("<I7dI"), struct.Struct("<Q")
_NO_POINT = -1  # COLMAP: of a pixel without a point
_POINT2D = np.dtype([("xy", "<f8", 2), ("point", "<i8")])


def write_colmap(folder: Path, one: FusedMap, owners: Mapping[int, MapOwner]) -> None:
    """Write the model into ``folder``. Translations and points are in the holder's unit.

    ``owners``: what is known of each map's owner. Without its key-frames a point has the view of the map only; without
    its images' names an image is called by agent and stamp. A point is moved to where its views see it; one of a single
    view stays a pixel of its image and is no point of the model, as COLMAP's own have two at least.
    """
    folder.mkdir(parents=True, exist_ok=True)
    cameras = [_camera(m.owner, owners[m.owner].camera) for m in one.maps]
    (folder / "cameras.bin").write_bytes(_table(len(cameras), cameras))
    views = _joined(_views(one, owners), one)
    points, off = _refitted(one, owners, views)
    twice = np.bincount(views.label, minlength=len(one.points)) >= 2
    firsts, images = np.cumsum([0, *[len(m.keyframes) for m in one.maps]]), []
    for copy, first in zip(one.maps, firsts, strict=False):
        own = slice(*np.searchsorted(views.image, [first, first + len(copy.keyframes)]))
        labels = np.where(twice[views.label[own]], views.label[own] + 1, _NO_POINT)
        images += _images(copy, views.image[own] - first, labels, views.uv[own], int(first), owners[copy.owner])
    (folder / "images.bin").write_bytes(_table(int(firsts[-1]), images))
    place = np.arange(len(views.image)) - np.searchsorted(views.image, views.image, side="left")
    of = twice[views.label]
    tracks = np.column_stack([views.label, views.image + 1, place])[of]
    (folder / "points3D.bin").write_bytes(_points(points, one.owners, twice, tracks, off[of]))


@dataclass(frozen=True, eq=False)
class _Views:
    """All views of the model, ordered by image: merged point ``label`` ``(n,)`` in ``image`` ``(n,)``, numbered through
    all maps, at ``uv`` ``(n, 2)`` pixels."""

    image: NDArray[np.intp]
    label: NDArray[np.intp]
    uv: Array


def _views(one: FusedMap, owners: Mapping[int, MapOwner]) -> _Views:
    image, label, uv = [np.zeros(0, dtype=np.intp)], [np.zeros(0, dtype=np.intp)], [np.zeros((0, 2))]
    labels = np.split(one.labels, np.cumsum([len(m.references) for m in one.maps])[:-1])
    first = 0
    for copy, mine in zip(one.maps, labels, strict=True):
        seen = _once(sightings(copy, owners[copy.owner]), mine)
        image.append(first + seen.rows)
        label.append(mine[seen.points])
        uv.append(seen.uv)
        first += len(copy.keyframes)
    return _Views(np.concatenate(image), np.concatenate(label), np.concatenate(uv))


def _joined(views: _Views, one: FusedMap) -> _Views:
    """The views of points that are one place as views of the first of them; an image sees that once."""
    T = np.concatenate([np.zeros((0, 4, 4)), *(se3_inverse(m.poses) for m in one.maps)])[views.image]
    depth = np.einsum("nj,nj->n", T[:, 2, :3], one.points[views.label]) + T[:, 2, 3]
    label = one_place(views.image, views.label, views.uv, depth, len(one.points))[views.label]
    _, first = np.unique(np.column_stack([views.image, label]), axis=0, return_index=True)
    kept = np.sort(first)
    return _Views(views.image[kept], label[kept], views.uv[kept])


def _once(seen: Sightings, labels: NDArray[np.intp]) -> Sightings:
    """An image sees a merged point once, whichever of its points was first."""
    _, first = np.unique(np.column_stack([seen.rows, labels[seen.points]]), axis=0, return_index=True)
    kept = np.sort(first)
    return Sightings(seen.rows[kept], seen.points[kept], seen.uv[kept])


def _refitted(one: FusedMap, owners: Mapping[int, MapOwner], views: _Views) -> tuple[Array, Array]:
    """The merged points where their views see them, and the distance ``(n,)``, pixels, of each view from its point's
    projection; that of the image's diagonal behind the camera."""
    poses = np.concatenate([np.zeros((0, 4, 4)), *(se3_inverse(m.poses) for m in one.maps)])
    of = [owners[m.owner].camera for m in one.maps for _ in m.keyframes]
    cameras = np.array([(c.fx, c.fy, c.cx, c.cy) for c in of], dtype=np.float64).reshape(-1, 4)
    order = np.argsort(views.label, kind="stable")
    start = np.searchsorted(views.label[order], np.arange(len(one.points) + 1))
    points = refit_points(one.points, start, views.image[order], views.uv[order], poses, cameras)
    T, c = poses[views.image], cameras[views.image]
    points_C = np.einsum("nij,nj->ni", T[:, :3, :3], points[views.label]) + T[:, :3, 3]
    off = np.array([np.hypot(c.width, c.height) for c in of], dtype=np.float64)[views.image]
    ahead = points_C[:, 2] > 0
    uv = points_C[ahead, :2] / points_C[ahead, 2:] * c[ahead, :2] + c[ahead, 2:]
    off[ahead] = np.linalg.norm(uv - views.uv[ahead], axis=1)
    return points, off


def _table(rows: int, parts: list[bytes]) -> bytes:
    return _COUNT.pack(rows) + b"".join(parts)


def _camera(owner: int, c: CameraEntry) -> bytes:
    model, parameters = colmap_model(c)
    return struct.pack(f"<IiQQ{len(parameters)}d", owner + 1, model, c.width, c.height, *parameters)


def _images(
    copy: MapCopy, rows: NDArray[np.intp], labels: NDArray[np.intp], uv: Array, first: int, owner: MapOwner
) -> list[bytes]:
    """``rows``, ``labels`` ``(n,)``, ``uv`` ``(n, 2)``: key-frame, number of the point and pixels of each view."""
    table = np.zeros(len(uv), dtype=_POINT2D)
    table["xy"], table["point"] = stored_pixels(uv, owner.camera) + _HALF_PX, labels
    bounds = np.searchsorted(rows, np.arange(len(copy.keyframes) + 1))
    T_C_F = product(turn_to_stored(owner.camera), se3_inverse(copy.poses))
    poses = np.concatenate([quat_wxyz_from_rotation(T_C_F[:, :3, :3]), T_C_F[:, :3, 3]], axis=1).tolist()
    views, ends = table.tobytes(), (bounds * table.itemsize).tolist()
    sizes = np.diff(bounds).tolist()
    out = []
    for row, (index, stamp) in enumerate(zip(copy.keyframes.tolist(), copy.stamps_ns.tolist(), strict=True)):
        own = owner.images[index] if 0 <= index < len(owner.images) else f"agent_{copy.owner:02d}/{stamp}.png"
        head = _IMAGE.pack(first + row + 1, *poses[row], copy.owner + 1)
        out += [head, own.encode() + b"\0", _COUNT.pack(sizes[row]), views[ends[row] : ends[row + 1]]]
    return out


def _points(
    points: Array, owners: NDArray[np.int32], kept: NDArray[np.bool_], tracks: NDArray[np.int64], errors: Array
) -> bytes:
    """The ``kept`` of the ``points``. ``tracks`` ``(n, 3)``: point, image, place in that image; ``errors`` ``(n,)``
    pixels. Points of equally long tracks are one table."""
    off = np.bincount(tracks[:, 0], errors, minlength=len(points))
    tracks = tracks[np.argsort(tracks[:, 0], kind="stable")]
    lengths = np.bincount(tracks[:, 0], minlength=len(points))
    starts = np.cumsum(lengths) - lengths
    parts = [_COUNT.pack(int(kept.sum()))]
    for length in np.unique(lengths[kept]):
        chosen = np.flatnonzero(kept & (lengths == length))
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
        table["id"], table["xyz"], table["length"] = chosen + 1, points[chosen], length
        table["error"] = off[chosen] / length
        table["rgb"] = COLOURS[owners[chosen] % len(COLOURS)]
        table["track"] = tracks[starts[chosen][:, None] + np.arange(length), 1:]
        parts.append(table.tobytes())
    return b"".join(parts)
