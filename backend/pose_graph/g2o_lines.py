"""Lines of a g2o file: ids and numbers, checked one by one; what is left out or filled in is counted."""

from __future__ import annotations

import re
import zlib
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ..errors import BackendError
from ..geometry import Array, rotation_from_quat_wxyz, se3, so3_exp
from .g2o_landmarks import LandmarkLine, LandmarkLines

_IGNORED = ("#", "PARAMS_")
_NO_OFFSET = [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]
_UPPER = np.triu_indices(6)
# Rows of a planar measurement (x, y, angle) in the tangent of SE(3), translation first.
PLANAR = np.ix_([0, 1, 5], [0, 1, 5])
# Numbers after the name; the second is that of ids among them, the third of those of an information matrix at the end.
_FIELDS = {
    "VERTEX_SE3:QUAT": (8, 1, 0),
    "EDGE_SE3:QUAT": (30, 2, 21),
    "EDGE_SE3_PRIOR": (30, 1, 21),
    "VERTEX_SE2": (4, 1, 0),
    "EDGE_SE2": (11, 2, 6),
    "EDGE_PRIOR_SE2": (10, 1, 6),
}
_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?|[+-]?(nan|inf|infinity)", re.ASCII | re.IGNORECASE)
_ID = re.compile(r"\d{1,20}", re.ASCII)
_LONGEST = 1e12
"""Of a pose's numbers: beyond it metres and millimetres alike are a mistake, and squares lose their digits."""
_HEAVIEST = 1e24
"""Of an information matrix's numbers."""
_UTF16 = (b"\xff\xfe", b"\xfe\xff")
_GZIP, _MOST_BYTES = b"\x1f\x8b", 1 << 30
_LARGEST_ID = (1 << 64) - 1


class G2oLine(NamedTuple):
    """A line that makes sense by itself: ids as written, and the other numbers."""

    file: int
    where: str
    tag: str
    ids: tuple[int, ...]
    values: Array

    @property
    def is_vertex(self) -> bool:
        """Whether it is the pose of a node."""
        return self.tag.startswith("VERTEX")


@dataclass
class Remarks:
    """What a user should know of lines that were read without an error."""

    landmarks: LandmarkLines = field(default_factory=LandmarkLines)
    without_information: Counter[str] = field(default_factory=Counter)
    fixed: list[tuple[int, int, str]] = field(default_factory=list)
    """File, id and place of each vertex that a FIX line pins."""

    def lines(self) -> list[str]:
        """A sentence for each."""
        out = []
        for tag, count in sorted(self.without_information.items()):
            out.append(f"{count} {tag} lines without an information matrix: the identity is taken")
        return out


def read_lines(file: int, path: Path, errors: list[BackendError], remarks: Remarks) -> list[G2oLine]:
    """The lines of ``path``, number ``file`` of a set; what makes no sense goes to ``errors``."""
    out = []
    for where, tag, fields in _split(path):
        try:
            if tag.startswith(_IGNORED):
                _check_parameters(where, tag, fields)
            elif tag == "FIX":
                remarks.fixed += [(file, i, where) for i in _ids(where, fields)]
            elif not remarks.landmarks.take(LandmarkLine(file, where, tag, tuple(fields))):
                out.append(_parsed(file, where, tag, fields, remarks))
        except BackendError as error:
            errors.append(error)
    return out


def _split(path: Path) -> Iterator[tuple[str, str, list[str]]]:
    data = _unpacked(path)
    # PowerShell writes UTF-16; editors on Windows a byte order mark.
    text = data.decode("utf-16" if data.startswith(_UTF16) else "utf-8-sig", errors="replace")
    for number, line in enumerate(text.splitlines(), 1):
        tag, *fields = line.split() or ["#"]
        yield f"{path}:{number}", tag, fields


def _unpacked(path: Path) -> bytes:
    """The file's bytes, unpacked where it is gzip's, whatever its name."""
    try:
        data = path.read_bytes()
    except OSError as error:
        raise BackendError(f"{path}: cannot be read: {error.strerror}") from error
    if not data.startswith(_GZIP):
        return data
    text = b""
    while data:
        unpacker = zlib.decompressobj(wbits=31)
        try:
            text += unpacker.decompress(data, _MOST_BYTES)
        except zlib.error as error:
            raise BackendError(f"{path}: damaged gzip file: {error}") from error
        if unpacker.unconsumed_tail or len(text) > _MOST_BYTES:
            raise BackendError(f"{path}: more than {_MOST_BYTES >> 30} GiB when unpacked")
        if not unpacker.eof:
            raise BackendError(f"{path}: gzip file is cut off")
        data = unpacker.unused_data
    return text


