"""What the numbers of a trajectory tell of its conventions: which end of a quaternion is real, and whether positions
are degrees of latitude and longitude."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from maslam.backend.geometry import Array, rotation_from_quat_wxyz

from .timestamps import NS_PER_S

AS_DEGREES = (
    "x and y look like degrees of latitude and longitude (as metres they hardly move); metres are meant: as positions, "
    "put time, lat, lon and alt into gps.csv with a header"
)
OPENGL = np.diag([1.0, -1.0, -1.0, 1.0])
"""OpenGL's camera, y up and looking along -z, in the axes of OpenCV's."""
ORDERS = ("qx qy qz qw", "qw qx qy qz")
"""Of a quaternion: with the real part at the end, in front."""
_ROWS = 3  # of one pose alone nothing is known
_AT_IDENTITY_DEG, _NEAR_IDENTITY_DEG = 2.0, 30.0  # of a first pose: taken for a start there, or doubted
_FEW, _MOST = 8, 400  # steps of a path: fewer tell nothing, more nothing new
_AHEAD, _FAR = 0.05, 0.25
_ASTRAY, _TIMES = 0.03, 10.0
"""A vehicle's or a walker's steps keep one direction in its own axes. By how much of the path they fall short of that
at most, and in the wrong order at least; or, of paths that bend little, at least and how many times as much."""
_TURNED_RAD = 0.3  # of the path's direction: without a bend any order fits
_LITTLE_RAD, _LITTLE_ASTRAY, _MANY_TIMES = 0.03, 2e-4, 20.0
"""Of a path that bends hardly: how much at least, and by how much and how many times as much the wrong order falls
short. It decides only where a start near the identity is in question, too."""
_ALONG = 0.9  # of a step, along the camera's axis: ahead, or backwards
_DEGREE_M = 111_195.0  # of a great circle
_SPEEDS_M_S = (0.3, 150.0)  # of what carries a camera across a map
_CREEPS_M_S = 0.002  # as metres: what is seen to move goes faster
_OFFSET = 30.0  # a place's degrees over the spread about it; metres mostly begin near zero
_GOES_ON = 0.5  # correlation of neighbouring steps of a path; that of noise is negative


def real_part_first(cells: Array, positions: Array, wxyz: bool, named: bool = False) -> tuple[bool, str]:
    """Whether the real part stands in front in quaternions ``cells`` ``(N, 4)`` as written, and what to say where that
    is not what is expected (``wxyz``), or in doubt.

    ``positions`` ``(N, 3)``, in order of time. A body moves ahead along an axis of its own; with the order mixed up its
    steps go any way. Where the path is straight, or says nothing (a camera in a hand), a start at the identity counts,
    unless the order is ``named``, or the camera would go backwards in that order alone. How far poses turn tells
    nothing: it is the same in either order.
    """
    if len(cells) < _ROWS:
        return wxyz, ""
    rows, ahead = _steps(positions)
    if len(rows):
        written = cells[rows]
        read, other = (_astray(_turns(written, order), ahead) for order in (wxyz, not wxyz))
        if contradicts(read, other):
            return not wxyz, f"rotations follow the path as {ORDERS[not wxyz]}, and not as {ORDERS[wxyz]}"
        if contradicts(other, read):
            return wxyz, ""
    if named:
        return wxyz, ""
    turned = np.degrees(2.0 * np.arccos(np.clip(np.abs(cells[0]) / np.linalg.norm(cells[0]), 0.0, 1.0)))
    here, there = (turned[0], turned[3]) if wxyz else (turned[3], turned[0])
    if there >= _NEAR_IDENTITY_DEG:
        return wxyz, ""
    says = f"its first quaternion is {there:.0f} degrees from the identity as {ORDERS[not wxyz]}, {here:.0f} as"
    bends = _by_little_bend(cells, positions, wxyz)
    if bends is not None and bends != wxyz:
        return bends, f"rotations follow the path as {ORDERS[bends]}, and not as {ORDERS[wxyz]}"
    if there < _AT_IDENTITY_DEG and bends is None and not _only_then_backwards(cells, positions, wxyz):
        return not wxyz, f"{says} {ORDERS[wxyz]}"
    return wxyz, f"{says} {ORDERS[wxyz]}, as which it is taken"


def _by_little_bend(cells: Array, positions: Array, wxyz: bool) -> bool | None:
    """Whether the real part stands in front, by a path that bends too little to decide alone; None: it says nothing."""
    rows, ahead = _steps(positions, _LITTLE_RAD)
    if not len(rows):
        return None
    read, other = (_astray(_turns(cells[rows], order), ahead) for order in (wxyz, not wxyz))
    if min(read, other) * _MANY_TIMES >= max(read, other) or max(read, other) < _LITTLE_ASTRAY:
        return None
    return wxyz if read < other else not wxyz


def _only_then_backwards(cells: Array, positions: Array, wxyz: bool) -> bool:
    """Whether a camera would go backwards in the other order, and goes ahead in this one (``wxyz``)."""
    rows, ahead = _steps(positions, 0.0)
    if not len(rows):
        return False
    here, there = (
        float(np.einsum("ni,ni->n", _turns(cells[rows], order)[:, :, 2], ahead).mean()) for order in (wxyz, not wxyz)
    )
    return here > _ALONG and there < -_ALONG


def _turns(cells: Array, wxyz: bool) -> Array:
    """Rotations ``(n, 3, 3)`` of quaternions as written, in one order."""
    return np.asarray(rotation_from_quat_wxyz(cells if wxyz else cells[:, [3, 0, 1, 2]]))


def contradicts(read: float, other: float) -> bool:
    """Whether the path is against one reading of rotations and for another, of each of which :func:`astray` tells."""
    return (read > _FAR and other < _AHEAD) or (read > _ASTRAY and read > _TIMES * other)


def astray(rotations: Array, positions: Array) -> float:
    """By how much of its path (0 to 1) a body with ``rotations`` ``(N, 3, 3)`` and ``positions`` ``(N, 3)``, in order
    of time, falls short of moving ahead along one axis of its own; NaN where the path is straight, or too short."""
    rows, ahead = _steps(positions)
    return _astray(rotations[rows], ahead) if len(rows) else float("nan")


def _steps(positions: Array, least_rad: float = _TURNED_RAD) -> tuple[NDArray[np.intp], Array]:
    """Rows ``(n,)`` from which ``positions`` ``(N, 3)`` move clearly, and the directions ``(n, 3)``; none where the
    path is too short, or its direction never turns by ``least_rad``."""
    nothing = np.zeros(0, dtype=np.intp), np.zeros((0, 3))
    if len(positions) <= _FEW:
        return nothing
    chosen = np.arange(0, len(positions), -(-len(positions) // _MOST))
    steps = np.diff(positions[chosen], axis=0)
    lengths = np.linalg.norm(steps, axis=1)
    moves = lengths > 0.1 * lengths.max(initial=0.0)
    if moves.sum() < _FEW:
        return nothing
    ahead = steps[moves] / lengths[moves, None]
    if float((ahead @ ahead[0]).min()) > np.cos(least_rad):
        return nothing
    return chosen[:-1][moves], ahead


def in_columns(cells: Array) -> NDArray[np.bool_]:
    """Which rows of 16 numbers ``(N, 16)`` are 4x4 matrices column by column, as OpenGL and ARKit write them: the
    bottom row stands last in each column of them, not in the end."""
    bottom = cells[:, [3, 7, 11, 15]]
    return np.asarray((bottom == (0.0, 0.0, 0.0, 1.0)).all(axis=1) & (cells[:, 12:15] != 0.0).any(axis=1))


def order_note(first: bool, why: str, expected: bool, named: bool) -> str:
    """What to say of quaternions whose real part stands in front (``first``) or at the end by what ``why`` says, where
    it was ``expected`` in front or not; an order that a heading has ``named`` is believed."""
    if named:
        return f"{why}, which the heading says and which is taken: is the heading right?"
    if first == expected:
        return f"{why}; a first line '# time tx ty tz {ORDERS[not first]}' says otherwise"
    return f"{why}: they are taken so; a first line '# time tx ty tz {ORDERS[first]}' settles it"


def _astray(rotations: Array, ahead: Array) -> float:
    """What the mean of unit steps ``ahead`` ``(n, 3)``, each in the body's own axes, lacks of length 1."""
    own = np.einsum("nij,ni->nj", rotations, ahead)
    return 1.0 - float(np.linalg.norm(own.mean(axis=0)))


