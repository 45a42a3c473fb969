"""Trajectories in the forms that people have: TUM, KITTI, EuRoC, matrices, with headings, in any unit of time."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from maslam.backend.geometry import rotation_from_quat_wxyz, se3

from ..errors import FrontendError
from .colmap_poses import NOTE, is_colmap_images, read_colmap_poses
from .headed_table import HeadedTable, is_number, read_headed_table
from .pose_arrays import ARRAY_SUFFIXES, PoseCells, read_pose_cells
from .pose_columns import FORMS, PoseColumns, find_columns, turns_of_angles
from .pose_conventions import AS_DEGREES, ORDERS, in_columns, look_like_degrees, order_note, real_part_first
from .pose_entries import AS_XYZW
from .time_units import NotATime, TimeUnit, parse_times, unit_of_heading
from .trajectory import Trajectory, rigid_rotations
from .two_part_times import TwoParts, stamps_of_parts

Array = NDArray[np.float64]
_QUATERNION_TOLERANCE = 0.05  # of its length: rounded digits are fine, a column mixed up is not
_NO_VALUE = ("", "-", "--", "null", "none", "na", "n/a")
_NAME = re.compile(r"\.(png|jpe?g|bmp|tiff?|pgm|ppm|webp)$", re.IGNORECASE)


@dataclass(frozen=True)
class PoseTable:
    """``poses`` ``(N, 4, 4)`` ``T_W_C``, in the order of the file; ``stamps_ns`` ``(N,)`` their times as they are, or
    None where the file has none; ``rows`` ``(N,)`` of the file, lost ones left out; ``notes``: what to know; ``names``:
    the image of each row as written, or none; ``doubt``: which of the notes is of the times' unit, else empty;
    ``form``: what was read, for people."""

    poses: Array
    stamps_ns: NDArray[np.int64] | None
    rows: NDArray[np.int64]
    count: int
    notes: tuple[str, ...] = ()
    names: tuple[str, ...] = ()
    doubt: str = ""
    form: str = ""

    def in_time(self) -> tuple[Trajectory, tuple[str, ...]]:
        """The poses in order of time, the first of each time kept, and notes that count what was changed.
        ``ValueError`` where the file has no times."""
        if self.stamps_ns is None:
            raise ValueError("no times in this table")
        back = int((np.diff(self.stamps_ns) < 0).sum())
        order = np.argsort(self.stamps_ns, kind="stable")
        stamps = self.stamps_ns[order]
        first = np.diff(stamps, prepend=stamps[:1] - 1) > 0
        notes = [f"time goes back {back} times; the poses are sorted by time"] if back else []
        if not first.all():
            notes.append(f"{int((~first).sum())} of {len(stamps)} poses have the time of another; the first is kept")
        return Trajectory(stamps[first], self.poses[order[first]]), tuple(notes)


def read_poses(path: Path, wxyz: bool = False, unit: TimeUnit | None = None) -> PoseTable:
    """Poses ``T_W_C`` of a text file, or of ``.json``, ``.npy`` or ``.npz`` (:mod:`.pose_arrays`), whose form its
    columns tell: 8 (time, position, quaternion: TUM; also 7, without a time; or the quaternion in front of the
    position), 12 (KITTI: 3x4) or 13 (with a time in front), 16 or 17 (4x4), four lines of four (4x4); with headings any
    columns among which a position and a quaternion, or roll, pitch and yaw, are found by name. Or of COLMAP's
    ``images.txt`` or ``images.bin``.

    The quaternion's order is that of the headings, else ``qx qy qz qw``, or ``qw`` first with ``wxyz``, or the other
    one where rotations follow the path, or start at the identity, in that alone, which is noted. Times are in ``unit``,
    or that which they must be in. Rows that hold NaN, or a quaternion of zeros, are moments without a pose.
    :class:`FrontendError` with the line for anything else that is no pose, and for degrees of latitude and longitude.
    """
    if is_colmap_images(path):
        named, of_images = read_colmap_poses(path)
        return PoseTable(of_images, None, np.arange(len(named)), len(named), (NOTE,), named, form="COLMAP")
    array = path.suffix.lower() in ARRAY_SUFFIXES
    cells = read_pose_cells(path) if array else PoseCells(read_headed_table(path))
    table, names = cells.table, cells.names
    values = _values(path, table)
    lines = table.lines
    if values.shape[1] == 4 and not table.headings:
        values, lines = _matrices(values, lines)
    columns, found = find_columns(f"{path}:{lines[0]}", table.headings, values, wxyz)
    if not names and (columns.time is None or not columns.named):
        names = _image_names(table)
        columns = replace(columns, time=None, parts=None) if names else columns
    known = np.isfinite(values[:, columns.all]).all(axis=1)
    if len(values) == len(table.rows):
        _check_cells(path, table, columns.all, np.flatnonzero(~known))
    if columns.quaternion is not None:
        known &= np.abs(values[:, columns.quaternion]).max(axis=1, initial=0.0) > 0
    rows = np.flatnonzero(known)
    if not len(rows):
        raise FrontendError(f"{path}: no poses in this file")
    notes = [f"{len(values) - len(rows)} of {len(values)} rows hold no pose (NaN or zeros)"] * (len(rows) < len(values))
    stamps, doubt = None, ""
    if columns.time is not None:
        stamps, doubt = _stamps(path, table, columns.time, columns.parts, unit)
        stamps = stamps[rows]
        notes += [doubt] if doubt else []
    values, turned = _by_rows(_in_metres(values, columns), columns)
    found += _unit_notes(columns)
    columns, order = _ordered(values[rows], columns, stamps)
    listed = [note for note in cells.notes if not (order and AS_XYZW in note)]
    said = [*listed, *found, *turned, *order]
    poses = _poses(path, values[rows], columns, [lines[i] for i in rows])
    if look_like_degrees(poses[_order(stamps, len(rows)), :3, 3], None if stamps is None else np.sort(stamps)):
        raise FrontendError(f"{path}: {AS_DEGREES}")
    form = _form(path, columns, values.shape[1])
    return PoseTable(poses, stamps, rows, len(values), (*notes, *said), names, doubt, form)


def _form(path: Path, columns: PoseColumns, width: int) -> str:
    """What the columns were taken for, in words."""
    if path.suffix.lower() in ARRAY_SUFFIXES:
        return f"{path.suffix[1:].lower()} of {'matrices' if columns.matrix else 'positions and rotations'}"
    if columns.matrix:
        return ("KITTI" if width in (12, 13) else "4x4 matrices") + (" with times" if columns.time is not None else "")
    if columns.angles:
        return "positions and angles by name"
    last = columns.quaternion is not None and columns.quaternion[0] == max(columns.quaternion)
    return f"{'columns by name' if columns.named else FORMS.get(width, 'EuRoC')}, {ORDERS[not last]}"


def _by_rows(values: Array, columns: PoseColumns) -> tuple[Array, list[str]]:
    """Rows with their 4x4 matrix row by row, and what to say where the file has it column by column."""
    if len(columns.matrix) != 12 or values.shape[1] != columns.matrix[0] + 16:
        return values, []
    first = columns.matrix[0]
    turned = in_columns(values[:, first:])
    if not turned.any():
        return values, []
    out = values.copy()
    out[turned, first:] = values[turned, first:].reshape(-1, 4, 4).swapaxes(1, 2).reshape(-1, 16)
    return out, ["its matrices stand column by column, and are read so"]


def _in_metres(values: Array, columns: PoseColumns) -> Array:
    """Values with their positions in metres, whatever unit headings name."""
    if all(unit == 1.0 for unit in columns.position_units):
        return values
    out = values.copy()
    out[:, columns.position] *= columns.position_units
    return out


def _unit_notes(columns: PoseColumns) -> list[str]:
    """What to say of positions in another unit than metres."""
    units = {unit for unit in columns.position_units if unit != 1.0}
    shown = ", ".join(f"{unit:g}" for unit in sorted(units))
    return [f"positions are taken in units of {shown} m, as the headings say"] if units else []


def _order(stamps: NDArray[np.int64] | None, count: int) -> NDArray[np.intp]:
    """Rows in order of time."""
    return np.arange(count) if stamps is None else np.argsort(stamps, kind="stable")


def _ordered(values: Array, columns: PoseColumns, stamps: NDArray[np.int64] | None) -> tuple[PoseColumns, list[str]]:
    """The columns with the quaternion's real part where the path says that it is, and what to say of it; headings are
    believed all the same."""
    if columns.quaternion is None:
        return columns, []
    rows = _order(stamps, len(values))
    cells = sorted(columns.quaternion)
    wxyz = columns.quaternion[0] == cells[0]
    positions = values[rows][:, columns.position]
    first, why = real_part_first(values[rows][:, cells], positions, wxyz, columns.named)
    if not why:
        return columns, []
    taken = wxyz if columns.named else first
    ordered = replace(columns, quaternion=cells if taken else [cells[-1], *cells[:-1]])
    return ordered, [order_note(first, why, wxyz, columns.named)]


def _values(path: Path, table: HeadedTable) -> Array:
    """All cells as numbers; what is no number, and a row of another length, is named with its line."""
    if not table.rows:
        raise FrontendError(f"{path}: no poses in this file")
    width = len(table.rows[0])
    for cells, line in zip(table.rows, table.lines, strict=True):
        if len(cells) != width:
            form = FORMS.get(width, "a row")
            raise FrontendError(f"{path}:{line}: {len(cells)} numbers, but the rows before ({form}) have {width}")
    try:
        return np.array(table.rows, dtype=object).astype(np.float64).reshape(-1, width)
    except ValueError:
        return np.array([[_number(cell) for cell in cells] for cells in table.rows])


def _check_cells(path: Path, table: HeadedTable, columns: Sequence[int], rows: NDArray[np.intp]) -> None:
    """:class:`FrontendError` with the line for a cell of a pose that is neither a number nor one of the words for
    none."""
    for row in rows:
        for cell in (table.rows[row][k] for k in columns):
            if not is_number(cell) and cell.strip().lower() not in _NO_VALUE:
                raise FrontendError(f"{path}:{table.lines[row]}: not a number: {cell[:40]!r}")


def _image_names(table: HeadedTable) -> tuple[str, ...]:
    """The cells of the first column that holds names of images, or none."""
    column = next((i for i, cell in enumerate(table.rows[0]) if _NAME.search(cell) and not is_number(cell)), None)
    return () if column is None else tuple(cells[column] for cells in table.rows)


def _matrices(values: Array, lines: list[int]) -> tuple[Array, list[int]]:
    """Lines of four numbers as matrices, one a row, with the line on which each begins: 4x4, or one of 3x4."""
    if len(values) == 3:
        return values.reshape(1, 12), lines[:1]
    if len(values) % 4 == 0 and (values[3::4] == (0.0, 0.0, 0.0, 1.0)).all():
        return values.reshape(-1, 16), lines[::4]
    return values, lines


def _number(cell: str) -> float:
    """A cell that is no number, such as a name or a date, is NaN: it matters only in a column that is used."""
    try:
        return float(cell)
    except ValueError:
        return float("nan")


def _stamps(
    path: Path, table: HeadedTable, column: int, parts: TwoParts | None, unit: TimeUnit | None
) -> tuple[NDArray[np.int64], str]:
    if unit is None and table.headings:
        unit = unit_of_heading(table.headings[column])
    try:
        if parts is not None:
            return stamps_of_parts(table.rows, parts), ""
        times = parse_times([cells[column] for cells in table.rows], unit)
    except NotATime as error:
        written = table.rows[error.index][column][:40]
        raise FrontendError(f"{path}:{table.lines[error.index]}: not a time: {written!r}") from None
    return times.stamps_ns, times.doubt


def _poses(path: Path, values: Array, columns: PoseColumns, lines: Sequence[int]) -> Array:
    if columns.angles:
        return se3(turns_of_angles(values[:, columns.angles] * columns.angle_unit), values[:, columns.position])
    if columns.quaternion is None:
        matrices = values[:, columns.matrix].reshape(-1, 3, 4)
        return se3(rigid_rotations(matrices[:, :, :3], path, lines), matrices[:, :, 3])
    quaternions = values[:, columns.quaternion]
    lengths = np.linalg.norm(quaternions, axis=1)
    for row in np.flatnonzero(np.abs(lengths - 1.0) > _QUATERNION_TOLERANCE)[:1]:
        raise FrontendError(f"{path}:{lines[row]}: the quaternion's length is {lengths[row]:.3f}, expected 1")
    return se3(rotation_from_quat_wxyz(quaternions), values[:, columns.position])
