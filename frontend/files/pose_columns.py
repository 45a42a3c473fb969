"""Which columns of a table of poses are the time, the position and the rotation: by headings, or by their number and
content. Angles have an order and a unit, which headings or the path must tell."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from maslam.backend.geometry import product, so3_exp

from ..errors import FrontendError
from .pose_conventions import astray, contradicts
from .position_units import length_unit, without_length_unit
from .two_part_times import TwoParts, find_two_parts

Array = NDArray[np.float64]
FORMS = {
    7: "positions and quaternions",
    8: "TUM",
    12: "KITTI",
    13: "KITTI with times",
    16: "4x4",
    17: "4x4 with times",
}
_AXES = ("x", "y", "z")
_ANGLES = ("roll", "pitch", "yaw")
_UNIT_LENGTH = 0.05  # of a quaternion: rounded digits are fine
_SOME, _MOST = 0.5, 0.9  # of the rows, by which a form is known; the others are broken
_IDENTITY = 0.999  # of a quaternion's real part, at the begin of a path
_ANGLES_CURE = (
    "a first line '# time x y z roll_deg pitch_deg yaw_deg' (or roll_rad …; without time too) says that they are turns "
    "about x, y, z: R = Rz(yaw) Ry(pitch) Rx(roll)"
)


@dataclass(frozen=True)
class PoseColumns:
    """Column of the time, or its two ``parts``; those of the position, with metres in one unit of each where that is
    not 1, and the quaternion (w x y z), of a row-major matrix, or of roll, pitch and yaw ``angles`` with their
    ``angle_unit`` in radians; whether they were ``named`` by headings."""

    time: int | None = None
    position: tuple[int, ...] = ()
    quaternion: list[int] | None = None
    matrix: tuple[int, ...] = ()
    angles: tuple[int, ...] = ()
    angle_unit: float = 1.0
    named: bool = False
    position_units: tuple[float, ...] = (1.0, 1.0, 1.0)
    parts: TwoParts | None = None

    @property
    def all(self) -> list[int]:
        """Those that make a pose."""
        return [*self.position, *(self.quaternion or ()), *self.matrix, *self.angles]


def find_columns(where: str, headings: Sequence[str], values: Array, wxyz: bool) -> tuple[PoseColumns, list[str]]:
    """The columns of ``values`` ``(n, width)``, and what to say of them. ``wxyz``: without headings the quaternion's
    real part comes first. ``where``: file and line of the first row, for :class:`FrontendError`."""
    width = values.shape[1]
    named = _named_columns(headings) if len(headings) == width else None
    if named is not None:
        return named, []
    if len(headings) == width:
        turned = _named_angles(where, headings, values)
        if turned is not None:
            return turned
        if _is_planar(headings):
            raise FrontendError(
                f"{where}: x, y and an angle, of a plane, are not read: write time x y z roll_deg pitch_deg yaw_deg, "
                "with z, roll and pitch of 0"
            )
    timed = width in (8, 13, 17) or (wxyz and width > 8)
    first = int(timed)
    if width in (7, 8) or (wxyz and width == 17):
        if width in (7, 8) and not _are_quaternions(values[:, first + 3 : first + 7]):
            return _other_seven(where, values, first)
        quaternion = [first + 3 + i for i in ((0, 1, 2, 3) if wxyz else (3, 0, 1, 2))]
        return PoseColumns(0 if timed else None, (first, first + 1, first + 2), quaternion), []
    if width == 17 and _is_euroc(values):
        order = "a time, a position, qw qx qy qz, and what is not used (EuRoC's columns)"
        return PoseColumns(0, (1, 2, 3), [4, 5, 6, 7]), [f"its 17 columns are taken as {order}"]
    if width in (12, 13, 16, 17):
        return PoseColumns(0 if timed else None, matrix=tuple(range(first, first + 12))), []
    if width == 6:
        raise FrontendError(f"{where}: 6 columns: a position and three angles? {_ANGLES_CURE}")
    forms = ", ".join(f"{n} ({form})" for n, form in FORMS.items())
    what = "positions without rotations" if width in (3, 4) else "no form of poses that is known"
    raise FrontendError(f"{where}: {width} columns: {what}; known are {forms}, or headings")


def _is_euroc(values: Array) -> bool:
    """Whether rows of 17 numbers are no time and matrix, whose bottom row would be known, but have a quaternion."""
    bottoms = (values[:, 13:17], values[:, [4, 8, 12, 16]])
    matrices = any((bottom == (0.0, 0.0, 0.0, 1.0)).all(axis=1).mean() >= _SOME for bottom in bottoms)
    return not matrices and _are_quaternions(values[:, 4:8])


def _are_quaternions(cells: Array) -> bool:
    """Whether at least half of the rows ``(n, 4)`` have length 1; those without a pose do not count."""
    lengths = np.linalg.norm(cells, axis=1)
    lengths = lengths[np.isfinite(lengths) & (lengths > 0)]
    return not len(lengths) or bool((np.abs(lengths - 1.0) <= _UNIT_LENGTH).mean() >= _SOME)


def _other_seven(where: str, values: Array, first: int) -> tuple[PoseColumns, list[str]]:
    """Columns of seven numbers behind ``first`` that end in no quaternion: it may stand in front, or there is none."""
    front = values[:, first : first + 4]
    lengths = np.linalg.norm(front, axis=1)
    known = np.isfinite(lengths) & (lengths > 0)
    if known.any() and (np.abs(lengths[known] - 1.0) <= _UNIT_LENGTH).mean() >= _MOST:
        last = (np.abs(front[known, 3]) > _IDENTITY).any() and not (np.abs(front[known, 0]) > _IDENTITY).any()
        quaternion = [first + i for i in ((3, 0, 1, 2) if last else (0, 1, 2, 3))]
        order = "qx qy qz qw" if last else "qw qx qy qz"
        columns = PoseColumns(0 if first else None, (first + 4, first + 5, first + 6), quaternion)
        time = "time " if first else ""
        return columns, [
            f"its quaternions stand in front of the positions, and are taken as {order}; a first line '# {time}{order} "
            "tx ty tz' settles it"
        ]
    if not first and (np.diff(values[np.isfinite(values[:, 0]), 0]) > 0).all() and len(values) > 1:
        raise FrontendError(
            f"{where}: 7 columns, the last four no quaternion (of length {_median_length(values[:, 3:]):.3g}): a "
            f"time, a position and three angles? {_ANGLES_CURE}"
        )
    raise FrontendError(
        f"{where}: {values.shape[1]} columns, of which neither the last four nor those in front are a quaternion (the "
        f"last four's length is {_median_length(values[:, first + 3 : first + 7]):.3g}, 1 is meant): a first line with "
        "the columns' names (# time tx ty tz qx qy qz qw) says what they are"
    )


def _median_length(cells: Array) -> float:
    return float(np.nanmedian(np.linalg.norm(cells, axis=1)))


def _named_columns(headings: Sequence[str]) -> PoseColumns | None:
    """By headings such as ``timestamp tx ty tz qx qy qz qw`` or EuRoC's ``p_RS_R_x [m]``, ``q_RS_w []``."""
    bare = _bare(headings)
    position = _position(bare)
    turn = [
        _find(bare, rf"(q_?|quat_?|q_.*_|orientation[_.]?|.*orientation[_.]|.*rotation[_.]|rot_?){axis}")
        for axis in ("w", *_AXES)
    ]
    if None in position or None in turn:
        return None
    at = tuple(i for i in position if i is not None)
    return PoseColumns(quaternion=[i for i in turn if i is not None], named=True, **_time_and_place(headings, bare, at))


