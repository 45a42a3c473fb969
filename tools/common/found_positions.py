"""Positions from outside (GPS) of one sequence: where the file is found, and whether it can be used."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from .errors import ToolError
from .text_table import counted

if TYPE_CHECKING:
    from maslam.frontend.datasets.base import Dataset, ImageSequence
    from maslam.frontend.files.positions import PositionFixes

DEFAULT_SIGMA_M = 2.0
UNLIKE = "positions in degrees and in metres: agents need one frame for them"


@dataclass(frozen=True)
class PositionSettings:
    """``file``: of a single sequence, or a folder with one named after each; None: ``gps.csv`` or ``gps.nmea`` beside
    the images. ``sigma_m``: where a file has none; ``antenna_m``: in the camera's frame; ``offset_s``: added to its
    times."""

    file: Path | None = None
    offset_s: float = 0.0
    sigma_m: float = DEFAULT_SIGMA_M
    antenna_m: tuple[float, float, float] | None = None


@dataclass(frozen=True, eq=False)
class FoundPositions:
    """``fixes`` of ``file``, of which ``during`` are from the first image to the last."""

    file: Path
    fixes: PositionFixes
    during: int

    def line(self) -> str:
        """What was found, for people."""
        return f"{self.during} of {counted(len(self.fixes), 'position')} in {self.file.name} while images are"

    def notes(self) -> list[str]:
        """What of the file was left out, for people."""
        return [f"{self.file.name}: {note}" for note in self.fixes.notes]


NO_POSITIONS = PositionSettings()
"""Those beside the images only."""


def found_positions(
    dataset: Dataset, sequence: ImageSequence, settings: PositionSettings, metric: bool | None
) -> FoundPositions | None:
    """Those of one sequence, with the antenna's place in the rectified camera's frame; None without a file. Degrees are
    left as they are. ``metric``: whether lengths are metres, None: by the rig.
    :class:`ToolError` for a file that cannot be used."""
    from maslam.frontend.errors import FrontendError
    from maslam.frontend.files.positions import NMEA, POSITIONS, read_positions

    file = _file_of(dataset, sequence, settings, (POSITIONS, NMEA))
    if file is None:
        return None
    antenna = None if settings.antenna_m is None else np.array(settings.antenna_m)
    try:
        fixes = read_positions(file, settings.sigma_m, antenna, settings.offset_s)
    except FrontendError as error:
        raise ToolError(str(error)) from error
    if fixes.antenna.any() and not (sequence.rig.metric if metric is None else metric):
        raise ToolError(f"{file}: an antenna's place in metres, but {sequence.name} has a unit of its own")
    if sequence.R_rectified_left is not None:
        fixes = replace(fixes, antenna=sequence.R_rectified_left @ fixes.antenna)
    first, last = int(sequence.stamps_ns[0]), int(sequence.stamps_ns[-1])
    during = len(fixes.between(first, last))
    if not during:
        spans = [f"{t[0] / 1e9:.3f} to {t[-1] / 1e9:.3f} s" for t in (fixes.stamps_ns, sequence.stamps_ns)]
        raise ToolError(f"{file}: positions {spans[0]}, but images {spans[1]}; --gps-offset shifts the positions")
    return FoundPositions(file, fixes, during)


def _file_of(
    dataset: Dataset, sequence: ImageSequence, settings: PositionSettings, usual: tuple[str, ...]
) -> Path | None:
    single = len(dataset.sequences) == 1
    given = settings.file
    if given is None:
        folders = [dataset.root / sequence.name, *([dataset.root] if single else [])]
        beside = [folder / name for folder in folders for name in usual]
        return next((path for path in beside if path.is_file()), None)
    if given.is_dir():
        hits = [given / f"{sequence.name}{suffix}" for suffix in (".csv", ".nmea", ".log", ".txt", ".tum")]
        return next((path for path in hits if path.is_file()), None)
    if not given.is_file():
        raise ToolError(f"{given}: no such file")
    if not single:
        raise ToolError(f"{given}: one file for {len(dataset.sequences)} sequences; name a folder with one for each")
    return given
