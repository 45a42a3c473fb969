"""Picture of a frame as the odometry sees it: the undistorted image with its features, and beside it the right image or
the depth."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import cv2
import numpy as np
from numpy.typing import NDArray

from ..checks.sensor_checks import check_rows

if TYPE_CHECKING:
    from maslam.frontend.datasets import ImageSequence
    from maslam.frontend.frames import Frame

Picture = NDArray[np.uint8]
_LEVEL_COLOURS = ((80, 220, 80), (80, 220, 220), (80, 160, 255), (90, 90, 255))  # BGR, finest level first
_LINE_COLOUR, _GOOD, _BAD = (150, 110, 60), (80, 220, 80), (60, 60, 255)
_LINES = 12
_ROW_PX = 1.0
_STRIP_PX = 22
_MAX_SEQUENCES = 8


def draw_sequences(sequences: Sequence[ImageSequence], share: float = 0.5) -> Picture:
    """One below the other, the frame at ``share`` of each sequence; at most eight."""
    rows = [draw(sequence, round(share * (len(sequence) - 1))) for sequence in sequences[:_MAX_SEQUENCES]]
    width = max(row.shape[1] for row in rows)
    padded = [cv2.copyMakeBorder(row, 0, 0, 0, width - row.shape[1], cv2.BORDER_CONSTANT) for row in rows]
    return np.concatenate(padded).astype(np.uint8)


def draw(sequence: ImageSequence, index: int) -> Picture:
    """Frame ``index`` with a line of text above. Stereo: both images with common rows, points that lie a pixel or more
    off their row in red. RGB-D: depth by colour (black: unknown) under the edges of the image."""
    frame = sequence.read(index)
    image, features = _with_features(frame)
    panels, caption = [image], f"{features} features"
    if frame.right is not None:
        left, right, matched = _pair(frame, image)
        panels, caption = [left, right], f"{caption}, {matched}"
    if frame.depth_m is not None:
        colours, span = _depth(frame)
        panels, caption = [image, colours], f"{caption}, depth {span}"
    camera = sequence.rig.camera
    how = "rectified" if sequence.rectifier is not None else "as stored"
    text = f"{sequence.name} frame {index}, {camera.width}x{camera.height} {how}, fx {camera.fx:.1f} px: {caption}"
    return np.concatenate([_strip(text, sum(p.shape[1] for p in panels)), np.concatenate(panels, axis=1)])


def _with_features(frame: Frame) -> tuple[Picture, int]:
    """A circle for each feature that a key-frame would take; larger and redder on coarser levels of the pyramid."""
    from maslam.frontend.config import FeatureConfig
    from maslam.frontend.image.orb_features import Detector, Pyramid

    config = FeatureConfig()
    pyramid = Pyramid(frame.image, config.levels, config.scale_factor, frame.used)
    uv, level, _ = Detector(config).detect(pyramid, config.tracks + config.landmarks, np.zeros((0, 2)))
    picture = cv2.cvtColor(frame.image, cv2.COLOR_GRAY2BGR)
    for (u, v), k in zip(uv.tolist(), level.tolist(), strict=True):
        radius = round(3.0 * config.scale_factor**k)
        cv2.circle(picture, (round(u), round(v)), radius, _LEVEL_COLOURS[k % 4], 1, cv2.LINE_AA)
    return picture.astype(np.uint8), len(uv)


def _pair(frame: Frame, left: Picture) -> tuple[Picture, Picture, str]:
    assert frame.right is not None
    right = cv2.cvtColor(frame.right, cv2.COLOR_GRAY2BGR)
    for picture in (left, right):
        for y in np.linspace(0, picture.shape[0] - 1, _LINES + 2)[1:-1]:
            cv2.line(picture, (0, round(y)), (picture.shape[1] - 1, round(y)), _LINE_COLOUR, 1)
    check = check_rows(frame)
    assert check is not None
    for (u, v), off in zip(check.right_uv.tolist(), check.rows_px.tolist(), strict=True):
        cv2.circle(right, (round(u), round(v)), 3, _GOOD if abs(off) < _ROW_PX else _BAD, 1, cv2.LINE_AA)
    if not len(check.right_uv):
        return left, right, "none found in the right image"
    good = (np.abs(check.rows_px) < _ROW_PX).mean()
    return left, right, f"{len(check.right_uv)} found in the right image, {100 * good:.0f} % on their row"


def _depth(frame: Frame) -> tuple[Picture, str]:
    assert frame.depth_m is not None
    known = frame.depth_m > 0
    if not known.any():
        return np.zeros((*known.shape, 3), dtype=np.uint8), "unknown"
    low, high = np.quantile(frame.depth_m[known], [0.02, 0.98])
    grey = 255 * (1 - (frame.depth_m - low) / max(high - low, 1e-6))
    colours = cv2.applyColorMap(np.clip(grey, 0, 255).astype(np.uint8), cv2.COLORMAP_TURBO)
    colours[~known] = 0
    colours[cv2.Canny(frame.image, 80, 160) > 0] = 255
    return colours.astype(np.uint8), f"{low:.2f} m (red) to {high:.2f} m (blue)"


def _strip(text: str, width: int) -> Picture:
    strip = np.zeros((_STRIP_PX, width, 3), dtype=np.uint8)
    size = min(0.45, 0.45 * (width - 8) / max(cv2.getTextSize(text, cv2.FONT_HERSHEY_SIMPLEX, 0.45, 1)[0][0], 1))
    cv2.putText(strip, text, (4, 15), cv2.FONT_HERSHEY_SIMPLEX, size, (230, 230, 230), 1, cv2.LINE_AA)
    return strip
