"""Calibrations of other programs that are not read: named, so that nobody takes them for used."""

from __future__ import annotations

import re
from pathlib import Path

_SURE = (
    (re.compile(r"SN\d+\.conf|.*calib.*\.conf|.*zed.*\.conf", re.IGNORECASE), "ZED's calibration"),
    (re.compile(r"camera_models(_overrides)?\.json"), "OpenSfM's cameras"),
    (re.compile(r"reconstruction(\.meshed)?\.json"), "OpenSfM's reconstruction"),
    (re.compile(r"sfm_data.*\.json|cameras\.sfm"), "OpenMVG's or Meshroom's scene"),
    (re.compile(r"perspective\.txt|image_0[0-3]\.yaml|calib_cam_to_pose\.txt"), "KITTI-360's calibration"),
    (re.compile(r"camera\.txt|pcalib\.txt"), "DSO's calibration"),
    (
        re.compile(
            r"(.*calib.*|.*intrinsics?.*|cam(era)?_?(mat(rix)?|params?|info)?|.*dist(ortion)?_?coef.*|mtx|dist|k)"
            r"\.(npy|pkl|pickle|p|mat|h5|hdf5|ini|cal|csv|toml)",
            re.IGNORECASE,
        ),
        "a calibration by its name",
    ),
)
_PLACES = (".", "..", "calibration", "calib", "../calibration", "../calib")
_SECTION = re.compile(rb"^\[(LEFT|RIGHT|STEREO)_?CAM|^\[STEREO\]", re.MULTILINE)
_CURE = "which is not read: write its numbers into camera.yaml"


def calibrations_of_others(folder: Path) -> list[str]:
    """A sentence for each file in ``folder``, beside or above it, that another program's calibration is; without a file
    that holds a camera, these are why its user thinks there is one."""
    found: dict[Path, str] = {}
    for place in _PLACES:
        try:
            files = sorted(path for path in (folder / place).iterdir() if path.is_file())
        except OSError:
            continue
        for path in files:
            what = _what(path)
            if what and path.resolve() not in found:
                found[path.resolve()] = f"{path.name} is {what}, {_CURE}"
    return list(found.values())


def _what(path: Path) -> str:
    """Whose calibration a file is; empty where none's that is known."""
    for pattern, what in _SURE:
        if pattern.fullmatch(path.name):
            return what
    if path.suffix.lower() != ".conf":
        return ""
    try:
        with open(path, "rb") as file:
            return "ZED's calibration" if _SECTION.search(file.read(4096)) else ""
    except OSError:
        return ""
