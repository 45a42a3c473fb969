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
    has as many cells. Words before numbers that are no heading of these are a title, and passed over, and so are empty
    lines and comments (``#``, ``%``, ``//``). :class:`FrontendError` for a file that cannot be read.
    """
    comment = ""
    found: list[tuple[int, str]] = []
    for number, raw in enumerate(read_text(path).splitlines(), 1):
        line = raw.strip()
        if not line or line.startswith(_COMMENTS):
            comment = line.lstrip("#%/ ") if line and not found else comment
        else:
            found.append((number, line))
    headings: list[str] = []
    while len(found) > 1 and _is_title(found[0][1], found[1][1]):
        title = found.pop(0)[1]
        headings = [title] if len(_split(found[0][1])) == 1 else []
    if found and not headings:
        first = _split(found[0][1])
        if not any(map(_is_value, first)):
            headings = first
            found.pop(0)
        elif comment:
            cells = (_splitter(line)(comment) for line in (found[0][1], comment))
            headings = next((one for one in cells if len(one) == len(first)), [])
    split = _splitter(found[0][1]) if found else _split
    rows, lines = [split(line) for _, line in found], [number for number, _ in found]
    return HeadedTable(tuple(cell.lower() for cell in headings), rows, lines)


def _split(line: str) -> list[str]:
    return _splitter(line)(line)


def _is_title(line: str, below: str) -> bool:
    """Whether ``line`` begins with a word and has another number of cells than the numbers ``below``."""
    cells, others = _split(line), _split(below)
    return not _is_value(cells[0]) and len(cells) != len(others) and all(map(is_number, others))


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
