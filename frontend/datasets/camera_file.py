"""The calibration file in a folder of images, found by its content."""

from __future__ import annotations

from pathlib import Path

from ..cameras.calibration import RawRig
from ..cameras.calibration_files import pair_of_files, read_calibration
from ..errors import FrontendError

_SUFFIXES = (".yaml", ".yml")
_USUAL = ("camera", "calibration", "camera_info", "camchain", "calib")


def find_camera_file(folder: Path) -> tuple[RawRig, Path] | None:
    """The rig and the file that it comes from; None where the folder has no YAML file.

    ``left.yaml`` with ``right.yaml`` are a stereo pair; else a file named as usual comes first; the only YAML file
    may have any name.
    """
    files = sorted(
        path
        for path in folder.iterdir()
        if path.suffix.lower() in _SUFFIXES and path.is_file() and not path.name.startswith(".")
    )
    if not files:
        return None
    by_stem = {path.stem.lower(): path for path in files}
    if "left" in by_stem and "right" in by_stem:
        return pair_of_files(by_stem["left"], by_stem["right"]), by_stem["left"]
    chosen = next((by_stem[stem] for stem in _USUAL if stem in by_stem), files[0] if len(files) == 1 else None)
    if chosen is None:
        names = ", ".join(path.name for path in files)
        raise FrontendError(f"{folder}: which of {names} is the camera? name it camera.yaml")
    return read_calibration(chosen), chosen
