"""Options of ``maslam agent`` for a camera that goes on."""

from __future__ import annotations

import argparse
from pathlib import Path

from ..common.options import add_model_options
from ..common.parser import at_least_one

SECTION = "odometry"
PLAYED, GROWING, CAMERA = "played", "growing", "camera"


def add_camera_arguments(parser: argparse.ArgumentParser) -> None:
    """``--live`` and what goes with it."""
    from maslam.frontend.config import OdometryConfig

    parser.add_argument(
        "--live",
        choices=[PLAYED, GROWING, CAMERA],
        help="track SEQS while the agent drives: a folder of images, film or bag played at its rate; a folder that "
        "grows; a camera's number or address (default: key-frames that were made before)",
    )
    parser.add_argument(
        "--rig", choices=["mono", "stereo", "rgbd"], help="--live: use only this much of the sensors (default: all)"
    )
    parser.add_argument(
        "--sequence",
        metavar="NAME",
        help="--live played: which sequence, where SEQS holds several (`maslam inspect` names them)",
    )
    parser.add_argument(
        "--calibration", type=Path, metavar="FILE", help="--live camera: its calibration, of any form that is read"
    )
    parser.add_argument(
        "--model",
        default="default",
        metavar="NAME|FILE",
        help="--live: place descriptor, the same for all agents (default: the shipped one)",
    )
    parser.add_argument(
        "--settle",
        type=at_least_one,
        metavar="N",
        help="--live: newer key-frames that one waits for before the agent acts on it; fewer than it takes until its "
        "pose is final make matches sooner, of poses that are less exact (default: until its pose is final)",
    )
    parser.add_argument(
        "--idle",
        type=float,
        metavar="S",
        help="--live growing: the drive is over after so many seconds without an image (default: at Ctrl-C)",
    )
    parser.add_argument(
        "--publish",
        action="append",
        choices=["map", "pose"],
        default=[],
        help="--live: give the current pose, or the team's map, out on the network as long as somebody listens; may be "
        "given twice (default: nothing)",
    )
    add_model_options(parser, OdometryConfig(), SECTION)
