"""Calibration files of other tools and our own, recognised by their content; a file here for each format."""

from __future__ import annotations

from .checked_camera import camera
from .fields import Fields
from .loading import load_fields
from .opencv_pair import pair_of_files
from .registry import read_calibration

__all__ = ["Fields", "camera", "load_fields", "pair_of_files", "read_calibration"]
