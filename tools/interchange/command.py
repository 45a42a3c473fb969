"""``maslam import``: another system's trajectory and its images, or the predecessor's files, become agent sequences."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from ..common.errors import UsageError
from ..common.options import read_settings
from ..common.progress import progress_on
from ..pipeline.preprocess_options import SECTIONS, add_preprocess_arguments
from ..pipeline.preprocess_options import settings_from as of_preprocess

if TYPE_CHECKING:
    from .given import ImportSettings

_MORE = """\
trajectories
  TUM, KITTI (12 columns: as many rows as images, or --times; 13: with times), EuRoC csv, 4x4 matrices, .npy, .npz
  and JSON, a COLMAP model or transforms.json (by the images' names), bags and MCAP with odometry or poses (needs
  rosbags). Poses map the camera, or with --T-body-camera the body that carries it, to the world, and stay as they are.
points
  One camera's images get depth by --points: PLY, PCD, NPY, BIN, XYZ of the whole map; csv x,y,z,image (or time), a
  line for each image that sees a point; points3D.txt with images.txt; or a folder of scans named by their times, in
  the axes of the body whose poses are given.
several agents
  IMAGES with a folder for each agent (agent_00, agent_01, ...) and POSES with a file of that name for each; or one
  import after the other into the same OUT with --add.
predecessor
  maslam import FOLDER OUT: the five files with netvlad_feats.bin and times.txt, one agent a sub-folder, or one sequence
  cut with --agents. `maslam run FOLDER` takes them directly.
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """``POSES IMAGES OUT``, or ``FOLDER OUT``, and everything that can be set."""
    parser.epilog = _MORE
    parser.add_argument(
        "source", metavar="POSES", type=Path, help="trajectory file, a folder of them, or the predecessor's FOLDER"
    )
    parser.add_argument(
        "images", metavar="IMAGES", type=Path, nargs="?", help="folder of images; `maslam inspect IMAGES` shows it"
    )
    parser.add_argument(
        "out",
        metavar="OUT",
        type=Path,
        help="for the agent sequences: a new folder, or an earlier import of the same, which is gone on with "
        "or made anew",
    )
    parser.add_argument("--add", action="store_true", help="keep the agents that OUT holds and add these")
    parser.add_argument(
        "--scale",
        choices=["metric", "arbitrary"],
        default="metric",
        help="unit of the poses: metres, or one of their own that may drift (one camera's; default: %(default)s)",
    )
    parser.add_argument(
        "--T-body-camera",
        dest="T_body_camera",
        metavar="FILE|NUMBERS",
        help="the camera's pose on the body (LiDAR, IMU) whose poses are given: 16, 12 or 7 numbers, or a file "
        "(default: the poses are the camera's)",
    )
    parser.add_argument(
        "--times",
        type=Path,
        metavar="FILE",
        help="times of poses without their own, one a line (default: the rows are the images)",
    )
    parser.add_argument(
        "--clock-offset",
        type=float,
        default=0.0,
        metavar="S",
        help="seconds to add to the trajectory's times to get the images' (default: 0)",
    )
    parser.add_argument(
        "--bridge",
        type=float,
        default=0.5,
        metavar="S",
        help="longest time between two poses that an image's is interpolated over, seconds (default: %(default)s)",
    )
    parser.add_argument(
        "--gap",
        type=float,
        default=5.0,
        metavar="S",
        help="a longer time without a pose begins a new track, seconds (default: %(default)s)",
    )
    parser.add_argument(
        "--points",
        type=Path,
        metavar="PATH",
        help="3-D points that measure depth for one camera: a cloud or a table of points and images that see them in "
        "the poses' frame, a COLMAP text model, or a folder of scans; a folder with one for each agent "
        "(default: rays place points)",
    )
    parser.add_argument("--topic", metavar="NAME", help="topic of the poses in a bag (default: the only one)")
    parser.add_argument(
        "--config", type=Path, metavar="FILE", help="YAML with settings, `odometry: {...}`, `images: {...}`"
    )
    parser.add_argument("--quiet", action="store_true", help="no progress")
    parser.add_argument("--json", action="store_true", help="print what was made, OUT/manifest.json, as one object")
    add_preprocess_arguments(parser)


def settings_from(arguments: argparse.Namespace) -> ImportSettings:
    """The settings of one command line."""
    from .given import ImportSettings

    return ImportSettings(
        images=of_preprocess(arguments, read_settings(arguments.config, SECTIONS)),
        scale=arguments.scale,
        T_body_camera=arguments.T_body_camera,
        times=arguments.times,
        clock_offset_s=arguments.clock_offset,
        bridge_s=arguments.bridge,
        gap_s=arguments.gap,
        topic=arguments.topic,
        points=arguments.points,
        add=arguments.add,
    )


def main(arguments: argparse.Namespace) -> None:
    """The command."""
    from ..pipeline.preprocess import summary_line
    from .given import import_given

    settings = settings_from(arguments)
    with progress_on(quiet=arguments.quiet) as progress:
        if arguments.images is None:
            from ..pipeline.predecessor import import_folder

            if settings.add or settings.T_body_camera is not None or settings.times is not None:
                raise UsageError("--add, --T-body-camera and --times go with POSES IMAGES OUT, not with the five files")
            split = settings.images.agents, settings.images.overlap, settings.images.overwrite
            manifest = import_folder(arguments.source, arguments.out, progress, settings.scale, *split)
        else:
            manifest = import_given(arguments.source, arguments.images, arguments.out, settings, progress)
    print(manifest.model_dump_json(indent=2) if arguments.json else summary_line(manifest, arguments.out))
