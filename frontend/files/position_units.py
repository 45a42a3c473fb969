"""Columns of positions in metres and degrees, whatever units their headings or sizes tell."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

_LENGTHS = {
    **dict.fromkeys(("m", "metre", "metres", "meter", "meters"), 1.0),
    **dict.fromkeys(("mm", "millimetres", "millimeters"), 1e-3),
    **dict.fromkeys(("cm", "centimetres", "centimeters"), 1e-2),
    **dict.fromkeys(("km", "kilometres", "kilometers"), 1e3),
    **dict.fromkeys(("ft", "feet"), 0.3048),
}
_BEHIND = re.compile(rf"(?<=[a-z])[_ .]({'|'.join(_LENGTHS)})$")
_ANGLES = {"rad": 180.0 / np.pi, "rads": 180.0 / np.pi, "radians": 180.0 / np.pi, "1e7": 1e-7, "e7": 1e-7}
_PLACE = ("lat", "lon")
_AS_THEY_ARE = ("hdop", "known", "status", "quality")
_BEYOND_DEGREES, _MOST = 1e5, 1.8e9
"""Whole numbers above the first, up to the second, are degrees times 10^7: a few metres off zero already."""


def in_metres_and_degrees(
    columns: Mapping[str, Sequence[str]], headings: Mapping[str, str]
) -> tuple[dict[str, NDArray[np.float64]], list[str]]:
    """The numbers of ``columns`` by their names, in metres, square metres and degrees, by the units that their
    ``headings`` name; and what was taken by the numbers alone: latitude and longitude as whole numbers of 10^-7
    degrees, as flight controllers log them, which go with altitudes in whole millimetres."""
    numbers = {name: np.array([float(text) for text in texts]) for name, texts in columns.items()}
    factors = {name: _factor(name, headings.get(name, "")) for name in numbers}
    notes = []
    if _whole_e7(columns, numbers) and all(factors[name] is None for name in _PLACE):
        factors |= dict.fromkeys(_PLACE, _ANGLES["e7"])
        notes.append("latitude and longitude are taken as degrees times 1e7, by their size")
        if "alt" in numbers and factors["alt"] is None and _whole(columns["alt"]):
            factors["alt"] = _LENGTHS["mm"]
            notes.append(
                "altitudes, whole numbers beside them, are taken as millimetres; a heading 'alt [m]' says else"
            )
    return {name: values * (factors[name] or 1.0) for name, values in numbers.items()}, notes


def _factor(name: str, heading: str) -> float | None:
    """What a column is multiplied by, as its heading says; None where it says nothing."""
    if name in _AS_THEY_ARE:
        return None
    words = [word for word in re.split(r"[^a-z0-9]+", heading.lower()) if word]
    if name in _PLACE:
        if words and words[-1].endswith("e7"):
            return _ANGLES["e7"]
        return next((_ANGLES[word] for word in reversed(words[1:]) if word in _ANGLES), None)
    factor = _length_unit(words)
    return factor**2 if factor is not None and name.startswith("variance") else factor


def length_unit(heading: str) -> float | None:
    """Metres in the unit of length that a heading names: ``x [mm]``, ``pos_y_cm``; None where it names none."""
    return _length_unit([word for word in re.split(r"[^a-z0-9]+", heading.lower()) if word][1:])


def without_length_unit(heading: str) -> str:
    """The heading without the unit of length behind it: ``x_mm`` is ``x``."""
    return _BEHIND.sub("", heading)


def _length_unit(words: Sequence[str]) -> float | None:
    return next((_LENGTHS[word.rstrip("2")] for word in reversed(words) if word.rstrip("2") in _LENGTHS), None)


def _whole(texts: Sequence[str]) -> bool:
    return all(re.fullmatch(r"[+-]?\d+(\.0*)?", text) for text in texts)


def _whole_e7(columns: Mapping[str, Sequence[str]], numbers: Mapping[str, NDArray[np.float64]]) -> bool:
    if not set(_PLACE) <= set(numbers) or not all(_whole(columns[name]) for name in _PLACE):
        return False
    largest = max(float(np.abs(numbers[name]).max()) for name in _PLACE)
    return _BEYOND_DEGREES < largest <= _MOST
