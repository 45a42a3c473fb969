"""KITTI odometry: rectified stereo, grey (``image_0``, ``image_1``) or colour (``image_2``, ``image_3``)."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from maslam.backend.geometry import se3

from ..cameras.calibration import RawCamera, RawRig
from ..cameras.models import RigKind
from ..errors import FrontendError
from ..files import text_tables
from .above import folder_above
from .assemble import FoundSequence, assemble, available_rigs
from .base import ImageSequence, Problems, Reader, choose_rig
from .image_times import TimedImages, by_list
from .images import holds_images, list_images
from .listed_times import read_listed_times
from .pairing import with_partners
from .truth import Truth, find_truth, read_truth

Array = NDArray[np.float64]

_PAIRS = ((0, 1), (2, 3))  # grey, then colour: folders image_<n>


class KittiReader(Reader):
    """A sequence folder: ``image_<n>/``, ``calib.txt`` (with or without ``P0:`` labels), ``times.txt``, and the
    ground truth in ``poses.txt`` beside them or in ``../../poses/<name>.txt``."""

    kind = "kitti"

    def recognises(self, folder: Path) -> bool:
        """See :meth:`Reader.recognises`."""
        there = (folder / "calib.txt").is_file() and any((folder / f"image_{left}").is_dir() for left, _ in _PAIRS)
        return there and not _is_of_numbers_alone(folder / "calib.txt")

    def open(self, folder: Path, rig: RigKind | None) -> ImageSequence:
        """See :meth:`Reader.open`."""
        problems = Problems()
        left, right = next((pair for pair in _PAIRS if holds_images(folder / f"image_{pair[0]}")), (-1, -1))
        if left < 0:
            raise FrontendError(f"{folder}: no images in image_0 or image_2")
        files = tuple(list_images(folder / f"image_{left}"))
        projections = read_projections(folder / "calib.txt")
        P_left = _projection(projections, left, folder)
        has_right = (folder / f"image_{right}").is_dir() and len(projections) > 1
        if rig is None and not has_right and holds_images(folder / f"image_{right}"):
            problems.warning(f"{folder / 'calib.txt'}: one camera, but image_{right} has right images: not used")
        P_right = _projection(projections, right, folder) if has_right else None
        images = _times(folder, files, problems)
        kind = choose_rig(available_rigs(has_right, False), rig, folder)
        second: tuple[Path, ...] = ()
        if kind is RigKind.STEREO:
            rights = list_images(folder / f"image_{right}")
            if rights:
                images, second = with_partners(folder, images, rights, "right image", problems)
            else:
                second = tuple(folder / f"image_{right}" / path.name for path in images.files)
        found = FoundSequence(
            kind=self.kind,
            folder=folder,
            raw=_rig(P_left, P_right),
            calibration=folder / "calib.txt",
            images=images.files,
            stamps_ns=images.stamps_ns,
            stamps_source=images.source,
            right=second,
            truth=_groundtruth(folder, images, P_left, problems),
            missing=images.missing,
        )
        return assemble(found, kind, problems)


def _is_of_numbers_alone(path: Path) -> bool:
    """Whether a ``calib.txt`` is no KITTI one: it begins with ``fx fy cx cy``, or a row of a 3x3 matrix."""
    first = next((line for line in text_tables.read_text(path).splitlines() if line.strip()), "")
    return ":" not in first and len(first.split()) in (3, 4)


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


def _times(folder: Path, files: tuple[Path, ...], problems: Problems) -> TimedImages:
    path = folder / "times.txt"
    if not path.is_file():
        raise FrontendError(f"{path}: missing; a KITTI sequence needs the time of each image, in seconds, one per line")
    listed = read_listed_times(path)
    if listed.doubt:
        problems.warning(f"{path}: {listed.doubt}")
    return by_list(files, listed, path, problems)


def _groundtruth(folder: Path, images: TimedImages, P_left: Array, problems: Problems) -> Truth | None:
    published = folder_above(folder_above(folder)) / "poses" / f"{folder.resolve().name}.txt"
    if (folder / "poses.txt").is_file() or not published.is_file():
        truth = find_truth(folder, images, problems)
    else:
        truth = read_truth(published, images, problems)
    # Poses are those of camera 0; the fourth column of P is K times where camera 0's origin lies in this camera.
    offset = np.linalg.solve(P_left[:, :3], P_left[:, 3])
    return None if truth is None else truth.moved(se3(np.eye(3), -offset))
