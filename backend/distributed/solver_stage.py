"""Stages of the solvers that work in rounds: the numbers that travel in each, and which of these cannot be."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from enum import IntEnum

import numpy as np

from ..errors import BackendError
from ..geometry import Array


class SolverStage(IntEnum):
    """Unknowns that a sweep works on, in this order."""

    START = 0
    SCALE = 1
    ROTATION = 2
    POSE = 3
    FREE = 4
    VOTE = 5
    DESCENT = 6
    TWO_LEVEL = 7
    COST = 8


# Numbers that one separator pose costs each sweep.
WIDTH = {
    SolverStage.START: 6,
    SolverStage.SCALE: 1,
    SolverStage.ROTATION: 9,
    SolverStage.POSE: 6,
    SolverStage.VOTE: 9,
    SolverStage.DESCENT: 6,
    SolverStage.FREE: 6,
    SolverStage.TWO_LEVEL: 0,
    SolverStage.COST: 0,
}


_WITH_UNIT = (SolverStage.START, SolverStage.POSE, SolverStage.FREE, SolverStage.DESCENT)


def width_of(stage: SolverStage, scaled: bool) -> int:
    """Numbers of a separator; ``scaled``: with one more for its unit of length."""
    return WIDTH[stage] + (scaled and stage in _WITH_UNIT)


@dataclass(frozen=True, order=True)
class Round:
    """One synchronous round: a sweep of a stage; ``step`` counts Gauss-Newton steps, or changes of weights."""

    stage: SolverStage
    step: int = 0
    sweep: int = 0


def number_type(stage: SolverStage) -> str:
    """Format of the numbers in :class:`Values`: single precision for block descent, which sends steps afterwards, else
    double."""
    return "<f4" if stage in (SolverStage.VOTE, SolverStage.DESCENT, SolverStage.FREE) else "<f8"


def as_sent(numbers: Iterable[float]) -> tuple[float, ...]:
    """``numbers`` as the receiver reads them: single precision."""
    return tuple(float(np.float32(x)) for x in numbers)


# More sums than any method needs are a mistake.
_MOST_SUMS = 64
# A vote collects what every two robots say of each other.
_MOST_IN_A_VOTE = 1 << 22


def check_rows(values: Array, stage: SolverStage) -> None:
    """:class:`BackendError` for rows of a width that the stage has not, or with infinity; NaN: no estimate yet."""
    if values.size and values.shape[1] not in (width_of(stage, False), width_of(stage, True)):
        raise BackendError(f"rows of {values.shape[1]} numbers, not {WIDTH[stage]}")
    if np.isinf(values).any():
        raise BackendError("an infinite value")


def check_sums(numbers: tuple[float, ...], stage: SolverStage) -> None:
    """:class:`BackendError` for more sums than a stage needs, or such as are not finite."""
    most = _MOST_IN_A_VOTE if stage is SolverStage.VOTE else _MOST_SUMS
    if len(numbers) > most or not np.isfinite(numbers).all():
        raise BackendError(f"{len(numbers)} sums: more than {most}, or not finite")
