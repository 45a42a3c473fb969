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
    focal, source = lens_tags(images[0]).focal_px(width, height), f"EXIF of {images[0].name}"
    if focal is None:
        focal, source = USUAL * max(width, height), f"{USUAL} x the longer side, as nothing is known"
    camera = RawCamera(focal, focal, (width - 1) / 2.0, (height - 1) / 2.0, (width, height))
    return RawRig(camera), source
