"""Trajectories as other programs write them, in whatever form: TUM, KITTI with or without times, EuRoC, 4x4 matrices.

What a file holds is found from its columns, the unit of its times as that of ground truth; both are said in ``form``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from maslam.backend.geometry import rotation_from_quat_wxyz, se3

from ..errors import FrontendError
from .pose_conventions import AS_DEGREES, in_columns, look_like_degrees, order_note, reads_as_other_order
from .text_tables import read_bytes
from .time_units import NotATime, Times, parse_times, unit_of_heading
from .timestamps import NS_PER_S, seconds_text
from .trajectory import Trajectory, rigid_rotations

_QUATERNION_TOLERANCE = 0.05
_TUM = 8  # numbers a row: time, position, quaternion
_COLUMNS = "8 (TUM: time x y z qx qy qz qw; EuRoC), 12 or 13 (KITTI, with a time), 16 or 17 (4x4 matrix, with a time)"


@dataclass(frozen=True)
class OtherTrajectory:
    """``trajectory``: poses as given, of whatever frame; where the file has no times its stamps are its rows 0, 1, 2 …
    and ``timed`` is False. ``form``: what was read, for people; ``repeated``: rows of a time given before, left out;
    ``lost``: rows without a pose (NaN, a quaternion of zeros), likewise; ``notes``: what to know of the times."""

    trajectory: Trajectory
    form: str
    timed: bool
    repeated: int = 0
    lost: int = 0
    notes: tuple[str, ...] = ()


def read_other_trajectory(path: Path, times: Path | None = None) -> OtherTrajectory:
    """Read ``path``; ``times``: a file with one time a row, for poses without their own.

    :class:`FrontendError` with file and line for a row that is no pose, times that go back, and a file without poses.
    """
    if path.suffix == ".npy":
        values, header = _read_npy(path), ""
        lines, stamps_text = list(range(1, len(values) + 1)), list[str]()
    else:
        stamps_text, values, lines, header = _read_rows(path)
    width, count = values.shape[1], len(values)
    known = _known(values)
    if not known.any():
        raise FrontendError(f"{path}: no poses in this file")
    doubt = ""
    if width in (12, 16):
        timed = times is not None
        form = "KITTI" if width == 12 else "4x4 matrices"
        form += " without times" if times is None else f", times of {times.name}"
        stamps = np.arange(len(values)) if times is None else _times_of(times, count)
        stamps = stamps[known]
    else:
        rows = np.flatnonzero(known)
        read = _stamps(path, [stamps_text[i] for i in rows], [lines[i] for i in rows], header)
        unit = "dates" if read.unit is None else read.unit.name
        stamps, doubt = read.stamps_ns, read.doubt
        form, timed = f"{_name_of(width, header, values)}, times in {unit}", True
        if times is not None:
            raise FrontendError(f"{path}: has times of its own; leave out {times}")
    lines = [lines[i] for i in np.flatnonzero(known)]
    scalar_first, order = _scalar_first(width, header), ""
    if width == _TUM and reads_as_other_order(values[known][:, 4:], values[known][:, 1:4], scalar_first):
        said = _says_order(header)
        order = order_note(scalar_first, said)
        scalar_first = scalar_first if said else not scalar_first
        form = form if said else f"{form}, but {'qw' if scalar_first else 'qx'} first"
    poses = _poses(path, values[known], lines, scalar_first)
    found = _in_order(path, stamps.astype(np.int64), poses, lines, form, timed)
    if look_like_degrees(poses[:, :3, 3], stamps.astype(np.int64) if timed else None):
        raise FrontendError(f"{path}: {AS_DEGREES}")
    notes = tuple(f"{path}: {note}" for note in (doubt, order) if note)
    return replace(found, lost=int((~known).sum()), notes=notes)


def _known(values: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Rows ``(N,)`` that hold a pose, as of ground truth: no NaN, no quaternion of zeros."""
    pose = values[:, values.shape[1] % 4 == 1 :] if values.shape[1] != _TUM else values[:, 1:]
    known = np.isfinite(pose).all(axis=1)
    if values.shape[1] == _TUM:
        known &= np.abs(values[:, 4:]).max(axis=1) > 0
    return np.asarray(known)


def _in_order(
    path: Path, stamps: NDArray[np.int64], poses: NDArray[np.float64], lines: list[int], form: str, timed: bool
) -> OtherTrajectory:
    steps = np.diff(stamps)
    for row in np.flatnonzero(steps < 0)[:1] + 1:
        times = f"from {seconds_text(stamps[row - 1])} s to {seconds_text(stamps[row])} s"
        raise FrontendError(f"{path}:{lines[row]}: time goes back {times}")
    first = np.concatenate([[True], steps > 0])
    return OtherTrajectory(Trajectory(stamps[first], poses[first]), form, timed, int((~first).sum()))


