"""Any folder of images with a calibration file beside them; also what ``maslam render`` writes for each agent."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..cameras.calibration import RawRig
from ..cameras.models import RigKind
from ..errors import FrontendError
from ..files.timestamps import NS_PER_S, decimal_ns, read_stamps
from ..files.trajectory import Trajectory, read_kitti_poses, read_tum
from .assemble import FoundSequence, assemble, available_rigs, frame_truth
from .base import ImageSequence, Problems, Reader, choose_rig
from .camera_file import find_camera_file
from .images import list_images
from .numbering import MissingImages, missing_images, numbered_steps
from .shared_camera import find_shared_camera

_LEFT = ("image_0", "left", "images", "image", "rgb", "color", "cam0", "left_camera", "infra1", ".")
_RIGHT = {"image_0": "image_1", "left": "right", "cam0": "cam1", "left_camera": "right_camera", "infra1": "infra2"}
_DEPTH = ("depth_0", "depth")
_TIMES = ("times.txt", "timestamps.txt")
_UNITS_NS = {19: 1, 16: 1_000, 13: 1_000_000}  # digits of a present-day Unix time in ns, us, ms
_DEFAULT_RATE_HZ = 10.0


class FolderReader(Reader):
    """Images in the folder itself or in ``image_0`` (``left``, ``images``, ``rgb``, ...); stereo with ``image_1``
    (``right``), RGB-D with ``depth_0`` (``depth``), files of one frame having one name; a calibration file (see
    :mod:`maslam.frontend.cameras.calibration_files`).

    Time stamps: ``times.txt`` (seconds, one an image), else file names that are times (seconds with a point; ns, us
    or ms by their number of digits), else the rate in the calibration file; images missing in the file names' numbers
    then take their time. Ground truth: ``poses.txt`` (KITTI rows,
    one an image) or ``groundtruth.txt|.tum``.
    """

    kind = "images"

    def recognises(self, folder: Path) -> bool:
        """See :meth:`Reader.recognises`."""
        return _image_folder(folder) is not None

    def open(self, folder: Path, rig: RigKind | None) -> ImageSequence:
        """See :meth:`Reader.open`."""
        problems = Problems()
        inside = _image_folder(folder)
        images = tuple(list_images(folder / inside)) if inside else ()
        calibration = (
            find_camera_file(folder)
            or (find_camera_file(folder / inside) if inside else None)
            or find_shared_camera(folder, problems)
        )
        if calibration is None:
            raise FrontendError(
                f"{folder}: images but no calibration file; put a camera.yaml beside them "
                "(width, height, fx, fy, cx, cy)"
            )
        raw, source = calibration
        right = _partners(folder, _RIGHT.get(inside or ""), images)
        depth = next((files for name in _DEPTH if (files := _partners(folder, name, images))), ())
        if right and raw.right is None:
            _say_unused(source, right[0].parent, raw, RigKind.RGBD if depth and rig is None else rig, problems)
            right = ()
        if raw.right is not None and not right and not depth:  # of RGB-D, Camera.bf is the projector's
            problems.warning(f"{source}: a calibrated pair, but {folder} has no right images: read as mono")
        if depth and raw.depth_unit_m is None:
            problems.warning(f"{source}: no depth unit (depth_unit_m, DepthMapFactor): millimetres taken")
        times, times_source, missing = _times(folder, images, raw, problems)
        found = FoundSequence(
            kind=self.kind,
            folder=folder,
            raw=raw,
            calibration=source,
            images=images,
            stamps_ns=times,
            stamps_source=times_source,
            right=right,
            depth=depth,
            depth_unit_m=raw.depth_unit_m or 0.001,
            truth=_groundtruth(folder, times),
            missing=missing,
        )
        return assemble(found, choose_rig(available_rigs(bool(right), bool(depth)), rig, folder), problems)


def _image_folder(folder: Path) -> str | None:
    return next((name for name in _LEFT if list_images(folder / name)), None)


def _say_unused(source: Path, folder: Path, raw: RawRig, rig: RigKind | None, problems: Problems) -> None:
    """Right images that the calibration is of no use for: an error where its pair cannot be what it says."""
    why = raw.contradiction or raw.no_pair or "no baseline of a pair: add baseline_m"
    if rig is RigKind.STEREO or (rig is None and raw.contradiction):
        raise FrontendError(f"{source}: {why}")
    if rig is None:
        problems.warning(f"{source}: right images in {folder} are not used, read as one camera: {why}")


def _partners(folder: Path, name: str | None, images: tuple[Path, ...]) -> tuple[Path, ...]:
    """The files in sub-folder ``name`` that belong to ``images``, by name whatever the suffix; empty where there is
    no such folder."""
    if name is None or not (folder / name).is_dir():
        return ()
    by_stem = {path.stem: path for path in list_images(folder / name)}
    return tuple(by_stem.get(path.stem, folder / name / path.name) for path in images)


def _times(
    folder: Path, images: tuple[Path, ...], raw: RawRig, problems: Problems
) -> tuple[NDArray[np.int64], Path, tuple[MissingImages, ...]]:
    """Time stamps, their source, and images missing in the names' numbers; names that are times count nothing, and a
    list of times says what there was."""
    stems = [path.stem for path in images]
    path = next((folder / name for name in _TIMES if (folder / name).is_file()), None)
    if path is not None:
        times = read_stamps(path)
        if len(times) != len(images):
            raise FrontendError(f"{path}: {len(times)} times for {len(images)} images in {images[0].parent}")
        return times, path, ()
    by_name = _times_of_names(stems)
    if by_name is not None:
        return by_name, images[0].parent, ()
    rate_hz = raw.rate_hz
    if rate_hz is None or rate_hz <= 0:
        rate_hz = _DEFAULT_RATE_HZ
        problems.warning(
            f"{folder}: no times.txt, no times in the file names, no rate in the calibration: {rate_hz:.0f} Hz taken"
        )
    numbers, step = numbered_steps(stems)
    ticks = (numbers - numbers[0]) // step if step else np.arange(len(images))
    return np.rint(ticks * (NS_PER_S / rate_hz)).astype(np.int64), folder, missing_images(stems)


def _times_of_names(stems: list[str]) -> NDArray[np.int64] | None:
    """Nanoseconds where all names are times, else None: frame numbers are no times."""
    if all("." in stem and stem.replace(".", "", 1).isdigit() for stem in stems):
        return np.array([decimal_ns(stem) for stem in stems], dtype=np.int64)
    digits = {len(stem) if stem.isdigit() else 0 for stem in stems}
    unit = _UNITS_NS.get(digits.pop()) if len(digits) == 1 else None
    return None if unit is None else np.array([int(stem) * unit for stem in stems], dtype=np.int64)


def _groundtruth(folder: Path, times: NDArray[np.int64]) -> Trajectory | None:
    rows = folder / "poses.txt"
    if rows.is_file():
        _, poses = read_kitti_poses(rows)
        if len(poses) != len(times):
            raise FrontendError(f"{rows}: {len(poses)} poses for {len(times)} images")
        return frame_truth(times, poses)
    lines = next((folder / name for name in ("groundtruth.txt", "groundtruth.tum") if (folder / name).is_file()), None)
    return None if lines is None else read_tum(lines)
