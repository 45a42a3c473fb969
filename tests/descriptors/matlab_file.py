"""A writer of MATLAB 5 files with objects of classes, which scipy does not write; after matio's description of them."""

from __future__ import annotations

import struct
import zlib
from pathlib import Path
from typing import Any

import numpy as np

_NUMBERS = {"f8": (6, 9), "f4": (7, 7), "u1": (9, 2), "u4": (13, 6), "i4": (12, 5), "b1": (9, 2)}
_MATRIX, _COMPRESSED = 14, 15


class Object:
    """An object of a class: its number among the file's objects and its class' number."""

    def __init__(self, name: str, number: int, class_number: int) -> None:
        self.name, self.number, self.class_number = name, number, class_number


def element(kind: int, data: bytes) -> bytes:
    return struct.pack("<II", kind, len(data)) + data + bytes(-len(data) % 8)


def matrix(value: Any, name: str = "") -> bytes:
    """A data element for an array, a string, a list (cells, a row), a tuple (cells, a column), a dict or an object."""
    if isinstance(value, _Raw):
        return bytes(value)
    title = element(1, name.encode())
    if value is None:
        return element(_MATRIX, b"")
    if isinstance(value, Object):
        reference = np.array([[0xDD000000], [2], [1], [1], [value.number], [value.class_number]], dtype=np.uint32)
        return _opaque(value.name, matrix(reference))
    if isinstance(value, str):
        head = element(6, struct.pack("<II", 4, 0)) + element(5, struct.pack("<ii", 1, len(value)))
        return element(_MATRIX, head + title + element(4, value.encode("utf-16-le")))
    if isinstance(value, list | tuple):
        shape = (len(value), 1) if isinstance(value, tuple) else (1, len(value))
        head = element(6, struct.pack("<II", 1, 0)) + element(5, struct.pack("<ii", *shape))
        return element(_MATRIX, head + title + b"".join(matrix(one) for one in value))
    if isinstance(value, dict):
        head = element(6, struct.pack("<II", 2, 0)) + element(5, struct.pack("<ii", 1, 1))
        names = element(5, struct.pack("<i", 32)) + element(1, b"".join(key.encode().ljust(32, b"\0") for key in value))
        return element(_MATRIX, head + title + names + b"".join(matrix(one) for one in value.values()))
    array = np.atleast_2d(np.asarray(value))
    if array.dtype == object:
        return matrix(list(array.ravel()), name)
    class_number, kind = _NUMBERS[array.dtype.str[1:]]
    head = element(6, struct.pack("<II", class_number, 0)) + element(5, struct.pack(f"<{array.ndim}i", *array.shape))
    return element(_MATRIX, head + title + element(kind, array.tobytes(order="F")))


def _opaque(class_name: str, content: bytes) -> bytes:
    head = element(6, struct.pack("<II", 17, 0)) + element(1, b"")
    return element(_MATRIX, head + element(1, b"MCOS") + element(1, class_name.encode()) + content)


def save(path: Path, name: str, value: Any, workspace: bytes | None) -> Path:
    """One variable, compressed, and what is in its objects as the unnamed one (None: left out)."""
    header = b"MATLAB 5.0 MAT-file, Platform: GLNXA64".ljust(116) + bytes(8) + struct.pack("<H", 0x0100) + b"IM"
    packed = zlib.compress(matrix(value, name))
    body = struct.pack("<II", _COMPRESSED, len(packed)) + packed
    unnamed = b"" if workspace is None else matrix(np.frombuffer(workspace, dtype=np.uint8))
    path.write_bytes(header + body + unnamed)
    return path


def workspace(classes: list[tuple[str, dict[str, Any]]], objects: list[tuple[int, dict[str, Any], bool]]) -> bytes:
    """The properties of all objects. ``classes``: names and default values, numbered from one; ``objects``: class
    number, own values, and whether the class has a saveobj of its own."""
    names: list[str] = []

    def index(name: str) -> int:
        if name not in names:
            names.append(name)
        return names.index(name) + 1

    values: list[Any] = []
    saved, plain = [[0, 0]], [[0, 0]]
    rows = [[0] * 6]
    for class_number, own, has_saveobj in objects:
        own = {"any": own} if has_saveobj else own
        block = [len(own)]
        for key, value in own.items():
            block += [index(key), 1, len(values)]
            values.append(value)
        part = saved if has_saveobj else plain
        part.append(block + [0] * (len(block) % 2))
        numbers = (len(part) - 1, 0) if has_saveobj else (0, len(part) - 1)
        rows.append([class_number, 0, 0, *numbers, len(rows)])
    table = [[0] * 4] + [[0, index(name), 0, 0] for name, _ in classes]
    flat = ([number for row in one for number in row] for one in (table, saved, rows, plain))
    parts = [np.array(one, dtype="<u4").tobytes() for one in flat]
    parts += [bytes(8 * len(rows)), bytes(8), bytes(8)]
    text = b"".join(name.encode() + b"\0" for name in names)
    text += bytes(-len(text) % 8)
    offsets = np.cumsum([40 + len(text), *(len(part) for part in parts)])
    head = struct.pack("<II8I", 4, len(names), *(int(offset) for offset in offsets))
    metadata = np.frombuffer(head + text + b"".join(parts), dtype=np.uint8)[:, None]
    empty: dict[str, Any] = {}
    tail = [tuple([empty] * (len(classes) + 1)), np.zeros((len(classes) + 1, 1), dtype=np.int32)]
    defaults = (empty, *(default for _, default in classes))
    content = matrix({"MCOS": _Raw(_opaque("FileWrapper__", matrix((metadata, None, *values, *tail, defaults))))})
    start = struct.pack("<H", 0x0100) + b"IM" + bytes(4)
    # MATLAB ends with one more unnamed variable, a file of nothing.
    return start + content + matrix(np.frombuffer(start + matrix({"MCOS": None}), dtype=np.uint8))


class _Raw(bytes):
    """A data element that is ready."""