def _read_rows(path: Path) -> tuple[list[str], NDArray[np.float64], list[int], str]:
    """First fields as written, all numbers ``(N, columns)``, line numbers, and the header (lower case, without ``#``).

    Commas, semicolons and blanks separate; lines that start with ``#`` and the words of a first line are a header.
    """
    text = read_bytes(path).removeprefix(b"\xef\xbb\xbf").decode("utf-8", "replace")
    header = ""
    first: list[str] = []
    rows: list[list[float]] = []
    lines: list[int] = []
    commas = False
    for number, line in enumerate(text.splitlines(), 1):
        fields = line.replace(",", " ").replace(";", " ").split()
        if not fields or fields[0].startswith("#"):
            header = header or line.strip("# ").lower()
            continue
        if not rows and not _number(fields[0]):
            header = line.lower()
            continue
        commas |= "," in line
        try:
            values = [float(field) for field in fields]
        except ValueError:
            raise FrontendError(f"{path}:{number}: not a pose: {line.strip()[:60]!r}") from None
        if rows and len(values) != len(rows[0]):
            raise FrontendError(f"{path}:{number}: {len(values)} numbers, but {len(rows[0])} in line {lines[0]}")
        rows.append(values)
        first.append(fields[0])
        lines.append(number)
    if not rows:
        raise FrontendError(f"{path}: no poses in this file")
    euroc = "q_rs" in header or (commas and len(rows[0]) == 17)
    if len(rows[0]) not in (8, 12, 13, 16, 17) and not euroc:
        raise FrontendError(f"{path}:{lines[0]}: {len(rows[0])} numbers a row are no pose; known are {_COLUMNS}")
    values_of = np.array(rows, dtype=np.float64)
    if euroc:  # time, position, quaternion, then velocity and biases
        values_of = values_of[:, :8]
    return first, values_of, lines, f"{'csv ' if commas else ''}{header}"


def _number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def _read_npy(path: Path) -> NDArray[np.float64]:
    """``(N, 4, 4)`` or ``(N, 3, 4)`` without pickle, as rows."""
    try:
        poses = np.load(path, allow_pickle=False)
    except (OSError, ValueError, EOFError) as error:
        raise FrontendError(f"{path}: not an array of poses: {' '.join(str(error).split())}") from error
    if poses.ndim != 3 or poses.shape[1:] not in ((4, 4), (3, 4)) or poses.dtype.kind not in "fiu":
        raise FrontendError(
            f"{path}: {poses.dtype} of shape {poses.shape}; N matrices of numbers, (N, 4, 4), are meant"
        )
    return np.asarray(poses, dtype=np.float64).reshape(len(poses), -1)


def _says_order(header: str) -> bool:
    """Whether the header names the quaternion's real part; otherwise its place is that of the form."""
    return any("q" in name and "w" in name.rpartition("q")[2] for name in header.replace(",", " ").split())


def _scalar_first(width: int, header: str) -> bool:
    """Whether the quaternion's real part comes first: in EuRoC's csv, and where the header says so."""
    if width != 8:
        return False
    names = header.replace("csv ", "").replace(",", " ").split()
    found = [k for k, name in enumerate(names) if "q" in name and ("w" in name.rpartition("q")[2])]
    if found and len(names) >= 8:
        others = [
            k for k, name in enumerate(names) if "q" in name and name.rpartition("q")[2].strip("_rs[]")[:1] in "xyz"
        ]
        return bool(others) and found[0] < min(others)
    return header.startswith("csv ")


def _name_of(width: int, header: str, values: NDArray[np.float64]) -> str:
    if width == 8:
        return "EuRoC (qw first)" if _scalar_first(width, header) else "TUM"
    return "KITTI with times" if width == 13 else "4x4 matrices with times"


def _stamps(path: Path, texts: Sequence[str], lines: Sequence[int], header: str = "") -> Times:
    """Times in the unit that the header or their size or rate tells."""
    named = header.removeprefix("csv ")
    heading = (named.split(",") if "," in named else named.split() or [""])[0]
    try:
        return parse_times(texts, unit_of_heading(heading))
    except NotATime as error:
        raise FrontendError(f"{path}:{lines[error.index]}: not a time: {texts[error.index][:40]!r}") from None


def _times_of(path: Path, count: int) -> NDArray[np.int64]:
    texts, lines = [], []
    for number, line in enumerate(read_bytes(path).decode("utf-8", "replace").lstrip("\ufeff").splitlines(), 1):
        fields = line.replace(",", " ").split()
        if fields and not fields[0].startswith("#"):
            texts.append(fields[0])
            lines.append(number)
            if not _number(fields[0]):
                raise FrontendError(f"{path}:{number}: not a time: {line.strip()[:60]!r}")
    if len(texts) != count:
        raise FrontendError(f"{path}: {len(texts)} times for {count} poses")
    return _stamps(path, texts, lines).stamps_ns


def _poses(path: Path, values: NDArray[np.float64], lines: list[int], scalar_first: bool) -> NDArray[np.float64]:
    if values.shape[1] == 8:
        q = values[:, [4, 5, 6, 7]] if scalar_first else values[:, [7, 4, 5, 6]]
        lengths = np.linalg.norm(q, axis=1)
        for row in np.flatnonzero(np.abs(lengths - 1.0) > _QUATERNION_TOLERANCE)[:1]:
            raise FrontendError(f"{path}:{lines[row]}: the quaternion's length is {lengths[row]:.3f}, expected 1")
        return se3(rotation_from_quat_wxyz(q / lengths[:, None]), values[:, 1:4])
    cells = values[:, values.shape[1] % 4 == 1 :]
    matrices = cells.reshape(len(values), -1, 4)
    if matrices.shape[1] == 4:
        turned = in_columns(cells)
        matrices = np.where(turned[:, None, None], matrices.swapaxes(1, 2), matrices)
    return se3(rigid_rotations(matrices[:, :3, :3], path), matrices[:, :3, 3])


def spacing_ns(stamps_ns: NDArray[np.int64]) -> int:
    """Median time between two poses; a second where there is one only."""
    return int(np.median(np.diff(stamps_ns))) if len(stamps_ns) > 1 else NS_PER_S
