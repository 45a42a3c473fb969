"""7-Scenes (Shotton et al., CVPR 2013): hand-held RGB-D, three files a frame in one folder."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from backend.geometry import project_to_so3, se3
from frontend import tables
from frontend.cameras import PinholeCamera, Rig, RigKind
from frontend.datasets import checks
from frontend.datasets.base import ImageSequence, Problems, Reader, choose_rig
from frontend.datasets.images import image_size, list_images
from frontend.errors import FrontendError
from frontend.stamps import NS_PER_S
from frontend.trajectory import Trajectory

_COLOUR = re.compile(r"frame-(\d+)\.color\.(?:png|jpg|jpeg)")
_RATE_HZ = 30  # of the Kinect; the data set has no time stamps
_DEFAULT_FOCAL_PX = 525.0  # of the Kinect's colour camera, to which depth is registered; the published 585 is its depth camera's
_DEPTH_UNIT_M = 0.001


class SevenScenesReader(Reader):
    """``frame-<n>.color.png|jpg``, ``frame-<n>.depth.png`` (mm, 0 and 65535 unknown), ``frame-<n>.pose.txt`` (``T_W_C``, 4x4).

    ``camera.txt``, if there: ``fx fy cx cy`` pixels of the colour images. Time stamps are the frame numbers at 30 Hz.
    """

    kind = "7scenes"

    @classmethod
    def recognises(cls, folder: Path) -> bool:
        return any(_COLOUR.fullmatch(path.name) for path in folder.iterdir())

    @classmethod
    def open(cls, folder: Path, rig: RigKind | None) -> ImageSequence:
        problems = Problems()
        images = tuple(path for path in list_images(folder) if _COLOUR.fullmatch(path.name))
        numbers = np.array([_number(path) for path in images], dtype=np.int64)
        has_depth = any((folder / f"{_stem(path)}.depth.png").is_file() for path in images)
        chosen = choose_rig([RigKind.RGBD, RigKind.MONO] if has_depth else [RigKind.MONO], rig, folder)
        depth = tuple(folder / f"{_stem(path)}.depth.png" for path in images) if chosen is RigKind.RGBD else ()
        checks.check_files(depth, "depth image", problems)
        size = image_size(images[0])
        camera = _camera(folder, size, problems)
        times = np.rint(numbers * (NS_PER_S / _RATE_HZ)).astype(np.int64)
        checks.check_stamps(times, [path.name for path in images], folder, problems)
        return ImageSequence(
            kind=cls.kind, name=folder.resolve().name, rig=Rig(chosen, camera), stamps_ns=times, left=images, stored_size=size, depth=depth,
            depth_unit_m=_DEPTH_UNIT_M, groundtruth=_groundtruth(images, times, problems), problems=tuple(problems.found),
        )  # fmt: skip


def _stem(path: Path) -> str:
    return path.name.split(".")[0]


def _number(path: Path) -> int:
    return int(_stem(path).removeprefix("frame-"))


def _camera(folder: Path, size: tuple[int, int], problems: Problems) -> PinholeCamera:
    source = folder / "camera.txt"
    if source.is_file():
        values = tables.read_table(source, 4, "a camera (fx fy cx cy)")
        if len(values) != 1:
            raise FrontendError(f"{source}: one line of four numbers (fx fy cx cy) expected, found {len(values)}")
        camera = PinholeCamera(*size, *values[0].tolist())
    else:
        focal = _DEFAULT_FOCAL_PX * size[0] / 640
        camera = PinholeCamera(*size, focal, focal, size[0] / 2, size[1] / 2)
        problems.warning(f"{source}: not there; the Kinect's usual fx = fy = {focal:.0f} px, centre {camera.cx:.0f} {camera.cy:.0f} taken")
    checks.check_camera(camera, source, problems)
    return camera


def _groundtruth(images: tuple[Path, ...], times: NDArray[np.int64], problems: Problems) -> Trajectory | None:
    """Poses of the frames that have one. The published rotations are not exactly orthonormal: the nearest rotation is taken."""
    stamps, poses, missing = [], [], []
    for stamp, image in zip(times.tolist(), images, strict=True):
        path = image.with_name(f"{_stem(image)}.pose.txt")
        if not path.is_file():
            missing.append(path)
            continue
        pose = tables.read_table(path, 4, "a row of a 4x4 pose")
        if pose.shape != (4, 4) or abs(np.linalg.det(pose[:3, :3]) - 1.0) > 0.05:
            raise FrontendError(f"{path}: not a rigid 4x4 transform")
        stamps.append(stamp)
        poses.append(pose)
    if missing and poses:
        problems.warning(f"{missing[0]}: no ground truth for {len(missing)} of {len(images)} frames")
    if not poses:
        return None
    matrices = np.array(poses)
    return Trajectory(np.array(stamps, dtype=np.int64), se3(project_to_so3(matrices[:, :3, :3]), matrices[:, :3, 3]))
