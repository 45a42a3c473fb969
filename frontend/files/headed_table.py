"""Text tables with or without a heading: cells as text, each row with its line, columns found by their names."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

from .text_tables import read_text

_COMMENTS = ("#", "%", "//")
_DAY = re.compile(r"\d{4}[-/]\d\d[-/]\d\d|\d\d\.\d\d\.\d{4}")
_CLOCK = re.compile(r"\d\d?:\d\d:\d\d")
_DECIMAL_COMMA = re.compile(r"([+-]?\d*),(\d+(?:[eE][+-]?\d+)?)", re.ASCII)
_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?|[+-]?(nan|inf|infinity)", re.ASCII | re.IGNORECASE)


@dataclass(frozen=True)
class HeadedTable:
    """``headings`` in lower case, one a column, or none; ``rows`` of cells; ``lines``: on which each stands, from 1."""

    headings: tuple[str, ...]
    rows: list[list[str]]
    lines: list[int]

    def column(self, matches: Callable[[str], bool]) -> int | None:
        """The first column whose heading matches; None where none does."""
        return next((i for i, heading in enumerate(self.headings) if matches(heading)), None)


def read_headed_table(path: Path) -> HeadedTable:
    """Rows separated by semicolons, commas, tabs or blanks; a date and its time of day are one cell. Commas within
    numbers that others separate are decimal ones.

    The heading is the first row, where no cell of it is a number, or else the last comment before the first row that
    has as many cells. Empty lines and comments (``#``, ``%``, ``//``) are passed over. :class:`FrontendError` for a
    file that cannot be read.
    """
    comment = ""
    rows: list[list[str]] = []
    lines: list[int] = []
    split: Callable[[str], list[str]] | None = None
    for number, raw in enumerate(read_text(path).splitlines(), 1):
        line = raw.strip()
        if not line or line.startswith(_COMMENTS):
            comment = line.lstrip("#%/ ") if line and not rows else comment
            continue
        split = split or _splitter(line)
        rows.append(split(line))
        lines.append(number)
    headings: list[str] = []
    if split is not None and not any(_is_value(cell) for cell in rows[0]):
        headings = rows.pop(0)
        lines.pop(0)
    elif split is not None and comment:
        splits = (split, _splitter(comment))
        headings = next((cells for cells in (one(comment) for one in splits) if len(cells) == len(rows[0])), [])
    return HeadedTable(tuple(cell.lower() for cell in headings), rows, lines)


def is_number(text: str) -> bool:
    """Whether a cell is a number; NaN and infinity, which some write for what is not known, are too."""
    return _NUMBER.fullmatch(text) is not None


def _is_value(cell: str) -> bool:
    return is_number(cell) or bool(_DAY.match(cell) or _CLOCK.match(cell) or re.search(r"\d{3,}", cell))


def decimal_points(cells: list[str]) -> list[str]:
    """Cells with the decimal commas that some countries write as points, of a row that other marks separate."""
    return [cell.replace(",", ".") if _DECIMAL_COMMA.fullmatch(cell) else cell for cell in cells]


def _splitter(line: str) -> Callable[[str], list[str]]:
    cells = line.split()
    commas = [_DECIMAL_COMMA.fullmatch(cell) is not None for cell in cells]
    decimal = len(cells) > 1 and any(commas) and all(map(is_number, decimal_points(cells)))
    mark = ";" if ";" in line else "," if "," in line and not decimal else ""
    if mark == ",":
        return lambda text: _joined(_cells(text, mark))
    if mark:
        return lambda text: _joined(decimal_points(_cells(text, mark)))
    return lambda text: _joined(decimal_points([cell.strip('"') for cell in text.split()]))


def _cells(text: str, mark: str) -> list[str]:
    return [cell.strip().strip('"') for cell in text.rstrip(mark).split(mark)]


def _joined(cells: list[str]) -> list[str]:
    """Cells, a day and the time of day behind it as one."""
    for i, (one, two) in enumerate(pairwise(cells)):
        if len(one) == 10 and _DAY.fullmatch(one) and _CLOCK.match(two):
            return [*cells[:i], f"{one} {two}", *cells[i + 2 :]]
    return cells
