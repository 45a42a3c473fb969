"""The calibration file, or files, in a folder of images, found by their content."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from ..cameras.calibration import RawRig
from ..cameras.calibration_files import (
    Fields,
    colmap,
    kalibr,
    load_fields,
    numbers_alone,
    opencv_pair,
    read_calibration,
)
from ..cameras.calibration_files.registry import CalibrationFormat, format_of
from ..errors import FrontendError
from ..files.colmap_poses import MODELS

_SUFFIXES = (".yaml", ".yml", ".xml", ".json", ".npz")
_NOT_CAMERAS = ("metadata.yaml",)  # of a ROS 2 bag
_OFTEN_OTHERS = (".json", ".xml", ".npz")  # passed over where they hold no camera
_USUAL = ("camera", "calibration", "camera_info", "camchain", "calib")
_SIDES = (("left", "right"), ("cam0", "cam1"), ("camera0", "camera1"))
_MANY = 30  # files of one suffix in a folder: more are of the images
_ONE_CAMERA = ("OpenCV or ROS", "EuRoC")  # forms of which two files make a pair

_Known = dict[Path, tuple[Fields, CalibrationFormat]]


def find_camera_file(folder: Path) -> tuple[RawRig, Path] | None:
    """The rig and the file that it comes from; None where the folder has no calibration file.

    Two files of one camera each whose names differ by left and right (or cam0 and cam1) are a stereo pair, and so are
    OpenCV's intrinsics and extrinsics; else a file named as usual comes first; the only one that holds a camera may
    have any name. COLMAP's ``cameras.txt`` and ``cameras.bin`` come next, text files of numbers alone last.
    """
    files = _candidates(folder)
    loaded, refused = _load(files)
    known = {path: (data, form) for path, data in loaded.items() if (form := format_of(data)) is not None}
    pair = _opencvs_pair(loaded, known) or _pair_of_sides(loaded, known)
    if pair is not None:
        return pair
    chosen = _chosen(folder, known, refused) or _colmaps(folder)
    if chosen is None:  # called as calibrations are, and none: reading it says so
        chosen = next((path for path in loaded if path.stem.lower() in _USUAL), None) or _numbers(folder)
    if chosen is None:
        chosen = _only_one(folder, [path for path in files if path.suffix.lower() not in _OFTEN_OTHERS])
    return None if chosen is None else (read_calibration(chosen), chosen)


def usual_camera_file(folder: Path) -> Path | None:
    """A YAML file called as calibrations are (``camera.yaml`` …), by its name alone."""
    names = (f"{stem}{suffix}" for stem in _USUAL for suffix in _SUFFIXES[:2])
    return next((folder / name for name in names if (folder / name).is_file()), None)


def _only_one(folder: Path, without_camera: list[Path]) -> Path | None:
    """A file that holds no camera, where there is one: reading it says what is wrong with it."""
    if len(without_camera) > 1:
        names = ", ".join(path.name for path in without_camera)
        raise FrontendError(f"{folder}: which of {names} is the camera? none of them has the keys of a known format")
    return without_camera[0] if without_camera else None


def _candidates(folder: Path) -> list[Path]:
    """Files that may hold a camera, by their names; where there is one for each image, only those named as usual."""
    files = [p for p in folder.iterdir() if p.suffix.lower() in _SUFFIXES and not p.name.startswith(".")]
    files = [path for path in files if path.name not in _NOT_CAMERAS]
    kept = []
    for suffix in _SUFFIXES:
        of_one = [path for path in files if path.suffix.lower() == suffix]
        kept += [path for path in of_one if len(of_one) <= _MANY or path.stem.lower() in (*_USUAL, "transforms")]
    return sorted(path for path in kept if path.is_file())


def _load(files: list[Path]) -> tuple[dict[Path, Fields], dict[Path, FrontendError]]:
    """The keys of all files that have some, and why the others have none."""
    loaded, refused = {}, {}
    for path in files:
        try:
            loaded[path] = load_fields(path)
        except FrontendError as error:
            refused[path] = error
    return loaded, refused


def _chosen(folder: Path, known: _Known, refused: dict[Path, FrontendError]) -> Path | None:
    """The file with the camera; an error where several might be meant, or the one meant cannot be read."""
    meant = [*known, *(path for path in refused if path.suffix.lower() not in _OFTEN_OTHERS)]
    for stem in _USUAL:
        for path in meant:
            if path.stem.lower() == stem:
                return path
    found = [path for path, (_, form) in known.items() if form.name == "VINS-Fusion"] or list(known)
    if len(found) > 1:
        names = ", ".join(path.name for path in found)
        raise FrontendError(f"{folder}: which of {names} is the camera? name it camera.yaml")
    return found[0] if found else None


def _colmaps(folder: Path) -> Path | None:
    return next((p for inside in MODELS for name in colmap.FILES if (p := folder / inside / name).is_file()), None)


def _numbers(folder: Path) -> Path | None:
    """A text file of numbers alone that is called as such are and holds a camera."""
    for path in numbers_files(folder):
        try:
            read_calibration(path)
        except FrontendError:
            continue
        return path
    return None


def numbers_files(folder: Path) -> list[Path]:
    """Text files that are called as calibrations are."""
    return [
        path
        for path in sorted(folder.iterdir())
        if path.suffix.lower() == ".txt" and path.stem.lower() in numbers_alone.STEMS and path.is_file()
    ]


def _opencvs_pair(loaded: dict[Path, Fields], known: _Known) -> tuple[RawRig, Path] | None:
    """``M1 D1 M2 D2`` of one file, with ``R T`` of another."""
    cameras = [path for path, (_, form) in known.items() if form.name == "OpenCV's pair"]
    stands = [path for path, data in loaded.items() if path not in known and opencv_pair.says_how_they_stand(data)]
    if len(cameras) != 1 or len(stands) != 1 or opencv_pair.says_how_they_stand(loaded[cameras[0]]):
        return None
    rig = opencv_pair.read_with_stand(loaded[cameras[0]], loaded[stands[0]])
    return replace(rig, form=f"OpenCV's pair, with {stands[0].name}"), cameras[0]


def _pair_of_sides(loaded: dict[Path, Fields], known: _Known) -> tuple[RawRig, Path] | None:
    """Two files of one camera each, whose names say which is which."""
    single = {path.stem.lower(): path for path, (_, form) in known.items() if form.name in _ONE_CAMERA}
    for left_word, right_word in _SIDES:
        for stem, left in single.items():
            right = single.get(stem.replace(left_word, right_word)) if left_word in stem else None
            if right is None:
                continue
            form = known[left][1].name
            if form == "EuRoC" and known[right][1].name == form:
                rig = kalibr.pair_of_sensors(loaded[left], loaded[right])
            else:
                rig = opencv_pair.pair_of_files(left, right, _stand(stem, left_word, loaded))
            return replace(rig, form=f"{form}, with {right.name}"), left
    return None


def _stand(stem: str, left_word: str, loaded: dict[Path, Fields]) -> Path | None:
    """RTAB-Map's ``NAME_pose.yaml`` beside ``NAME_left.yaml``."""
    name = stem.removesuffix(left_word).rstrip("_") + "_pose"
    return next((p for p in loaded if p.stem.lower() == name and "rotation_matrix" in loaded[p]), None)
