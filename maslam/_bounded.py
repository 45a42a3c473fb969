"""Files of others, read within bounds: text, YAML, JSON and arrays that are damaged, or made to fill the memory."""

from __future__ import annotations

import json
import zipfile
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from numpy.lib.npyio import NpzFile

_DEEPEST, _ALIASES = 40, 100
_TEXT_BYTES = 64 << 20
_ARRAY_BYTES = 8 << 30
_DENSEST = 1000.0
"""Times as large as its file: no measured numbers are packed so well, but zeros without end are."""
_FREE_BYTES = 64 << 20


class Unreadable(ValueError):
    """What is wrong with a file, in a few words, which the caller puts behind its name."""


def read_text(path: Path, most: int = _TEXT_BYTES) -> str:
    """UTF-8 text without its byte order mark; :class:`Unreadable` for other bytes, with the line, and for more than
    ``most``. ``OSError`` as of any file."""
    if path.stat().st_size > most:
        raise Unreadable(f"{path.stat().st_size >> 20} MiB of text; {most >> 20} MiB are read")
    data = path.read_bytes()
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = data.count(b"\n", 0, error.start) + 1
        raise Unreadable(f"line {line}: not UTF-8 text: byte 0x{data[error.start]:02x}") from error


def check_yaml(text: str) -> None:
    """:class:`Unreadable` where YAML is nested so deep, or refers to itself so often, that reading it would not end."""
    import yaml

    depth = aliases = 0
    anchored: list[bool] = []
    try:
        for event in yaml.parse(text, Loader=yaml.SafeLoader):
            line = event.start_mark.line + 1 if event.start_mark is not None else 0
            if isinstance(event, yaml.CollectionStartEvent):
                depth += 1
                anchored.append(event.anchor is not None)
                if depth > _DEEPEST:
                    raise Unreadable(f"line {line}: nested deeper than {_DEEPEST} levels")
            elif isinstance(event, yaml.CollectionEndEvent):
                depth -= 1
                anchored.pop()
            elif isinstance(event, yaml.AliasEvent):
                aliases += 1
                if any(anchored) or aliases > _ALIASES:
                    raise Unreadable(f"line {line}: *{event.anchor}: references within references are not read")
    except yaml.YAMLError:
        return  # whoever reads it says so


def load_yaml(text: str) -> Any:
    """The content of YAML; :class:`Unreadable` for what is none, or is made to fill the memory."""
    import yaml

    check_yaml(text)
    try:
        return yaml.safe_load(text)
    except (yaml.YAMLError, ValueError, TypeError) as error:  # 2001-99-99 is no date, a list no key
        raise Unreadable(f"not YAML: {' '.join(str(error).split())}") from error


def load_json(text: str) -> Any:
    """The content of JSON; :class:`Unreadable` for what is none, or is nested without end."""
    try:
        return json.loads(text)
    except RecursionError as error:
        raise Unreadable("not JSON: nested too deep") from error
    except ValueError as error:
        raise Unreadable(f"not JSON: {error}") from error


@contextmanager
def open_npz(path: Path) -> Iterator[NpzFile]:
    """The arrays of ``path`` by name; :class:`Unreadable`, also from within the block, for a damaged file and for one
    whose arrays would fill the memory."""
    import numpy as np

    try:
        check_npz(path)
        with np.load(path, allow_pickle=False) as stored:
            if not isinstance(stored, np.lib.npyio.NpzFile):
                raise Unreadable("one array without a name, where several are meant (.npz)")
            yield stored
    except (ValueError, EOFError, KeyError, zipfile.BadZipFile, zlib.error, NotImplementedError, MemoryError) as error:
        if isinstance(error, Unreadable):
            raise
        text = " ".join(str(error).split()) or type(error).__name__
        raise Unreadable(f"damaged, or not such a file: {text}") from error


def check_npz(path: Path) -> None:
    """:class:`Unreadable` where the arrays of an ``.npz`` claim more than anybody stores."""
    size = path.stat().st_size
    if not zipfile.is_zipfile(path):
        raise Unreadable("damaged, or not such a file: not a zip archive")
    with zipfile.ZipFile(path) as archive:
        for entry in archive.infolist():
            with archive.open(entry) as file:
                claimed = max(entry.file_size, _claimed(file))
            if claimed > max(min(_ARRAY_BYTES, _DENSEST * size), _FREE_BYTES):
                raise Unreadable(f"{entry.filename} claims {claimed >> 20} MiB in a file of {size} bytes")


def _claimed(file: Any) -> int:
    """Bytes that an array's head says it has; 0 where there is no such head."""
    from math import prod

    from numpy.lib import format as npy

    try:
        version = npy.read_magic(file)
        shape, _, dtype = (npy.read_array_header_1_0 if version == (1, 0) else npy.read_array_header_2_0)(file)
    except ValueError:
        return 0
    return int(prod(shape) * dtype.itemsize)
