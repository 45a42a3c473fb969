"""What rectification left of a rig's calibration error, as a model linear in its parameters.

The first camera's lens keeps a little radial and tangential distortion (``k1 k2 p1 p2``). The right camera of a stereo
pair differs from it by a small turn (``wx wy wz``), by its principal point (``cx cy``) and by its lens (``q1 q2``
tangential, ``m1`` radial). A lone camera estimates
``k1`` only. All are displacements in the image of what an ideal pair would see; they are functions of
where a point was *measured*, so that an ideal position is the measured one minus ``basis @ parameters``, exactly.

Not among them: focal lengths, the baseline and the first camera's principal point. A car that drives straight on shows
nothing of these: another focal length stretches its world along the road, and drift would be made up for by them.

Parameters are in pixels: angles and coefficients times ``fx`` (:func:`physical` divides). A turn about y, a shift of
the principal point and ``q2`` look much alike over a narrow image and may all be large while their sum is small: so
the prior is on the displacement, not on the parameters (:func:`prior_information`).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from maslam._kernels import kernel
from maslam.backend.geometry import product

from .linear_algebra import solve_symmetric, weighted_gram

Array = NDArray[np.float64]
LENS = ("k1", "k2", "p1", "p2")
RIGHT = ("wx", "wy", "wz", "cx", "cy", "q1", "q2", "m1")
N_RADIAL, N_LENS, N_ALL = 1, len(LENS), len(LENS) + len(RIGHT)
"""Counts of leading parameters: a lone camera's, one lens's, a pair's."""
_DRIFT = 0.02
"""Standard deviation of what a calibration may change from key-frame to key-frame, as a share of its prior's. Windows
overlap, so their information is counted more than once: this also keeps an early estimate from lasting for ever."""
_GRID = 15
_REWEIGHTED = 5


class CalibrationEstimate(NamedTuple):
    """The parameters as a normal distribution: ``mean`` ``(C,)``, pixels, and ``information`` ``(C, C)``, its inverse
    covariance."""

    mean: Array
    information: Array


@kernel
def _lens(x: float, y: float, out: Array) -> None:
    """Rows u, v of the lens's displacement at normalised ``x, y``, written into ``out`` ``(2, 4)``."""
    r2 = x * x + y * y
    out[0, 0], out[0, 1], out[0, 2], out[0, 3] = x * r2, x * r2 * r2, 2.0 * x * y, r2 + 2.0 * x * x
    out[1, 0], out[1, 1], out[1, 2], out[1, 3] = y * r2, y * r2 * r2, r2 + 2.0 * y * y, 2.0 * x * y


@kernel
def _right(x: float, y: float, out: Array) -> None:
    """Rows u, v of what the right camera has beyond the lens, written into ``out`` ``(2, 8)``."""
    r2 = x * x + y * y
    out[0, 0], out[0, 1], out[0, 2], out[0, 3], out[0, 4] = -x * y, 1.0 + x * x, -y, 1.0, 0.0
    out[1, 0], out[1, 1], out[1, 2], out[1, 3], out[1, 4] = -(1.0 + y * y), x * y, x, 0.0, 1.0
    out[0, 5], out[0, 6], out[0, 7] = 2.0 * x * y, r2 + 2.0 * x * x, x * r2
    out[1, 5], out[1, 6], out[1, 7] = r2 + 2.0 * y * y, 2.0 * x * y, y * r2


@kernel
def basis(uv: Array, disparity: Array, cam: Array, count: int) -> Array:
    """``(n, 4, count)``: what the parameters add to u, v, disparity and row difference (right minus left) measured at
    ``uv`` ``(n, 2)``; the last two are zero where the disparity is NaN, or with the lens's parameters alone."""
    out = np.zeros((len(uv), 4, count))
    left, moved, right = np.zeros((2, N_LENS)), np.zeros((2, N_LENS)), np.zeros((2, N_ALL - N_LENS))
    for i in range(len(uv)):
        x, y = (uv[i, 0] - cam[2]) / cam[0], (uv[i, 1] - cam[3]) / cam[1]
        _lens(x, y, left)
        for k in range(min(N_LENS, count)):
            out[i, 0, k], out[i, 1, k] = left[0, k], left[1, k]
        if count <= N_LENS or np.isnan(disparity[i]):
            continue
        x_right = x - disparity[i] / cam[0]
        _lens(x_right, y, moved)
        _right(x_right, y, right)
        for k in range(N_LENS):
            out[i, 2, k], out[i, 3, k] = left[0, k] - moved[0, k], moved[1, k] - left[1, k]
        for k in range(count - N_LENS):
            out[i, 2, N_LENS + k], out[i, 3, N_LENS + k] = -right[0, k], right[1, k]
    return out


def undistort(uv: Array, cam: Array, parameters: Array) -> Array:
    """Ideal pinhole positions ``(n, 2)``, pixels, of those measured at ``uv`` ``(n, 2)`` by the first camera."""
    return uv - lens_shift(uv, cam, parameters[:N_LENS])


def distort(ideal: Array, cam: Array, parameters: Array) -> Array:
    """Inverse of :func:`undistort` by two fixed-point steps: to a hundredth of a pixel for the displacements that
    rectification leaves."""
    uv = ideal
    for _ in range(2):
        uv = ideal + lens_shift(uv, cam, parameters[:N_LENS])
    return uv


