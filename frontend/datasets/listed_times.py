"""Lists of times beside images, in any of the forms in which people keep them: a column, a table with headings, with
the images' names, with dates."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..errors import FrontendError
from ..files.headed_table import HeadedTable, is_number, read_headed_table
from ..files.pose_arrays import ARRAY_SUFFIXES, read_time_cells
from ..files.time_units import (
    UNITS,
    NotATime,
    TimeUnit,
    is_date,
    is_time_of_day,
    is_unix_s,
    parse_times,
    unit_of_heading,
)
from ..files.timestamps import NS_PER_S
from ..files.two_part_times import TwoParts, find_two_parts, stamps_of_parts
from .images import IMAGE_SUFFIXES, natural_key

_TIME_WORDS = ("time", "stamp")
_NAME_WORDS = ("file", "image", "name", "path")
_EVEN = 0.5
"""Share of the unevenness of its steps that another unit of the second column leaves: the right one leaves far less."""


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
    table = read_time_cells(path) if path.suffix.lower() in ARRAY_SUFFIXES else read_headed_table(path)
    width = len(table.rows[0]) if table.rows else 0
    for cells, line in zip(table.rows, table.lines, strict=True):
        if len(cells) < width:
            raise FrontendError(f"{path}:{line}: {len(cells)} columns, but the rows before have {width}")
    if not table.rows:
        return ListedTimes(np.zeros(0, dtype=np.int64))
    name = _name_column(table)
    names = tuple(cells[name] for cells in table.rows) if name is not None else ()
    parts = find_two_parts(table.headings) if table.headings else _parts_by_content(path, table)
    if parts is not None:
        try:
            return in_order(ListedTimes(stamps_of_parts(table.rows, parts), names))
        except NotATime as error:
            raise _no_time(path, table, error.index) from None
    column = _time_column(path, table, name)
    heading = unit_of_heading(table.headings[column]) if column < len(table.headings) else None
    try:
        times = parse_times(_column(table, column), heading)
    except NotATime as error:
        raise _no_time(path, table, error.index) from None
    return in_order(ListedTimes(times.stamps_ns, names, times.doubt))


def in_order(listed: ListedTimes) -> ListedTimes:
    """Rows with names in order of time where all come in reverse, or where the names count in that order too; others
    as they are: whether time really goes back, only their owner knows."""
    stamps = listed.stamps_ns
    order = np.argsort(stamps, kind="stable")
    if not listed.names or (np.diff(stamps) >= 0).all() or len(set(stamps.tolist())) < len(stamps):
        return listed
    names = tuple(listed.names[i] for i in order)
    keys = [natural_key(Path(name).name) for name in names]
    if (np.diff(stamps) < 0).all():
        how = "its rows are in reverse order of time: sorted"
    elif keys == sorted(keys):
        how = f"{int((np.diff(stamps) < 0).sum())} of its {len(stamps)} rows are out of order by their times: sorted"
    else:
        return listed
    return ListedTimes(stamps[order], names, f"{listed.doubt}; {how}" if listed.doubt else how)


def _parts_by_content(path: Path, table: HeadedTable) -> TwoParts | None:
    """Whole seconds and what is beyond them, by what makes the steps even, where the first two whole numbers of a row
    can be nothing else."""
    whole = [i for i in range(len(table.rows[0])) if all(row[i].isdecimal() for row in table.rows)]
    for first, second in pairwise(whole):
        if second == first + 1 and (beyond := _unit_beyond(path, table, first, second)) is not None:
            return TwoParts(first, second, beyond)
    return None


def _unit_beyond(path: Path, table: HeadedTable, first: int, second: int) -> TimeUnit | None:
    """The unit of the second column where both together are a time; :class:`FrontendError` where that is so and the
    unit stays open."""
    seconds = np.array([int(cell) for cell in _column(table, first)], dtype=object)
    beyond = np.array([int(cell) for cell in _column(table, second)], dtype=object)
    steps = np.diff(seconds)
    if not len(steps) or (steps == 0).sum() * 4 < len(steps) or max(beyond) >= NS_PER_S or len(set(beyond)) < 3:
        return None  # a second in which no two images were taken, or a column that only counts
    if not is_unix_s(float(seconds[0])) and (steps < 0).any():
        return None
    known = {}
    for unit in UNITS[1:]:
        if max(beyond) * unit.ns < NS_PER_S:
            apart = np.sort(((seconds - seconds[0]) * NS_PER_S + beyond * unit.ns).astype(np.float64))
            gaps = np.diff(apart)
            known[unit] = float(np.abs(gaps - np.median(gaps)).mean() / max(float(np.median(gaps)), 1.0))
    best = sorted(known, key=lambda unit: known[unit])
    sure = len(best) == 1 or (best and known[best[0]] < _EVEN * known[best[1]])
    if sure and known[best[0]] < 1.0:
        return best[0]
    if not is_unix_s(float(seconds[0])):
        return None
    raise FrontendError(
        f"{path}:{table.lines[0]}: seconds, and in the next column a part of one in a unit that its numbers leave "
        "open; head the columns: sec nsec (or sec usec, or sec msec)"
    )


def _no_time(path: Path, table: HeadedTable, row: int) -> FrontendError:
    written = ", ".join(table.rows[row])
    return FrontendError(f"{path}:{table.lines[row]}: not a time: {written[:60]!r}")


def _column(table: HeadedTable, column: int) -> list[str]:
    return [cells[column] for cells in table.rows]


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
    usable = [
        i
        for i, cell in enumerate(table.rows[0])
        if i != name and (is_number(cell) or is_date(cell) or is_time_of_day(cell))
    ]
    if not usable:
        raise _no_time(path, table, 0)
    counting = [i for i in usable if _counts_rows([cells[i] for cells in table.rows])]
    return next((i for i in usable if i not in counting), usable[0])


def _counts_rows(cells: list[str]) -> bool:
    return all(cell.isdecimal() for cell in cells) and len({int(c) - i for i, c in enumerate(cells)}) == 1
