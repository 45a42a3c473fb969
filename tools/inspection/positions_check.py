"""Positions (GPS) beside the images, as a run would find them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from ..common.errors import ToolError
from ..common.found_positions import NO_POSITIONS, UNLIKE, found_positions, unread_positions

if TYPE_CHECKING:
    from collections.abc import Sequence

    from maslam.frontend.datasets import Dataset, ImageSequence, Problem


@dataclass(frozen=True)
class PositionsCheck:
    """``line``: which there are, empty without; ``geodetic``: whether they are degrees, None without; ``notes``: what
    of the file was left out; ``problems``: why a run would refuse it."""

    line: str = ""
    geodetic: bool | None = None
    notes: tuple[str, ...] = ()
    problems: tuple[Problem, ...] = ()


def check_positions(dataset: Dataset, sequence: ImageSequence) -> PositionsCheck:
    """The positions that a run without ``--gps`` would take for ``sequence``."""
    from maslam.frontend.datasets import Problem, Severity

    try:
        found = found_positions(dataset, sequence, NO_POSITIONS, None)
    except ToolError as error:
        return PositionsCheck(problems=(Problem(Severity.ERROR, str(error)),))
    if found is None:
        return PositionsCheck(notes=tuple(unread_positions(dataset, sequence)))
    stamps, geodetic = found.fixes.stamps_ns, found.fixes.geodetic is not None
    line = (
        f"{found.line()}, {stamps[0] / 1e9:.3f} to {stamps[-1] / 1e9:.3f} s, in {'degrees' if geodetic else 'metres'}"
    )
    return PositionsCheck(line, geodetic, tuple(found.notes()))


def unlike(checks: Sequence[PositionsCheck]) -> tuple[Problem, ...]:
    """An error where some agents' positions are degrees and others' metres."""
    from maslam.frontend.datasets import Problem, Severity

    kinds = {one.geodetic for one in checks} - {None}
    return (Problem(Severity.ERROR, UNLIKE),) if len(kinds) > 1 else ()
