"""Whether rotations of ground truth are those of its images: odometry's turns and steps, each in the camera's own axes,
against those that the truth has."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from maslam.backend.geometry import Array, product, quat_wxyz_from_rotation, rotation_from_quat_wxyz, so3_log

_LEAST = 5  # pairs of frames: fewer agree with anything
_PAIRS, _CLEAR_RAD = 40, 0.05
"""Pairs of frames, evenly over the track, whose turns are compared; from which angle."""
_MOVES = 0.3
"""Of the median step: shorter ones have no direction."""
_UNLIKE, _TIMES_UNLIKE = 0.3, 3.0
"""Difference of turns as a share of them, and of directions in radians, from which they are no drift, and over that of
the other reading."""
_SAME = 0.1
"""Between readings, or axes, that fit equally well: the simpler is named. In a plane an inverted rotation is one from
the other end in other axes; either cure is right there."""
_NEAR_RAD = np.deg2rad(12.0)
"""Between axes along or against the camera's and those found."""
_WAYS = (("right", "left"), ("down", "up"), ("ahead", "behind"))
_USUAL = tuple(
    np.array(rows, dtype=np.float64)
    for rows in (
        ((1, 0, 0), (0, -1, 0), (0, 0, -1)),  # x right, y up, z behind: OpenGL
        ((0, 0, 1), (-1, 0, 0), (0, -1, 0)),  # x ahead, y left, z up: ROS, LiDARs
        ((0, 0, 1), (1, 0, 0), (0, 1, 0)),  # x ahead, y right, z down: aircraft
        ((1, 0, 0), (0, 0, 1), (0, -1, 0)),  # x right, y ahead, z up: survey
    )
)
_OTHER_END = "its rotations are odometry's only with quaternions read from the other end (qw first or last; a heading "
_READINGS = {
    "": "",
    "inverted": "its rotations are odometry's only inverted (R_C_W beside positions in the world): transpose each "
    "rotation, or negate qx, qy, qz, and keep the positions",
    "real part last": _OTHER_END + "names the columns)",
    "real part first": _OTHER_END + "names the columns)",
}


@dataclass(frozen=True, eq=False)
class _Motion:
    """Rotation vectors ``turns`` ``(m, 3)`` and unit ``steps`` ``(k, 3)`` between pairs of frames, in the axes of the
    first of them."""

    turns: Array
    steps: Array

    def unlike(self, other: _Motion, R_B_C: Array) -> float:
        """Median difference of the turns as a share of them, or of the steps in radians, whichever is larger, of
        ``other`` turned into the camera's axes, which are ``R_B_C`` ``(3, 3)`` in its own."""
        shares = [0.0]
        for a, b in ((self.turns, other.turns), (self.steps, other.steps)):
            if len(a):
                size = float(np.median(np.linalg.norm(a, axis=1)))
                shares.append(float(np.median(np.linalg.norm(a - product(b, R_B_C), axis=1))) / size)
        return max(shares)

    def axes(self, other: _Motion) -> tuple[Array, float]:
        """The camera's axes in those of ``other`` ``(3, 3)``, ``R_B_C``, that make it this motion, the camera's own and
        usual ones first, and how unlike it still is."""
        size = float(np.median(np.linalg.norm(self.turns, axis=1))) if len(self.turns) else 1.0
        a, b = (np.vstack([one.turns / size, one.steps]) for one in (self, other))
        left, _, right = np.linalg.svd(product(b.T, a))
        R_B_C = product(product(left, np.diag([1.0, 1.0, np.linalg.det(product(left, right))])), right)
        tried = [np.eye(3), *_USUAL, *_squared(R_B_C), R_B_C]
        unlike = [self.unlike(other, one) for one in tried]
        k = next(k for k, value in enumerate(unlike) if value <= min(unlike) + _SAME)
        return tried[k], unlike[k]


