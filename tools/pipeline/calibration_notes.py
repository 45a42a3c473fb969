"""What is said of a calibration that is off after tracking, by what odometry had to correct."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from maslam.frontend.cameras.models import Rig

_SAID_PX = 1.0
"""Displacement by a correction, pixels, from which it is said."""
_LENS_PX, _LENS_SHARE = 2.0, 0.03
"""The same of the lens, in pixels and as a share of the way to the corners: what tracking takes for the lens of an
exact camera reaches 2 percent."""


def corrected(stats: Mapping[str, float], rig: Rig) -> str:
    """What odometry found the calibration to be off by, and corrected; empty where that is little."""
    camera = rig.camera
    parts = []
    if abs(rows := stats.get("row_offset_px", 0.0)) > _SAID_PX:
        parts.append(f"rows of the pair by {rows:+.2f} px")
    if abs(disparity := stats.get("disparity_offset_px", 0.0)) > _SAID_PX:
        parts.append(f"disparities by {disparity:+.2f} px")
    roll_px = np.radians(stats.get("right_turn_z_deg", 0.0)) * 0.5 * camera.width
    if abs(roll_px) > _SAID_PX:
        parts.append(
            f"a turn of the right camera about its axis by {stats['right_turn_z_deg']:+.2f} degrees "
            f"({abs(roll_px):.1f} px at the sides of the image)"
        )
    radius = float(np.hypot(0.5 * camera.width / camera.fx, 0.5 * camera.height / camera.fy))
    bend_px = (stats.get("lens_k1", 0.0) * radius**3 + stats.get("lens_k2", 0.0) * radius**5) * camera.fx
    corner_px = float(np.hypot(camera.width, camera.height)) / 2.0
    if (
        abs(bend_px) > max(_LENS_PX, _LENS_SHARE * corner_px) and not parts
    ):  # a turn of the right camera leaves traces in the lens
        parts.append(f"the lens by {bend_px:+.1f} px in the corners (k1 {stats['lens_k1']:+.3f})")
    if not parts:
        return ""
    return f"the calibration is off, and was corrected while tracking: {', '.join(parts)}; calibrate anew"
