"""What lies beside a recording and belongs to it: a camera file, ground truth."""

from __future__ import annotations

from pathlib import Path

from ...cameras.calibration import RawRig
from ...cameras.calibration_files import read_calibration
from ...files.trajectory import read_tum
from ..camera_file import find_camera_file
from ..truth import Truth

_CAMERA_SUFFIXES = (".yaml", ".yml")
_TRUTH_SUFFIX = ".tum"
_TRUTHS = ("groundtruth.txt", "groundtruth.tum")


def camera_beside(folder: Path, name: str, others: bool = True) -> tuple[RawRig, Path] | None:
    """The camera of the recording or robot ``name`` in ``folder``: ``<name>.yaml``, else, with ``others``, the folder's
    camera file; None where there is none."""
    own = _first(folder, [name + suffix for suffix in _CAMERA_SUFFIXES])
    if own is not None:
        return read_calibration(own), own
    return find_camera_file(folder) if others else None


def truth_beside(folder: Path, name: str, alone: bool) -> Truth | None:
    """``T_W_C`` of the recording or robot ``name``: ``<name>.tum`` (TUM lines, on the recording's clock), or
    ``groundtruth.txt`` where it is ``alone`` in the folder; None where there is none."""
    path = _first(folder, [name + _TRUTH_SUFFIX, *(_TRUTHS if alone else ())])
    return None if path is None else Truth(read_tum(path), path)


def _first(folder: Path, names: list[str]) -> Path | None:
    return next((folder / name for name in names if (folder / name).is_file()), None)
