"""How a camera stands to the IMU, in Kalibr's chains."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..cameras.calibration_files import load_fields


def T_camera_body(calibration: Path) -> NDArray[np.float64] | None:
    """``T_C_body`` ``(4, 4)`` of ``cam0``, the IMU being the body; None where the file does not say."""
    fields = load_fields(calibration)
    if "cam0" not in fields or not isinstance(fields.data["cam0"], dict):
        return None
    cam = fields.inner("cam0")
    return cam.transform("T_cam_imu") if "T_cam_imu" in cam else None
