"""EuRoC in ASL layout (Burri et al., IJRR 2016): a raw stereo pair, distorted, rectified on the fly."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from maslam.backend.geometry import product, se3, se3_inverse

from ..cameras.calibration import RawCamera, RawRig
from ..cameras.calibration_files import kalibr, load_fields
from ..cameras.models import RigKind
from ..cameras.rectification import stereo_rotations
from ..errors import FrontendError
from .above import folder_above
from .assemble import FoundSequence, assemble, available_rigs
from .base import ImageSequence, Problems, Reader, choose_rig
from .image_times import TimedImages, known_times
from .images import list_images
from .listed_times import read_listed_times
from .pairing import paired_in_time
from .truth import Truth, find_truth, read_truth


class EurocReader(Reader):
    """``mav0/cam0``, ``mav0/cam1`` with ``sensor.yaml``, ``data.csv`` and ``data/<ns>.png``; the folder may be ``mav0``
    itself.

    Ground truth: ``mav0/state_groundtruth_estimate0`` (of the body), else a ``groundtruth*.tum`` beside ``mav0``:
    TUM lines, poses of the rectified left camera.
    """

    kind = "euroc"

    def recognises(self, folder: Path) -> bool:
        """See :meth:`Reader.recognises`."""
        return (_mav(folder) / "cam0" / "sensor.yaml").is_file()

    def open(self, folder: Path, rig: RigKind | None) -> ImageSequence:
        """See :meth:`Reader.open`."""
        problems = Problems()
        mav = _mav(folder)
        images = camera_images(mav / "cam0", problems)
        left, T_body_left = _sensor(mav / "cam0")
        has_right = (mav / "cam1" / "sensor.yaml").is_file()
        kind = choose_rig(available_rigs(has_right, False), rig, folder)
        raw = RawRig(left, form="EuRoC")
        right_images: tuple[Path, ...] = ()
        if has_right:
            right, T_body_right = _sensor(mav / "cam1")
            raw = RawRig(left, right, product(se3_inverse(T_body_left), T_body_right), rectified=False, form="EuRoC")
        elif list_images(mav / "cam1" / "data") and rig is None:
            problems.warning(f"{mav / 'cam1'}: right images, but no sensor.yaml: not used, read as one camera")
        if kind is RigKind.STEREO:
            seconds = camera_images(mav / "cam1", problems)
            images, right_images = paired_in_time(images, seconds, "right image", problems)
        found = FoundSequence(
            kind=self.kind,
            folder=folder_above(mav),
            raw=raw,
            calibration=mav / "cam0" / "sensor.yaml",
            images=images.files,
            stamps_ns=images.stamps_ns,
            stamps_source=images.source,
            right=right_images,
            truth=_groundtruth(mav, raw, T_body_left, images, problems),
        )
        return assemble(found, kind, problems)


def _mav(folder: Path) -> Path:
    return folder / "mav0" if (folder / "mav0").is_dir() else folder


def camera_images(cam: Path, problems: Problems) -> TimedImages:
    """Times and files by ``data.csv``, or by the file names where there is none."""
    table = cam / "data.csv"
    if table.is_file():
        listed = read_listed_times(table)
        if not listed.names:
            raise FrontendError(f"{table}: no images: a time in nanoseconds and a file name in each line expected")
        return TimedImages(tuple(cam / "data" / Path(name).name for name in listed.names), listed.stamps_ns, cam)
    files = list_images(cam / "data")
    named = known_times(cam, files, problems) if files else None
    if named is None:
        raise FrontendError(f"{cam / 'data'}: no images named by their time in nanoseconds, and no {table.name}")
    return named


def _sensor(cam: Path) -> tuple[RawCamera, NDArray[np.float64]]:
    """The camera and its ``T_body_camera``."""
    fields = load_fields(cam / "sensor.yaml")
    raw = kalibr.one_camera(fields, "distortion_coefficients")
    return raw, fields.transform("T_BS")


def _groundtruth(
    mav: Path, raw: RawRig, T_body_left: NDArray[np.float64], images: TimedImages, problems: Problems
) -> Truth | None:
    """``T_W_C`` of the left camera as calibrated."""
    state = mav / "state_groundtruth_estimate0" / "data.csv"
    if state.is_file():
        body = read_truth(state, images, problems, wxyz=True)
        return None if body is None else body.moved(T_body_left)
    beside = find_truth(folder_above(mav), images, problems)
    if beside is None or raw.T_left_right is None:
        return beside
    R_rectified_left, _, _ = stereo_rotations(raw.T_left_right)
    return beside.moved(se3(R_rectified_left, np.zeros(3)))
