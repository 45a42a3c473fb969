"""Checks of a calibration on the images of a pair, or on an image and its depth."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from maslam.frontend.datasets import Problem
    from maslam.frontend.datasets.orb_points import PairMatches
    from maslam.frontend.datasets.pair_check import PairFit
    from maslam.frontend.frames import Frame

_MAX_ROWS = 12.0
"""Rows apart, pixels, within which a point is looked for in the right image."""
_ENOUGH = 40
"""Fewest matches from which anything is concluded."""
_ROWS_PX, _ROWS_75_PX = 1.0, 1.5
_WRONG_WAY = 0.25
"""Share of points that may lie right of their place in the left image: mismatches; far points do so by rounding."""
_YAW_DEG = 0.5
"""A turn of the right camera about y that moves all disparities, as cameras in each other's place do."""
_NO_CALIBRATION_DEG = 15.0
"""A right camera turned farther is no rig's: the images are no pairs."""
_DEPTH_M = (0.1, 30.0)
_DEPTH_KNOWN = 0.05


@dataclass(frozen=True)
class RowCheck:
    """Points of the left image found in the right one: ``left_uv``, ``right_uv`` ``(n, 2)`` pixels, of ``features``
    looked for."""

    left_uv: NDArray[np.float64]
    right_uv: NDArray[np.float64]
    features: int

    @property
    def rows_px(self) -> NDArray[np.float64]:
        """Row difference of each point, right minus left image ``(n,)``, pixels: 0 in a rectified pair."""
        return self.right_uv[:, 1] - self.left_uv[:, 1]

    @property
    def disparity_px(self) -> NDArray[np.float64]:
        """Column difference of each point, left minus right image ``(n,)``, pixels: above 0 in front of the cameras."""
        return self.left_uv[:, 0] - self.right_uv[:, 0]


@dataclass(frozen=True)
class DepthCheck:
    """``known``: share of pixels with depth; ``median_m`` of these."""

    known: float
    median_m: float


def check_rows(frame: Frame, matches: PairMatches | None = None) -> RowCheck | None:
    """Match ORB key-points of the two images, then refine by Lucas-Kanade; None without a right image. ``matches``:
    those of the frame's images, where they are known already.

    Made of OpenCV's parts alone, not of the odometry's: an opinion of its own.
    """
    import cv2

    from maslam.frontend.datasets.pair_check import match_pair

    if frame.right is None:
        return None
    if matches is None:
        matches = match_pair(frame.image, frame.right)
    near = np.abs(matches.right_uv[:, 1] - matches.left_uv[:, 1]) <= _MAX_ROWS
    uv, guess = matches.left_uv[near], matches.right_uv[near]
    if not len(uv):
        none = np.zeros((0, 2))
        return RowCheck(none, none, matches.features)
    found, ok, _ = cv2.calcOpticalFlowPyrLK(
        frame.image,
        frame.right,
        uv[:, None],
        guess[:, None].copy(),
        winSize=(15, 15),
        maxLevel=0,
        flags=cv2.OPTFLOW_USE_INITIAL_FLOW,
    )
    moved = np.linalg.norm(found[:, 0] - guess, axis=1)
    good = (ok[:, 0] > 0) & (moved < 3.0)
    return RowCheck(uv[good].astype(np.float64), found[good, 0].astype(np.float64), matches.features)


def check_depth(frame: Frame) -> DepthCheck | None:
    """None without a depth image."""
    if frame.depth_m is None:
        return None
    known = frame.depth_m[frame.depth_m > 0]
    return DepthCheck(len(known) / frame.depth_m.size, float(np.median(known)) if len(known) else 0.0)


def row_lines(checks: Sequence[RowCheck]) -> tuple[str, list[Problem]]:
    """The line of the report and what is wrong, from several frames; nothing is concluded from too few points."""
    from maslam.frontend.datasets import Problem, Severity

    features, count = sum(c.features for c in checks), sum(len(c.left_uv) for c in checks)
    if count < _ENOUGH:
        line = f"only {count} points of {features} found in both images: too few to tell"
        if features < 5 * _ENOUGH:
            return line, []
        message = f"only {count} of {features} points of the left images are found in the right: are they pairs?"
        return line, [Problem(Severity.WARNING, message)]
    rows = np.concatenate([c.rows_px for c in checks])
    disparity = np.concatenate([c.disparity_px for c in checks])
    median, most = float(np.median(rows)), float(np.quantile(np.abs(rows), 0.75))
    line = f"apart by {median:+.2f} px (median), three in four within {most:.2f} px, {count} points in both images"
    problems = []
    if (disparity < -1.0).mean() > 1.0 - _WRONG_WAY:
        problems.append(
            Problem(
                Severity.ERROR,
                f"points lie {-np.median(disparity):.1f} px farther right in the right image (median): "
                "left and right are swapped",
            )
        )
    if abs(median) > _ROWS_PX or most > _ROWS_75_PX:
        problems.append(
            Problem(
                Severity.WARNING,
                f"a point's rows in the left and the right image differ by {median:+.2f} px (median), "
                f"three in four by less than {most:.2f} px: the pair is not rectified, or by another calibration",
            )
        )
    return line, problems


def turned_lines(checks: Sequence[RowCheck], fit: PairFit | None) -> tuple[str, str, list[Problem]]:
    """As :func:`row_lines`, with a cause of what else looks like other faults: the right camera is turned against its
    calibration (``fit``), which moves rows and disparities. Between them the words on that, empty where it is not."""
    from maslam.frontend.datasets import Problem, Severity

    line, problems = row_lines(checks)
    if fit is None or not fit.off:
        return line, "", problems
    errors = [one for one in problems if one.severity is Severity.ERROR and abs(fit.turn_deg[1]) < _YAW_DEG]
    if float(np.abs(fit.turn_deg).max()) > _NO_CALIBRATION_DEG:
        off = f"are the right images of other moments than the left ones, or of another rig? {fit.text()}"
    else:
        off = f"the calibration is off, or the pair is not rectified: {fit.text()}; calibrate the pair anew"
    return line, off, [*errors, Problem(Severity.WARNING, off)]


def depth_lines(checks: Sequence[DepthCheck]) -> tuple[str, list[Problem]]:
    """The line of the report and what is wrong, from several frames."""
    from maslam.frontend.datasets import Problem, Severity

    known = float(np.mean([c.known for c in checks]))
    medians = [c.median_m for c in checks if c.known > 0]
    median = float(np.median(medians)) if medians else 0.0
    problems = []
    if known < _DEPTH_KNOWN:
        problems.append(Problem(Severity.WARNING, f"depth is known for only {100 * known:.1f} % of the pixels"))
    if medians and not _DEPTH_M[0] <= median <= _DEPTH_M[1]:
        problems.append(
            Problem(
                Severity.WARNING,
                f"half of the depths are below {median:.4g} m, expected {_DEPTH_M[0]} to {_DEPTH_M[1]:.0f} m: "
                "is the depth unit right?",
            )
        )
    return f"known for {100 * known:.0f} % of the pixels, median {median:.2f} m", problems