def look_like_degrees(positions: Array, stamps_ns: NDArray[np.int64] | None) -> bool:
    """Whether x and y of ``positions`` ``(N, 3)`` are degrees of latitude and longitude, in either order: as metres
    they creep about a place far from zero, as degrees they go on at a vehicle's or a walker's speed.

    ``stamps_ns`` ``(N,)`` ascending; None: ten positions a second.
    """
    xy = positions[:, :2]
    seconds = np.arange(len(xy)) / 10.0 if stamps_ns is None else (stamps_ns - stamps_ns[:1]) / NS_PER_S
    inside = (np.abs(xy) <= 180).all() and (np.abs(xy) <= 90).all(axis=0).any()
    if not inside or len(xy) <= _FEW or seconds[-1] <= 0:
        return False
    other = np.concatenate([[True], (np.diff(xy, axis=0) != 0).any(axis=1)])
    steps = np.diff(xy[other], axis=0)
    spread = float(np.ptp(xy, axis=0).max())
    if len(steps) < _FEW or float(np.abs(xy.mean(axis=0)).max()) < _OFFSET * spread:
        return False
    goes_on = float((steps[1:] * steps[:-1]).sum()) > _GOES_ON * float((steps**2).sum())
    speed = float(np.linalg.norm(steps, axis=1).sum()) / float(seconds[-1])
    fastest = min(_SPEEDS_M_S[1] / _DEGREE_M, _CREEPS_M_S)
    return goes_on and _SPEEDS_M_S[0] / _DEGREE_M < speed < fastest
