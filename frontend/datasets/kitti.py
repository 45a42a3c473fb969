"""KITTI odometry: rectified stereo, grey (``image_0``, ``image_1``) or colour (``image_2``, ``image_3``)."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from backend.geometry import se3
from frontend import stamps, tables
from frontend.cameras import PinholeCamera, Rig, RigKind
from frontend.datasets import checks
from frontend.datasets.base import ImageSequence, Problems, Reader, choose_rig
from frontend.datasets.images import image_size, list_images
from frontend.errors import FrontendError
from frontend.trajectory import Trajectory, read_kitti_poses

_PAIRS = ((0, 1), (2, 3))  # grey, then colour: folders image_<n>


class KittiReader(Reader):
    """A sequence folder: ``image_<n>/``, ``calib.txt`` (with or without ``P0:`` labels), ``times.txt``, ``poses.txt`` beside or ``../../poses/<name>.txt``."""

    kind = "kitti"

    @classmethod
    def recognises(cls, folder: Path) -> bool:
        return (folder / "calib.txt").is_file() and any((folder / f"image_{n}").is_dir() for pair in _PAIRS for n in pair[:1])

    @classmethod
    def open(cls, folder: Path, rig: RigKind | None) -> ImageSequence:
        problems = Problems()
        left_id, right_id = next((pair for pair in _PAIRS if list_images(folder / f"image_{pair[0]}")), (-1, -1))
        if left_id < 0:
            raise FrontendError(f"{folder}: no images in image_0 or image_2")
        images = tuple(list_images(folder / f"image_{left_id}"))
        projections = read_projections(folder / "calib.txt")
        stereo_possible = (folder / f"image_{right_id}").is_dir() and len(projections) > 1
        chosen = choose_rig([RigKind.STEREO, RigKind.MONO] if stereo_possible else [RigKind.MONO], rig, folder)
        right = tuple(folder / f"image_{right_id}" / path.name for path in images) if chosen is RigKind.STEREO else ()
        checks.check_files(right, "right image", problems)
        size = image_size(images[0])
        P_left = _projection(projections, left_id, folder)
        camera = PinholeCamera(*size, *(float(P_left[i, j]) for i, j in ((0, 0), (1, 1), (0, 2), (1, 2))))
        checks.check_camera(camera, folder / "calib.txt", problems)
        baseline_m = None
        if chosen is RigKind.STEREO:
            baseline_m = float((P_left[0, 3] - _projection(projections, right_id, folder)[0, 3]) / P_left[0, 0])
            checks.check_baseline(baseline_m, folder / "calib.txt", problems)
        times = _times(folder, images, problems)
        truth = _groundtruth(folder, images, times, P_left, problems)
        return ImageSequence(
            kind=cls.kind, name=folder.resolve().name, rig=Rig(chosen, camera, baseline_m), stamps_ns=times, left=images,
            stored_size=size, right=right, groundtruth=truth, problems=tuple(problems.found),
        )  # fmt: skip


def read_projections(path: Path) -> dict[int, NDArray[np.float64]]:
    """Camera number to 3x4 projection matrix from ``calib.txt``; rows without a label count up from 0; other labels are passed over."""
    projections: dict[int, NDArray[np.float64]] = {}
    for number, line in enumerate(tables.read_bytes(path).decode("ascii", "replace").splitlines(), 1):
        label, colon, rest = line.partition(":")
        fields = (rest if colon else line).split()
        if not fields or (colon and not (label.strip()[:1] == "P" and label.strip()[1:].isdigit())):
            continue
        try:
            row = np.array([float(field) for field in fields])
        except ValueError:
            raise FrontendError(f"{path}:{number}: not a number in the projection matrix") from None
        if len(row) != 12 or not np.isfinite(row).all():
            raise FrontendError(f"{path}:{number}: a projection matrix has 12 finite numbers, found {len(row)}")
        projections[int(label.strip()[1:]) if colon else len(projections)] = row.reshape(3, 4)
    if not projections:
        raise FrontendError(f"{path}: no projection matrix (rows of 12 numbers, with or without P0: before them)")
    return projections


def _projection(projections: dict[int, NDArray[np.float64]], camera: int, folder: Path) -> NDArray[np.float64]:
    """The matrix of one camera; a file of one or two rows holds those of the pair that is there."""
    found = projections.get(camera, projections.get(camera % 2) if len(projections) <= 2 else None)
    if found is None:
        raise FrontendError(f"{folder / 'calib.txt'}: no row P{camera} for the images in image_{camera}")
    if found[0, 0] <= 0 or found[1, 1] <= 0:
        raise FrontendError(f"{folder / 'calib.txt'}: focal lengths {found[0, 0]}, {found[1, 1]} px in P{camera} cannot be")
    return found


def _rows_of_images(count: int, images: tuple[Path, ...]) -> NDArray[np.int64] | None:
    """Row of a per-image table for each image: in order, or by the number in the file name where some images were taken out."""
    if count == len(images):
        return np.arange(count)
    numbers = [int(path.stem) if path.stem.isdigit() else -1 for path in images]
    return np.array(numbers) if 0 <= min(numbers) and max(numbers) < count else None


def _times(folder: Path, images: tuple[Path, ...], problems: Problems) -> NDArray[np.int64]:
    path = folder / "times.txt"
    if not path.is_file():
        raise FrontendError(f"{path}: missing; a KITTI sequence needs the time of each image, in seconds, one a line")
    times = stamps.read_stamps(path)
    rows = _rows_of_images(len(times), images)
    if rows is None:
        raise FrontendError(f"{path}: {len(times)} times for {len(images)} images in {images[0].parent.name}")
    if len(times) != len(images):
        problems.warning(f"{path}: {len(times)} times for {len(images)} images; taken by the number in the file name")
    checks.check_stamps(times[rows], [p.name for p in images], path, problems)
    return times[rows]


def _groundtruth(
    folder: Path, images: tuple[Path, ...], times: NDArray[np.int64], P_left: NDArray[np.float64], problems: Problems
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
    # Poses are those of camera 0; the fourth column of P is where camera 0's origin lies in this camera, times K.
    offset = np.linalg.solve(P_left[:, :3], P_left[:, 3])
    return Trajectory(times, poses[rows] @ se3(np.eye(3), -offset))
