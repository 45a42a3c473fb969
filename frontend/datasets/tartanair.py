"""TartanAir (Wang et al., IROS 2020): rendered stereo with depth, a camera that is the same in all of it."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from maslam.backend.geometry import se3

from ..cameras.calibration import RawCamera, RawRig
from ..cameras.models import RigKind
from ..errors import FrontendError
from ..files.timestamps import NS_PER_S
from .assemble import FoundSequence, assemble, available_rigs
from .base import ImageSequence, Problems, Reader, choose_rig
from .camera_file import find_camera_file
from .depth_unit import unit_of_depth
from .image_times import TimedImages
from .images import first_size, list_images
from .truth import read_truth

_VIEWS = (("left", "right"), ("lcam_front", "rcam_front"))
"""Names of the two cameras: of the first version, and of TartanAir V2, of whose six directions the front is read."""
_RATE_HZ = 10.0
_BASELINE_M = 0.25
# Axes of the stored poses: x forward, y right, z down. Columns: the camera's x, y, z in them.
_T_NED_C = se3(np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]), np.zeros(3))


class TartanAirReader(Reader):
    """``image_left/<n>_left.png``, ``image_right/<n>_right.png``, ``depth_left/<n>_left_depth.npy`` (metres),
    ``pose_left.txt`` (``tx ty tz qx qy qz qw``, north-east-down); of TartanAir V2 ``lcam_front`` and ``rcam_front``
    instead of left and right, without its depth.

    Camera: 90 degrees wide (fx = 320 at 640 pixels), 0.25 m between the two; a calibration file in the folder comes
    first. No time stamps are published: 10 Hz, or the calibration's rate.
    """

    kind = "tartanair"

    def recognises(self, folder: Path) -> bool:
        """See :meth:`Reader.recognises`."""
        return _view(folder) is not None

    def open(self, folder: Path, rig: RigKind | None) -> ImageSequence:
        """See :meth:`Reader.open`."""
        problems = Problems()
        left_name, right_name = _view(folder) or _VIEWS[0]
        inside = folder / f"image_{left_name}"
        images = tuple(path for path in list_images(inside) if _is_numbered(path, left_name))
        if not images:
            raise FrontendError(f"{inside}: no images <n>_{left_name}.png")
        numbers = [path.stem.partition("_")[0] for path in images]
        right = _second(folder / f"image_{right_name}", [f"{n}_{right_name}" for n in numbers], (".png", ".jpg"))
        depth = _second(folder / "depth_left", [f"{n}_left_depth" for n in numbers], (".npy", ".png"))
        if (folder / "depth_lcam_front").is_dir() and not right and rig is None:
            problems.warning(
                f"{folder / 'depth_lcam_front'}: depth packed into colours is not read: read as one camera"
            )
        raw, source = find_camera_file(folder) or (_published(first_size(images)), folder)
        of_numbers = np.array([int(n) for n in numbers], dtype=np.int64)
        stamps = np.rint((of_numbers - of_numbers[0]) * (NS_PER_S / (raw.rate_hz or _RATE_HZ))).astype(np.int64)
        timed = TimedImages(images, stamps, inside, measured=False)
        poses = folder / f"pose_{left_name}.txt"
        given = read_truth(poses, timed, problems) if poses.is_file() else None
        truth = None if given is None else given.moved(_T_NED_C)
        found = FoundSequence(
            kind=self.kind,
            folder=folder,
            raw=raw,
            calibration=source,
            images=images,
            stamps_ns=stamps,
            stamps_source=inside,
            right=right,
            depth=depth,
            depth_unit_m=unit_of_depth(depth, raw.depth_unit_m, 1.0, source, problems),
            truth=truth,
        )
        stereo = bool(right) and raw.right is not None
        return assemble(found, choose_rig(available_rigs(stereo, bool(depth)), rig, folder), problems)


def _view(folder: Path) -> tuple[str, str] | None:
    """The names of the two cameras in the folder; None where it is none of this kind."""
    for view in _VIEWS:
        if any(_is_numbered(path, view[0]) for path in list_images(folder / f"image_{view[0]}")):
            return view
    return None


def _is_numbered(path: Path, name: str) -> bool:
    return re.fullmatch(rf"\d+_{name}", path.stem) is not None


def _second(folder: Path, stems: list[str], suffixes: tuple[str, ...]) -> tuple[Path, ...]:
    """The files of these names, whatever their suffix of those known; empty where there is no such folder."""
    if not folder.is_dir():
        return ()
    there = {path.stem: path for path in folder.iterdir() if path.suffix.lower() in suffixes}
    return tuple(there.get(stem, folder / f"{stem}{suffixes[0]}") for stem in stems)


def _published(size: tuple[int, int]) -> RawRig:
    """The data set's camera for images of ``size`` ``(width, height)``."""
    width, height = size
    camera = RawCamera(width / 2, width / 2, width / 2, height / 2, size)
    return RawRig(camera, camera, se3(np.eye(3), [_BASELINE_M, 0.0, 0.0]))
