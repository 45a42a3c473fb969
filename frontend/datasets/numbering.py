"""Images numbered by their names: which numbers are missing, and what time a number stands for."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

_REGULAR = 0.5
"""Share of steps from name to name that must be the usual one: other numbers are a choice, in which nothing is
missing."""


@dataclass(frozen=True)
class MissingImages:
    """``count`` images missing after frame ``after`` of the sequence; ``first``, ``last``: what their names would be,
    without suffix."""

    after: int
    first: str
    last: str
    count: int

    def __str__(self) -> str:
        return self.first if self.count == 1 else f"{self.first} to {self.last}"


def missing_images(stems: Sequence[str]) -> tuple[MissingImages, ...]:
    """The holes in the numbers of names that are otherwise numbered in equal steps, from wherever; none where names
    have no numbers, or other text beside them, or no usual step."""
    numbers, step = numbered_steps(stems)
    if not step:
        return ()
    prefix, digits, suffix = _parts(stems[0])
    width = len(digits) if len({len(stem) for stem in stems}) == 1 else 0

    def name(number: int) -> str:
        return f"{prefix}{number:0{width}d}{suffix}"

    return tuple(
        MissingImages(i, name(before + step), name(after - step), (after - before) // step - 1)
        for i, (before, after) in enumerate(zip(numbers[:-1].tolist(), numbers[1:].tolist(), strict=True))
        if after - before > step
    )


def numbered_steps(stems: Sequence[str]) -> tuple[NDArray[np.int64], int]:
    """Numbers ``(N,)`` of the names, and their usual step; 0 where they are not numbered in such steps."""
    numbers = numbers_of(stems)
    nothing = np.zeros(0, dtype=np.int64), 0
    if numbers is None or len(numbers) < 3:
        return nothing
    steps = np.diff(numbers)
    step, often = Counter(steps.tolist()).most_common(1)[0]
    regular = step > 0 and often > _REGULAR * len(steps) and (steps > 0).all() and not (steps % step).any()
    return (numbers, step) if regular else nothing


def numbers_of(stems: Sequence[str]) -> NDArray[np.int64] | None:
    """The last number ``(N,)`` in each name, where all names are alike but for it; else None."""
    parts = [_parts(stem) for stem in stems]
    if not parts or not parts[0][1] or len({(prefix, suffix) for prefix, _, suffix in parts}) > 1:
        return None
    if max(len(digits) for _, digits, _ in parts) > 18:
        return None
    return np.array([int(digits) for _, digits, _ in parts], dtype=np.int64)


def _parts(stem: str) -> tuple[str, str, str]:
    """What stands before its last number, the number's digits, and what stands after it."""
    found = re.fullmatch(r"(.*?)(\d+)(\D*)", stem, re.DOTALL)
    return (found[1], found[2], found[3]) if found else (stem, "", "")
