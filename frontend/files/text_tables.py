"""Text tables of numbers: read fast, and an error names the broken line."""

from __future__ import annotations

import codecs
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import FrontendError

_NEWLINE = ord("\n")
_BYTES = [str(value) for value in range(256)]


def read_table(path: Path, columns: int | Sequence[int], what: str) -> NDArray[np.float64]:
    """All rows of a table of numbers separated by blanks, tabs or commas: ``(rows, columns)`` float64.

    ``columns``: the number of columns, or the numbers allowed (all rows alike). Empty lines and lines that start
    with ``#`` are passed over. ``what`` names a row in messages ("a pose has 16 numbers"). Raises
    :class:`FrontendError` with file and line for anything that is not a finite number, and for a row of another
    length. An empty table has as many columns as the first number allowed.
    """
    values, width = _read(path, columns, what, np.float64)
    return values.reshape(-1, width).astype(np.float64, copy=False)


def read_integer_table(path: Path, columns: int | Sequence[int], what: str) -> NDArray[np.int64]:
    """As :func:`read_table` for whole numbers, several times faster; ``1.0`` and ``1e0`` are whole numbers too."""
    values, width = _read(path, columns, what, np.int64)
    whole = np.rint(values)
    if (whole != values).any():
        row = int(np.flatnonzero(whole != values)[0]) // width
        raise FrontendError(f"{path}:{row_line(path, row)}: not a whole number")
    return whole.astype(np.int64).reshape(-1, width)


def _read(path: Path, columns: int | Sequence[int], what: str, dtype: type) -> tuple[NDArray[Any], int]:
    """All numbers in one row, and the number of columns."""
    allowed = (columns,) if isinstance(columns, int) else tuple(columns)
    data = read_text_bytes(path)
    if b"," in data:
        data = data.replace(b",", b" ")
    per_line = _tokens_per_line(data)
    if b"#" in data:
        lines = data.split(b"\n")
        comments = [i for i, line in enumerate(lines) if line.lstrip().startswith(b"#")]
        per_line[comments] = 0
        drop = set(comments)
        data = b"\n".join(line for i, line in enumerate(lines) if i not in drop)
    used = np.flatnonzero(per_line)
    if not len(used):
        return np.zeros(0), allowed[0]
    width = int(per_line[used[0]])
    wrong = used[per_line[used] != width] if width in allowed else used
    if len(wrong):
        expected = " or ".join(str(n) for n in (allowed if width not in allowed else (width,)))
        raise FrontendError(f"{path}:{wrong[0] + 1}: {what} has {expected} numbers, found {per_line[wrong[0]]}")
    values = _parse(data, len(used) * width, dtype)
    if values is None and dtype is not np.float64:
        values = _parse(data, len(used) * width, np.float64)
    if values is None or not np.isfinite(values).all():
        raise _first_bad_number(path)
    return values, width


def read_bytes(path: Path) -> bytes:
    """The whole file, or a :class:`FrontendError` that names it."""
    try:
        return path.read_bytes()
    except OSError as error:
        raise FrontendError(f"{path}: cannot be read: {error.strerror}") from error


def read_text_bytes(path: Path) -> bytes:
    """A text file's bytes as every tool's parser expects them: lines end in one line feed, and there is no byte order
    mark; UTF-16, known by its mark, becomes UTF-8. Errors as :func:`read_bytes`'s."""
    data = read_bytes(path)
    if data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        data = data.decode("utf-16", "replace").encode()
    data = data.removeprefix(codecs.BOM_UTF8)
    return data.replace(b"\r\n", b"\n").replace(b"\r", b"\n") if b"\r" in data else data


def read_text(path: Path) -> str:
    """A text file as :func:`read_text_bytes` gives it, decoded; what is no UTF-8 becomes the replacement character."""
    return read_text_bytes(path).decode("utf-8", "replace")


def row_line(path: Path, row: int) -> int:
    """Line number (from 1) of data row ``row`` (from 0): for messages about a value found wrong after reading."""
    seen = -1
    for number, line in enumerate(read_text_bytes(path).split(b"\n"), 1):
        if line.strip() and not line.lstrip().startswith(b"#"):
            seen += 1
            if seen == row:
                return number
    return 0


def format_floats(rows: NDArray[np.float64]) -> str:
    """One line per row, the shortest digits that give back the same float64."""
    return "".join(" ".join(map(repr, row)) + "\n" for row in np.asarray(rows, dtype=np.float64).tolist())


def format_integers(rows: NDArray[np.integer]) -> str:
    """One line per row of decimal integers."""
    return "".join(" ".join(map(str, row)) + "\n" for row in np.asarray(rows).tolist())


def format_bytes_and_integers(octets: NDArray[np.uint8], integers: NDArray[np.integer]) -> str:
    """One line per row: the bytes of ``octets`` ``(N, a)``, then ``integers`` ``(N, b)``."""
    text = _BYTES.__getitem__
    pairs = zip(octets.tolist(), integers.tolist(), strict=True)
    return "".join(f"{' '.join(map(text, left))} {' '.join(map(str, right))}\n" for left, right in pairs)


def _tokens_per_line(data: bytes) -> NDArray[np.int64]:
    """Number of blank-separated fields on each line."""
    text = np.frombuffer(data, dtype=np.uint8)
    inside = text > ord(" ")
    starts = inside.copy()
    starts[1:] &= ~inside[:-1]
    line_ends = np.flatnonzero(text == _NEWLINE)
    line_of_start = np.searchsorted(line_ends, np.flatnonzero(starts))
    return np.bincount(line_of_start, minlength=len(line_ends) + 1)


def _parse(data: bytes, count: int, dtype: type) -> NDArray[Any] | None:
    """All numbers of ``data``, or None when they are not ``count`` clean numbers."""
    values: NDArray[Any]
    try:
        values = np.fromstring(data, dtype=dtype, sep=" ")
    except (ValueError, DeprecationWarning):  # the warning where warnings are errors: older numpy only warns
        return None
    return values if len(values) == count else None


def _first_bad_number(path: Path) -> FrontendError:
    for number, line in enumerate(read_text_bytes(path).split(b"\n"), 1):
        if line.lstrip().startswith(b"#"):
            continue
        for field in line.replace(b",", b" ").split():
            try:
                value = float(field)
            except ValueError:
                return FrontendError(f"{path}:{number}: not a number: {field.decode('ascii', 'replace')[:40]!r}")
            if not np.isfinite(value):
                return FrontendError(f"{path}:{number}: NaN or infinity in the line")
    return FrontendError(f"{path}: cannot be read as a table of numbers")
