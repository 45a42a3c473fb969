"""TUM-VI (Schubert et al., IROS 2018), and EuRoC's layout from anywhere else where no camera has a ``sensor.yaml``."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from maslam.backend.geometry import product, rotation_from_quat_wxyz, se3, se3_inverse

from ..cameras.calibration import RawRig
from ..cameras.models import RigKind
from ..errors import FrontendError
from ..files import text_tables
from ..files.timestamps import read_stamps
from ..files.trajectory import Trajectory
from .assemble import FoundSequence, assemble, available_rigs
from .base import ImageSequence, Problems, Reader, choose_rig
from .camera_file import find_camera_file
from .euroc import camera_images, paired_images
from .images import list_images
from .kalibr_body import T_camera_body

_TRUTHS = ("mocap0", "state_groundtruth_estimate0", "gt0")


class TumViReader(Reader):
    """``mav0/cam0/data``, ``mav0/cam1/data`` with ``data.csv`` or images named by nanoseconds, and a calibration of the
    whole rig in ``dso/camchain.yaml``, in ``mav0`` or beside it.

    Ground truth: ``mav0/mocap0/data.csv``, poses of the IMU, where the calibration says how it stands (Kalibr's
    ``T_cam_imu``).
    """

    kind = "tum-vi"

    def recognises(self, folder: Path) -> bool:
        """See :meth:`Reader.recognises`."""
        cam = folder / "mav0" / "cam0"
        return not (cam / "sensor.yaml").is_file() and bool(list_images(cam / "data"))

    def open(self, folder: Path, rig: RigKind | None) -> ImageSequence:
        """See :meth:`Reader.open`."""
        problems = Problems()
        mav = folder / "mav0"
        raw, source = _calibration(folder, mav)
        stamps, images = camera_images(mav / "cam0")
        right: tuple[Path, ...] = ()
        has_right = raw.right is not None and (mav / "cam1" / "data").is_dir()
        kind = choose_rig(available_rigs(has_right, False), rig, folder)
        if kind is RigKind.STEREO:
            right_stamps, right = camera_images(mav / "cam1")
            stamps, images, right = paired_images(stamps, images, right_stamps, right, mav, problems)
        found = FoundSequence(
            kind=self.kind,
            folder=folder,
            raw=raw,
            calibration=source,
            images=images,
            stamps_ns=stamps,
            stamps_source=mav / "cam0",
            right=right,
            truth=_truth(mav, source, problems),
        )
        return assemble(found, kind, problems)


def _calibration(folder: Path, mav: Path) -> tuple[RawRig, Path]:
    for place in (folder / "dso", mav, folder):
        found = find_camera_file(place) if place.is_dir() else None
        if found is not None:
            return found
    raise FrontendError(
        f"{mav / 'cam0' / 'data'}: images, but neither a sensor.yaml beside them nor a calibration of the rig "
        "(dso/camchain.yaml)"
    )


def _truth(mav: Path, calibration: Path, problems: Problems) -> Trajectory | None:
    """``T_W_C`` of the left camera as calibrated."""
    path = next((p for name in _TRUTHS if (p := mav / name / "data.csv").is_file()), None)
    if path is None:
        return None
    T_C_body = T_camera_body(calibration)
    if T_C_body is None:
        problems.warning(f"{calibration}: no T_cam_imu, so {path}, poses of the IMU, says nothing of the camera")
        return None
    values = text_tables.read_table(path, (8, 17), "a pose (ns, position, quaternion wxyz)")
    stamps = read_stamps(path, nanoseconds=True)
    kept = _ascending(stamps)
    if len(kept) < len(stamps):
        problems.warning(f"{path}: time does not go on in {len(stamps) - len(kept)} of {len(stamps)} lines; left out")
    T_W_body = se3(rotation_from_quat_wxyz(values[kept, 4:8]), values[kept, 1:4])
    return Trajectory(stamps[kept], product(T_W_body, se3_inverse(T_C_body)))


def _ascending(stamps: NDArray[np.int64]) -> NDArray[np.int64]:
    """Rows that lie after all before them."""
    highest = np.maximum.accumulate(stamps)
    return np.flatnonzero(np.concatenate([[True], stamps[1:] > highest[:-1]]))