def _named_angles(where: str, headings: Sequence[str], values: Array) -> tuple[PoseColumns, list[str]] | None:
    """By headings such as ``time x y z roll_deg pitch_deg yaw_deg``; None where there are none."""
    bare = _bare(headings)
    position = _position(bare)
    turn = [
        _find(bare, rf"(.*[_.])?{angle}(_?(deg|degrees?|rad|radians?))?|{angle[0]}(_?(deg|rad))") for angle in _ANGLES
    ]
    if None in position or None in turn:
        return None
    angles, at = tuple(i for i in turn if i is not None), tuple(i for i in position if i is not None)
    unit, why = _angle_unit(where, [headings[i] for i in angles], values[:, at], values[:, angles])
    named = "degrees" if unit != 1.0 else "radians"
    note = f"roll, pitch and yaw are taken in {named}{why}, R = Rz(yaw) Ry(pitch) Rx(roll)"
    columns = PoseColumns(angles=angles, angle_unit=unit, named=True, **_time_and_place(headings, bare, at))
    return columns, [note]


def _is_planar(headings: Sequence[str]) -> bool:
    """Whether a position in a plane and its angle are named."""
    bare = _bare(headings)
    x, y, z = _position(bare)
    angle = _find(bare, r"(.*[_.])?(theta|yaw|heading|phi|angle)(_?(deg|degrees?|rad|radians?))?")
    return None not in (x, y, angle) and z is None


