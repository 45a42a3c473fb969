"""Lists of associated images, as TUM's ``associate.py`` writes them and ORB-SLAM reads them."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from maslam.backend.geometry import rotation_from_quat_wxyz, se3

from ..cameras.models import RigKind
from ..errors import FrontendError
from ..files import text_tables
from ..files.timestamps import NS_PER_S, decimal_ns
from ..files.trajectory import Trajectory
from . import icl_nuim
from .assemble import FoundSequence, assemble, available_rigs
from .base import ImageSequence, Problems, Reader, choose_rig
from .depth_unit import unit_of_depth
from .image_times import TimedImages
from .images import IMAGE_SUFFIXES
from .truth import Truth, find_truth
from .tum import DEPTH_UNIT_M, camera_of_recording

_NAME = re.compile(r"(associat\w*|assoc|rgbd?_assoc\w*|\w*_assoc(iat\w*)?)\.txt", re.IGNORECASE)
_POSE = 7
_FRAME_RATE_HZ = 30.0


@dataclass(frozen=True)
class _AssociatedLine:
    """Image, depth (where the line has one) and pose ``tx ty tz qx qy qz qw`` (likewise), with their times in ns."""

    stamp_ns: int
    image: Path
    depth: Path | None
    truth_ns: int
    truth: tuple[float, ...]


class AssociationsReader(Reader):
    """``associations.txt`` (``associate.txt``, ``…_assoc.txt``): ``time rgb/file time depth/file`` lines, the two in
    any order, or colour and a pose, or all three (``time tx ty tz qx qy qz qw``).

    Camera and depth unit as of TUM recordings, or of ICL-NUIM (see :mod:`.icl_nuim`). Ground truth: the poses in the
    list, else ``groundtruth.txt``.
    """

    kind = "associations"

    def recognises(self, folder: Path) -> bool:
        """See :meth:`Reader.recognises`."""
        return bool(_lists(folder))

    def open(self, folder: Path, rig: RigKind | None) -> ImageSequence:
        """See :meth:`Reader.open`."""
        problems = Problems()
        lists = _lists(folder)
        if len(lists) > 1:
            problems.warning(f"{lists[0]}: read, and {', '.join(p.name for p in lists[1:])} beside it is not")
        lines = _read(lists[0])
        if len(lines) > 1 and all(after.stamp_ns < before.stamp_ns for before, after in pairwise(lines)):
            problems.warning(f"{lists[0]}: its rows are in reverse order of time: sorted")
            lines.reverse()
        stamps = np.array([line.stamp_ns for line in lines], dtype=np.int64)
        icl = icl_nuim.poses_file(folder) if _are_numbers(stamps) else None
        if _are_numbers(stamps):
            problems.warning(f"{lists[0]}: the times are frame numbers: {_FRAME_RATE_HZ:.0f} Hz taken")
            stamps = np.rint(stamps / _FRAME_RATE_HZ).astype(np.int64)
        has_depth = all(line.depth is not None for line in lines)
        depth = tuple(line.depth for line in lines if line.depth is not None) if has_depth else ()
        raw, source = (icl_nuim.camera if icl else camera_of_recording)(folder, problems)
        found = FoundSequence(
            kind=self.kind,
            folder=folder,
            raw=raw,
            calibration=source,
            images=tuple(line.image for line in lines),
            stamps_ns=stamps,
            stamps_source=lists[0],
            depth=depth,
            depth_unit_m=unit_of_depth(depth, raw.depth_unit_m, DEPTH_UNIT_M, source, problems),
            truth=icl_nuim.truth(icl, _FRAME_RATE_HZ, problems) if icl else _truth(folder, lists[0], lines, problems),
        )
        return assemble(found, choose_rig(available_rigs(False, has_depth), rig, folder), problems)


def _lists(folder: Path) -> list[Path]:
    found = sorted(path for path in folder.iterdir() if _NAME.fullmatch(path.name) and path.is_file())
    return [path for path in found if _names_images(path)]


def _names_images(path: Path) -> bool:
    """Whether the first line that is no comment names an image; False where the file cannot be read."""
    try:
        with path.open("rb") as file:
            head = file.read(4096).decode("utf-8-sig", "replace").splitlines()
    except OSError:
        return False
    first = next((line.split() for line in head if line.strip() and not line.lstrip().startswith("#")), [])
    return any(Path(field).suffix.lower() in IMAGE_SUFFIXES for field in first)


def _read(path: Path) -> list[_AssociatedLine]:
    lines = []
    for number, text in enumerate(text_tables.read_bytes(path).decode("utf-8-sig", "replace").splitlines(), 1):
        fields = text.replace(",", " ").split()
        if not fields or fields[0].startswith("#"):
            continue
        try:
            lines.append(_line(path.parent, fields))
        except ValueError:
            expected = "time file time file, or time file time tx ty tz qx qy qz qw"
            raise FrontendError(f"{path}:{number}: {expected} expected, found {text[:60]!r}") from None
    if not lines:
        raise FrontendError(f"{path}: no images")
    return lines


def _line(folder: Path, fields: Sequence[str]) -> _AssociatedLine:
    """``ValueError`` for what is no such line."""
    files: list[tuple[int, Path]] = []
    truth: tuple[float, ...] = ()
    truth_ns, rest = 0, list(fields)
    while rest:
        stamp = decimal_ns(rest.pop(0))
        if rest and Path(rest[0]).suffix.lower() in IMAGE_SUFFIXES:
            files.append((stamp, folder / rest.pop(0)))
        elif len(rest) >= _POSE and not truth:
            truth_ns, truth = stamp, tuple(float(value) for value in rest[:_POSE])
            rest = rest[_POSE:]
        else:
            raise ValueError
    if not 1 <= len(files) <= 2 or not np.isfinite(truth).all():
        raise ValueError
    files.sort(key=lambda one: "depth" in f"{one[1].parent.name}/{one[1].name}".lower())
    return _AssociatedLine(files[0][0], files[0][1], files[1][1] if len(files) == 2 else None, truth_ns, truth)


def _are_numbers(stamps: NDArray[np.int64]) -> bool:
    """Whether times are frame numbers, as ICL-NUIM's lists have them."""
    return len(stamps) > 1 and not (stamps % NS_PER_S).any() and int(np.median(np.diff(stamps))) == NS_PER_S


def _truth(folder: Path, source: Path, lines: Sequence[_AssociatedLine], problems: Problems) -> Truth | None:
    if not all(line.truth for line in lines):
        stamps = np.array([line.stamp_ns for line in lines], dtype=np.int64)
        return find_truth(folder, TimedImages(tuple(line.image for line in lines), stamps, source), problems)
    values = np.array([line.truth for line in lines])
    stamps = np.array([line.truth_ns for line in lines], dtype=np.int64)
    lengths = np.linalg.norm(values[:, 3:], axis=1)
    if (np.abs(lengths - 1.0) > 0.05).any() or (np.diff(stamps) <= 0).any():
        problems.warning(f"{source}: poses whose quaternions are not of length 1, or times that go back: left out")
        return None
    return Truth(Trajectory(stamps, se3(rotation_from_quat_wxyz(values[:, [6, 3, 4, 5]]), values[:, :3])), source)
