"""``maslam calibrate``: a camera from a film, or images, of a board that is moved in front of it."""

from __future__ import annotations

import argparse
import json
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..common.errors import ToolError, UsageError
from ..common.folders import check_file
from ..common.options import size
from ..common.parser import at_least_one
from ..common.progress import Progress, progress_on

if TYPE_CHECKING:
    from .board import Board
    from .fit import FittedCamera

_LEAST_COVER, _GOOD_COVER = 0.25, 0.6
"""Share of the image's cells with a point of the board: below the first refused, below the second warned of."""
_KINDS = ("chessboard", "charuco", "circles", "asymmetric-circles")
_MODELS = ("radial-tangential", "equidistant")


@dataclass(frozen=True)
class CalibrateSettings:
    """Settings of ``maslam calibrate``: the ``board``, the lens's ``model``, with ``k3`` a fifth coefficient of the
    radial-tangential one; each ``stride``-th frame is looked at; at most ``views`` are used."""

    board: Board
    model: str = _MODELS[0]
    k3: bool = False
    stride: int = 1
    views: int = 30


@dataclass(frozen=True)
class Calibrated:
    """``fitted``, from ``seen`` views of the board in ``frames``; ``covered``: share of the image's cells with a
    point."""

    fitted: FittedCamera
    frames: int
    seen: int
    covered: float

    @property
    def warnings(self) -> tuple[str, ...]:
        """What its user should know."""
        if self.covered >= _GOOD_COVER:
            return ()
        return (
            f"points of the board cover {100 * self.covered:.0f} % of the image: the lens is not known beyond them; "
            "show the board in the corners",
        )

    def lines(self) -> list[str]:
        """The report, a line each."""
        fitted = self.fitted
        camera = fitted.camera
        assert camera.size is not None
        parameters = fitted.parameters.items()
        return [
            f"views      {len(fitted.views)} used of {self.seen} with the board, in {self.frames} frames",
            f"fit        {fitted.rms_px:.3f} px root mean square; slants differ by up to {fitted.tilt_deg:.0f} degrees",
            f"coverage   {100 * self.covered:.0f} % of the image",
            f"camera     {camera.size[0]}x{camera.size[1]} px, {camera.distortion}",
            *(f"  {name:<8} {value:12.5f} +- {sigma:.5f}" for name, (value, sigma) in parameters),
        ]

    def record(self) -> dict[str, Any]:
        """The report as plain values."""
        fitted = self.fitted
        camera = fitted.camera
        return {
            "frames": self.frames,
            "views_seen": self.seen,
            "views_used": [view.name for view in fitted.views],
            "rms_px": fitted.rms_px,
            "view_rms_px": list(fitted.view_rms_px),
            "tilt_deg": fitted.tilt_deg,
            "covered": self.covered,
            "width": camera.size[0] if camera.size else None,
            "height": camera.size[1] if camera.size else None,
            "model": camera.distortion.value,
            "parameters": {name: {"value": v, "sigma": s} for name, (v, s) in fitted.parameters.items()},
            "warnings": list(self.warnings),
        }


