"""The calibration of a robot that lies with those of the others, above its own folder."""

from __future__ import annotations

from pathlib import Path

from ..cameras.calibration import RawRig
from ..cameras.calibration_files import read_calibration
from .above import folder_above
from .base import Problems

_SUFFIXES = (".yaml", ".yml", ".json")
_FOLDERS = (".", "calibration", "calib", "calibrations", "cameras")
_OF_ALL = ("camera", "calibration", "camera_info", "camchain", "calib")


def find_shared_camera(folder: Path, problems: Problems) -> tuple[RawRig, Path] | None:
    """The calibration beside ``folder`` that has its name, else one for all (``camera.yaml`` …), directly there or in
    ``calibration``; None without. Taking it is said."""
    above, name_of = folder_above(folder), folder.resolve().name
    beside = [path for name in _FOLDERS for path in _files(above / name)]
    for stem in (name_of.lower(), *_OF_ALL):
        for path in beside:
            if path.stem.lower() == stem:
                problems.warning(f"{path}: taken as the calibration of {name_of}, which has none of its own")
                return read_calibration(path), path
    return None


def _files(folder: Path) -> list[Path]:
    try:
        return sorted(p for p in folder.iterdir() if p.suffix.lower() in _SUFFIXES and p.is_file())
    except OSError:
        return []
