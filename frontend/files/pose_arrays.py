"""Arrays and JSON that hold poses or times, as rows of the tables that text files have."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import FrontendError
from .headed_table import HeadedTable, is_number
from .pose_archives import cells_of_arrays, has_columns, read_archive, read_times_archive, rows_of_array
from .pose_entries import NAME_KEYS, POSES_MEANT, TIME_KEYS, first_of, flat_cells, in_opencv, pose_of_entry
from .text_tables import read_text

ARRAY_SUFFIXES = (".json", ".npy", ".npz")
_MOST = 50_000_000  # characters of JSON
_LISTS = ("poses", "frames", "trajectory", "times", "timestamps", "stamps")
_TIMES_MEANT = "a list of times, or one by each image's name, is read"


@dataclass(frozen=True)
class PoseCells:
    """Poses as a ``table``, row k counted as line k + 1; ``names`` of their images, or their numbers, or none;
    ``notes``: what to know."""

    table: HeadedTable
    names: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()


def read_pose_cells(path: Path) -> PoseCells:
    """Poses of ``.npy`` (N matrices, or N rows as in a text file), ``.npz`` (:mod:`.pose_archives`) or ``.json`` (N
    matrices in a list, by the images' names, or in entries of :mod:`.pose_entries`; or one matrix).
    :class:`FrontendError` for anything else."""
    suffix = path.suffix.lower()
    if suffix == ".npy":
        return PoseCells(_table([[repr(v) for v in row] for row in rows_of_array(path, _array(path)).tolist()]))
    data = None if suffix == ".npz" else _loaded(path)
    columns = _columns(data)
    if data is None or has_columns(columns):
        rows, names, notes = read_archive(path) if data is None else cells_of_arrays(path, columns)
        return PoseCells(_table(rows), names, notes)
    entries = _entries(data)
    if len(entries) in (3, 4) and all(len(flat_cells(entry)) == 4 for _, entry in entries):
        return PoseCells(_table([[cell for _, row in entries for cell in flat_cells(row)]]))
    read = [pose_of_entry(f"{path}: pose {k + 1}", name, entry) for k, (name, entry) in enumerate(entries)]
    if isinstance(data, Mapping) and _LISTS[1] in data:
        read = [in_opencv(one, str(data.get("applied_scale", "1"))) for one in read]
    if len({(one.headings, len(one.cells)) for one in read}) > 1:
        raise FrontendError(f"{path}: poses in several forms; {POSES_MEANT}")
    timed, named = (bool(read) and all(getattr(one, what) for one in read) for what in ("time", "name"))
    headings = (*(("time",) if timed and read[0].headings else ()), *(read[0].headings if read else ()))
    table = _table([[one.time, *one.cells] if timed else list(one.cells) for one in read])
    notes = tuple(dict.fromkeys(note for one in read for note in one.notes))
    names = tuple(one.name for one in read) if named and not timed else ()
    return PoseCells(HeadedTable(headings, table.rows, table.lines), names, notes)


def read_time_cells(path: Path) -> HeadedTable:
    """Times of ``.npy`` or ``.npz`` (N numbers) or ``.json`` (N in a list, by the images' names, or in entries with
    them) as a table. :class:`FrontendError` for anything else."""
    if path.suffix.lower() in (".npy", ".npz"):
        array = _array(path) if path.suffix.lower() == ".npy" else read_times_archive(path)
        if array.ndim != 1:
            raise FrontendError(f"{path}: numbers of shape {array.shape}; N times are meant")
        return _table([[repr(v)] for v in array.tolist()])
    rows, heading = [], "time"
    for name, entry in _entries(_loaded(path)):
        own, time = name, entry
        if isinstance(entry, Mapping):
            heading = next((key for key in TIME_KEYS if key in entry), heading)
            own, time = name or str(first_of(entry, NAME_KEYS) or ""), first_of(entry, TIME_KEYS)
        if not isinstance(time, str):
            raise FrontendError(f"{path}: times in a form that is not read; {_TIMES_MEANT}")
        rows.append([own, time] if own else [time])
    if len({len(row) for row in rows}) > 1:
        raise FrontendError(f"{path}: some times have a name and others none; {_TIMES_MEANT}")
    table = _table(rows)
    headings = (("name",) if rows and len(rows[0]) > 1 else ()) + (heading,)
    return HeadedTable(headings, table.rows, table.lines)


def _table(rows: list[list[str]]) -> HeadedTable:
    return HeadedTable((), rows, list(range(1, len(rows) + 1)))


def _array(path: Path) -> np.ndarray[Any, Any]:
    try:
        array = np.load(path, allow_pickle=False)
    except (OSError, ValueError, EOFError, MemoryError) as error:
        raise FrontendError(f"{path}: not an array of numbers: {' '.join(str(error).split())}") from error
    if not isinstance(array, np.ndarray) or array.dtype.kind not in "fiu":
        raise FrontendError(f"{path}: not an array of numbers")
    return array


def _loaded(path: Path) -> Any:
    """The content of JSON, its numbers as they are written."""
    text = read_text(path)
    if len(text) > _MOST:
        raise FrontendError(f"{path}: {len(text)} characters of JSON; {_MOST} are read")
    try:
        return json.loads(text, parse_float=str, parse_int=str, parse_constant=str)
    except RecursionError:
        raise FrontendError(f"{path}: not JSON: nested too deep") from None
    except ValueError as error:
        raise FrontendError(f"{path}: not JSON: {error}") from None


def _entries(data: Any) -> list[tuple[str, Any]]:
    """Entries of a list, or of an object by their names, numbers as they are written."""
    if isinstance(data, Mapping):
        inside = next((data[key] for key in _LISTS if isinstance(data.get(key), list | dict)), data)
        data = inside
    if isinstance(data, Mapping):
        return [(str(key), value) for key, value in data.items()]
    return [("", value) for value in data] if isinstance(data, list) else []


def _columns(data: Any) -> dict[str, np.ndarray[Any, Any]]:
    """Lists of an object that are arrays of numbers or texts: poses, times and names side by side."""
    out = {}
    for key, value in data.items() if isinstance(data, Mapping) else ():
        if not isinstance(value, list) or not value:
            continue
        if all(isinstance(cell, str) for cell in value):
            whole = all(cell.lstrip("-").isdecimal() and len(cell) < 19 for cell in value)
            number = all(map(is_number, value))
            out[key] = np.array(value, dtype=np.int64 if whole else np.float64 if number else np.str_)
        elif len(cells := {len(flat_cells(row)) for row in value}) == 1 and cells != {0}:
            array = np.array([[float(cell) for cell in flat_cells(row)] for row in value])
            nested = isinstance(value[0][0], list) and array.shape[1] in (9, 12, 16)
            out[key] = array.reshape(len(value), len(value[0]), -1) if nested else array
    return out
