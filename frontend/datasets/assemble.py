"""From files found and numbers read to a checked sequence: what all kinds of data set have in common."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from maslam.backend.geometry import product, se3

from ..cameras.calibration import RawRig
from ..cameras.description import UnderstoodCamera
from ..cameras.models import PinholeCamera, Rig, RigKind
from ..cameras.rectification import rectify_rig
from ..errors import FrontendError
from ..files.trajectory import Trajectory
from . import checks
from .base import ImageSequence, Problems
from .numbering import MissingImages
from .stored_image import ImageRef, first_size, folder_of
from .truth import Truth, check_cover


@dataclass(frozen=True)
class DepthSensor:
    """The camera that measured the depth, where depth is stored as measured, not as the image's camera would see it.

    ``T_C_D`` ``(4, 4)``: from its frame to that of the calibrated (left) camera, metres.
    """

    camera: PinholeCamera
    T_C_D: NDArray[np.float64]


@dataclass(frozen=True)
class FoundSequence:
    """Files and numbers that a reader found in a folder.

    Paths need not exist: missing ones become problems. ``calibration``: source of ``raw``; ``stamps_source``: source of
    ``stamps_ns`` (both for messages). ``truth``: ``T_W_C`` of the calibrated left camera, before rectification.
    ``depth_unit_m``: metres per step of the depth images. ``depth_sensor``: None where depth is stored registered to
    the image. ``missing``: images that the names' numbers lack. ``name``: of the sequence, by default the folder's;
    ``origin``: what of a recording is read, for people. ``focal_guess``: where the focal length comes from that nobody
    calibrated, else empty.
    """

    kind: str
    folder: Path
    raw: RawRig
    calibration: Path
    images: tuple[ImageRef, ...]
    stamps_ns: NDArray[np.int64]
    stamps_source: Path
    right: tuple[ImageRef, ...] = ()
    depth: tuple[ImageRef, ...] = ()
    depth_unit_m: float = 0.001
    depth_sensor: DepthSensor | None = None
    truth: Truth | None = None
    missing: tuple[MissingImages, ...] = ()
    name: str = ""
    origin: str = ""
    focal_guess: str = ""


def assemble(found: FoundSequence, kind: RigKind, problems: Problems) -> ImageSequence:
    """Return the sequence, rectified as ``kind``; files that this rig does not use are left out. Everything wrong is
    added to ``problems``."""
    right = found.right if kind is RigKind.STEREO else ()
    depth = found.depth if kind is RigKind.RGBD else ()
    checks.check_count(len(found.images), kind, found.folder, problems)
    checks.check_files(found.images, "image", problems)
    checks.check_files(right, "right image", problems)
    checks.check_files(depth, "depth image", problems)
    checks.check_kinds([path.name for path in found.images], folder_of(found.images[0]), problems)
    checks.check_numbers(found.missing, folder_of(found.images[0]), problems)
    checks.check_stamps(found.stamps_ns, [path.name for path in found.images], found.stamps_source, problems)
    size = first_size(found.images)
    checks.check_size(found.raw.left.size, size, found.calibration, found.images[0], problems)
    checks.check_camera(found.raw.left.pinhole(size), found.calibration, problems)
    for doubt in found.raw.doubts if kind is RigKind.STEREO else ():
        problems.warning(f"{found.calibration}: {doubt}")
    T_left_right = found.raw.T_left_right
    if kind is RigKind.STEREO and found.raw.right is not None and T_left_right is not None:
        checks.check_size(found.raw.right.size, size, found.calibration, right[0], problems)
        checks.check_camera(found.raw.right.pinhole(size), found.calibration, problems)
        if found.raw.rectified or checks.check_side_by_side(T_left_right, found.calibration, problems):
            checks.check_baseline(float(T_left_right[0, 3]), found.calibration, problems)
    try:
        ideal = rectify_rig(found.raw, kind, size)
    except FrontendError as error:
        raise FrontendError(f"{found.calibration}: {error}") from None
    registration = None
    if depth and found.depth_sensor is not None:
        from ..cameras.depth_registration import DepthRegistration  # it brings the compiler

        T_ideal_left = se3(ideal.R_rectified_left, np.zeros(3))
        sensor = found.depth_sensor
        registration = DepthRegistration(sensor.camera, ideal.camera, product(T_ideal_left, sensor.T_C_D))
    truth = None if found.truth is None else found.truth.trajectory
    if found.truth is not None and (np.diff(found.stamps_ns) > 0).all():
        check_cover(found.truth, found.stamps_ns, problems)
    if truth is not None and ideal.rectifier is not None:
        truth = Trajectory(truth.stamps_ns, product(truth.poses, se3(ideal.R_rectified_left.T, np.zeros(3))))
    return ImageSequence(
        kind=found.kind,
        name=found.name or found.folder.resolve().name,
        rig=Rig(kind, ideal.camera, ideal.baseline_m),
        stamps_ns=found.stamps_ns,
        left=found.images,
        stored_size=size,
        right=right,
        depth=depth,
        depth_unit_m=found.depth_unit_m,
        rectifier=ideal.rectifier,
        stored_camera=None if ideal.rectifier is None else found.raw.left,
        R_rectified_left=None if ideal.rectifier is None else ideal.R_rectified_left,
        registration=registration,
        groundtruth=truth,
        missing=found.missing,
        understood=_understood(found, kind, None if ideal.rectifier is None else ideal.camera),
        origin=found.origin,
        focal_guess=found.focal_guess,
        notes=tuple(f"{found.calibration}: {note}" for note in found.raw.notes),
        problems=tuple(dict.fromkeys(problems.found)),
    )


def _understood(found: FoundSequence, kind: RigKind, ideal: PinholeCamera | None) -> tuple[UnderstoodCamera, ...]:
    raw, right = found.raw, found.raw.right
    if found.focal_guess:
        return ()
    if kind is not RigKind.STEREO or right is None:
        return (UnderstoodCamera("camera", raw.left, found.calibration, raw.form, ideal),)
    sides = (("left", raw.left), ("right", right))
    return tuple(UnderstoodCamera(side, one, found.calibration, raw.form, ideal) for side, one in sides)


def available_rigs(right: bool, depth: bool) -> list[RigKind]:
    """Rigs from most to least informative, given the files present besides the (left) image."""
    return [RigKind.STEREO] * right + [RigKind.RGBD] * depth + [RigKind.MONO]
