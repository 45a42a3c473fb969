"""The keys of a calibration file, each checked when it is read."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from maslam.backend.geometry import is_se3, se3

from ...errors import FrontendError

_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?", re.ASCII)
_NOT_FINITE = re.compile(r"[+-]?\.?(inf|nan|infinity)", re.IGNORECASE)
_TRUE = ("1", "true", "yes", "on")
_FISHEYE_FLAGS = ("fisheye_model", "fisheye", "is_fisheye")
_MAX_SIZE = 1_000_000  # pixels along a side: no image is so large


class Fields:
    """The keys of one calibration file. Each access checks the value; a wrong one raises :class:`FrontendError`, naming
    file and key."""

    def __init__(self, data: dict[str, Any], path: Path, prefix: str = "") -> None:
        self.data, self.path, self.prefix = data, path, prefix

    def __contains__(self, key: str) -> bool:
        return self.data.get(key) is not None

    def fail(self, key: str, expected: str) -> FrontendError:
        """The error that ``expected`` is missing at ``key``, to be raised."""
        found = repr(self.data.get(key))
        return FrontendError(f"{self.path}: {self.prefix}{key}: {expected} expected, found {found[:60]}")

    def first(self, *keys: str) -> str:
        """The first of the ``keys`` that the file has; the first of all where it has none."""
        return next((key for key in keys if key in self), keys[0])

    def number(self, key: str, default: float | None = None) -> float:
        """A finite number; ``default`` where the key is absent, an error without one."""
        if default is not None and key not in self:
            return default
        value = _as_number(self.data.get(key))
        if value is None:
            raise self.fail(key, "a number")
        if not np.isfinite(value):
            raise self.fail(key, "a finite number")
        return value

    def numbers(self, key: str, count: int | None = None) -> tuple[float, ...]:
        """A list, a nested list, or the ``data`` of a matrix."""
        value = self.data.get(key)
        value = value.get("data") if isinstance(value, dict) else value
        flat = _flat(value) if isinstance(value, list) else None
        if flat is None:
            raise self.fail(key, "a list of numbers" if count is None else f"{count} finite numbers")
        if not np.isfinite(flat).all() or (count is not None and len(flat) != count):
            raise self.fail(key, "finite numbers" if count is None else f"{count} finite numbers")
        return tuple(flat)

    def text(self, key: str) -> str:
        """The value at ``key`` as text; empty where the key is absent."""
        value = self.data.get(key)
        return "" if value is None else str(value).strip()

    def flag(self, key: str) -> bool:
        """Whether the value at ``key`` says yes; no where the key is absent."""
        return self.text(key).lower() in _TRUE

    @property
    def says_fisheye(self) -> bool:
        """Whether one of the flags that programs write beside a matrix names OpenCV's fisheye."""
        flags = (key for key in _FISHEYE_FLAGS if isinstance(self.data.get(key), str | int | float | bool))
        return any(self.flag(key) for key in flags)

    def inner(self, key: str) -> Fields:
        """The group of keys at ``key``."""
        if not isinstance(self.data.get(key), dict):
            raise self.fail(key, "a group of keys")
        return Fields(self.data[key], self.path, f"{self.prefix}{key}.")

    def listed(self, key: str) -> list[Fields]:
        """The groups of keys in the list at ``key``."""
        value = self.data.get(key)
        if not isinstance(value, list) or not all(isinstance(one, dict) for one in value):
            raise self.fail(key, "a list of groups of keys")
        return [Fields(one, self.path, f"{self.prefix}{key}[{i}].") for i, one in enumerate(value)]

    def size(self, width: str, height: str) -> tuple[int, int] | None:
        """``(width, height)`` pixels under these two keys; None where both are absent."""
        if width not in self and height not in self:
            return None
        return self._pixels(width), self._pixels(height)

    def resolution(self, key: str) -> tuple[int, int] | None:
        """``(width, height)`` pixels in a list under one key; None where it is absent."""
        if key not in self:
            return None
        width, height = (self._whole(key, value) for value in self.numbers(key, 2))
        return width, height

    def _pixels(self, key: str) -> int:
        return self._whole(key, self.number(key))

    def _whole(self, key: str, value: float) -> int:
        if value != int(value) or not 0 < value <= _MAX_SIZE:
            raise self.fail(key, "a whole number of pixels")
        return int(value)

    def transform(self, key: str) -> NDArray[np.float64]:
        """A rigid transform ``(4, 4)``, of its 16 numbers or the first 12."""
        values = self.numbers(key)
        if len(values) not in (12, 16):
            raise self.fail(key, "a rigid 4x4 transform, of 16 finite numbers,")
        matrix = np.array([*values[:12], *(values[12:] or (0.0, 0.0, 0.0, 1.0))]).reshape(4, 4)
        if not is_se3(matrix, 1e-3):
            raise self.fail(key, "a rigid 4x4 transform")
        return matrix

    def turned_and_moved(self, rotation: str, position: str) -> NDArray[np.float64]:
        """A rigid transform ``(4, 4)`` of a rotation's 9 numbers under one key and 3 numbers under another."""
        matrix = se3(np.array(self.numbers(rotation, 9)).reshape(3, 3), self.numbers(position, 3))
        if not is_se3(matrix, 1e-3):
            raise self.fail(rotation, "a rotation matrix")
        return matrix


def _as_number(value: object) -> float | None:
    """A number, or the text of one as every language writes it: no underscore, no colon, no leading 0 of another
    base."""
    if isinstance(value, bool):
        return None
    if isinstance(value, int | float):
        return float(value) if abs(value) < 1e300 else float("inf")
    text = value.strip() if isinstance(value, str) else ""
    if _NUMBER.fullmatch(text):
        return float(text)
    return float(text.replace(".", "")) if _NOT_FINITE.fullmatch(text) else None


def _flat(values: list[Any]) -> list[float] | None:
    """All numbers of a nested list, row by row; None where something else is in it."""
    flat: list[float] = []
    for value in values:
        part = _flat(value) if isinstance(value, list) else [_as_number(value)]
        if part is None or None in part:
            return None
        flat += [one for one in part if one is not None]
    return flat
