"""Trajectories in the frame of the positions measured from outside (GPS): metres east, north and up, and degrees."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from maslam.backend.geometry import Sim3
from maslam.frontend.files.positions import write_geodetic
from maslam.frontend.files.trajectory import Trajectory, write_tum

from ..evaluation.summary import DatumFigures

TRAJECTORY_ENU, TRAJECTORY_GEODETIC = "trajectory_enu.tum", "trajectory_geodetic.csv"


def write_georeferenced(folder: Path, trajectory: Trajectory, T_E_F: Sim3, datum: DatumFigures | None) -> None:
    """``trajectory`` (``T_F_C``) of an agent as ``T_E_C``, and, with a ``datum``, its latitudes and longitudes."""
    there = Trajectory(trajectory.stamps_ns, T_E_F.transform_poses(trajectory.poses))
    write_tum(folder / TRAJECTORY_ENU, there)
    if datum is not None and len(there):
        origin = np.array([datum.latitude_deg, datum.longitude_deg, datum.altitude_m])
        write_geodetic(folder / TRAJECTORY_GEODETIC, there.stamps_ns, there.centres, origin)
