"""ICL-NUIM (Handa et al., ICRA 2014), its TUM-compatible images: what is its own of lists of associations."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from maslam.backend.geometry import product

from ..cameras.calibration import RawCamera, RawRig
from ..errors import FrontendError
from ..files.pose_table import read_poses
from ..files.timestamps import NS_PER_S
from ..files.trajectory import Trajectory
from .base import Problems
from .camera_file import find_camera_file
from .truth import Truth

_SUFFIX = ".freiburg"  # livingRoom2.gt.freiburg, traj0.gt.freiburg
_PUBLISHED = RawCamera(481.2, 480.0, 319.5, 239.5, (640, 480))  # -480 of the data set's page is of images upside down
_MIRROR = np.diag([1.0, -1.0, 1.0, 1.0])
"""Poses are in the renderer's axes, y up in world and camera, which mirrors the images' world."""


def poses_file(folder: Path) -> Path | None:
    """The file of true poses, by which the data set is known; its first column counts frames."""
    return next((p for p in sorted(folder.iterdir()) if p.suffix.lower() == _SUFFIX and p.is_file()), None)


def camera(folder: Path, problems: Problems) -> tuple[RawRig, Path]:
    """The calibration in the folder, else the published one."""
    return find_camera_file(folder) or (RawRig(_PUBLISHED, form="ICL-NUIM, as published"), folder)


def truth(path: Path, rate_hz: float, problems: Problems) -> Truth | None:
    """``T_W_C``, at the frames' numbers at ``rate_hz``, mirrored into the axes of the images."""
    try:
        table = read_poses(path)
        if table.stamps_ns is None:
            raise FrontendError(f"{path}: a frame's number and a pose in each line expected")
        trajectory, _ = table.in_time()
    except FrontendError as error:
        problems.warning(f"{error}: ground truth left out, errors cannot be known")
        return None
    numbers = np.rint(trajectory.stamps_ns / NS_PER_S).astype(np.int64)
    stamps = np.rint(numbers * (NS_PER_S / rate_hz)).astype(np.int64)
    return Truth(Trajectory(stamps, product(product(_MIRROR, trajectory.poses), _MIRROR)), path)
