"""``maslam export``: a run as other programs read it."""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import get_args

from ..common.progress import progress_on
from .export_request import ExportRequest, Frames, Groups, Program

_FORMS = """\
programs
  colmap hloc nerfstudio gsplat   one folder for all four: undistorted images, COLMAP model, transforms.json, points
  evo          trajectories and ground truth: TUM, KITTI
  mcap         a ROS 2 bag in an MCAP file, for Foxglove and RViz: tf, paths, points, optionally images
  tf           one transform a line, without ROS: map, agent_00/odom, agent_00/camera
  csv          all that the report plots
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """``RUN OUT``, for which program, and how much."""
    parser.epilog = _FORMS
    parser.add_argument("run", metavar="RUN", type=Path, help="folder that `maslam run` or `maslam slam` made")
    parser.add_argument("out", metavar="OUT", type=Path, help="new folder for the export")
    parser.add_argument("--for", dest="program", choices=get_args(Program), required=True, help="see below")
    parser.add_argument("--agent", type=int, metavar="N", help="export this agent alone (default: the whole team)")
    parser.add_argument(
        "--frames",
        choices=get_args(Frames),
        default="keyframes",
        help="images of key-frames, or of all frames that have a place (default: %(default)s)",
    )
    parser.add_argument(
        "--groups",
        choices=get_args(Groups),
        default="largest",
        help="of agents that no match joins: the largest group, or all, a folder each (default: %(default)s)",
    )
    parser.add_argument(
        "--images", type=Path, metavar="DIR", help="where the images are now, if their folder has moved since the run"
    )
    parser.add_argument("--with-images", action="store_true", help="mcap: put the images into the recording as well")
    parser.add_argument("--overwrite", action="store_true", help="replace an earlier export in OUT")
    parser.add_argument("--json", action="store_true", help="print what was written, OUT/export.json, as one object")
    parser.add_argument("--quiet", action="store_true", help="no progress")


def main(arguments: argparse.Namespace) -> None:
    """The command."""
    from .export_folder import export_run

    request = ExportRequest(
        program=arguments.program,
        agent=arguments.agent,
        frames=arguments.frames,
        groups=arguments.groups,
        images=arguments.images,
        with_images=arguments.with_images,
        overwrite=arguments.overwrite,
    )
    with progress_on(quiet=arguments.quiet) as progress:
        made = export_run(arguments.run, arguments.out, request, progress)
    print(json.dumps(made.record, indent=1) if arguments.json else "\n".join(made.lines))
