"""Replica as NICE-SLAM renders it (Straub et al., 2019; Zhu et al., CVPR 2022): colour and depth in one folder."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import numpy as np

from ..cameras.calibration import RawCamera, RawRig
from ..cameras.models import RigKind
from ..errors import FrontendError
from ..files import text_tables
from ..files.timestamps import NS_PER_S
from .above import folder_above
from .assemble import FoundSequence, assemble, available_rigs
from .base import ImageSequence, Problems, Reader, choose_rig
from .camera_file import find_camera_file
from .depth_unit import unit_of_depth
from .image_times import TimedImages
from .images import list_images
from .truth import Truth, read_truth

_IMAGE = re.compile(r"(?:frame|rgb|colou?r|image|img)[-_]?(\d+)", re.IGNORECASE)
_DEPTH = re.compile(r"depth[-_]?(\d+)", re.IGNORECASE)
_PARAMETERS, _POSES = "cam_params.json", "traj.txt"
_RATE_HZ = 30.0


class ReplicaReader(Reader):
    """``results/frame<n>.jpg`` and ``results/depth<n>.png``, or that folder itself; ``traj.txt``, 16 numbers an image
    (``T_W_C``), in the folder or above.

    Camera: ``cam_params.json`` (``w h fx fy cx cy``, ``scale`` steps of depth a metre) in the folder, beside it or
    above it, else a calibration file. Time stamps are the numbers in the names at 30 Hz, or at the calibration's rate.
    """

    kind = "replica"

    def recognises(self, folder: Path) -> bool:
        """See :meth:`Reader.recognises`."""
        return _inside(folder) is not None

    def open(self, folder: Path, rig: RigKind | None) -> ImageSequence:
        """See :meth:`Reader.open`."""
        problems = Problems()
        inside = _inside(folder)
        if inside is None:
            raise FrontendError(f"{folder}: no images frame<n> beside depth<n>")
        images, depth_of = _numbered(inside, _IMAGE), _numbered(inside, _DEPTH)
        raw, source = _camera(inside, problems)
        rate_hz = raw.rate_hz or _RATE_HZ
        numbers = np.array(sorted(images), dtype=np.int64)
        stamps = np.rint((numbers - numbers[0]) * (NS_PER_S / rate_hz)).astype(np.int64)
        timed = TimedImages(tuple(images[n] for n in numbers.tolist()), stamps, inside, measured=False)
        depth = tuple(depth_of.get(n, inside / f"depth{n:06d}.png") for n in numbers.tolist())
        found = FoundSequence(
            kind=self.kind,
            folder=folder_above(inside) if inside.name == "results" else folder,
            raw=raw,
            calibration=source,
            images=timed.files,
            stamps_ns=stamps,
            stamps_source=inside,
            depth=depth,
            depth_unit_m=unit_of_depth(depth, raw.depth_unit_m, None, source, problems),
            truth=_truth(inside, timed, problems),
        )
        return assemble(found, choose_rig(available_rigs(False, True), rig, folder), problems)


def _inside(folder: Path) -> Path | None:
    for place in (folder / "results", folder):
        names = [path.stem for path in list_images(place)]
        both = any(map(_DEPTH.fullmatch, names)) and any(map(_IMAGE.fullmatch, names))
        above = folder_above(place)
        if both and any((at / name).is_file() for at in (place, above) for name in (_POSES, _PARAMETERS)):
            return place
    return None


def _numbered(folder: Path, pattern: re.Pattern[str]) -> dict[int, Path]:
    matches = ((pattern.fullmatch(path.stem), path) for path in list_images(folder))
    return {int(match[1]): path for match, path in matches if match}


def _camera(inside: Path, problems: Problems) -> tuple[RawRig, Path]:
    above = folder_above(inside)
    for place in (inside, above, folder_above(above)):
        path = place / _PARAMETERS
        if path.is_file():
            return _parameters(path), path
    found = find_camera_file(inside) or find_camera_file(above)
    if found is None:
        raise FrontendError(f"{above}: no {_PARAMETERS} and no calibration file; put one beside the images")
    return found


def _parameters(path: Path) -> RawRig:
    try:
        content: Any = json.loads(text_tables.read_bytes(path))
        fields = content.get("camera", content)
        size = int(fields["w"]), int(fields["h"])
        fx, fy, cx, cy = (float(fields[key]) for key in ("fx", "fy", "cx", "cy"))
        scale = float(fields["scale"]) if "scale" in fields else None
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
        raise FrontendError(f"{path}: a camera with w, h, fx, fy, cx, cy expected: {error!r}") from None
    if not np.isfinite([fx, fy, cx, cy]).all() or min(fx, fy) <= 0 or (scale is not None and not 0 < scale < np.inf):
        raise FrontendError(f"{path}: focal lengths {fx}, {fy} px, centre {cx}, {cy} px and scale {scale} cannot be")
    return RawRig(RawCamera(fx, fy, cx, cy, size), depth_unit_m=None if scale is None else 1.0 / scale)


def _truth(inside: Path, images: TimedImages, problems: Problems) -> Truth | None:
    """A row for each number, from 0 on; or one for each image."""
    path = next((p for p in (inside / _POSES, folder_above(inside) / _POSES) if p.is_file()), None)
    return None if path is None else read_truth(path, images, problems)
