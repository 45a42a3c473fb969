"""Cameras as ``sensor_msgs/CameraInfo`` messages state them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from maslam.backend.geometry import se3

from ...cameras.calibration import RawCamera, RawRig
from ...cameras.calibration_files import Fields
from ...cameras.calibration_files.opencv import read_one
from ...cameras.calibration_files.opencv_pair import states_baseline, transform_of_files
from ...errors import FrontendError

CAMERA_INFO = "sensor_msgs/msg/CameraInfo"


class CameraInfo:
    """One message, of ``source`` (bag and topic, for messages to people)."""

    def __init__(self, message: Any, source: Path) -> None:
        """:class:`FrontendError` for images of a part of the sensor, of which a calibration says too little."""
        small = {name: _listed(message, name) for name in ("k", "d", "r", "p")}
        self.source = source
        self.size = (int(message.width), int(message.height))
        self.fields = Fields(
            {
                "K": small["k"],
                "D": small["d"],
                "R": small["r"],
                "P": small["p"],
                "distortion_model": str(message.distortion_model),
                **({"width": self.size[0], "height": self.size[1]} if all(self.size) else {}),
            },
            source,
        )
        self.calibrated = small["k"][0] > 0
        self.frame = str(message.header.frame_id).strip("/")
        self.P = np.array(small["p"], dtype=np.float64).reshape(3, 4)
        roi, binning = message.roi, (int(message.binning_x), int(message.binning_y))
        cut = roi.width and (int(roi.width), int(roi.height)) != self.size
        if cut or roi.x_offset or roi.y_offset or any(step > 1 for step in binning):
            raise FrontendError(f"{source}: images of a part of the sensor (roi, binning) are not read")

    def camera(self, rectified: bool) -> RawCamera:
        """The camera of the images as they are: of ``rectified`` ones, P without distortion. :class:`FrontendError`
        where nothing is stated."""
        if rectified and self.P[0, 0] > 0:
            fx, fy, cx, cy = (float(self.P[at]) for at in ((0, 0), (1, 1), (0, 2), (1, 2)))
            return RawCamera(fx, fy, cx, cy, self.size if all(self.size) else None)
        if not self.calibrated:
            raise FrontendError(f"{self.source}: the camera is not calibrated: K holds zeros; put a camera file beside")
        return read_one(self.fields)

    def same_view(self, other: CameraInfo) -> bool:
        """Whether both state one camera, to a pixel."""
        near = np.allclose(_matrix(self), _matrix(other), rtol=0.01, atol=1.0)
        return self.size == other.size and bool(near)


def one_camera(info: CameraInfo, rectified: bool) -> RawRig:
    """The rig of one camera."""
    return RawRig(info.camera(rectified))


def pair(left: CameraInfo, right: CameraInfo, rectified: bool) -> RawRig | None:
    """The rig of two; None where the right one's P states no baseline: how they stand is then not known."""
    if right.P[0, 0] <= 0 or right.P[0, 3] == left.P[0, 3] or not states_baseline(left.P, right.P):
        return None
    if rectified:
        baseline = float((left.P[0, 3] - right.P[0, 3]) / right.P[0, 0])
        camera = left.camera(True)
        return RawRig(camera, right.camera(True), se3(np.eye(3), [baseline, 0.0, 0.0]))
    transform = transform_of_files(left.fields, right.fields)
    return RawRig(left.camera(False), right.camera(False), transform, rectified=False)


def pair_apart(left: CameraInfo, right: CameraInfo, rectified: bool, T_left_right: NDArray[np.float64]) -> RawRig:
    """The rig of two of which something else says how they stand; of ``rectified`` ones only along x."""
    cameras = left.camera(rectified), right.camera(rectified)
    stands = se3(np.eye(3), [float(T_left_right[0, 3]), 0.0, 0.0]) if rectified else T_left_right
    return RawRig(*cameras, stands, rectified=rectified)


def _listed(message: Any, name: str) -> list[float]:
    """ROS 1 writes K, D, R, P; ROS 2 k, d, r, p."""
    values = getattr(message, name if hasattr(message, name) else name.upper())
    return [float(value) for value in values]


def _matrix(info: CameraInfo) -> NDArray[np.float64]:
    return np.array(info.fields.numbers("K", 9))