def calibrate(source: Path, settings: CalibrateSettings, progress: Progress) -> Calibrated:
    """Find the board in ``source``, choose views, fit the camera; ``ToolError`` where the views are too few, too alike,
    or in one corner of the image."""
    from maslam.frontend.cameras.calibration import Distortion

    from .film import frames_of
    from .fit import fit_camera
    from .views import choose_views, coverage, find_views

    expected, frames = frames_of(source, settings.stride)
    found = find_views(frames, expected, settings.board, progress)
    board = settings.board
    if not found.views:
        raise ToolError(
            f"{source}: no {board.kind} of {board.columns}x{board.rows} points in {found.frames} frames; "
            "is --points right (chessboard: inner corners)?"
        )
    views = choose_views(found, settings.views)
    try:
        fitted = fit_camera(views, found.size, Distortion(settings.model), settings.k3)
    except ToolError as error:
        raise ToolError(f"{source}: {error} ({len(found.views)} of {found.frames} frames show the board)") from error
    counts = coverage(fitted.views, found.size)
    covered = float((counts > 0).mean())
    if covered < _LEAST_COVER:
        raise ToolError(
            f"{source}: points of the board cover {100 * covered:.0f} % of the image, {100 * _LEAST_COVER:.0f} % are "
            "needed: come closer, and show it in the corners"
        )
    return Calibrated(fitted, found.frames, len(found.views), covered)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """``SRC OUT`` and everything that can be set."""
    parser.add_argument("source", metavar="SRC", type=Path, help="a film of the board, or a folder of images")
    parser.add_argument(
        "out", metavar="OUT.yaml", type=Path, help="for the camera; put it beside the images as camera.yaml"
    )
    parser.add_argument("--board", choices=_KINDS, default=_KINDS[0], help=f"the pattern (default: {_KINDS[0]})")
    parser.add_argument(
        "--points",
        metavar="WxH",
        default="9x6",
        help="chessboard: inner corners along both sides; ChArUco: squares; circles: circles (default: 9x6)",
    )
    parser.add_argument("--model", choices=_MODELS, default=_MODELS[0], help=f"of the lens (default: {_MODELS[0]})")
    parser.add_argument("--k3", action="store_true", help="radial-tangential: estimate a third radial coefficient")
    parser.add_argument(
        "--stride", type=at_least_one, default=1, metavar="N", help="look at each n-th frame (default: 1)"
    )
    parser.add_argument(
        "--views", type=at_least_one, default=30, metavar="N", help="use at most so many views (default: 30)"
    )
    parser.add_argument(
        "--marker",
        type=float,
        default=0.75,
        metavar="SHARE",
        help="ChArUco: marker's side by the square's (default: 0.75)",
    )
    parser.add_argument(
        "--dictionary", default="DICT_4X4_50", metavar="NAME", help="ChArUco: OpenCV's name (default: DICT_4X4_50)"
    )
    parser.add_argument(
        "--png", type=Path, metavar="FILE", help="draw where points covered the image, and their errors"
    )
    parser.add_argument("--overwrite", action="store_true", help="replace a file that `maslam calibrate` did not write")
    parser.add_argument("--quiet", action="store_true", help="no progress")
    parser.add_argument("--json", action="store_true", help="print the result as one JSON object")


def settings_from(arguments: argparse.Namespace) -> CalibrateSettings:
    """The settings of one command line."""
    from .board import Board, BoardKind
    from .fit import FEWEST_VIEWS

    if arguments.views < FEWEST_VIEWS:
        raise UsageError(f"--views {arguments.views}: at least {FEWEST_VIEWS} are needed")
    columns, rows = size(arguments.points, "--points")
    board = Board(BoardKind(arguments.board), columns, rows, arguments.marker, arguments.dictionary)
    return CalibrateSettings(board, arguments.model, arguments.k3, arguments.stride, arguments.views)


def main(arguments: argparse.Namespace) -> None:
    """The command."""
    import cv2

    from maslam._atomic import write_atomically

    from .output import MADE_BY, camera_text, check_camera_file, draw_coverage

    settings = settings_from(arguments)
    check_camera_file(arguments.out, arguments.source, arguments.overwrite)
    if arguments.png is not None:
        check_file(arguments.png, arguments.source, (".png",))
    with progress_on(quiet=arguments.quiet) as progress:
        done = calibrate(arguments.source, settings, progress)
        for warning in done.warnings:
            progress.say(f"warning: {arguments.source}: {warning}")
    made = f"{MADE_BY} {len(done.fitted.views)} views, {done.fitted.rms_px:.3f} px root mean square"
    arguments.out.parent.mkdir(parents=True, exist_ok=True)
    write_atomically(arguments.out, camera_text(done.fitted, made))
    if arguments.png is not None:
        _, encoded = cv2.imencode(".png", draw_coverage(done.fitted))
        write_atomically(arguments.png, encoded.tobytes())
    print(
        json.dumps(done.record(), indent=2)
        if arguments.json
        else "\n".join([*done.lines(), f"written: {arguments.out}"])
    )
