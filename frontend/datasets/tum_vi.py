"""TUM-VI (Schubert et al., IROS 2018), and EuRoC's layout from anywhere else where no camera has a ``sensor.yaml``."""

from __future__ import annotations

from pathlib import Path

from maslam.backend.geometry import se3_inverse

from ..cameras.calibration import RawRig
from ..cameras.models import RigKind
from ..errors import FrontendError
from .assemble import FoundSequence, assemble, available_rigs
from .base import ImageSequence, Problems, Reader, choose_rig
from .camera_file import find_camera_file
from .euroc import camera_images
from .image_times import TimedImages
from .images import list_images
from .kalibr_body import T_camera_body
from .pairing import paired_in_time
from .truth import Truth, read_truth

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
        images = camera_images(mav / "cam0", problems)
        right: tuple[Path, ...] = ()
        has_right = raw.right is not None and (mav / "cam1" / "data").is_dir()
        kind = choose_rig(available_rigs(has_right, False), rig, folder)
        if kind is RigKind.STEREO:
            images, right = paired_in_time(images, camera_images(mav / "cam1", problems), "right image", problems)
        found = FoundSequence(
            kind=self.kind,
            folder=folder,
            raw=raw,
            calibration=source,
            images=images.files,
            stamps_ns=images.stamps_ns,
            stamps_source=images.source,
            right=right,
            truth=_truth(mav, source, images, problems),
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


def _truth(mav: Path, calibration: Path, images: TimedImages, problems: Problems) -> Truth | None:
    """``T_W_C`` of the left camera as calibrated."""
    path = next((p for name in _TRUTHS if (p := mav / name / "data.csv").is_file()), None)
    if path is None:
        return None
    T_C_body = T_camera_body(calibration)
    if T_C_body is None:
        problems.warning(f"{calibration}: no T_cam_imu, so {path}, poses of the IMU, says nothing of the camera")
        return None
    truth = read_truth(path, images, problems, wxyz=True)
    return None if truth is None else truth.moved(se3_inverse(T_C_body))
