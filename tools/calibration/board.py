"""Calibration boards: their points, and how they are found in an image."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

import cv2
import numpy as np
from numpy.typing import NDArray

from ..common.errors import UsageError

Array = NDArray[np.float64]
_FEWEST = 12
"""Fewest points of a board that is seen in part (ChArUco)."""
_SEARCH_PX = 800
"""Longest side of the image in which a chessboard is looked for first."""


class BoardKind(StrEnum):
    """Patterns that OpenCV finds."""

    CHESSBOARD = "chessboard"
    CHARUCO = "charuco"
    CIRCLES = "circles"
    ASYMMETRIC_CIRCLES = "asymmetric-circles"


@dataclass(frozen=True)
class Board:
    """A flat pattern of ``columns`` x ``rows`` points (chessboard: inner corners; ChArUco: squares). ``marker``: side
    of a ChArUco marker as a share of a square's; ``dictionary``: OpenCV's name of its markers."""

    kind: BoardKind
    columns: int
    rows: int
    marker: float = 0.75
    dictionary: str = "DICT_4X4_50"

    def __post_init__(self) -> None:
        if min(self.columns, self.rows) < 3:
            raise UsageError(f"--points {self.columns}x{self.rows}: at least 3 along each side are meant")
        if not 0.1 < self.marker < 1.0:
            raise UsageError(f"--marker {self.marker}: a share of the square between 0.1 and 1 is meant")
        if not hasattr(cv2.aruco, self.dictionary):
            raise UsageError(f"--dictionary {self.dictionary}: OpenCV has no such dictionary of markers")

    def find(self, image: NDArray[np.uint8]) -> tuple[Array, Array] | None:
        """Points ``(n, 3)`` on the board, in units of its spacing, and where ``image`` shows them ``(n, 2)``, pixels;
        None where the board is not seen (a ChArUco board may be seen in part)."""
        if self.kind is BoardKind.CHARUCO:
            return self._charuco(image)
        uv = self._corners(image) if self.kind is BoardKind.CHESSBOARD else self._circles(image)
        return None if uv is None else (self._points(), uv)

    def _points(self) -> Array:
        column, row = np.meshgrid(np.arange(self.columns, dtype=np.float64), np.arange(self.rows, dtype=np.float64))
        if self.kind is BoardKind.ASYMMETRIC_CIRCLES:  # every second row is half a step to the right
            column, row = column + 0.5 * (row % 2), 0.5 * row
        return np.stack([column.ravel(), row.ravel(), np.zeros(column.size)], axis=1)

    def _corners(self, image: NDArray[np.uint8]) -> Array | None:
        share = min(1.0, _SEARCH_PX / max(image.shape))
        small = image if share == 1.0 else cv2.resize(image, None, fx=share, fy=share, interpolation=cv2.INTER_AREA)
        flags = cv2.CALIB_CB_ADAPTIVE_THRESH | cv2.CALIB_CB_NORMALIZE_IMAGE | cv2.CALIB_CB_FAST_CHECK
        seen, corners = cv2.findChessboardCorners(small, (self.columns, self.rows), flags=flags)
        if not seen or corners is None or len(corners) != self.columns * self.rows:
            return None
        uv = (corners.reshape(-1, 2) + 0.5) / share - 0.5
        grid = uv.reshape(self.rows, self.columns, 2)
        step = min(float(np.linalg.norm(np.diff(grid, axis=k), axis=2).min()) for k in (0, 1))
        half = int(np.clip(round(0.4 * step), 2, 15))
        criteria = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 40, 1e-3)
        start = uv.astype(np.float32).reshape(-1, 1, 2)
        found = cv2.cornerSubPix(image, start, (half, half), (-1, -1), criteria)
        return np.asarray(found, dtype=np.float64).reshape(-1, 2)

    def _circles(self, image: NDArray[np.uint8]) -> Array | None:
        kind = (
            cv2.CALIB_CB_ASYMMETRIC_GRID if self.kind is BoardKind.ASYMMETRIC_CIRCLES else cv2.CALIB_CB_SYMMETRIC_GRID
        )
        found, centres = cv2.findCirclesGrid(image, (self.columns, self.rows), flags=kind)
        return np.asarray(centres.reshape(-1, 2), dtype=np.float64) if found and centres is not None else None

    def _charuco(self, image: NDArray[np.uint8]) -> tuple[Array, Array] | None:
        markers = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, self.dictionary))
        board = cv2.aruco.CharucoBoard((self.columns, self.rows), 1.0, self.marker, markers)
        corners, ids, *_ = cv2.aruco.CharucoDetector(board).detectBoard(image)
        if ids is None or corners is None or len(ids) < _FEWEST:
            return None
        points = np.asarray(board.getChessboardCorners(), dtype=np.float64)[np.asarray(ids).ravel()]
        if len(np.unique(points[:, 0])) < 3 or len(np.unique(points[:, 1])) < 3:
            return None
        return points, np.asarray(corners, dtype=np.float64).reshape(-1, 2)
