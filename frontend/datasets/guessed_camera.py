"""A camera for images that come without a calibration: focal length from EXIF, or the one that most cameras have."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from ..cameras.calibration import RawCamera, RawRig
from ..files.exif import lens_tags
from .images import first_size

USUAL = 1.2
"""Focal length of an unknown camera by the longer side of its images, as COLMAP takes it."""


def guess_camera(images: Sequence[Path]) -> tuple[RawRig, str]:
    """A pinhole for ``images``, its centre in the middle, and where its focal length comes from."""
    width, height = first_size(images)
    focal = lens_tags(images[0]).focal_px(width, height)
    if focal is None:
        return usual_camera((width, height))
    return _pinhole(focal, (width, height)), f"EXIF of {images[0].name}"


def usual_camera(size: tuple[int, int]) -> tuple[RawRig, str]:
    """The same for images of ``size`` (width, height), of whose camera nothing is known."""
    return _pinhole(USUAL * max(size), size), f"{USUAL} x the longer side, as nothing is known"


def guess_text(source: Path, raw: RawRig, guess: str) -> str:
    """What is said of a guessed camera."""
    return (
        f"{source}: no calibration file: focal length {raw.left.fx:.1f} px taken ({guess}); preprocess and slam refine "
        "it from the images where their motion tells it; `maslam calibrate` makes a camera.yaml"
    )


def _pinhole(focal: float, size: tuple[int, int]) -> RawRig:
    return RawRig(RawCamera(focal, focal, (size[0] - 1) / 2.0, (size[1] - 1) / 2.0, size))
