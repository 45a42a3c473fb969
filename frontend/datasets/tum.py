"""TUM RGB-D (Sturm et al., IROS 2012): colour and depth with their own time stamps, associated by time."""

from __future__ import annotations

import re
from pathlib import Path

from ..cameras.calibration import Distortion, RawCamera, RawRig
from ..cameras.models import RigKind
from ..errors import FrontendError
from .assemble import FoundSequence, assemble, available_rigs
from .base import ImageSequence, Problems, Reader, choose_rig
from .camera_file import find_camera_file
from .depth_unit import unit_of_depth
from .image_times import TimedImages
from .listed_times import read_listed_times
from .pairing import paired_in_time
from .truth import find_truth

TOLERANCE_NS = 20_000_000  # between colour and depth: more than half a frame at 30 Hz is another frame
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
        images = read_list(folder / "rgb.txt", problems)
        has_depth = (folder / "depth.txt").is_file()
        kind = choose_rig(available_rigs(False, has_depth), rig, folder)
        depth: tuple[Path, ...] = ()
        if kind is RigKind.RGBD:
            images, depth = _with_depth(folder, images, problems)
        raw, source = camera_of_recording(folder, problems)
        found = FoundSequence(
            kind=self.kind,
            folder=folder,
            raw=raw,
            calibration=source,
            images=images.files,
            stamps_ns=images.stamps_ns,
            stamps_source=images.source,
            depth=depth,
            depth_unit_m=unit_of_depth(depth, raw.depth_unit_m, DEPTH_UNIT_M, source, problems),
            truth=find_truth(folder, images, problems),
        )
        return assemble(found, kind, problems)


def read_list(path: Path, problems: Problems) -> TimedImages:
    """The images that a list names, a time and a file in each line."""
    listed = read_listed_times(path)
    if not len(listed.stamps_ns):
        raise FrontendError(f"{path}: no images")
    if not listed.names:
        raise FrontendError(f"{path}: a time and an image file in each line expected")
    if listed.doubt:
        problems.warning(f"{path}: {listed.doubt}")
    return TimedImages(tuple(path.parent / name for name in listed.names), listed.stamps_ns, path)


def _with_depth(folder: Path, images: TimedImages, problems: Problems) -> tuple[TimedImages, tuple[Path, ...]]:
    """Colour frames whose nearest depth image is near enough and nearer to no other colour frame."""
    depth = read_list(folder / "depth.txt", problems)
    return paired_in_time(images, depth, "depth image", problems, TOLERANCE_NS)


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
