"""Positions from outside (GPS) for the sequences of a data set: where they are found, and the one frame they share."""

from __future__ import annotations

import argparse
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..common.errors import ToolError, UsageError
from ..common.text_table import counted

if TYPE_CHECKING:
    from maslam.frontend.datasets.base import Dataset, ImageSequence

DEFAULT_SIGMA_M = 2.0
LONGEST_S = 9e9  # of 64 bits of nanoseconds


@dataclass(frozen=True)
class PositionSettings:
    """``file``: of a single sequence, or a folder with one named after each; None: ``gps.csv`` or ``gps.nmea`` beside
    the images. ``sigma_m``: where a file has none; ``antenna_m``: in the camera's frame; ``offset_s``: added to its
    times."""

    file: Path | None = None
    offset_s: float = 0.0
    sigma_m: float = DEFAULT_SIGMA_M
    antenna_m: tuple[float, float, float] | None = None


NO_POSITIONS = PositionSettings()
"""Those beside the images only."""


def add_position_options(parser: argparse.ArgumentParser) -> None:
    """Of ``maslam preprocess`` and ``maslam import``."""
    group = parser.add_argument_group("positions (GPS)")
    group.add_argument(
        "--gps",
        type=Path,
        metavar="FILE",
        help="positions: NMEA log, csv with a header (time lat lon alt, or time east north up; sigma or covariance of "
        "each axis) or TUM lines; a folder with one for each agent (default: gps.csv or gps.nmea beside the images)",
    )
    group.add_argument(
        "--gps-offset", type=float, default=0.0, metavar="S", help="seconds to add to their times (default: 0)"
    )
    group.add_argument(
        "--gps-sigma",
        type=float,
        default=DEFAULT_SIGMA_M,
        metavar="M",
        help="standard deviation of each axis where the file has none, at HDOP 1, metres (default: %(default)s)",
    )
    group.add_argument(
        "--gps-antenna", metavar="X,Y,Z", help="the antenna's place in the camera's frame, metres (default: 0,0,0)"
    )


def positions_from(arguments: argparse.Namespace) -> PositionSettings:
    """The settings of one command line."""
    antenna = None
    if arguments.gps_antenna is not None:
        try:
            numbers = tuple(float(part) for part in arguments.gps_antenna.replace(",", " ").split())
        except ValueError:
            numbers = ()
        if len(numbers) != 3 or not all(map(math.isfinite, numbers)):
            raise UsageError(f"--gps-antenna {arguments.gps_antenna}: three numbers, X,Y,Z in metres, are meant")
        antenna = (numbers[0], numbers[1], numbers[2])
    if not (math.isfinite(arguments.gps_sigma) and arguments.gps_sigma > 0):
        raise UsageError(f"--gps-sigma {arguments.gps_sigma}: metres above 0 are meant")
    if not (math.isfinite(arguments.gps_offset) and abs(arguments.gps_offset) < LONGEST_S):
        raise UsageError(f"--gps-offset {arguments.gps_offset}: seconds are meant")
    return PositionSettings(arguments.gps, arguments.gps_offset, arguments.gps_sigma, antenna)


def with_positions(
    dataset: Dataset, settings: PositionSettings, metric: bool | None, earlier: Sequence[float] | None = None
) -> tuple[Dataset, dict[str, Any], list[str]]:
    """``dataset`` with the positions of its sequences, what is to be noted of them, and what was found, for people.

    ``metric``: whether lengths are metres, None: by the rig. All agents' positions are metres around one place:
    ``earlier`` (latitude, longitude, altitude), or the first fix. :class:`ToolError` for a file that cannot be used.
    """
    from maslam.frontend.errors import FrontendError
    from maslam.frontend.files.positions import NMEA, POSITIONS, read_positions

    found, lines, sequences = {}, [], []
    origin = None if earlier is None else np.array(earlier, dtype=np.float64)
    kinds = set()
    for sequence in dataset.sequences:
        file = _file_of(dataset, sequence, settings, (POSITIONS, NMEA))
        if file is None:
            sequences.append(sequence)
            continue
        antenna = None if settings.antenna_m is None else np.array(settings.antenna_m)
        try:
            fixes = read_positions(file, settings.sigma_m, antenna, settings.offset_s)
        except FrontendError as error:
            raise ToolError(str(error)) from error
        kinds.add(fixes.geodetic is not None)
        if fixes.geodetic is not None:
            origin = fixes.geodetic[0] if origin is None else origin
            fixes = fixes.around(origin)
        if fixes.antenna.any() and not (sequence.rig.metric if metric is None else metric):
            raise ToolError(f"{file}: an antenna's place in metres, but {sequence.name} has a unit of its own")
        if sequence.R_rectified_left is not None:
            fixes = replace(fixes, antenna=sequence.R_rectified_left @ fixes.antenna)
        first, last = int(sequence.stamps_ns[0]), int(sequence.stamps_ns[-1])
        during = len(fixes.between(first, last))
        if not during:
            spans = [f"{t[0] / 1e9:.3f} to {t[-1] / 1e9:.3f} s" for t in (fixes.stamps_ns, sequence.stamps_ns)]
            raise ToolError(f"{file}: positions {spans[0]}, but images {spans[1]}; --gps-offset shifts the positions")
        lines.append(f"{sequence.name}: {during} of {counted(len(fixes), 'position')} in {file.name} while images are")
        lines += [f"{sequence.name}: {file.name}: {note}" for note in fixes.notes]
        found[sequence.name] = str(file)
        sequences.append(replace(sequence, positions=fixes))
    if len(kinds) > 1:
        raise ToolError("positions in degrees and in metres: agents need one frame for them")
    noted = {"files": found, "origin": None if origin is None else origin.tolist()} if found else {}
    return replace(dataset, sequences=sequences), noted, lines


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
