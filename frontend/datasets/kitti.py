"""KITTI odometry: rectified stereo, grey (``image_0``, ``image_1``) or colour (``image_2``, ``image_3``)."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from maslam.backend.geometry import se3

from ..cameras.calibration import RawCamera, RawRig
from ..cameras.models import RigKind
from ..errors import FrontendError
from ..files import text_tables, timestamps
from ..files.trajectory import Trajectory, read_kitti_poses
from .assemble import FoundSequence, assemble, available_rigs, frame_truth
from .base import ImageSequence, Problems, Reader, choose_rig
from .images import list_images

Array = NDArray[np.float64]

_PAIRS = ((0, 1), (2, 3))  # grey, then colour: folders image_<n>


class KittiReader(Reader):
    """A sequence folder: ``image_<n>/``, ``calib.txt`` (with or without ``P0:`` labels), ``times.txt``, and the
    ground truth in ``poses.txt`` beside them or in ``../../poses/<name>.txt``."""

    kind = "kitti"

    def recognises(self, folder: Path) -> bool:
        """See :meth:`Reader.recognises`."""
        return (folder / "calib.txt").is_file() and any((folder / f"image_{left}").is_dir() for left, _ in _PAIRS)

    def open(self, folder: Path, rig: RigKind | None) -> ImageSequence:
        """See :meth:`Reader.open`."""
        problems = Problems()
        left, right = next((pair for pair in _PAIRS if list_images(folder / f"image_{pair[0]}")), (-1, -1))
        if left < 0:
            raise FrontendError(f"{folder}: no images in image_0 or image_2")
        images = tuple(list_images(folder / f"image_{left}"))
        projections = read_projections(folder / "calib.txt")
        P_left = _projection(projections, left, folder)
        has_right = (folder / f"image_{right}").is_dir() and len(projections) > 1
        P_right = _projection(projections, right, folder) if has_right else None
        times = _times(folder, images, problems)
        found = FoundSequence(
            kind=self.kind,
            folder=folder,
            raw=_rig(P_left, P_right),
            calibration=folder / "calib.txt",
            images=images,
            stamps_ns=times,
            stamps_source=folder / "times.txt",
            right=tuple(folder / f"image_{right}" / path.name for path in images),
            truth=_groundtruth(folder, images, times, P_left, problems),
        )
        return assemble(found, choose_rig(available_rigs(has_right, False), rig, folder), problems)


def read_projections(path: Path) -> dict[int, Array]:
    """Camera number to 3x4 projection matrix; rows without a label count up from 0; labels other than ``P<n>:`` are
    passed over."""
    projections: dict[int, Array] = {}
    for number, line in enumerate(text_tables.read_text(path).splitlines(), 1):
        label, colon, rest = line.partition(":")
        fields = (rest if colon else line).split()
        label = label.strip() if colon else f"P{len(projections)}"
        if not fields or label[:1] != "P" or not label[1:].isdigit():
            continue
        try:
            row = np.array([float(field) for field in fields])
        except ValueError:
            raise FrontendError(f"{path}:{number}: not a number in the projection matrix") from None
        if len(row) != 12 or not np.isfinite(row).all():
            raise FrontendError(f"{path}:{number}: a projection matrix has 12 finite numbers, found {len(row)}")
        if row[0] <= 0 or row[5] <= 0:
            raise FrontendError(f"{path}:{number}: focal lengths {row[0]}, {row[5]} px cannot be")
        projections[int(label[1:])] = row.reshape(3, 4)
    if not projections:
        raise FrontendError(f"{path}: no projection matrix (rows of 12 numbers, with or without P0: before them)")
    return projections


def _projection(projections: dict[int, Array], camera: int, folder: Path) -> Array:
    """The matrix of one camera; a file of one or two rows holds those of the pair that is there."""
    found = projections.get(camera, projections.get(camera % 2) if len(projections) <= 2 else None)
    if found is None:
        raise FrontendError(f"{folder / 'calib.txt'}: no row P{camera} for the images in image_{camera}")
    return found


def _rig(P_left: Array, P_right: Array | None) -> RawRig:
    cameras = [
        RawCamera(float(P[0, 0]), float(P[1, 1]), float(P[0, 2]), float(P[1, 2]))
        for P in (P_left, P_right)
        if P is not None
    ]
    if P_right is None:
        return RawRig(cameras[0])
    baseline_m = float((P_left[0, 3] - P_right[0, 3]) / P_left[0, 0])
    return RawRig(cameras[0], cameras[1], se3(np.eye(3), [baseline_m, 0.0, 0.0]))


def _rows_of_images(count: int, images: tuple[Path, ...]) -> NDArray[np.int64] | None:
    """Row of a per-image table for each image: in order, or by the number in the file name where some images were
    taken out."""
    if count == len(images):
        return np.arange(count)
    numbers = [int(path.stem) if path.stem.isdigit() else -1 for path in images]
    return np.array(numbers) if min(numbers) >= 0 and max(numbers) < count else None


def _times(folder: Path, images: tuple[Path, ...], problems: Problems) -> NDArray[np.int64]:
    path = folder / "times.txt"
    if not path.is_file():
        raise FrontendError(f"{path}: missing; a KITTI sequence needs the time of each image, in seconds, one per line")
    times = timestamps.read_stamps(path)
    rows = _rows_of_images(len(times), images)
    if rows is None:
        raise FrontendError(f"{path}: {len(times)} times for {len(images)} images in {images[0].parent.name}")
    if len(times) != len(images):
        problems.warning(f"{path}: {len(times)} times for {len(images)} images; taken by the number in the file name")
    return times[rows]


def _groundtruth(
    folder: Path, images: tuple[Path, ...], times: NDArray[np.int64], P_left: Array, problems: Problems
) -> Trajectory | None:
    resolved = folder.resolve()
    candidates = (folder / "poses.txt", resolved.parent.parent / "poses" / f"{resolved.name}.txt")
    path = next((p for p in candidates if p.is_file()), None)
    if path is None:
        return None
    _, poses = read_kitti_poses(path)
    rows = _rows_of_images(len(poses), images)
    if rows is None:
        problems.warning(f"{path}: {len(poses)} poses for {len(images)} images; ground truth left out")
        return None
    # Poses are those of camera 0; the fourth column of P is K times where camera 0's origin lies in this camera.
    offset = np.linalg.solve(P_left[:, :3], P_left[:, 3])
    return frame_truth(times, poses[rows] @ se3(np.eye(3), -offset))
