"""TUM RGB-D (Sturm et al., IROS 2012): colour and depth with their own time stamps, associated by time."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..cameras.calibration import Distortion, RawCamera, RawRig
from ..cameras.models import RigKind
from ..errors import FrontendError
from ..files import text_tables
from ..files.timestamps import decimal_ns
from ..files.trajectory import read_tum
from .assemble import FoundSequence, assemble, available_rigs
from .base import ImageSequence, Problems, Reader, choose_rig
from .camera_file import find_camera_file

_TOLERANCE_NS = 20_000_000  # between colour and depth: more than half a frame at 30 Hz is another frame
DEPTH_UNIT_M = 1.0 / 5000.0
_RADTAN = Distortion.RADIAL_TANGENTIAL
_PUBLISHED = {  # colour cameras, from the data set's page; the recordings' folder names say which
    "freiburg1": RawCamera(517.3, 516.5, 318.6, 255.3, (640, 480), _RADTAN, (0.2624, -0.9531, -0.0054, 0.0026, 1.1633)),
    "freiburg2": RawCamera(
        520.9, 521.0, 325.1, 249.7, (640, 480), _RADTAN, (0.2312, -0.7849, -0.0033, -0.0001, 0.9172)
    ),
    "freiburg3": RawCamera(535.4, 539.2, 320.1, 247.6, (640, 480)),
}
_ROS_DEFAULT = RawCamera(525.0, 525.0, 319.5, 239.5, (640, 480))


class TumReader(Reader):
    """``rgb.txt``, ``depth.txt`` (``time file`` lines), ``groundtruth.txt`` if there. Depth: 5000 steps per metre.

    Camera: a calibration file in the folder, else the published one by the folder's name (freiburg1 to 3), else the
    ROS default.
    """

    kind = "tum"

    def recognises(self, folder: Path) -> bool:
        """See :meth:`Reader.recognises`."""
        return (folder / "rgb.txt").is_file()

    def open(self, folder: Path, rig: RigKind | None) -> ImageSequence:
        """See :meth:`Reader.open`."""
        problems = Problems()
        stamps, images = _listed(folder / "rgb.txt")
        has_depth = (folder / "depth.txt").is_file()
        kind = choose_rig(available_rigs(False, has_depth), rig, folder)
        depth: tuple[Path, ...] = ()
        if kind is RigKind.RGBD:
            stamps, images, depth = _with_depth(folder, stamps, images, problems)
        raw, source = camera_of_recording(folder, problems)
        truth = folder / "groundtruth.txt"
        found = FoundSequence(
            kind=self.kind,
            folder=folder,
            raw=raw,
            calibration=source,
            images=images,
            stamps_ns=stamps,
            stamps_source=folder / "rgb.txt",
            depth=depth,
            depth_unit_m=raw.depth_unit_m or DEPTH_UNIT_M,
            truth=read_tum(truth) if truth.is_file() else None,
        )
        return assemble(found, kind, problems)


def _listed(path: Path) -> tuple[NDArray[np.int64], tuple[Path, ...]]:
    stamps, files = [], []
    for number, line in enumerate(text_tables.read_text(path).splitlines(), 1):
        fields = line.split()
        if not fields or fields[0].startswith("#"):
            continue
        try:
            stamps.append(decimal_ns(fields[0]))
            files.append(path.parent / fields[1])
        except (ValueError, IndexError):
            raise FrontendError(
                f"{path}:{number}: a time in seconds and a file expected, found {line[:60]!r}"
            ) from None
    if not files:
        raise FrontendError(f"{path}: no images")
    return np.array(stamps, dtype=np.int64), tuple(files)


def _with_depth(
    folder: Path, stamps: NDArray[np.int64], images: tuple[Path, ...], problems: Problems
) -> tuple[NDArray[np.int64], tuple[Path, ...], tuple[Path, ...]]:
    """Colour frames whose nearest depth image is near enough and nearer to no other colour frame."""
    depth_stamps, depth = _listed(folder / "depth.txt")
    if (np.diff(stamps) <= 0).any() or (np.diff(depth_stamps) <= 0).any():
        back = folder / ("rgb.txt" if (np.diff(stamps) <= 0).any() else "depth.txt")
        raise FrontendError(f"{back}: time goes back or stands still")
    to_depth, to_colour = _nearest(stamps, depth_stamps), _nearest(depth_stamps, stamps)
    mutual = to_colour[to_depth] == np.arange(len(stamps))
    kept = np.flatnonzero(mutual & (np.abs(depth_stamps[to_depth] - stamps) <= _TOLERANCE_NS))
    if not len(kept):
        raise FrontendError(
            f"{folder / 'depth.txt'}: no depth image within {_TOLERANCE_NS / 1e6:.0f} ms of a colour image"
        )
    if len(kept) < len(images):
        problems.warning(
            f"{folder / 'depth.txt'}: no depth image for {len(images) - len(kept)} of {len(images)} frames; "
            "these are left out"
        )
    return stamps[kept], tuple(images[i] for i in kept), tuple(depth[i] for i in to_depth[kept])


def _nearest(stamps: NDArray[np.int64], among: NDArray[np.int64]) -> NDArray[np.int64]:
    after = np.clip(np.searchsorted(among, stamps), 0, len(among) - 1)
    before = np.maximum(after - 1, 0)
    return np.where(stamps - among[before] <= among[after] - stamps, before, after)


def camera_of_recording(folder: Path, problems: Problems) -> tuple[RawRig, Path]:
    """The calibration in the folder, else the published one by the folder's name, else ROS's, which is said."""
    found = find_camera_file(folder)
    if found is not None:
        return found
    name = re.search(r"freiburg[123]", folder.resolve().name)
    if name:
        return RawRig(_PUBLISHED[name[0]]), folder
    problems.warning(
        f"{folder}: no calibration file, and no freiburg1 to 3 in the folder's name: "
        "fx = fy = 525 px taken (ROS default)"
    )
    return RawRig(_ROS_DEFAULT), folder
