"""Whether the rows of a pair agree, and if not, by which turn of the right camera: a calibration that is off.

Made of OpenCV's parts alone, not of the odometry's: an opinion of its own.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from maslam.backend.geometry import product

from ..cameras.models import PinholeCamera, RigKind
from ..errors import FrontendError
from .base import ImageSequence
from .orb_points import PairMatches, find_points, match_points

Array = NDArray[np.float64]
_FEATURES, _MATCH_DISTANCE = 1000, 40
_ENOUGH, _SHARE = 60, 0.35
"""Fewest points, and smallest share of all matches, that must agree before anything is concluded."""
_INLIER_PX, _TRIALS, _REFITTED = 1.5, 300, 25
_ROWS_PX, _LARGEST_PX, _SIGMAS = 1.0, 1.2, 8.0
"""Rows apart over the image, root mean square, that are said; or at its worst place, where the turn is that certain."""
_TURN_DEG = 0.9
_MAX_ROWS = 0.3
"""Share of the height beyond which rows are not believed to be a calibration's fault."""
_SAMPLES = 6
_GRID = 9


@dataclass(frozen=True)
class PairFit:
    """How the rows of pairs differ: as if the right camera were turned by ``turn_deg`` ``(3,)`` about x, y, z beyond
    its calibration, with standard deviations ``sigma_deg``. A turn about x and a shift of the rows look alike.

    ``points`` of ``matches`` agree; ``rms_px``, ``largest_px``: row differences by the fit over the image;
    ``median_px`` of the points, right minus left.
    """

    points: int
    matches: int
    turn_deg: Array
    sigma_deg: Array
    rms_px: float
    largest_px: float
    median_px: float

    @property
    def off(self) -> bool:
        """Whether the calibration is wrong enough to be said."""
        certain = np.abs(self.turn_deg) > np.maximum(_TURN_DEG, _SIGMAS * self.sigma_deg)
        return self.rms_px > _ROWS_PX or bool(certain.any() and self.largest_px > _LARGEST_PX)

    def text(self) -> str:
        """What is wrong, with figures."""
        x, y, z = self.turn_deg
        return (
            f"rows of the pair differ by {self.median_px:+.2f} px (median; {self.rms_px:.1f} px root mean square over "
            f"the image, at most {self.largest_px:.1f}), as if the right camera were turned by x {x:+.2f} (or its rows "
            f"shifted), y {y:+.2f}, z {z:+.2f} degrees against the calibration"
        )


def match_pair(left: NDArray[np.uint8], right: NDArray[np.uint8]) -> PairMatches:
    """ORB key-points found in both images, wherever they lie."""
    return match_points(find_points(left, _FEATURES), find_points(right, _FEATURES), _MATCH_DISTANCE)


def fit_pair(matches: Sequence[PairMatches], camera: PinholeCamera) -> PairFit | None:
    """The turn that most matches of several pairs agree on; None where too few agree."""
    if not matches:
        return None
    left = np.concatenate([pair.left_uv for pair in matches]).astype(np.float64)
    right = np.concatenate([pair.right_uv for pair in matches]).astype(np.float64)
    rows = right[:, 1] - left[:, 1]
    near = np.abs(rows) < _MAX_ROWS * camera.height
    left, right, rows = left[near], right[near], rows[near]
    if len(rows) < _ENOUGH:
        return None
    A = _by_turn(right, camera)
    agree = _most_agree(A, rows)
    for _ in range(_REFITTED):
        if agree.sum() < _ENOUGH:
            return None
        turn = np.asarray(np.linalg.lstsq(A[agree], rows[agree], rcond=None)[0], dtype=np.float64)
        beyond = rows - product(A, turn)
        agree = np.abs(beyond) < _INLIER_PX
    points = int(agree.sum())
    if points < max(_ENOUGH, _SHARE * len(rows)):
        return None
    noise_px = float(np.sqrt((beyond[agree] ** 2).mean()))
    sigma = noise_px * np.sqrt(np.diag(np.linalg.inv(product(A[agree].T, A[agree]))))
    u, v = np.meshgrid(np.linspace(0, camera.width - 1, _GRID), np.linspace(0, camera.height - 1, _GRID))
    shown = product(_by_turn(np.stack([u.ravel(), v.ravel()], axis=1), camera), turn)
    rms, largest = float(np.sqrt((shown**2).mean())), float(np.abs(shown).max())
    return PairFit(points, len(rows), np.degrees(turn), np.degrees(sigma), rms, largest, float(np.median(rows[agree])))


def check_pairs(sequence: ImageSequence, frames: Iterable[int] | None = None) -> PairFit | None:
    """The fit over some frames of a stereo sequence; None for other rigs, and where too little is seen. Frames that
    cannot be read are passed over."""
    if sequence.rig.kind is not RigKind.STEREO:
        return None
    count = len(sequence)
    chosen = sorted({round(i * (count - 1) / (_SAMPLES - 1)) for i in range(_SAMPLES)}) if frames is None else frames
    matches = []
    for i in chosen:
        try:
            frame = sequence.read(i)
        except FrontendError:
            continue
        if frame.right is not None:
            matches.append(match_pair(frame.image, frame.right))
    return fit_pair(matches, sequence.rig.camera)


def _by_turn(right_uv: Array, camera: PinholeCamera) -> Array:
    """``(n, 3)`` pixels: row differences at ``right_uv`` by small turns of the right camera about x, y, z, radians."""
    x, y = (right_uv[:, 0] - camera.cx) / camera.fx, (right_uv[:, 1] - camera.cy) / camera.fy
    return camera.fy * np.stack([-(1.0 + y * y), x * y, x], axis=1)


def _most_agree(A: Array, rows: Array) -> NDArray[np.bool_]:
    """The matches ``(n,)`` that agree with the turn, of three matches each, with which most agree."""
    rng = np.random.default_rng(0)
    best = np.abs(rows) < _INLIER_PX
    for _ in range(_TRIALS):
        chosen = rng.choice(len(rows), 3, replace=False)
        if np.linalg.cond(A[chosen]) > 1e4:
            continue
        turn = np.asarray(np.linalg.solve(A[chosen], rows[chosen]), dtype=np.float64)
        agree = np.abs(rows - product(A, turn)) < _INLIER_PX
        if agree.sum() > best.sum():
            best = agree
    return best
