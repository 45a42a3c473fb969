"""Every format of calibration files, recognised by its content."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

from ...errors import FrontendError
from ..calibration import RawRig
from . import (
    basalt,
    colmap,
    depth_cameras,
    kalibr,
    nerfstudio,
    numbers_alone,
    opencv,
    opencv_pair,
    openvslam,
    orb_slam,
    own,
    vins,
)
from .fields import Fields
from .loading import load_fields


@dataclass(frozen=True)
class CalibrationFormat:
    """``name`` of a format and what it is ``known_by``, for messages; whether keys are its own, and the rig of them."""

    name: str
    known_by: str
    recognises: Callable[[Fields], bool]
    read: Callable[[Fields], RawRig]


FORMATS = (
    CalibrationFormat("basalt", "T_imu_cam and intrinsics", basalt.recognises, basalt.read),
    CalibrationFormat("nerfstudio", "fl_x", nerfstudio.recognises, nerfstudio.read),
    CalibrationFormat("Kalibr", "cam0", kalibr.recognises, kalibr.read),
    CalibrationFormat("VINS", "model_type", vins.recognises, vins.read),
    CalibrationFormat("VINS-Fusion", "cam0_calib", vins.recognises_configuration, vins.read_configuration),
    CalibrationFormat("OpenVSLAM", "Camera.model", openvslam.recognises, openvslam.read),
    CalibrationFormat("ORB-SLAM", "Camera.fx", orb_slam.recognises, orb_slam.read),
    CalibrationFormat("OpenCV's pair", "M1 and M2", opencv_pair.recognises, opencv_pair.read),
    CalibrationFormat("EuRoC", "camera_model and intrinsics", kalibr.recognises_sensor, kalibr.read_sensor),
    CalibrationFormat("OpenCV or ROS", "camera_matrix or K", opencv.recognises, opencv.read),
    CalibrationFormat("Open3D", "intrinsic_matrix", depth_cameras.recognises_open3d, depth_cameras.read_open3d),
    CalibrationFormat("RealSense", "ppx", depth_cameras.recognises_realsense, depth_cameras.read_realsense),
    CalibrationFormat("maslam", "fx", own.recognises, own.read),
)
"""Tried in this order."""


def read_calibration(path: Path) -> RawRig:
    """One or two cameras from a file of any of :data:`FORMATS`, COLMAP's ``cameras.txt`` or ``cameras.bin``, or a text
    file of numbers alone.

    A ROS or OpenCV file holds one camera; for a pair of such files see :func:`.pair_of_files`. Raises
    :class:`FrontendError` naming the key that is missing or wrong, or for a file of no known format.
    """
    if path.name in colmap.FILES:
        return colmap.read(path)
    if path.suffix.lower() == ".txt":
        return numbers_alone.read(path)
    data = load_fields(path)
    found = format_of(data)
    if found is None:
        known = ", ".join(f"{one.name} {one.known_by}" for one in FORMATS)
        raise FrontendError(f"{path}: no camera in this file (known: {known})")
    return replace(found.read(data), form=found.name)


def format_of(data: Fields) -> CalibrationFormat | None:
    """The format whose keys a file has; None where there is none."""
    return next((one for one in FORMATS if one.recognises(data)), None)
