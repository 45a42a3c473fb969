"""KITTI raw drives (Geiger et al., IJRR 2013): ``image_00/data``, dates as times, the calibration of the day above."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from maslam.backend.geometry import product, se3, se3_inverse

from ..cameras.calibration import Distortion, RawCamera, RawRig
from ..cameras.models import RigKind
from ..errors import FrontendError
from ..files import text_tables
from .above import folder_above
from .assemble import FoundSequence, assemble, available_rigs
from .base import ImageSequence, Problems, Reader, choose_rig
from .image_times import by_list
from .images import first_size, list_images
from .kitti_oxts import poses_of_imu
from .listed_times import read_listed_times
from .truth import as_truth, frame_truth

Array = NDArray[np.float64]
Lists = dict[str, Array]

_PAIRS = (("00", "01"), ("02", "03"))  # grey, then colour: folders image_<nn>
_CALIBRATION = "calib_cam_to_cam.txt"


class KittiRawReader(Reader):
    """A drive: ``image_<nn>/data/<number>.png`` with ``image_<nn>/timestamps.txt`` (dates), and in it or above
    ``calib_cam_to_cam.txt``. Ground truth: ``oxts/data`` (GPS and IMU), where ``calib_imu_to_velo.txt`` and
    ``calib_velo_to_cam.txt`` say how it stands.

    Rectified drives (``_sync``) are read as they are, others (``_extract``, images of the size before rectification)
    are rectified here.
    """

    kind = "kitti-raw"

    def recognises(self, folder: Path) -> bool:
        """See :meth:`Reader.recognises`."""
        return any((folder / f"image_{left}" / "data").is_dir() for left, _ in _PAIRS)

    def open(self, folder: Path, rig: RigKind | None) -> ImageSequence:
        """See :meth:`Reader.open`."""
        problems = Problems()
        pair = next((p for p in _PAIRS if list_images(folder / f"image_{p[0]}" / "data")), None)
        if pair is None:
            raise FrontendError(f"{folder}: no images in image_00/data or image_02/data")
        left, right = (folder / f"image_{name}" for name in pair)
        images = tuple(list_images(left / "data"))
        lists, source = _calibration(folder)
        has_right = right.is_dir() and f"P_rect_{pair[1]}" in lists
        raw = _rig(lists, pair if has_right else pair[:1], source, first_size(images))
        times = left / "timestamps.txt"
        timed = by_list(images, read_listed_times(times), times, problems)
        poses = _truth(folder, source, lists, pair[0], images, problems) if raw.rectified else None
        found = FoundSequence(
            kind=self.kind,
            folder=folder,
            raw=raw,
            calibration=source,
            images=images,
            stamps_ns=timed.stamps_ns,
            stamps_source=times,
            missing=timed.missing,
            right=tuple(right / "data" / path.name for path in images),
            truth=None if poses is None else as_truth(frame_truth(timed.stamps_ns, poses), folder / "oxts" / "data"),
        )
        return assemble(found, choose_rig(available_rigs(has_right, False), rig, folder), problems)


def _calibration(folder: Path) -> tuple[Lists, Path]:
    above = folder_above(folder)
    for place in (folder, above):
        if (place / _CALIBRATION).is_file():
            return read_lists(place / _CALIBRATION), place / _CALIBRATION
    raise FrontendError(f"{above / _CALIBRATION}: missing; the calibration of the day lies beside its drives")


def read_lists(path: Path) -> Lists:
    """``name: numbers`` lines of a file; what is no list of finite numbers (a date) is passed over."""
    lists: Lists = {}
    for line in text_tables.read_bytes(path).decode("utf-8-sig", "replace").splitlines():
        name, colon, rest = line.partition(":")
        try:
            values = np.array([float(field) for field in rest.split()])
        except ValueError:
            continue
        if colon and len(values) and np.isfinite(values).all():
            lists[name.strip()] = values
    return lists


def numbers(lists: Lists, name: str, shape: tuple[int, ...], path: Path) -> Array:
    """The list ``name`` in this shape; :class:`FrontendError` where it is missing or of another length."""
    values = lists.get(name, np.zeros(0))
    if len(values) != np.prod(shape):
        raise FrontendError(f"{path}: {name}: {np.prod(shape):.0f} numbers expected, found {len(values)}")
    return values.reshape(shape)


def _rig(lists: Lists, cameras: tuple[str, ...], path: Path, size: tuple[int, int]) -> RawRig:
    if _is_raw(lists, cameras[0], size):
        raws = [_raw_camera(lists, name, path, size) for name in cameras]
        if len(raws) == 1:
            return RawRig(raws[0], rectified=False)
        T_left_0, T_right_0 = (
            se3(numbers(lists, f"R_{name}", (3, 3), path), numbers(lists, f"T_{name}", (3,), path)) for name in cameras
        )
        return RawRig(raws[0], raws[1], product(T_left_0, se3_inverse(T_right_0)), rectified=False)
    P = [numbers(lists, f"P_rect_{name}", (3, 4), path) for name in cameras]
    for name, matrix in zip(cameras, P, strict=True):
        if min(matrix[0, 0], matrix[1, 1]) <= 0:
            raise FrontendError(f"{path}: P_rect_{name}: focal lengths {matrix[0, 0]}, {matrix[1, 1]} px cannot be")
    rectified = [RawCamera(float(m[0, 0]), float(m[1, 1]), float(m[0, 2]), float(m[1, 2]), size) for m in P]
    if len(P) == 1:
        return RawRig(rectified[0])
    baseline_m = float((P[0][0, 3] - P[1][0, 3]) / P[0][0, 0])
    return RawRig(rectified[0], rectified[1], se3(np.eye(3), [baseline_m, 0.0, 0.0]))


def _is_raw(lists: Lists, camera: str, size: tuple[int, int]) -> bool:
    """Whether images of ``size`` are those before rectification, by the two sizes in the file."""
    stored, rectified = (tuple(lists.get(f"{name}_{camera}", np.zeros(0)).tolist()) for name in ("S", "S_rect"))
    return stored == size and bool(rectified) and rectified != size


def _raw_camera(lists: Lists, name: str, path: Path, size: tuple[int, int]) -> RawCamera:
    K = numbers(lists, f"K_{name}", (3, 3), path)
    lens = tuple(numbers(lists, f"D_{name}", (5,), path).tolist())
    if min(K[0, 0], K[1, 1]) <= 0:
        raise FrontendError(f"{path}: K_{name}: focal lengths {K[0, 0]}, {K[1, 1]} px cannot be")
    values = (float(K[0, 0]), float(K[1, 1]), float(K[0, 2]), float(K[1, 2]))
    return RawCamera(*values, size, Distortion.RADIAL_TANGENTIAL, lens)


def _truth(
    folder: Path, source: Path, lists: Lists, camera: str, images: tuple[Path, ...], problems: Problems
) -> Array | None:
    """``T_W_C`` ``(N, 4, 4)`` of the rectified camera; None where the drive has no GPS and IMU, or nothing says how
    they stand."""
    data = folder / "oxts" / "data"
    if not data.is_dir():
        return None
    files = [source.with_name(name) for name in ("calib_imu_to_velo.txt", "calib_velo_to_cam.txt")]
    missing = [path for path in files if not path.is_file()]
    if missing:
        problems.warning(f"{missing[0]}: missing, so {data} says nothing of the camera; ground truth left out")
        return None
    try:
        T_velo_imu, T_0_velo = (
            se3(numbers(one, "R", (3, 3), path), numbers(one, "T", (3,), path))
            for path, one in ((path, read_lists(path)) for path in files)
        )
        R_rect = se3(numbers(lists, "R_rect_00", (3, 3), source), np.zeros(3))
        P = numbers(lists, f"P_rect_{camera}", (3, 4), source)
        T_W_imu = poses_of_imu([data / f"{image.stem}.txt" for image in images])
    except FrontendError as error:
        problems.warning(f"{error}; ground truth left out")
        return None
    T_rect_imu = product(product(R_rect, T_0_velo), T_velo_imu)
    offset = se3(np.eye(3), np.linalg.solve(P[:, :3], P[:, 3]))  # where camera 0's origin lies in this one
    return np.asarray(product(T_W_imu, se3_inverse(product(offset, T_rect_imu))))
