"""Properties of the objects in a MATLAB 5 file, which scipy leaves in their opaque form.

MATLAB writes an object of a class as a reference (an object's number) where it stands, and the properties of all
objects of the file together into an unnamed variable at its end, itself laid out like a MAT-file. MathWorks documents
neither; the layout is as found out by the authors of the matio package (docs/subsystem_data_format.md of its
repository). Only what plain value objects need is read.
"""

from __future__ import annotations

import io
import struct
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import DescriptorError

WORKSPACE = "__function_workspace__"
"""The name scipy gives the unnamed variable."""
_REFERENCE = 0xDD000000
_VERSIONS = (2, 3, 4)
_FIRST_VALUE = 2  # cells before the first property's value
_PROPERTY = 1  # kind of an entry whose number is that of its value; else the number is the value itself
_MAX_ENTRIES = 100_000


class MatlabObjects:
    """The objects of one file: ``properties`` gives those of the object a reference means."""

    def __init__(self, workspace: NDArray[np.uint8]) -> None:
        cells = _cells(np.asarray(workspace, dtype=np.uint8).tobytes())
        head = np.asarray(cells[0]).ravel()
        if head.dtype != np.uint8 or len(head) < 40:
            raise DescriptorError("no table of MATLAB objects where one must stand")
        words = head[: len(head) // 4 * 4].view("<u4").astype(np.int64)
        if words[0] not in _VERSIONS:
            raise DescriptorError(f"MATLAB objects in version {words[0]} of their layout; 2, 3 and 4 are known")
        offsets = words[2:8]
        if (offsets % 4).any() or (np.diff(offsets) < 0).any() or offsets[0] < 40 or offsets[-1] > len(head):
            raise DescriptorError("the table of MATLAB objects is damaged: its parts are not in order")
        names = head[40 : offsets[0]].tobytes().split(b"\0")
        self._names = [name.decode("ascii", "replace") for name in names if name]
        self._saved, self._objects, self._plain = (
            words[start // 4 : end // 4] for start, end in pairwise(offsets[1:5])
        )
        self._cells = cells
        self._defaults = np.asarray(cells[-1], dtype=object).ravel()

    def properties(self, reference: NDArray[Any]) -> dict[str, Any]:
        """Names and values of the properties of one object, its class' defaults where it has no value of its own.

        ``reference``: what stands for the object, the ``arr`` of scipy's ``MatlabOpaque``.
        """
        numbers = np.asarray(reference).ravel()
        if numbers.dtype != np.uint32 or len(numbers) < 5 or numbers[0] != _REFERENCE:
            raise DescriptorError("an object of a MATLAB class that is not referred to as one")
        index = int(numbers[-2])
        entry = self._objects[6 * index : 6 * index + 6]
        if index < 1 or len(entry) < 6:
            raise DescriptorError(f"object {index} is not in the table of MATLAB objects")
        class_id, _, _, saved, plain, _ = (int(number) for number in entry)
        found = self._default_values(class_id)
        # Classes with a saveobj of their own are listed apart, and what it gave is the property "any".
        block = _block(self._saved, saved) if saved else _block(self._plain, plain)
        for name, kind, value in block:
            found[self._name(name)] = self._value(value) if kind == _PROPERTY else bool(value)
        whole = found.get("any")
        return found if whole is None else found | as_fields(whole)

    def _default_values(self, class_id: int) -> dict[str, Any]:
        return as_fields(self._defaults[class_id]) if class_id < len(self._defaults) else {}

    def _name(self, index: int) -> str:
        if not 1 <= index <= len(self._names):
            raise DescriptorError(f"property name {index} of {len(self._names)} in the table of MATLAB objects")
        return self._names[index - 1]

    def _value(self, index: int) -> Any:
        if not 0 <= index < len(self._cells) - _FIRST_VALUE:
            raise DescriptorError(f"property value {index} is not in the table of MATLAB objects")
        return self._cells[index + _FIRST_VALUE]


def as_fields(value: Any) -> dict[str, Any]:
    """The fields of a 1x1 struct as scipy reads it, or nothing."""
    array = np.asarray(value)
    return {name: array.ravel()[0][name] for name in array.dtype.names or ()} if array.size == 1 else {}


def _cells(data: bytes) -> NDArray[Any]:
    """The cells that hold the table and the values: the field MCOS of the first variable in ``data``."""
    from scipy.io import loadmat

    if len(data) < 16 or data[2:4] != b"IM":
        raise DescriptorError("MATLAB objects of a big-endian machine, or damaged")
    kind, size = struct.unpack_from("<II", data, 8)
    if kind != 14 or 16 + size > len(data):
        raise DescriptorError("the MATLAB objects are cut short")
    # What follows the first variable has no name either and would hide it.
    file = b"MATLAB 5.0 MAT-file".ljust(116) + bytes(8) + data[:4] + data[8 : 16 + size]
    found = as_fields(loadmat(io.BytesIO(file)).get(WORKSPACE)).get("MCOS")
    opaque = np.asarray(found).ravel()
    cells = opaque[0]["arr"] if len(opaque) == 1 and "arr" in (opaque.dtype.names or ()) else np.zeros(0)
    cells = np.asarray(cells).ravel()
    if cells.dtype != object or len(cells) < _FIRST_VALUE + 1:
        raise DescriptorError("no MATLAB objects where they must stand")
    return cells


def _block(words: NDArray[np.int64], index: int) -> list[tuple[int, int, int]]:
    """The ``index``-th block of a part of the table: a count, so many (name, kind, value), padded to eight bytes."""
    position = 0
    for k in range(index + 1):
        count = int(words[position]) if position < len(words) else -1
        end = position + 1 + 3 * count
        if not 0 <= count <= _MAX_ENTRIES or end > len(words):
            raise DescriptorError("the table of MATLAB objects is damaged: a list of properties has no end")
        if k == index:
            rows = words[position + 1 : end].reshape(-1, 3)
            return [(int(name), int(kind), int(value)) for name, kind, value in rows]
        position = end + end % 2
    return []
