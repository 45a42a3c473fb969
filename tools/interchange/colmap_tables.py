"""COLMAP models as arrays: ``cameras.bin``, ``images.bin``, ``points3D.bin`` read and written without COLMAP.

COLMAP's first pixel has its centre at (0.5, 0.5), ours at (0, 0); numbers of cameras, images and points start at 1.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from maslam.backend.geometry import Array, quat_wxyz_from_rotation, rotation_from_quat_wxyz, se3
from maslam.mas.manifest import CameraEntry

from ..common.errors import ToolError

HALF_PX = 0.5
_PINHOLE = 1
_COUNT, _IMAGE, _CAMERA = struct.Struct("<Q"), struct.Struct("<I7dI"), struct.Struct("<IiQQ4d")
_POINT = struct.Struct("<Q3d3BdQ")
_POINT2D = np.dtype([("xy", "<f8", 2), ("point", "<i8")])
_TRACK_ENTRY = 8  # bytes: image and place in it


@dataclass(frozen=True, eq=False)
class ModelTables:
    """A model that was read. Images: ``names``, ``cameras`` ``(I,)``, ``T_C_W`` ``(I, 4, 4)``; views, ordered by image:
    ``image`` ``(n,)`` row, ``uv`` ``(n, 2)`` pixels with the first pixel's centre at (0, 0), ``point`` ``(n,)`` row or
    -1; ``points`` ``(P, 3)``."""

    names: tuple[str, ...]
    cameras: NDArray[np.int64]
    T_C_W: Array
    image: NDArray[np.int64]
    uv: Array
    point: NDArray[np.int64]
    points: Array


@dataclass(frozen=True, eq=False)
class ModelParts:
    """A model to be written: one rectified camera an entry of ``cameras``; images as in :class:`ModelTables`, with
    ``cameras_of`` ``(I,)`` rows of ``cameras``; views of points only, ordered by image; ``colours`` ``(P, 3)`` uint8
    RGB; ``errors`` ``(n,)`` pixels, of each view."""

    cameras: Sequence[CameraEntry]
    names: Sequence[str]
    cameras_of: NDArray[np.int64]
    T_C_W: Array
    image: NDArray[np.int64]
    uv: Array
    point: NDArray[np.int64]
    points: Array
    colours: NDArray[np.uint8]
    errors: Array


def read_model(folder: Path) -> ModelTables:
    """The model in ``folder``; ``ToolError`` where a file is missing or is cut off."""
    try:
        ids, points = _read_points((folder / "points3D.bin").read_bytes())
        parts = _read_images((folder / "images.bin").read_bytes())
    except (struct.error, ValueError) as error:
        raise ToolError(f"{folder}: the COLMAP model is damaged ({error})") from None
    names, cameras, quaternions, translations, counts, table = parts
    order = np.argsort(ids)
    at = np.searchsorted(ids[order], table["point"]) if len(ids) else np.zeros(len(table), dtype=np.int64)
    at = np.minimum(at, max(len(ids) - 1, 0))
    known = ids[order][at] == table["point"] if len(ids) else np.zeros(len(table), dtype=bool)
    return ModelTables(
        names=tuple(names),
        cameras=np.array(cameras, dtype=np.int64),
        T_C_W=se3(rotation_from_quat_wxyz(np.reshape(quaternions, (-1, 4))), np.reshape(translations, (-1, 3))),
        image=np.repeat(np.arange(len(names)), counts),
        uv=table["xy"] - HALF_PX,
        point=np.where(known, order[at] if len(ids) else -1, -1),
        points=points,
    )


def write_model(folder: Path, parts: ModelParts) -> None:
    """Write the model into ``folder``, which is made."""
    folder.mkdir(parents=True)
    cameras = [
        _CAMERA.pack(row + 1, _PINHOLE, c.width, c.height, c.fx, c.fy, c.cx + HALF_PX, c.cy + HALF_PX)
        for row, c in enumerate(parts.cameras)
    ]
    (folder / "cameras.bin").write_bytes(_COUNT.pack(len(cameras)) + b"".join(cameras))
    (folder / "images.bin").write_bytes(_images(parts))
    (folder / "points3D.bin").write_bytes(_points(parts))


def _read_points(data: bytes) -> tuple[NDArray[np.int64], Array]:
    (count,) = _COUNT.unpack_from(data)
    ids, points, offset = np.zeros(0, dtype=np.int64), np.zeros((0, 3)), _COUNT.size
    if count * _POINT.size > len(data):
        raise ValueError(f"{count} points in {len(data)} bytes")
    rows = []
    for _ in range(count):
        row = _POINT.unpack_from(data, offset)
        rows.append(row[:4])
        offset += _POINT.size + row[8] * _TRACK_ENTRY
    if rows:
        ids = np.array([row[0] for row in rows], dtype=np.int64)
        points = np.array([row[1:] for row in rows], dtype=np.float64)
    return ids, points


def _read_images(data: bytes) -> tuple[list[str], list[int], list[float], list[float], list[int], NDArray[np.void]]:
    (count,) = _COUNT.unpack_from(data)
    offset = _COUNT.size
    names: list[str] = []
    cameras: list[int] = []
    quaternions: list[float] = []
    translations: list[float] = []
    counts: list[int] = []
    tables = [np.zeros(0, dtype=_POINT2D)]
    for _ in range(count):
        _, *pose, camera = _IMAGE.unpack_from(data, offset)
        end = data.index(b"\0", offset + _IMAGE.size)
        names.append(data[offset + _IMAGE.size : end].decode("utf-8", "surrogateescape"))
        (seen,) = _COUNT.unpack_from(data, end + 1)
        start = end + 1 + _COUNT.size
        tables.append(np.frombuffer(data, dtype=_POINT2D, count=seen, offset=start))
        quaternions += pose[:4]
        translations += pose[4:]
        cameras.append(camera)
        counts.append(seen)
        offset = start + seen * _POINT2D.itemsize
    return names, cameras, quaternions, translations, counts, np.concatenate(tables)


def _images(parts: ModelParts) -> bytes:
    table = np.zeros(len(parts.image), dtype=_POINT2D)
    table["xy"], table["point"] = parts.uv + HALF_PX, parts.point + 1
    bounds = np.searchsorted(parts.image, np.arange(len(parts.names) + 1))
    T = parts.T_C_W
    poses = np.concatenate([quat_wxyz_from_rotation(T[:, :3, :3]), T[:, :3, 3]], axis=1).tolist()
    out = [_COUNT.pack(len(parts.names))]
    for row, name in enumerate(parts.names):
        seen = table[bounds[row] : bounds[row + 1]]
        out.append(_IMAGE.pack(row + 1, *poses[row], int(parts.cameras_of[row]) + 1))
        out += [name.encode("utf-8", "surrogateescape"), b"\0", _COUNT.pack(len(seen)), seen.tobytes()]
    return b"".join(out)


def _points(parts: ModelParts) -> bytes:
    place = np.arange(len(parts.image)) - np.searchsorted(parts.image, parts.image, side="left")
    order = np.argsort(parts.point, kind="stable")
    tracks = np.column_stack([parts.image + 1, place]).astype("<u4")[order]
    start = np.searchsorted(parts.point[order], np.arange(len(parts.points) + 1))
    off = np.bincount(parts.point, parts.errors, minlength=len(parts.points))
    out = [_COUNT.pack(len(parts.points))]
    for j, (xyz, rgb) in enumerate(zip(parts.points.tolist(), parts.colours.tolist(), strict=True)):
        track = tracks[start[j] : start[j + 1]]
        out += [_POINT.pack(j + 1, *xyz, *rgb, off[j] / max(len(track), 1), len(track)), track.tobytes()]
    return b"".join(out)
