"""Arrays and JSON that hold poses or times, as rows of the tables that text files have."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import FrontendError
from .headed_table import HeadedTable, is_number
from .text_tables import read_text

ARRAY_SUFFIXES = (".json", ".npy")
_MOST = 50_000_000  # characters of JSON
_LISTS = ("poses", "frames", "trajectory", "times", "timestamps", "stamps")
_MATRICES = ("pose", "matrix", "transform", "transform_matrix", "T_W_C", "T_wc", "c2w", "camera_to_world", "cam2world")
_NAMES = ("name", "file", "file_name", "filename", "file_path", "image", "image_name", "image_path", "path")
_TIMES = ("time", "timestamp", "stamp", "t", "timestamp_ns", "time_ns", "timestamp_us", "timestamp_ms", "time_s")
_POSES_MEANT = "a list of 4x4 matrices T_W_C, or one by each image's name, is read; or lines time tx ty tz qx qy qz qw"
_TIMES_MEANT = "a list of times, or one by each image's name, is read"


def read_pose_cells(path: Path) -> tuple[HeadedTable, tuple[str, ...]]:
    """Poses of ``.npy`` (N matrices, or N rows as in a text file) or ``.json`` (N matrices in a list, by the images'
    names, or in entries with names or times; or one matrix) as a table, row k counted as line k + 1, and the images'
    names or none. :class:`FrontendError` for anything else."""
    if path.suffix.lower() == ".npy":
        array = _array(path)
        if array.ndim not in (2, 3) or (array.ndim == 3 and array.shape[1:] not in ((4, 4), (3, 4))):
            raise FrontendError(f"{path}: numbers of shape {array.shape}; N matrices, (N, 4, 4), are meant")
        if array.shape in ((4, 4), (3, 4)):
            array = array[None]
        return _table([[repr(v) for v in row] for row in array.reshape(len(array), -1).tolist()]), ()
    entries = _entries(path)
    if len(entries) in (3, 4) and all(len(_flat(entry)) == 4 for _, entry in entries):
        return _table([[cell for _, row in entries for cell in _flat(row)]]), ()
    names, times, rows = [], [], []
    for name, entry in entries:
        matrix, own = entry, name
        if isinstance(entry, Mapping):
            matrix = _first(entry, _MATRICES)
            own = name or str(_first(entry, _NAMES) or "")
            times += [str(time)] if (time := _first(entry, _TIMES)) is not None else []
        cells = _flat(matrix)
        if len(cells) not in (12, 16):
            raise FrontendError(f"{path}: poses in a form that is not read; {_POSES_MEANT}")
        names += [own] if own else []
        rows.append(cells)
    timed = len(times) == len(rows)
    rows = [[time, *row] for time, row in zip(times, rows, strict=True)] if timed else rows
    return _table(rows), () if timed or len(names) != len(rows) else tuple(names)


def read_time_cells(path: Path) -> HeadedTable:
    """Times of ``.npy`` (N numbers) or ``.json`` (N in a list, by the images' names, or in entries with them) as a
    table. :class:`FrontendError` for anything else."""
    if path.suffix.lower() == ".npy":
        array = _array(path)
        if array.ndim != 1:
            raise FrontendError(f"{path}: numbers of shape {array.shape}; N times are meant")
        return _table([[repr(v)] for v in array.tolist()])
    rows, heading = [], "time"
    for name, entry in _entries(path):
        own, time = name, entry
        if isinstance(entry, Mapping):
            heading = next((key for key in _TIMES if key in entry), heading)
            own, time = name or str(_first(entry, _NAMES) or ""), _first(entry, _TIMES)
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


def _entries(path: Path) -> list[tuple[str, Any]]:
    """Entries of a list, or of an object by their names, numbers as they are written."""
    text = read_text(path)
    if len(text) > _MOST:
        raise FrontendError(f"{path}: {len(text)} characters of JSON; {_MOST} are read")
    try:
        data = json.loads(text, parse_float=str, parse_int=str, parse_constant=str)
    except RecursionError:
        raise FrontendError(f"{path}: not JSON: nested too deep") from None
    except ValueError as error:
        raise FrontendError(f"{path}: not JSON: {error}") from None
    if isinstance(data, Mapping):
        inside = next((data[key] for key in _LISTS if isinstance(data.get(key), list | dict)), data)
        data = inside
    if isinstance(data, Mapping):
        return [(str(key), value) for key, value in data.items()]
    return [("", value) for value in data] if isinstance(data, list) else []


def _first(entry: Mapping[str, Any], keys: Sequence[str]) -> Any:
    return next((entry[key] for key in keys if key in entry), None)


def _flat(matrix: Any) -> list[str]:
    """The cells of a matrix row by row, of lists or of lists of lists; none of anything else."""
    if not isinstance(matrix, list):
        return []
    cells = [cell for row in matrix for cell in (row if isinstance(row, list) else [row])]
    return cells if all(isinstance(cell, str) and is_number(cell.replace("-Inf", "-inf")) for cell in cells) else []