@kernel
def lens_shift(uv: Array, cam: Array, lens: Array) -> Array:
    """Displacement ``(n, 2)`` pixels by the lens at measured ``uv``."""
    out, left = np.empty((len(uv), 2)), np.zeros((2, N_LENS))
    for i in range(len(uv)):
        _lens((uv[i, 0] - cam[2]) / cam[0], (uv[i, 1] - cam[3]) / cam[1], left)
        for r in range(2):
            total = 0.0
            for k in range(len(lens)):
                total += left[r, k] * lens[k]
            out[i, r] = total
    return out


def pair_shift(uv: Array, disparity: Array, cam: Array, parameters: Array) -> Array:
    """``(n, 2)`` pixels: what the parameters add to a disparity and to a row difference; 0 where it is NaN."""
    return product(basis(uv, disparity, cam, len(parameters))[:, 2:], parameters)


def prior_information(width: int, height: int, cam: Array, shift_px: float, distortion_px: float, count: int) -> Array:
    """Information ``(count, count)`` of the prior: the root mean square of the displacements over the image is about
    ``shift_px``; without a shift and a roll of the right image, about ``distortion_px``. ``cam``: fx, fy, cx, cy."""
    grid = np.meshgrid(np.linspace(0, width - 1, _GRID), np.linspace(0, height - 1, _GRID))
    uv = np.stack([grid[0].ravel(), grid[1].ravel()], axis=1)
    rows = basis(uv, np.zeros(len(uv)), cam, count).reshape(-1, count)
    shifts = [N_LENS + RIGHT.index(name) for name in ("cx", "cy", "wz") if count > N_LENS]
    rigid = np.ascontiguousarray(rows[:, shifts])
    one = np.ones(len(rows))
    beyond = rows
    if rigid.size:
        fitted = solve_symmetric(weighted_gram(rigid, one, rigid), weighted_gram(rigid, one, rows))
        beyond = rows - product(rigid, fitted)
    together, rest = weighted_gram(rows, one, rows), weighted_gram(beyond, one, beyond)
    return (together / shift_px**2 + rest / distortion_px**2) / len(uv)


def physical(parameters: Array, cam: Array) -> dict[str, float]:
    """Parameters by name: turns in degrees, the principal point in pixels, coefficients of lenses as in OpenCV."""
    out = {}
    for name, value in zip((LENS + RIGHT)[: len(parameters)], parameters.tolist(), strict=True):
        if name.startswith("w"):
            out[f"right_turn_{name[1]}_deg"] = float(np.degrees(value / cam[0]))
        elif name.startswith("c"):
            out[f"right_{name}_px"] = value
        else:
            out[f"lens_{name}"] = value / float(cam[0])
    return out


def with_rows(
    uv: Array, disparity: Array, row: Array, cam: Array, information: Array, start: Array, sigma_px: float
) -> CalibrationEstimate:
    """The parameters by the prior ``information`` (mean 0) and the row
    differences ``row`` ``(n,)``: these depend on no pose and no point, so they enter a bundle adjustment as a prior.

    Robust: weights of Cauchy's function, begun at the parameters ``start``.
    """
    rows = np.ascontiguousarray(basis(uv, disparity, cam, len(start))[:, 3])
    mean, H = start, information
    for _ in range(_REWEIGHTED):
        weight = 1.0 / (1.0 + ((row - product(rows, mean)) / (2.0 * sigma_px)) ** 2) / sigma_px**2
        H = information + weighted_gram(rows, weight, rows)
        mean = solve_symmetric(H, weighted_gram(rows, weight, np.ascontiguousarray(row)[:, None]))[:, 0]
    return CalibrationEstimate(mean, H)


@dataclass(frozen=True)
class CalibrationFilter:
    """Estimate of the parameters by earlier windows, beginning with the prior; ``drift`` ``(C, C)`` is the covariance
    of their change from key-frame to key-frame.

    The lens of one camera is observable while the camera turns; between turns earlier windows keep the estimate, and
    with it the scale of a monocular map.
    """

    estimate: CalibrationEstimate
    drift: Array

    @classmethod
    def at_start(cls, prior: Array) -> CalibrationFilter:
        """Begin with mean 0 and the information ``prior`` ``(C, C)``."""
        drift = np.asarray(_DRIFT**2 * solve_symmetric(prior, np.eye(len(prior))), dtype=np.float64)
        return cls(CalibrationEstimate(np.zeros(len(prior)), prior), drift)

    def after(self, mean: Array, gained: Array) -> CalibrationFilter:
        """Filter after a window that estimates ``mean`` ``(C,)`` and gained the information ``gained`` ``(C, C)``."""
        spread = solve_symmetric(self.estimate.information + gained, np.eye(len(gained))) + self.drift
        information = np.asarray(solve_symmetric(spread, np.eye(len(spread))), dtype=np.float64)
        symmetric = np.asarray(0.5 * (information + information.T), dtype=np.float64)
        return CalibrationFilter(CalibrationEstimate(mean, symmetric), self.drift)
