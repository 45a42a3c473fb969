"""OpenLORIS-Scene (Shi et al., ICRA 2020), its packages: colour and aligned depth of a RealSense D435i."""

from __future__ import annotations

from pathlib import Path

from ..cameras.calibration import RawCamera, RawRig
from ..cameras.calibration_files import Fields, camera, load_fields
from ..cameras.models import RigKind
from .assemble import FoundSequence, assemble, available_rigs
from .base import ImageSequence, Problems, Reader, choose_rig
from .depth_unit import unit_of_depth
from .pairing import paired_in_time
from .truth import find_truth
from .tum import TOLERANCE_NS, read_list

_COLOUR, _DEPTH, _SENSORS = "color.txt", "aligned_depth.txt", "sensors.yaml"
_FRAME = "d400_color_optical_frame"
_MILLIMETRE = 0.001


class OpenLorisReader(Reader):
    """``color.txt`` and ``aligned_depth.txt`` (``time file``), ``sensors.yaml`` with the group
    ``d400_color_optical_frame``, whose ``intrinsics`` are ``fx cx fy cy``; ``groundtruth.txt`` as it is. The
    fisheye pair is not read."""

    kind = "openloris"

    def recognises(self, folder: Path) -> bool:
        """See :meth:`Reader.recognises`."""
        return (folder / _COLOUR).is_file() and (folder / _SENSORS).is_file()

    def open(self, folder: Path, rig: RigKind | None) -> ImageSequence:
        """See :meth:`Reader.open`."""
        problems = Problems()
        images = read_list(folder / _COLOUR, problems)
        has_depth = (folder / _DEPTH).is_file()
        if not has_depth and (folder / "depth.txt").is_file() and rig is None:
            problems.warning(f"{folder}: depth.txt, of a camera of its own, but no {_DEPTH}: read without depth")
        kind = choose_rig(available_rigs(False, has_depth), rig, folder)
        depth: tuple[Path, ...] = ()
        if kind is RigKind.RGBD:
            seconds = read_list(folder / _DEPTH, problems)
            images, depth = paired_in_time(images, seconds, "depth image", problems, TOLERANCE_NS)
        source = folder / _SENSORS
        found = FoundSequence(
            kind=self.kind,
            folder=folder,
            raw=RawRig(_camera(load_fields(source).inner(_FRAME)), form="OpenLORIS"),
            calibration=source,
            images=images.files,
            stamps_ns=images.stamps_ns,
            stamps_source=images.source,
            depth=depth,
            depth_unit_m=unit_of_depth(depth, None, _MILLIMETRE, source, problems),
            truth=find_truth(folder, images, problems),
        )
        return assemble(found, kind, problems)


def _camera(group: Fields) -> RawCamera:
    if group.text("model") != "pinhole" or group.text("distortion_model") not in ("", "radial-tangential"):
        raise group.fail("model", "pinhole with radial-tangential distortion")
    fx, cx, fy, cy = group.numbers("intrinsics", 4)
    key = "distortion_coefficients"
    bent = group.numbers(key) if key in group else ()
    return camera(group, (fx, fy, cx, cy), group.size("width", "height"), "radtan" if bent else "none", bent)
