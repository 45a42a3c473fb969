"""Point clouds as other programs write them: PLY, PCD, NPY, KITTI's ``.bin``, and text with x y z first."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..errors import FrontendError
from .text_tables import read_bytes

SUFFIXES = (".ply", ".pcd", ".npy", ".bin", ".xyz", ".txt", ".csv")
_PLY_TYPES = {
    **dict.fromkeys(("char", "int8"), "i1"),
    **dict.fromkeys(("uchar", "uint8"), "u1"),
    **dict.fromkeys(("short", "int16"), "i2"),
    **dict.fromkeys(("ushort", "uint16"), "u2"),
    **dict.fromkeys(("int", "int32"), "i4"),
    **dict.fromkeys(("uint", "uint32"), "u4"),
    **dict.fromkeys(("float", "float32"), "f4"),
    **dict.fromkeys(("double", "float64"), "f8"),
}
_MOST = 200_000_000


def read_cloud(path: Path) -> NDArray[np.float64]:
    """Points ``(N, 3)``, those that are not finite left out; :class:`FrontendError` for a file that is no cloud."""
    content = read_bytes(path)
    readers = {".ply": _ply, ".pcd": _pcd, ".npy": _npy, ".bin": _kitti}
    points = readers.get(path.suffix.lower(), _text)(path, content)
    points = np.asarray(points, dtype=np.float64)
    points = points[np.isfinite(points).all(axis=1)]
    if not len(points):
        raise FrontendError(f"{path}: no points")
    return points


def _ply(path: Path, content: bytes) -> NDArray[np.float64]:
    end = re.search(rb"end_header[ \t]*\r?\n", content[:100_000])
    if not content.startswith(b"ply") or end is None:
        raise FrontendError(f"{path}: not a PLY file")
    lines = [line.split() for line in content[: end.start()].decode("ascii", "replace").splitlines()]
    form = next((words[1] for words in lines if words[:1] == ["format"] and len(words) > 1), "")
    elements = [k for k, words in enumerate(lines) if words[:1] == ["element"]]
    if not elements or lines[elements[0]][1:2] != ["vertex"]:
        raise FrontendError(f"{path}: the first element is not vertex")
    stop = elements[1] if len(elements) > 1 else len(lines)
    properties = [words for words in lines[elements[0] + 1 : stop] if words[:1] == ["property"]]
    try:
        count = int(lines[elements[0]][2])
        types = [(words[2], _PLY_TYPES[words[1]]) for words in properties]
    except (KeyError, IndexError, ValueError):
        raise FrontendError(f"{path}: a header that is not understood") from None
    return _records(path, content[end.end() :], form.replace("binary_big_endian", ">"), types, count)


def _pcd(path: Path, content: bytes) -> NDArray[np.float64]:
    end = re.search(rb"^DATA[ \t]+(\w+)[ \t]*\r?\n", content[:100_000], re.MULTILINE)
    if end is None:
        raise FrontendError(f"{path}: not a PCD file")
    lines = content[: end.start()].decode("ascii", "replace").splitlines()
    head = {words[0]: words[1:] for words in (line.split() for line in lines) if words and words[0][0] != "#"}
    form = end.group(1).decode("ascii")
    if form not in ("ascii", "binary"):
        raise FrontendError(f"{path}: DATA {form} is not read; write it as ascii or binary")
    try:
        kinds = [k.lower() + s for k, s in zip(head["TYPE"], head["SIZE"], strict=True)]
        counts = [int(n) for n in head.get("COUNT", ["1"] * len(kinds))]
        types = [
            (name if n == 1 else f"{name}_{k}", kind)
            for name, kind, n in zip(head["FIELDS"], kinds, counts, strict=True)
            for k in range(n)
        ]
        count = int(head["POINTS"][0]) if "POINTS" in head else int(head["WIDTH"][0]) * int(head["HEIGHT"][0])
    except (KeyError, IndexError, ValueError):
        raise FrontendError(f"{path}: a header that is not understood") from None
    return _records(path, content[end.end() :], "ascii" if form == "ascii" else "<", types, count)


def _records(path: Path, body: bytes, form: str, types: list[tuple[str, str]], count: int) -> NDArray[np.float64]:
    """``x y z`` of ``count`` records with named fields, as text or binary (``<`` or ``>``)."""
    names = [name for name, _ in types]
    if not {"x", "y", "z"} <= set(names) or not 0 <= count <= _MOST:
        raise FrontendError(f"{path}: no x, y and z, or a count that cannot be: {count}")
    if form == "ascii":
        numbers = np.array(body.split()[: count * len(names)])
        if len(numbers) != count * len(names):
            raise FrontendError(f"{path}: {len(numbers) // len(names)} points, its header says {count}: cut off")
        try:
            rows = numbers.astype(np.float64).reshape(count, len(names))
        except ValueError:
            raise FrontendError(f"{path}: a coordinate is no number") from None
        return np.asarray(rows[:, [names.index(axis) for axis in "xyz"]])
    order = ">" if form == ">" else "<"
    try:
        record = np.dtype([(f"{k}_{name}", f"{order}{kind}") for k, (name, kind) in enumerate(types)])
    except TypeError:
        raise FrontendError(f"{path}: a header that is not understood") from None
    if len(body) < count * record.itemsize:
        raise FrontendError(f"{path}: {len(body) // record.itemsize} points, its header says {count}: cut off")
    read = np.frombuffer(body, dtype=record, count=count)
    fields = [f"{names.index(axis)}_{axis}" for axis in "xyz"]
    return np.column_stack([read[name].astype(np.float64) for name in fields])


def _npy(path: Path, content: bytes) -> NDArray[np.float64]:
    try:
        array = np.load(path, allow_pickle=False)
    except (ValueError, EOFError, OSError) as error:
        raise FrontendError(f"{path}: {error}") from error
    if not isinstance(array, np.ndarray) or array.ndim != 2 or array.shape[1] < 3 or array.dtype.kind not in "fiu":
        raise FrontendError(f"{path}: not an array of numbers (N, 3)")
    return np.asarray(array[:, :3], dtype=np.float64)


def _kitti(path: Path, content: bytes) -> NDArray[np.float64]:
    if len(content) % 16:
        raise FrontendError(f"{path}: {len(content)} bytes are no x y z and reflectance of float32: cut off, or other")
    return np.frombuffer(content, dtype="<f4").reshape(-1, 4)[:, :3].astype(np.float64)


def _text(path: Path, content: bytes) -> NDArray[np.float64]:
    rows = []
    for number, line in enumerate(content.removeprefix(b"\xef\xbb\xbf").decode("utf-8", "replace").splitlines(), 1):
        words = line.replace(",", " ").replace(";", " ").split()
        if not words or words[0].startswith(("#", "//")):
            continue
        try:
            rows.append([float(word) for word in words[:3]])
            if len(words) < 3:
                raise ValueError
        except ValueError:
            if not rows and not re.search(r"\d", words[0]):
                continue  # a heading
            raise FrontendError(f"{path}:{number}: not x y z: {line.strip()[:60]!r}") from None
    return np.array(rows, dtype=np.float64).reshape(-1, 3)
