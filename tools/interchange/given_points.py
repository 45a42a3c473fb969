"""Given 3-D points as depth of images that have none: clouds of the whole map, scans with their times, and map points
with the images that see them."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from maslam.backend.geometry import Array, se3_inverse, transform_points
from maslam.frontend.cameras.models import PinholeCamera
from maslam.frontend.datasets.stored_image import identities
from maslam.frontend.errors import FrontendError
from maslam.frontend.files.cloud_files import SUFFIXES, read_cloud
from maslam.frontend.files.colmap_poses import numbers_of_names
from maslam.frontend.files.headed_table import is_number, read_headed_table
from maslam.frontend.files.text_tables import read_text
from maslam.frontend.files.time_units import NotATime, parse_times
from maslam.frontend.mapping.point_depth import depth_of_points

from ..common.errors import ToolError
from ..common.text_table import counted

if TYPE_CHECKING:
    from maslam.frontend.datasets.base import ImageSequence

_COLMAP = "points3D.txt"
_SAME_NS = 1_000_000
_NEAR_NS = 500_000_000
"""A scan serves images up to so long before and after it."""


@dataclass(frozen=True, eq=False)
class GivenPoints:
    """Points in the frame of the poses. ``points`` ``(n, 3)``; ``seen``: for each image that sees any the rows of its
    points, None: which is found by what hides what. Or ``scans``: files of points in a body's frame, each with its
    pose ``T_W_B`` ``(m, 4, 4)`` and time ``stamps_ns`` ``(m,)`` ascending. ``text``: what there is, for people."""

    text: str
    points: Array
    seen: dict[int, NDArray[np.int64]] | None = None
    scans: tuple[Path, ...] = ()
    T_W_B: Array | None = None
    stamps_ns: NDArray[np.int64] | None = None

    def depth(self, index: int, stamp_ns: int, T_W_C: Array, camera: PinholeCamera) -> NDArray[np.float32]:
        """Depth image of frame ``index``, 0 where no point is near."""
        T_C_W = se3_inverse(T_W_C)
        if self.seen is not None:
            return depth_of_points(T_C_W, self.points[self.seen.get(index, np.zeros(0, np.int64))], camera, False)
        if not self.scans:
            return depth_of_points(T_C_W, self.points, camera, True)
        assert self.T_W_B is not None and self.stamps_ns is not None
        nearest = int(np.abs(self.stamps_ns - stamp_ns).argmin())
        if abs(int(self.stamps_ns[nearest]) - stamp_ns) > _NEAR_NS:
            return np.zeros((camera.height, camera.width), dtype=np.float32)
        points = transform_points(self.T_W_B[nearest], _scan(self.scans[nearest]))
        return depth_of_points(T_C_W, points, camera, True)

    def digest(self) -> str:
        """Of all that depth is made of."""
        parts = [self.points, *((self.T_W_B, self.stamps_ns) if self.scans else ())]
        digest = hashlib.sha256(b"".join(np.ascontiguousarray(part).tobytes() for part in parts if part is not None))
        for index, rows in sorted((self.seen or {}).items()):
            digest.update(f"{index} ".encode() + rows.tobytes())
        for identity in identities(self.scans):
            digest.update(identity.encode())
        return digest.hexdigest()


@lru_cache(maxsize=2)
def _scan(path: Path) -> Array:
    return read_cloud(path)


def points_file(points: Path, name: str, single: bool) -> Path:
    """Where the points of the sequence ``name`` are: ``points`` itself for a single one, else what in that folder has
    its name. :class:`ToolError` where that is nothing."""
    if not points.exists():
        raise ToolError(f"{points}: no such file or folder")
    if single and not (points / name).exists():
        return points
    hits = [points / name, *(points / f"{name}{suffix}" for suffix in SUFFIXES)]
    found = next((path for path in hits if path.exists()), None)
    if found is None:
        raise ToolError(f"{points}: no points for {name}; name the file or folder {name}")
    return found


def scans_of(path: Path) -> tuple[tuple[Path, ...], NDArray[np.int64]] | None:
    """The scans in a folder and their times, which are their names (else lines of ``times.txt``); None where ``path``
    is no folder of scans."""
    if not path.is_dir() or (path / _COLMAP).is_file():
        return None
    files = sorted(p for p in path.iterdir() if p.suffix.lower() in SUFFIXES and p.name not in ("times.txt",))
    if not files:
        raise ToolError(f"{path}: no scans ({', '.join(SUFFIXES)}) and no {_COLMAP}")
    listed = path / "times.txt"
    texts = read_text(listed).split() if listed.is_file() else [file.stem for file in files]
    if len(texts) != len(files):
        raise ToolError(f"{listed}: {len(texts)} times for {len(files)} scans")
    try:
        stamps = parse_times(texts).stamps_ns
    except NotATime as error:
        raise ToolError(
            f"{path}: {texts[error.index]!r} is no time; scans are named by their times, or times.txt has them"
        ) from None
    order = np.argsort(stamps, kind="stable")
    return tuple(files[k] for k in order), stamps[order]


def read_points(path: Path, sequence: ImageSequence) -> GivenPoints:
    """The points of a file, or of a COLMAP model as text, in the frame of the poses; :class:`ToolError` for files that
    are none, and where no image of the sequence sees any."""
    try:
        if path.is_dir():
            return _colmap(path, sequence)
        table = None
        if path.suffix.lower() in (".txt", ".csv"):
            table = read_headed_table(path)
        if table is not None and {"image", "time"} & set(table.headings):
            return _observed(path, list(table.headings), table.rows, table.lines, sequence)
        points = read_cloud(path)
    except FrontendError as error:
        raise ToolError(str(error)) from error
    return GivenPoints(f"{path.name}: {counted(len(points), 'point')}", points)


def _observed(
    path: Path, headings: list[str], rows: Sequence[Sequence[str]], lines: Sequence[int], sequence: ImageSequence
) -> GivenPoints:
    if not {"x", "y", "z"} <= set(headings):
        raise ToolError(f"{path}: columns x, y, z and image (its name) or time are meant")
    by_name = "image" in headings
    columns = [headings.index(name) for name in ("x", "y", "z")]
    for row, line in zip(rows, lines, strict=True):
        if len(row) != len(headings) or not all(is_number(row[k]) for k in columns):
            raise ToolError(f"{path}:{line}: not {len(headings)} columns with numbers x, y, z")
    points = np.array([[float(row[k]) for k in columns] for row in rows]).reshape(-1, 3)
    texts = [row[headings.index("image" if by_name else "time")] for row in rows]
    if by_name:
        index = _by_name(sequence)
        image = np.array([index.get(Path(text).stem, -1) for text in texts], dtype=np.int64)
    else:
        try:
            image = _by_time(parse_times(texts).stamps_ns, sequence)
        except NotATime as error:
            raise ToolError(f"{path}:{lines[error.index]}: no time: {texts[error.index]!r}") from None
    return _seen(path, points, np.arange(len(points)), image)


def _colmap(folder: Path, sequence: ImageSequence) -> GivenPoints:
    """Of ``points3D.txt`` and ``images.txt``."""
    names = {key: Path(name).stem for key, name in numbers_of_names(folder / "images.txt").items()}
    index = _by_name(sequence)
    points: list[list[float]] = []
    row: list[int] = []
    image: list[int] = []
    for number, line in enumerate(read_text(folder / _COLMAP).splitlines(), 1):
        words = line.split()
        if not words or words[0].startswith("#"):
            continue
        if len(words) < 8 or not all(is_number(word) for word in words[1:4]):
            raise ToolError(f"{folder / _COLMAP}:{number}: not ID, x, y, z, colour, error and track")
        for one in words[8::2]:
            row.append(len(points))
            image.append(index.get(names.get(one, ""), -1))
        points.append([float(word) for word in words[1:4]])
    return _seen(folder / _COLMAP, np.array(points).reshape(-1, 3), np.array(row, np.int64), np.array(image, np.int64))


def _seen(path: Path, points: Array, row: NDArray[np.int64], image: NDArray[np.int64]) -> GivenPoints:
    known = image >= 0
    if not known.any():
        raise ToolError(
            f"{path}: none of its {len(points)} points is seen by an image of this sequence: are the names or times "
            "the images'?"
        )
    if not np.isfinite(points).all():
        raise ToolError(f"{path}: a point that is not finite")
    seen = {int(k): row[image == k] for k in np.unique(image[known])}
    lost = int((~known).sum())
    by = counted(len(seen), "image")
    text = f"{path.name}: {counted(len(points), 'point')}, seen {int(known.sum())} times by {by}"
    return GivenPoints(text + (f", {lost} times by others" if lost else ""), points, seen)


def _by_name(sequence: ImageSequence) -> dict[str, int]:
    return {Path(str(one)).stem: k for k, one in enumerate(sequence.left)}


def _by_time(stamps_ns: NDArray[np.int64], sequence: ImageSequence) -> NDArray[np.int64]:
    """The image of each time ``(n,)``, -1 where none is within a millisecond."""
    right = np.clip(np.searchsorted(sequence.stamps_ns, stamps_ns), 1, len(sequence) - 1) if len(sequence) > 1 else 0
    left = np.maximum(np.asarray(right) - 1, 0)
    before, after = sequence.stamps_ns[left], sequence.stamps_ns[right]
    nearest = np.where(stamps_ns - before <= after - stamps_ns, left, right)
    return np.where(np.abs(sequence.stamps_ns[nearest] - stamps_ns) <= _SAME_NS, nearest, -1)