def rotations_fault(estimate: Array, truth: Array) -> str:
    """What is wrong with the rotations of ``truth`` ``(n, 4, 4)`` ``T_W_C``, whose positions fit odometry's
    ``estimate`` of the same frames, with the cure: they are inverted, read from the other end, or of other axes than
    the camera's. Empty where nothing is wrong, where no such change makes them odometry's, and where neither turns nor
    steps tell."""
    rows, apart = _pairs(len(estimate))
    seen = _motion(estimate, rows, apart)
    clear = np.linalg.norm(seen.turns, axis=1) > _CLEAR_RAD
    moves = _moves(estimate, rows, apart) & _moves(truth, rows, apart)
    clear, moves = (one if one.sum() >= _LEAST else np.zeros(len(rows), dtype=bool) for one in (clear, moves))
    if not clear.any() and not moves.any():
        return ""
    seen = _Motion(seen.turns[clear], seen.steps[moves])
    as_read = 0.0
    found: dict[str, tuple[Array, float]] = {}
    for name, rotations in _readings(truth).items():
        poses = truth.copy()
        poses[:, :3, :3] = rotations
        whole = _motion(poses, rows, apart)
        own = _Motion(whole.turns[clear], whole.steps[moves])
        found[name] = seen.axes(own)
        as_read = seen.unlike(own, np.eye(3)) if not name else as_read
    best = min(unlike for _, unlike in found.values())
    near = [name for name in found if found[name][1] <= best + _SAME]
    name = min(near, key=lambda one: bool(one) and not np.array_equal(found[one][0], np.eye(3)))
    R_B_C, unlike = found[name]
    if as_read < _UNLIKE or unlike > _UNLIKE or as_read < _TIMES_UNLIKE * unlike:
        return ""
    return "; and ".join(text for text in (_READINGS[name], _axes_text(R_B_C)) if text)


def _pairs(count: int) -> tuple[NDArray[np.intp], int]:
    """The first frame of each pair, and how far apart they are."""
    apart = max(1, count // _PAIRS)
    return np.arange(0, count - apart, max(1, apart // 2)), apart


def _motion(poses: Array, rows: NDArray[np.intp], apart: int) -> _Motion:
    """Turns ``(m, 3)`` and unit steps ``(m, 3)`` from each of ``rows`` to the frame so far ``apart``; steps of no
    length are zeros."""
    back = np.swapaxes(poses[rows, :3, :3], 1, 2)
    steps = np.einsum("nij,nj->ni", back, poses[rows + apart, :3, 3] - poses[rows, :3, 3])
    lengths = np.linalg.norm(steps, axis=1)
    return _Motion(so3_log(product(back, poses[rows + apart, :3, :3])), steps / np.maximum(lengths, 1e-12)[:, None])


def _moves(poses: Array, rows: NDArray[np.intp], apart: int) -> NDArray[np.bool_]:
    """Between which pairs the camera moves clearly."""
    lengths = np.linalg.norm(poses[rows + apart, :3, 3] - poses[rows, :3, 3], axis=1)
    return np.asarray((lengths > _MOVES * np.median(lengths)) & (lengths > 1e-9))


def _readings(truth: Array) -> dict[str, Array]:
    """Rotations ``(n, 3, 3)`` as they are, and as they would be if something is wrong that people do."""
    read = truth[:, :3, :3]
    q = quat_wxyz_from_rotation(read)
    last, first = (rotation_from_quat_wxyz(np.roll(q, shift, axis=1)) for shift in (1, -1))
    return {"": read, "inverted": np.swapaxes(read, 1, 2), "real part last": last, "real part first": first}


def _squared(R: Array) -> list[Array]:
    """The axes along or against others that ``R`` ``(3, 3)`` nearly is, if there are such."""
    left, _, right = np.linalg.svd(np.where(np.abs(R) == np.abs(R).max(axis=1, keepdims=True), np.sign(R), 0.0))
    square = np.rint(product(left, right))
    near = np.linalg.det(square) > 0.5 and np.linalg.norm(so3_log((square.T @ R)[None])) < _NEAR_RAD
    return [square] if near else []


def _axes_text(R_B_C: Array) -> str:
    """What to do about axes ``R_B_C`` ``(3, 3)``, the camera's in those of the truth; empty where they are alike."""
    if np.array_equal(R_B_C, np.eye(3)):
        return ""
    if np.array_equal(R_B_C, np.rint(R_B_C)):
        ways = [_WAYS[int(np.abs(row).argmax())][int(row.sum() < 0)] for row in R_B_C]
        what = f"its axes are x {ways[0]}, y {ways[1]}, z {ways[2]}"
        what += " (OpenGL's camera)" if np.array_equal(R_B_C, _USUAL[0]) else ""
    else:
        angle = float(np.rad2deg(np.linalg.norm(so3_log(R_B_C[None]))))
        what = f"its axes are turned by {angle:.0f} degrees"
    rows = ", ".join("[" + ", ".join(f"{v + 0.0:.3g}" for v in row) + "]" for row in R_B_C)
    return f"{what}, where a camera's are x right, y down, z ahead: multiply each rotation from the right by [{rows}]"
