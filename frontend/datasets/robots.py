"""Sub-folders of a data set that are robots, by what is in them and what they are called."""

from __future__ import annotations

import os
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

from .base import Reader
from .image_headers import UNREAD
from .images import natural_key

_AGENT = re.compile(r"agent_\d+")
_CAMERA = re.compile(
    r"(^|[^a-z])(cam(era)?s?|left|right|front|rear|back|side|top|bottom|rgb|colou?r|gr[ae]y|mono|stereo|depth|infra(red)?|"
    r"ir|nir|thermal|fisheye|wide|tele|images?|img|frames?|masks?|disparity|flow|semantics?|labels?|seg(mentation)?|"
    r"results?|data|pose|intrinsics?|calib(ration)?|velodyne\w*|oxts|lidar|imu|mav)([^a-z]|$)"
)
_NUMBERED = (
    "seq(uence)?|scene|run|session|traj(ectory)?|part|take|drive|trip|loop|route|lap|day|night|"
    "test|train(ing)?|val(idation)?|rec(ording)?|bag|clip|video|shot|dataset|p|mh|v\\d"
)
_RECORDING = re.compile(
    rf"({_NUMBERED})?[-_ ]*\d+([-_ ].*)?|rgbd_dataset_.*|\d{{4}}[-_]\d\d[-_]\d\d.*|train(ing)?|test(ing)?|val(idation)?"
)
_ASIDE = re.compile(
    "configs?|configuration|params?|parameters|ground_?truth|gt|maps?|meta|docs?|notes?|scripts?|tools?|logs?|out|"
    "outputs?|eval(uation)?|plots?|figures?|tmp|cache"
)
"""Folders beside robots that nobody takes for one."""
_OF_A_SEQUENCE = frozenset(
    ("camera", "calibration", "camera_info", "camchain", "calib", "intrinsics", "times", "timestamps", "timestamp")
)
"""Files, without suffix, that lie with the images of one sequence."""
_DEEPEST, _MOST = 2, 1000
"""Levels of folders, and folders of one, in which a sequence is looked for."""


@dataclass(frozen=True)
class SubFolders:
    """Sub-folders that a reader recognises, in natural order of their names: ``robots``, ``recordings`` (whole
    sequences by their names, which may have one camera in turn) and ``cameras`` (parts of one sequence)."""

    robots: tuple[Path, ...] = ()
    recordings: tuple[Path, ...] = ()
    cameras: tuple[Path, ...] = ()

    @property
    def all(self) -> tuple[Path, ...]:
        """All of them, in natural order."""
        return tuple(sorted((*self.robots, *self.recordings, *self.cameras), key=lambda p: natural_key(p.name)))


def agent_folders(folder: Path) -> list[Path]:
    """Sub-folders ``agent_<n>``: agents whatever is in them."""
    return _sorted(p for p in folder.iterdir() if p.is_dir() and _AGENT.fullmatch(p.name))


def sub_folders(folder: Path, readers: Sequence[Reader]) -> SubFolders:
    """The sub-folders of ``folder`` that one of ``readers`` recognises. A name alone tells a robot from a recording:
    Alice, husky_1 and drone from seq-01, 00 and run_2."""
    inside = _folders_in(folder)
    usable = [p for p in inside if any(reader.recognises(p) for reader in readers)]
    # A robot whose images lie one folder deeper (robot/forward/infra1): where no folder holds any itself.
    usable = usable or [p for p in inside if not _CAMERA.search(p.name.lower()) and only_sequence(p, readers)]
    cameras = [p for p in usable if _CAMERA.search(p.name.lower())]
    recordings = [p for p in usable if p not in cameras and _RECORDING.fullmatch(p.name.lower())]
    robots = [p for p in usable if p not in cameras and p not in recordings]
    return SubFolders(tuple(robots), tuple(recordings), tuple(cameras))


def without_images(folder: Path, taken: Sequence[Path], readers: Sequence[Reader]) -> list[Path]:
    """The sub-folders of ``folder`` that none of ``readers`` recognises and that seem to be meant as robots all the
    same, beside the ``taken`` ones: they are called like these but for a number, are empty, hold folders of cameras,
    a calibration, times, or a sequence farther down."""
    alike = {_numberless(p) for p in taken if _numberless(p) != p.name.lower()}
    found = []
    for p in _folders_in(folder):
        if p in taken or any(reader.recognises(p) for reader in readers):
            continue
        name = p.name.lower()
        usual = _ASIDE.fullmatch(name) or _CAMERA.search(name) or _RECORDING.fullmatch(name)
        if _numberless(p) in alike or (not usual and (_is_bare(p) or only_sequence(p, readers) is not None)):
            found.append(p)
    return found


def _numberless(folder: Path) -> str:
    return re.sub(r"\d+", "#", folder.name.lower())


def _is_bare(folder: Path) -> bool:
    """Whether a folder is empty, or holds what belongs to a sequence."""
    inside = list(folder.iterdir())
    return not inside or any(
        _CAMERA.search(p.name.lower()) if p.is_dir() else p.stem.lower() in _OF_A_SEQUENCE or p.suffix.lower() in UNREAD
        for p in inside
    )


def only_sequence(folder: Path, readers: Sequence[Reader]) -> Path | None:
    """The one sub-folder that one of ``readers`` recognises, directly in ``folder`` or, where there is none, one level
    deeper; None where there are several, or none, or what there is may be one camera of several."""
    level = [folder]
    for _ in range(_DEEPEST):
        level = [p for place in level for p in _folders_in(place)]
        usable = [p for p in level[:_MOST] if any(reader.recognises(p) for reader in readers)]
        if usable:
            return usable[0] if len(usable) == 1 and not _CAMERA.search(usable[0].name.lower()) else None
    return None


def _folders_in(folder: Path) -> list[Path]:
    """The folders in ``folder`` that can be looked into, hidden ones apart."""
    try:
        inside = [p for p in folder.iterdir() if p.is_dir() and not p.name.startswith(".")]
    except OSError:
        return []
    return _sorted(p for p in inside if os.access(p, os.R_OK | os.X_OK))


def _sorted(folders: Iterable[Path]) -> list[Path]:
    return sorted(folders, key=lambda p: natural_key(p.name))
