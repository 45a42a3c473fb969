"""How many metres a step of depth images is."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import FrontendError
from .base import Problems
from .depth_files import UNKNOWN, stored_depth

_TRIED = 5  # files of which one must be whole to tell their format
_MILLIMETRE = 0.001
_NEAREST_M, _FARTHEST_M = 0.05, 200.0  # between which half of the depths of a scene lie


def unit_of_depth(
    files: Sequence[Path], stated_m: float | None, usual_m: float | None, source: Path, problems: Problems
) -> float:
    """Metres of a step of the depth ``files``: ``stated_m`` by the calibration ``source``; else metres themselves where
    they are floating-point numbers, and ``usual_m`` of the kind of data set, or millimetres with a warning, of 16 bits.

    A stated unit that is one of 16 bits is not that of metres beside it: the depths tell, and that is said.
    """
    stored = _first_stored(files)
    if stored is None:
        return stated_m or usual_m or _MILLIMETRE
    known = stored[np.isfinite(stored) & (stored > 0) & (stored != (UNKNOWN if stored.dtype == np.uint16 else 0))]
    median = float(np.median(known)) if known.size else 0.0
    if stored.dtype != np.uint16:
        if stated_m is None or stated_m == 1.0:
            return 1.0
        if median * stated_m < _NEAREST_M <= median <= _FARTHEST_M:
            problems.warning(
                f"{source}: depth in steps of {stated_m:.4g} m, but {files[0].name} holds floating-point numbers, "
                f"half of them below {median:.3g}: metres taken"
            )
            return 1.0
        return stated_m
    if stated_m is None and usual_m is None:
        problems.warning(
            f"{source}: no depth unit (depth_unit_m, DepthMapFactor): millimetres taken; half of the depths are then "
            f"below {median * _MILLIMETRE:.3g} m, and below {median / 5000:.3g} m in TUM's 1/5000 m"
        )
    return stated_m or usual_m or _MILLIMETRE


def _first_stored(files: Sequence[Path]) -> NDArray[Any] | None:
    """The first file that can be read."""
    for path in files[:_TRIED]:
        try:
            return stored_depth(path)
        except FrontendError:
            continue
    return None
