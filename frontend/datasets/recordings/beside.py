"""What lies beside a recording and belongs to it: a camera file, ground truth."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from pathlib import Path

from ...cameras.calibration import RawRig
from ...cameras.calibration_files import load_fields, read_calibration
from ...cameras.calibration_files.registry import format_of
from ...errors import FrontendError
from ...files.pose_table import read_poses
from ..base import Problems
from ..camera_file import find_camera_file
from ..truth import Truth, check_axes

_CAMERA_SUFFIXES = (".yaml", ".yml", ".json")
_CAMERA_FOLDERS = ("", "calibration", "calibrations", "calib", "config", "configs", "params", "cameras")
_TRUTH_SUFFIXES = (".tum", ".txt", ".csv")
_TRUTH_FOLDERS = ("", "ground_truth", "groundtruth", "gt", "poses")
_OF_ALL = ("groundtruth", "ground_truth")
_NOT_NAMES = ("camera", "calibration", "camera_info", "camchain", "calib", "groundtruth", "times", "timestamps", "data")
_TRUE = re.compile(r"[-_.]?(gt|ground_?truth|odom(etry)?|poses?|traj(ectory)?)$")
_LEFT_OUT = "ground truth left out, errors cannot be known"


def camera_beside(folders: Sequence[Path], name: str, others: bool = True) -> tuple[RawRig, Path] | None:
    """The camera of the recording or robot ``name``: a file of its name in one of ``folders``, or in their
    ``calibration`` or ``configs``; else, with ``others``, the camera file of the first folder, or of one in it that is
    called so. None where there is none."""
    for path in _files(folders, _CAMERA_FOLDERS, _CAMERA_SUFFIXES):
        own = path.suffix.lower() in _CAMERA_SUFFIXES[:2] and path.stem.lower() == name.lower()
        if own or (_names(path.stem, name) and _holds_camera(path)):
            return read_calibration(path), path
    if not others:
        return None
    return find_camera_file(folders[0]) or next(
        filter(None, map(_camera_in, _places(folders[:1], _CAMERA_FOLDERS[1:]))), None
    )


def _holds_camera(path: Path) -> bool:
    """Whether a file has the keys of a calibration; other settings may have a robot's name."""
    try:
        return format_of(load_fields(path)) is not None
    except FrontendError:
        return False


def _camera_in(folder: Path) -> tuple[RawRig, Path] | None:
    """The camera in a folder that may hold other settings, too."""
    try:
        return find_camera_file(folder)
    except FrontendError:
        return None


def truth_beside(folders: Sequence[Path], name: str, alone: bool, problems: Problems) -> Truth | None:
    """``T_W_C`` of the recording or robot ``name``, on the recording's clock: a file of its name (``alice.tum``,
    ``alice_gt.txt``, ``alice_gt_odom.csv``) in one of ``folders``, or in their ``ground_truth``, there also in a folder
    for each recording; or ``groundtruth.txt`` where it is ``alone``. In any form with times.

    None where there is none, or, which is said, where it cannot be used or several are found.
    """
    found = [p for p in _files(folders, _TRUTH_FOLDERS, _TRUTH_SUFFIXES) if _names(_bare(p.stem), name)]
    if not found:
        found = [p for p in _of_recordings(folders) if _names(_bare(p.stem), name)]
        said = [p for p in found if p.parent.name in re.sub(r"[^0-9a-z]", "", f"{folders[0].name}{name}".lower())]
        found = said or found
    if not found and alone:
        found = [p for p in _files(folders[:1], ("",), _TRUTH_SUFFIXES) if p.stem.lower() in _OF_ALL]
    if not found:
        return None
    if len({path.parent for path in found}) > 1 and len(found) > 1 and found[0].parent not in folders:
        names = ", ".join(f"{path.parent.name}/{path.name}" for path in found)
        problems.warning(f"{found[0].parent.parent}: which of {names} is of {name}? {_LEFT_OUT}")
        return None
    return _read(found[0], problems)


def _read(path: Path, problems: Problems) -> Truth | None:
    sure = path.suffix.lower() == _TRUTH_SUFFIXES[0] or path.stem.lower() in _OF_ALL or _bare(path.stem) != path.stem
    try:
        table = read_poses(path)
    except FrontendError as error:
        if sure:  # else notes, or another sensor's table, that have the recording's name
            problems.warning(f"{error}: {_LEFT_OUT}")
        return None
    if table.stamps_ns is None:
        problems.warning(f"{path}: poses without times beside a recording: {_LEFT_OUT}")
        return None
    trajectory, more = table.in_time()
    for note in (*table.notes, *more):
        problems.warning(f"{path}: {note}")
    truth = Truth(trajectory, path)
    check_axes(truth, problems)
    return truth


def _bare(stem: str) -> str:
    """A truth file's name without the words that say that it is one."""
    bare = stem
    while (shorter := _TRUE.sub("", bare.lower())) != bare.lower() and shorter:
        bare = bare[: len(shorter)]
    return bare


def _names(stem: str, name: str) -> bool:
    """Whether a file of this ``stem`` is of the recording or robot ``name``: alike, or its last part, as Kimera-Multi's
    ``acl_jackal`` in ``10_14_acl_jackal``."""
    stem, name = stem.lower(), name.lower()
    if stem == name:
        return True
    return stem not in _NOT_NAMES and any(c.isalpha() for c in stem) and name.endswith((f"_{stem}", f"-{stem}"))


def _places(folders: Sequence[Path], inside: Sequence[str]) -> Iterator[Path]:
    """The folders, and those in them that are called so, whatever the case."""
    for folder in folders:
        if "" in inside:
            yield folder
        yield from (path for path in _listed(folder) if path.name.lower() in inside and path.is_dir())


def _files(folders: Sequence[Path], inside: Sequence[str], suffixes: Sequence[str]) -> Iterator[Path]:
    for place in _places(folders, inside):
        for suffix in suffixes:
            yield from (path for path in _listed(place) if path.suffix.lower() == suffix and path.is_file())


def _of_recordings(folders: Sequence[Path]) -> list[Path]:
    """Files of true poses in ``ground_truth/<recording>``."""
    inside = [sub for place in _places(folders, _TRUTH_FOLDERS[1:]) for sub in _listed(place) if sub.is_dir()]
    return list(_files(inside, ("",), _TRUTH_SUFFIXES))


def _listed(folder: Path) -> list[Path]:
    try:
        return sorted(path for path in folder.iterdir() if not path.name.startswith("."))
    except OSError:
        return []