def _check_parameters(where: str, tag: str, fields: list[str]) -> None:
    if tag == "PARAMS_SE3OFFSET" and _numbers(where, fields[1:]).tolist() != _NO_OFFSET:
        if len(fields) != len(_NO_OFFSET) + 1:
            raise BackendError(f"{where}: {tag} has {len(_NO_OFFSET) + 1} fields after its name, found {len(fields)}")
        raise BackendError(f"{where}: a sensor's offset from the node's frame is not supported")


def _parsed(file: int, where: str, tag: str, fields: list[str], remarks: Remarks) -> G2oLine:
    if tag not in _FIELDS:
        raise BackendError(f"{where}: unknown line {tag!r}; known are {', '.join(_FIELDS)}")
    count, ids, information = _FIELDS[tag]
    bare = bool(information) and len(fields) == count - information
    if len(fields) != count and not bare:
        raise BackendError(f"{where}: {tag} has {count} fields after its name, found {len(fields)}")
    named = _ids(where, fields[:ids])
    # g2o's 3-D prior names the sensor's offset after the node; only the node's own frame is known here.
    first = ids + 1 if tag == "EDGE_SE3_PRIOR" else ids
    values = _numbers(where, fields[first:])
    if bare:
        side = {6: 3, 21: 6}[information]
        values = np.concatenate([values, np.eye(side)[np.triu_indices(side)]])
        remarks.without_information[tag] += 1
    _check_sizes(where, values[: len(values) - information], values[len(values) - information :])
    return G2oLine(file, where, tag, named, values)


def _ids(where: str, fields: list[str]) -> tuple[int, ...]:
    for text in fields:
        if not _ID.fullmatch(text):
            raise BackendError(f"{where}: {text!r} is not a node id (a whole number from 0)")
        if int(text) > _LARGEST_ID:
            raise BackendError(f"{where}: {text} is not a node id: it is beyond 64 bits ({_LARGEST_ID})")
    return tuple(map(int, fields))


def _numbers(where: str, fields: list[str]) -> Array:
    for text in fields:
        if not _NUMBER.fullmatch(text):  # Python takes 1_0.5 for a number, and digits of any script
            comma = " (a decimal comma? a point is meant)" if _NUMBER.fullmatch(text.replace(",", ".", 1)) else ""
            raise BackendError(f"{where}: not a number: {text!r}{comma}")
    values = np.array(fields, dtype=np.float64)
    if not np.isfinite(values).all():
        raise BackendError(f"{where}: NaN or infinity in the line")
    return values


def _check_sizes(where: str, pose: Array, information: Array) -> None:
    for what, values, most in (("a pose", pose, _LONGEST), ("an information matrix", information, _HEAVIEST)):
        largest = np.abs(values).max(initial=0.0)
        if largest > most:
            raise BackendError(f"{where}: {largest:.6g} in {what} is beyond {most:g}")


def pose_of(values: Array, where: str) -> Array:
    """The pose of ``x y z qx qy qz qw`` or ``x y angle``."""
    if len(values) == 3:
        return se3(so3_exp([0.0, 0.0, values[2]]), [values[0], values[1], 0.0])
    norm = float(np.linalg.norm(values[3:7]))
    if abs(norm - 1.0) > 0.05:
        raise BackendError(f"{where}: the quaternion's length is {norm:.3f}, expected 1")
    return se3(rotation_from_quat_wxyz(values[[6, 3, 4, 5]]), values[:3])


def measurement_of(values: Array, where: str) -> tuple[Array, Array]:
    """A relative pose and its information, from the numbers after the ids."""
    information = np.eye(6)
    if len(values) == 9:
        a, b, c, d, e, f = values[3:]
        information[PLANAR] = [[a, b, c], [b, d, e], [c, e, f]]
        return pose_of(values[:3], where), information
    information[_UPPER] = values[7:]
    return pose_of(values[:7], where), np.triu(information) + np.triu(information, 1).T
