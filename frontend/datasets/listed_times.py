"""Lists of times beside images, in any of the forms in which people keep them: a column, a table with headings, with
the images' names, with dates."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..errors import FrontendError
from ..files.headed_table import HeadedTable, is_number, read_headed_table
from ..files.time_units import NotATime, is_date, parse_times, unit_of_heading
from ..files.timestamps import NS_PER_S
from .images import IMAGE_SUFFIXES

_TIME_WORDS = ("time", "stamp")
_NAME_WORDS = ("file", "image", "name", "path")
_SECOND_PART = re.compile(r"(nsec|nsecs|nanosec|nanosecs|nanoseconds)\b")
_FIRST_PART = re.compile(r"(sec|secs|seconds)\b")


@dataclass(frozen=True)
class ListedTimes:
    """``stamps_ns`` ``(N,)`` row by row; ``names``: the image of each row as written, or none; ``doubt``: how the unit
    was taken where it is not certain."""

    stamps_ns: NDArray[np.int64]
    names: tuple[str, ...] = ()
    doubt: str = ""


def read_listed_times(path: Path) -> ListedTimes:
    """Times, and image names if there are any; the headings say which column is which, else the content.

    :class:`FrontendError` with the line for a row that has no time.
    """
    table = read_headed_table(path)
    width = len(table.rows[0]) if table.rows else 0
    for cells, line in zip(table.rows, table.lines, strict=True):
        if len(cells) < width:
            raise FrontendError(f"{path}:{line}: {len(cells)} columns, but the rows before have {width}")
    if not table.rows:
        return ListedTimes(np.zeros(0, dtype=np.int64))
    name = _name_column(table)
    names = tuple(cells[name] for cells in table.rows) if name is not None else ()
    first = table.column(lambda h: _FIRST_PART.search(h) is not None and "nano" not in h and "nsec" not in h)
    second = table.column(lambda h: _SECOND_PART.search(h) is not None)
    if first is not None and second is not None:
        return ListedTimes(_in_two_parts(path, table, _column(table, first), _column(table, second)), names)
    column = _time_column(path, table, name)
    unit = unit_of_heading(table.headings[column]) if table.headings else None
    try:
        times = parse_times(_column(table, column), unit)
    except NotATime as error:
        raise _no_time(path, table, error.index) from None
    return ListedTimes(times.stamps_ns, names, times.doubt)


def _no_time(path: Path, table: HeadedTable, row: int) -> FrontendError:
    written = ", ".join(table.rows[row])
    return FrontendError(f"{path}:{table.lines[row]}: not a time: {written[:60]!r}")


def _column(table: HeadedTable, column: int) -> list[str]:
    return [cells[column] for cells in table.rows]


def _in_two_parts(path: Path, table: HeadedTable, seconds: list[str], rest: list[str]) -> NDArray[np.int64]:
    """Whole seconds and nanoseconds in columns of their own, as ROS writes a time."""
    stamps = []
    for row, (one, two) in enumerate(zip(seconds, rest, strict=True)):
        if not (one.isdecimal() and two.isdecimal() and int(one) < 2**33 and int(two) < NS_PER_S):
            raise _no_time(path, table, row)
        stamps.append(int(one) * NS_PER_S + int(two))
    return np.array(stamps, dtype=np.int64)


def _name_column(table: HeadedTable) -> int | None:
    first = table.rows[0]
    for column, cell in enumerate(first):
        if Path(cell).suffix.lower() in IMAGE_SUFFIXES:
            return column
    named = table.column(lambda h: any(word in h for word in _NAME_WORDS))
    return named if named is not None and not is_number(first[named]) else None


def _time_column(path: Path, table: HeadedTable, name: int | None) -> int:
    """The column headed as a time; else the first one of numbers or dates that does not just count the rows."""
    headed = table.column(lambda h: any(word in h for word in _TIME_WORDS) or h.strip() in ("t", "ns", "[ns]"))
    if headed is not None:
        return headed
    usable = [i for i, cell in enumerate(table.rows[0]) if i != name and (is_number(cell) or is_date(cell))]
    if not usable:
        raise _no_time(path, table, 0)
    counting = [i for i in usable if _counts_rows([cells[i] for cells in table.rows])]
    return next((i for i in usable if i not in counting), usable[0])


def _counts_rows(cells: list[str]) -> bool:
    return all(cell.isdecimal() for cell in cells) and len({int(c) - i for i, c in enumerate(cells)}) == 1
