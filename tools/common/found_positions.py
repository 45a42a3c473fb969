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
_LOGS = (".gpx", ".nmea", ".kml", ".ubx")
UNLIKE = "positions in degrees and in metres: agents need one frame for them"


@dataclass(frozen=True)
class PositionSettings:
    """``file``: of a single sequence, or a folder with one named after each; None: ``gps.csv``, ``gps.nmea`` or
    ``gps.gpx`` beside the images. ``sigma_m``: where a file has none; ``antenna_m``: in the camera's frame;
    ``offset_s``: added to its times."""

    file: Path | None = None
    offset_s: float = 0.0
    sigma_m: float = DEFAULT_SIGMA_M
    antenna_m: tuple[float, float, float] | None = None


@dataclass(frozen=True, eq=False)
class FoundPositions:
    """``fixes`` of ``source`` (a file, or a topic of a recording), called ``name`` for short, of which ``during`` are
    from the first image to the last."""

    source: str
    name: str
    fixes: PositionFixes
    during: int

    def line(self) -> str:
        """What was found, for people."""
        return f"{self.during} of {counted(len(self.fixes), 'position')} in {self.name} while images are"

    def notes(self) -> list[str]:
        """What of the file was left out, for people."""
        return [f"{self.name}: {note}" for note in self.fixes.notes]


NO_POSITIONS = PositionSettings()
"""Those beside the images, or in the recording, only."""


def found_positions(
    dataset: Dataset, sequence: ImageSequence, settings: PositionSettings, metric: bool | None
) -> FoundPositions | None:
    """Those of one sequence, with the antenna's place in the rectified camera's frame; None without a file, and where
    the recording has none while images are. Degrees are left as they are. ``metric``: whether lengths are metres, None:
    by the rig. :class:`ToolError` for a file that cannot be used."""
    from maslam.frontend.errors import FrontendError
    from maslam.frontend.files.positions import BESIDE, read_positions

    file = _file_of(dataset, sequence, settings, BESIDE)
    recorded = sequence.positions if file is None else None
    antenna = None if settings.antenna_m is None else np.array(settings.antenna_m)
    try:
        if file is not None:
            source, name = str(file), file.name
            fixes = read_positions(file, settings.sigma_m, antenna, settings.offset_s)
        elif recorded is not None:
            source, name = recorded.source, recorded.source.rpartition(" ")[2]
            fixes = recorded.completed(settings.sigma_m, antenna, settings.offset_s)
        else:
            return None
    except FrontendError as error:
        raise ToolError(str(error)) from error
    if fixes.antenna.any() and not (sequence.rig.metric if metric is None else metric):
        raise ToolError(f"{source}: an antenna's place in metres, but {sequence.name} has a unit of its own")
    if sequence.R_rectified_left is not None:
        fixes = replace(fixes, antenna=sequence.R_rectified_left @ fixes.antenna)
    during = len(fixes.between(int(sequence.stamps_ns[0]), int(sequence.stamps_ns[-1])))
    if not during and recorded is None:
        raise ToolError(f"{source}: {_apart(fixes, sequence)}")
    return FoundPositions(source, name, fixes, during) if during else None


def _apart(fixes: PositionFixes, sequence: ImageSequence) -> str:
    spans = [f"{t[0] / 1e9:.3f} to {t[-1] / 1e9:.3f} s" for t in (fixes.stamps_ns, sequence.stamps_ns)]
    return f"positions {spans[0]}, but images {spans[1]}; --gps-offset shifts the positions"


def unread_positions(dataset: Dataset, sequence: ImageSequence) -> list[str]:
    """A sentence for each source of positions that :func:`found_positions` has left out: of the recording at other
    times, and a receiver's tracks beside the images under other names."""
    recorded = sequence.positions
    apart = [] if recorded is None else [f"{recorded.source}: not used: {_apart(recorded, sequence)}"]
    folders = _folders(dataset, sequence)
    beside = [path for folder in folders if folder.is_dir() for path in sorted(folder.iterdir())]
    return apart + [
        f"{path} is not read: call it gps{path.suffix.lower()}, or give --gps FILE"
        for path in beside
        if path.suffix.lower() in _LOGS and path.is_file()
    ]


def _folders(dataset: Dataset, sequence: ImageSequence) -> list[Path]:
    return [dataset.root / sequence.name, *([dataset.root] if len(dataset.sequences) == 1 else [])]


def _file_of(
    dataset: Dataset, sequence: ImageSequence, settings: PositionSettings, usual: tuple[str, ...]
) -> Path | None:
    single = len(dataset.sequences) == 1
    given = settings.file
    if given is None:
        beside = [folder / name for folder in _folders(dataset, sequence) for name in usual]
        return next((path for path in beside if path.is_file()), None)
    if given.is_dir():
        hits = [given / f"{sequence.name}{suffix}" for suffix in (".csv", ".nmea", ".gpx", ".log", ".txt", ".tum")]
        return next((path for path in hits if path.is_file()), None)
    if not given.is_file():
        raise ToolError(f"{given}: no such file")
    if not single:
        raise ToolError(f"{given}: one file for {len(dataset.sequences)} sequences; name a folder with one for each")
    return given
