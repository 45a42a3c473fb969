"""EuRoC in ASL layout (Burri et al., IJRR 2016): a raw stereo pair, distorted, rectified on the fly."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from maslam.backend.geometry import product, rotation_from_quat_wxyz, se3, se3_inverse

from ..cameras.calibration import RawCamera, RawRig
from ..cameras.calibration_files import kalibr, load_fields
from ..cameras.models import RigKind
from ..cameras.rectification import stereo_rotations
from ..errors import FrontendError
from ..files import text_tables
from ..files.timestamps import integer_ns, read_stamps
from ..files.trajectory import Trajectory, read_tum
from .assemble import FoundSequence, assemble, available_rigs
from .base import ImageSequence, Problems, Reader, choose_rig
from .images import list_images


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
        left_stamps, left_images = camera_images(mav / "cam0")
        left, T_body_left = _sensor(mav / "cam0")
        has_right = (mav / "cam1" / "sensor.yaml").is_file()
        kind = choose_rig(available_rigs(has_right, False), rig, folder)
        raw = RawRig(left, form="EuRoC")
        right_images: tuple[Path, ...] = ()
        if has_right:
            right, T_body_right = _sensor(mav / "cam1")
            raw = RawRig(left, right, product(se3_inverse(T_body_left), T_body_right), rectified=False, form="EuRoC")
        if kind is RigKind.STEREO:
            right_stamps, right_images = camera_images(mav / "cam1")
            left_stamps, left_images, right_images = paired_images(
                left_stamps, left_images, right_stamps, right_images, mav, problems
            )
        found = FoundSequence(
            kind=self.kind,
            folder=mav.resolve().parent,
            raw=raw,
            calibration=mav / "cam0" / "sensor.yaml",
            images=left_images,
            stamps_ns=left_stamps,
            stamps_source=mav / "cam0",
            right=right_images,
            truth=_groundtruth(mav, raw, T_body_left),
        )
        return assemble(found, kind, problems)


def _mav(folder: Path) -> Path:
    return folder / "mav0" if (folder / "mav0").is_dir() else folder


def camera_images(cam: Path) -> tuple[NDArray[np.int64], tuple[Path, ...]]:
    """Time stamps and files by ``data.csv``, or by the file names where there is none."""
    table = cam / "data.csv"
    if not table.is_file():
        images = list_images(cam / "data")
        try:
            named = np.array([integer_ns(path.stem) for path in images], dtype=np.int64)
        except ValueError:
            named = np.zeros(0, dtype=np.int64)
        if not len(named):
            raise FrontendError(f"{cam / 'data'}: no images named by their time in nanoseconds, and no {table.name}")
        return named, tuple(images)
    stamps, files = [], []
    for number, line in enumerate(text_tables.read_text(table).splitlines(), 1):
        fields = [field.strip() for field in line.split(",")]
        if not line.strip() or line.startswith("#"):
            continue
        try:
            stamps.append(integer_ns(fields[0]))
            files.append(cam / "data" / fields[1])
        except (ValueError, IndexError):
            found = repr(line[:60])
            raise FrontendError(f"{table}:{number}: nanoseconds and a file name expected, found {found}") from None
    if not files:
        raise FrontendError(f"{table}: no images")
    return np.array(stamps, dtype=np.int64), tuple(files)


def _sensor(cam: Path) -> tuple[RawCamera, NDArray[np.float64]]:
    """The camera and its ``T_body_camera``."""
    fields = load_fields(cam / "sensor.yaml")
    raw = kalibr.one_camera(fields, "distortion_coefficients")
    return raw, fields.transform("T_BS")


def paired_images(
    left_stamps: NDArray[np.int64],
    left: tuple[Path, ...],
    right_stamps: NDArray[np.int64],
    right: tuple[Path, ...],
    mav: Path,
    problems: Problems,
) -> tuple[NDArray[np.int64], tuple[Path, ...], tuple[Path, ...]]:
    """Frames that both cameras have by their tables: the recorder dropped some images of one camera in some
    sequences."""
    right_of = dict(zip(right_stamps.tolist(), right, strict=True))
    kept = [i for i, stamp in enumerate(left_stamps.tolist()) if stamp in right_of]
    if not kept:
        raise FrontendError(f"{mav}: no image of cam0 has the time of one of cam1")
    if len(kept) < len(left):
        problems.warning(
            f"{mav / 'cam1'}: no right image for {len(left) - len(kept)} of {len(left)} frames; these are left out"
        )
    return left_stamps[kept], tuple(left[i] for i in kept), tuple(right_of[int(left_stamps[i])] for i in kept)


def _groundtruth(mav: Path, raw: RawRig, T_body_left: NDArray[np.float64]) -> Trajectory | None:
    """``T_W_C`` of the left camera as calibrated."""
    state = mav / "state_groundtruth_estimate0" / "data.csv"
    if state.is_file():
        values = text_tables.read_table(
            state, (17, 8), "a state (ns, position, quaternion wxyz, and velocity and biases)"
        )
        stamps = read_stamps(state, nanoseconds=True)
        for row in np.flatnonzero(np.diff(stamps) <= 0)[:1] + 1:
            raise FrontendError(f"{state}:{text_tables.row_line(state, row)}: time does not go on")
        T_W_body = se3(rotation_from_quat_wxyz(values[:, 4:8]), values[:, 1:4])
        return Trajectory(stamps, product(T_W_body, T_body_left))
    beside = sorted(mav.resolve().parent.glob("groundtruth*.tum"))
    if not beside:
        return None
    rectified = read_tum(beside[0])
    if raw.T_left_right is None:
        return rectified
    R_rectified_left, _, _ = stereo_rotations(raw.T_left_right)
    return Trajectory(rectified.stamps_ns, product(rectified.poses, se3(R_rectified_left, np.zeros(3))))
