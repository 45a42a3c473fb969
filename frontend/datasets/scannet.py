"""ScanNet (Dai et al., CVPR 2017) as its reader exports it: colour, depth of another size, a pose a frame."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from maslam.backend.geometry import product, se3_inverse

from ..cameras.calibration import RawCamera, RawRig
from ..cameras.models import PinholeCamera, RigKind
from ..errors import FrontendError
from ..files import text_tables
from ..files.timestamps import NS_PER_S
from .assemble import DepthSensor, FoundSequence, assemble, available_rigs
from .base import ImageSequence, Problems, Reader, choose_rig
from .images import first_size, list_images
from .rigid_poses import poses_of_rows
from .truth import Truth, truth_of_files

_RATE_HZ = 30  # of the sensor; exported frames have no time stamps


class ScanNetReader(Reader):
    """``color/<n>.jpg``, ``depth/<n>.png`` (mm, of the depth camera), ``pose/<n>.txt`` (4x4, camera to world; infinite
    where unknown), ``intrinsic/intrinsic_color.txt``, ``intrinsic_depth.txt``, ``extrinsic_color.txt``,
    ``extrinsic_depth.txt`` (4x4). Time stamps are the numbers at 30 Hz."""

    kind = "scannet"

    def recognises(self, folder: Path) -> bool:
        """See :meth:`Reader.recognises`."""
        return (folder / "color").is_dir() and (folder / "intrinsic" / "intrinsic_color.txt").is_file()

    def open(self, folder: Path, rig: RigKind | None) -> ImageSequence:
        """See :meth:`Reader.open`."""
        problems = Problems()
        images = tuple(path for path in list_images(folder / "color") if path.stem.isdigit())
        if not images:
            raise FrontendError(f"{folder / 'color'}: no images named by their numbers")
        stamps = np.array([int(path.stem) * NS_PER_S // _RATE_HZ for path in images], dtype=np.int64)
        source = folder / "intrinsic" / "intrinsic_color.txt"
        K = _matrix(source)
        depth_of = {path.stem: path for path in list_images(folder / "depth")}
        depth = tuple(depth_of.get(path.stem, folder / "depth" / f"{path.stem}.png") for path in images)
        kind = choose_rig(available_rigs(False, bool(depth_of)), rig, folder)
        found = FoundSequence(
            kind=self.kind,
            folder=folder,
            raw=RawRig(RawCamera(K[0, 0], K[1, 1], K[0, 2], K[1, 2])),
            calibration=source,
            images=images,
            stamps_ns=stamps,
            stamps_source=folder / "color",
            depth=depth,
            depth_sensor=_sensor(folder, list(depth_of.values())) if kind is RigKind.RGBD else None,
            truth=_truth(folder / "pose", images, stamps, problems),
        )
        return assemble(found, kind, problems)


def _matrix(path: Path) -> NDArray[np.float64]:
    values = text_tables.read_table(path, 4, "a row of a 4x4 matrix")
    if values.shape != (4, 4):
        raise FrontendError(f"{path}: a 4x4 matrix expected, found {len(values)} rows")
    return values


def _sensor(folder: Path, depth: list[Path]) -> DepthSensor:
    """The depth camera, of the size of its images; where files are missing it is taken to stand where the colour
    camera does."""
    width, height = first_size(depth)
    inside = folder / "intrinsic"
    path = inside / "intrinsic_depth.txt"
    K = _matrix(path if path.is_file() else inside / "intrinsic_color.txt")
    if not 0 < K[0, 0] < np.inf or not 0 < K[1, 1] < np.inf:
        raise FrontendError(f"{path}: focal lengths {K[0, 0]}, {K[1, 1]} px cannot be")
    T_body = [_pose(inside / f"extrinsic_{name}.txt") for name in ("color", "depth")]
    camera = PinholeCamera(width, height, float(K[0, 0]), float(K[1, 1]), float(K[0, 2]), float(K[1, 2]))
    return DepthSensor(camera, product(se3_inverse(T_body[0]), T_body[1]))


def _pose(path: Path) -> NDArray[np.float64]:
    return poses_of_rows(path, _matrix(path).reshape(1, 16))[0] if path.is_file() else np.eye(4)


def _truth(folder: Path, images: tuple[Path, ...], stamps: NDArray[np.int64], problems: Problems) -> Truth | None:
    """Poses of the frames that have one; the others' files hold infinity, or are not there."""
    if not folder.is_dir():
        return None
    files = [path if (path := folder / f"{image.stem}.txt").is_file() else None for image in images]
    return truth_of_files(folder, [path if path and _is_known(path) else None for path in files], stamps, problems)


def _is_known(path: Path) -> bool:
    return b"inf" not in text_tables.read_bytes(path).lower()
