"""7-Scenes (Shotton et al., CVPR 2013): a hand-held Kinect, three files per frame in one folder."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from maslam.backend.geometry import se3, se3_inverse

from ..cameras.calibration import RawCamera, RawRig
from ..cameras.models import PinholeCamera, RigKind
from ..errors import FrontendError
from ..files import text_tables
from ..files.timestamps import NS_PER_S
from .assemble import DepthSensor, FoundSequence, assemble, available_rigs
from .base import ImageSequence, Problems, Reader, choose_rig
from .images import first_size, list_images
from .numbering import missing_images
from .truth import Truth, truth_of_files

_COLOUR = re.compile(r"frame-(\d+)\.color\.(?:png|jpg|jpeg)")
_RATE_HZ = 30  # of the Kinect; the data set has no time stamps
# Depth is stored as the Kinect's depth camera measured it, and the poses, by KinectFusion, are that camera's. The data
# set's page publishes its intrinsics (585, centre 320, 240) and says that depth and colour are not registered to each
# other; the colour camera's are those of OpenNI's driver (525).
_COLOUR_FOCAL_PX = 525.0  # at 640 pixels of width
_DEPTH_FOCAL_PX = 585.0  # at 640 pixels of width
# The colour camera stands 2.5 cm to the right of the depth camera (a Kinect's lenses, looking out: depth, colour,
# projector). Edges of the depth fall on edges of the image there and nowhere else: checked on RedKitchen.
_T_C_D = se3(np.eye(3), [-0.025, 0.0, 0.0])


class SevenScenesReader(Reader):
    """``frame-<n>.color.png|jpg``, ``frame-<n>.depth.png`` (mm, 0 and 65535 unknown, as the depth camera sees
    it), ``frame-<n>.pose.txt`` (4x4, depth camera to world).

    ``camera.txt``, if there: ``fx fy cx cy`` pixels of the colour images. Time stamps are the frame numbers at 30 Hz.
    What comes out, depth and ground truth, is the colour camera's.
    """

    kind = "7scenes"

    def recognises(self, folder: Path) -> bool:
        """See :meth:`Reader.recognises`."""
        return any(_COLOUR.fullmatch(path.name) for path in folder.iterdir())

    def open(self, folder: Path, rig: RigKind | None) -> ImageSequence:
        """See :meth:`Reader.open`."""
        problems = Problems()
        images = tuple(path for path in list_images(folder) if _COLOUR.fullmatch(path.name))
        depth = tuple(path.with_name(f"{_stem(path)}.depth.png") for path in images)
        times = np.array(
            [int(_stem(path).removeprefix("frame-")) * NS_PER_S // _RATE_HZ for path in images], dtype=np.int64
        )
        size = first_size(images)
        found = FoundSequence(
            kind=self.kind,
            folder=folder,
            raw=RawRig(_camera(folder, size, problems)),
            calibration=folder / "camera.txt",
            images=images,
            stamps_ns=times,
            stamps_source=folder,
            depth=depth,
            depth_sensor=DepthSensor(_depth_camera(size), _T_C_D),
            truth=_groundtruth(folder, images, times, problems),
            missing=missing_images([_stem(path) for path in images]),
        )
        has_depth = any(path.is_file() for path in depth)
        return assemble(found, choose_rig(available_rigs(False, has_depth), rig, folder), problems)


def _stem(path: Path) -> str:
    return path.name.split(".")[0]


def _camera(folder: Path, size: tuple[int, int], problems: Problems) -> RawCamera:
    source = folder / "camera.txt"
    if source.is_file():
        values = text_tables.read_table(source, 4, "a camera (fx fy cx cy)")
        if len(values) != 1:
            raise FrontendError(f"{source}: one line of four numbers (fx fy cx cy) expected, found {len(values)}")
        fx, fy, cx, cy = values[0].tolist()
        return RawCamera(fx, fy, cx, cy)
    focal = _COLOUR_FOCAL_PX * size[0] / 640
    problems.warning(f"{source}: not there; the Kinect's usual fx = fy = {focal:.0f} px and the image centre are taken")
    return RawCamera(focal, focal, size[0] / 2, size[1] / 2)


def _depth_camera(size: tuple[int, int]) -> PinholeCamera:
    width, height = size
    focal = _DEPTH_FOCAL_PX * width / 640
    return PinholeCamera(width, height, focal, focal, width / 2, height / 2)


def _groundtruth(folder: Path, images: tuple[Path, ...], times: NDArray[np.int64], problems: Problems) -> Truth | None:
    """Colour camera's poses of the frames that have one. The published rotations are not exactly
    orthonormal: the nearest rotation is taken."""
    files = [path.with_name(f"{_stem(path)}.pose.txt") for path in images]
    truth = truth_of_files(folder, [path if path.is_file() else None for path in files], times, problems)
    return None if truth is None else truth.moved(se3_inverse(_T_C_D))
