"""Positions from outside (GPS) for the sequences of a data set: where they are found, and the one frame they share."""

from __future__ import annotations

import argparse
import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..common.errors import ToolError, UsageError
from ..common.found_positions import DEFAULT_SIGMA_M, UNLIKE, PositionSettings, found_positions, unread_positions

if TYPE_CHECKING:
    from maslam.frontend.datasets.base import Dataset

LONGEST_S = 9e9  # of 64 bits of nanoseconds


def add_position_options(parser: argparse.ArgumentParser) -> None:
    """Of ``maslam preprocess`` and ``maslam import``."""
    group = parser.add_argument_group("positions (GPS)")
    group.add_argument(
        "--gps",
        type=Path,
        metavar="FILE",
        help="positions: NMEA log, GPX, csv with a header (time lat lon alt, or time east north up; sigma or "
        "covariance of each axis) or TUM lines; a folder with one for each agent (default: gps.csv, gps.nmea or "
        "gps.gpx beside the images, or a bag's NavSatFix)",
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
    found, lines, sequences = {}, [], []
    origin = None if earlier is None else np.array(earlier, dtype=np.float64)
    kinds = set()
    for sequence in dataset.sequences:
        one = found_positions(dataset, sequence, settings, metric)
        if one is None:
            lines += [f"{sequence.name}: {note}" for note in unread_positions(dataset, sequence)]
            sequences.append(replace(sequence, positions=None))
            continue
        fixes = one.fixes
        kinds.add(fixes.geodetic is not None)
        if fixes.geodetic is not None:
            origin = fixes.geodetic[0] if origin is None else origin
            fixes = fixes.around(origin)
        lines.append(f"{sequence.name}: {one.line()}")
        lines += [f"{sequence.name}: {note}" for note in one.notes()]
        found[sequence.name] = one.source
        sequences.append(replace(sequence, positions=fixes))
    if len(kinds) > 1:
        raise ToolError(UNLIKE)
    noted = {"files": found, "origin": None if origin is None else origin.tolist()} if found else {}
    return replace(dataset, sequences=sequences), noted, lines
