"""What `maslam calibrate` writes: the camera in OpenCV's form, and a picture of where the image was covered."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from maslam.frontend.cameras.calibration import Distortion, RawCamera

from ..common.errors import ToolError
from ..common.folders import check_file
from .fit import FittedCamera
from .views import coverage

_NAMED = {Distortion.RADIAL_TANGENTIAL: "plumb_bob", Distortion.EQUIDISTANT: "fisheye"}
MADE_BY = "maslam calibrate:"
"""In a comment of the file, by which an earlier result is known."""
_MAGNIFIED = 20.0
"""Times that errors are drawn longer than they are."""
_HEIGHT_PX = 720


def check_camera_file(path: Path, source: Path, overwrite: bool) -> None:
    """Refuse, before the work, a file that no camera can be written to, or that somebody else wrote."""
    check_file(path, source, (".yaml", ".yml"))
    if not path.exists() or overwrite:
        return
    try:
        earlier = f"# {MADE_BY}" in path.read_text(encoding="utf-8", errors="replace")
    except OSError as error:
        raise ToolError(f"{path}: cannot be read: {error.strerror}") from error
    if not earlier:
        raise ToolError(f"{path}: is there already; choose another name, or replace it with --overwrite")


def camera_text(fitted: FittedCamera, made: str) -> str:
    """The camera as a YAML file of OpenCV's kind, which `cv2.FileStorage` and maslam read; ``made``: how it came about,
    as a comment."""
    camera = fitted.camera
    assert camera.size is not None
    lines = [
        "%YAML:1.0",
        "---",
        f"# {made}",
        *(f"# {name} {value:.6g} +- {sigma:.2g}" for name, (value, sigma) in fitted.parameters.items()),
        f"image_width: {camera.size[0]}",
        f"image_height: {camera.size[1]}",
        f'distortion_model: "{_NAMED[camera.distortion]}"',
        *_matrix("camera_matrix", camera.K),
        *_matrix("distortion_coefficients", np.array([camera.coefficients])),
    ]
    return "\n".join(lines) + "\n"


def _matrix(name: str, values: NDArray[np.float64]) -> list[str]:
    numbers = ", ".join(repr(float(value)) for value in values.ravel())
    rows, columns = values.shape
    return [
        f"{name}: !!opencv-matrix",
        f"   rows: {rows}",
        f"   cols: {columns}",
        "   dt: d",
        f"   data: [ {numbers} ]",
    ]


def draw_coverage(fitted: FittedCamera) -> NDArray[np.uint8]:
    """The image's area with every point that was used, its error twenty times as long, and cells that no point lies in
    in red; BGR."""
    camera: RawCamera = fitted.camera
    assert camera.size is not None
    width, height = camera.size
    scale = _HEIGHT_PX / height
    picture = np.full((_HEIGHT_PX, round(width * scale), 3), 30, dtype=np.uint8)
    counts = coverage(fitted.views, camera.size)
    rows, columns = counts.shape
    for r in range(rows):
        for c in range(columns):
            low = (round(c * picture.shape[1] / columns), round(r * _HEIGHT_PX / rows))
            high = (round((c + 1) * picture.shape[1] / columns) - 2, round((r + 1) * _HEIGHT_PX / rows) - 2)
            shade = min(int(counts[r, c]), 40)
            colour = (40, 40 + 2 * shade, 40) if shade else (40, 40, 130)
            cv2.rectangle(picture, low, high, colour, -1)
    for view, residual in zip(fitted.views, fitted.residuals, strict=True):
        for (u, v), (du, dv) in zip(view.uv.tolist(), residual.tolist(), strict=True):
            at = (round(u * scale), round(v * scale))
            end = (round((u + _MAGNIFIED * du) * scale), round((v + _MAGNIFIED * dv) * scale))
            cv2.line(picture, at, end, (80, 200, 255), 1, cv2.LINE_AA)
            cv2.circle(picture, at, 2, (230, 230, 230), -1, cv2.LINE_AA)
    return picture
