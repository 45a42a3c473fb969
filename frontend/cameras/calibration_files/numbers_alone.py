"""Text files of numbers without names: ``fx fy cx cy`` with or without coefficients, or a camera matrix."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ...errors import FrontendError
from ...files.text_tables import read_text
from ..calibration import RawRig
from .checked_camera import camera, camera_matrix
from .fields import Fields

STEMS = (
    "calib",
    "calibration",
    "intrinsics",
    "intrinsic",
    "camera-intrinsics",
    "camera_intrinsics",
    "camera",
    "cam",
    "k",
)
"""Names of such files, in lower case, with the suffix ``.txt``."""
_NO_PAIR = "the file of one camera"
_FORMS = "fx fy cx cy, with 4, 5 or 8 coefficients of OpenCV behind, or a 3x3 or 4x4 camera matrix"


def read(path: Path) -> RawRig:
    """The one camera. :class:`FrontendError` where the file holds anything else."""
    rows = _rows(path)
    sizes = {len(row) for row in rows}
    flat = [value for row in rows for value in row]
    fields = Fields({"numbers": flat}, path)
    if (len(rows) == 1 and _is_matrix(flat)) or (sizes == {3} and len(rows) == 3):
        return _matrix(path, flat)
    if sizes == {4} and len(rows) == 4:
        return _matrix(path, [flat[i] for i in (0, 1, 2, 4, 5, 6, 8, 9, 10)])
    if len(flat) in (4, 8, 9, 12) and (len(rows) == 1 or sizes == {1}):
        return RawRig(camera(fields, flat[:4], None, "radtan", flat[4:]), form="numbers", no_pair=_NO_PAIR)
    raise FrontendError(f"{path}: {_FORMS} expected, found {len(flat)} numbers in {len(rows)} lines")


def _rows(path: Path) -> list[list[float]]:
    found = []
    for number, line in enumerate(read_text(path).splitlines(), 1):
        words = line.partition("#")[0].replace(",", " ").split()
        try:
            values = [float(word) for word in words]
        except ValueError:
            raise FrontendError(f"{path}:{number}: {_FORMS} expected, found {line[:60]!r}") from None
        if values and not np.isfinite(values).all():
            raise FrontendError(f"{path}:{number}: finite numbers expected, found {line[:60]!r}")
        found += [values] if values else []
    if not found:
        raise FrontendError(f"{path}: {_FORMS} expected, found nothing")
    return found


def _is_matrix(flat: list[float]) -> bool:
    return len(flat) == 9 and flat[1] == flat[3] == flat[6] == flat[7] == 0.0 and flat[8] == 1.0


def _matrix(path: Path, flat: list[float]) -> RawRig:
    fields = Fields({"matrix": [repr(value) for value in flat]}, path)
    return RawRig(camera(fields, camera_matrix(fields, "matrix"), None, "none", ()), form="matrix", no_pair=_NO_PAIR)