def _angle_unit(where: str, headings: Sequence[str], positions: Array, angles: Array) -> tuple[float, str]:
    """Radians in one unit of the angles, and what tells it: the headings, their size, or the path."""
    text = " ".join(headings)
    degrees = np.pi / 180.0
    if re.search(r"deg|°", text):
        return degrees, ""
    if re.search(r"rad", text):
        return 1.0, ""
    known = np.isfinite(angles).all(axis=1) & np.isfinite(positions).all(axis=1)
    if not known.any() or np.abs(angles[known]).max() > 2.0 * np.pi + 1e-6:
        return degrees, " by their size"
    in_radians, in_degrees = (astray(turns_of_angles(angles[known] * one), positions[known]) for one in (1.0, degrees))
    if contradicts(in_degrees, in_radians):
        return 1.0, " by the path"
    if contradicts(in_radians, in_degrees):
        return degrees, " by the path"
    raise FrontendError(
        f"{where}: roll, pitch and yaw in degrees or in radians? None is above {np.abs(angles[known]).max():.3g}; name "
        "the columns roll_deg, pitch_deg, yaw_deg, or roll_rad …"
    )


def turns_of_angles(angles: Array) -> Array:
    """Rotations ``(n, 3, 3)`` of roll, pitch, yaw ``(n, 3)`` in radians: ``Rz(yaw) Ry(pitch) Rx(roll)``."""
    x, y, z = (so3_exp(angles[:, k, None] * np.eye(3)[k]) for k in range(3))
    return np.asarray(product(product(z, y), x))


def _time_and_place(headings: Sequence[str], bare: Sequence[str], position: tuple[int, ...]) -> dict[str, Any]:
    """The fields of :class:`PoseColumns` that are of the time and the ``position``, with the units of the headings."""
    parts = find_two_parts(headings)
    units = tuple(length_unit(headings[i]) or 1.0 for i in position)
    return {
        "time": _time(bare) if parts is None else parts.seconds,
        "parts": parts,
        "position": position,
        "position_units": units,
    }


def _bare(headings: Sequence[str]) -> list[str]:
    return [re.sub(r"[\[(].*?[\])]", "", heading).strip().replace("-", "_") for heading in headings]


def _position(bare: Sequence[str]) -> list[int | None]:
    bare = [without_length_unit(heading) for heading in bare]
    return [
        _find(bare, rf"(t_?|p_?|pos_?|position[_.]?|p_.*_|.*position[_.]|.*translation[_.])?{axis}") for axis in _AXES
    ]


def _time(bare: Sequence[str]) -> int | None:
    named = ("t", "ts", "ns", "sec")
    return next((i for i, one in enumerate(bare) if "time" in one or "stamp" in one or one in named), None)


def _find(headings: Sequence[str], pattern: str) -> int | None:
    return next((i for i, heading in enumerate(headings) if re.fullmatch(pattern, heading)), None)
