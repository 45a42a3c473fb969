"""``maslam render``: synthetic images of several agents from the command line."""

from __future__ import annotations

import argparse
from pathlib import Path

from ..common.options import DEST, add_model_options, build, overlaid, size
from ..common.parser import at_least_one
from ..common.progress import counter, progress_on
from ..common.text_table import counted


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """``OUT`` and everything that can be set."""
    from .config import RenderConfig

    parser.add_argument(
        "out", metavar="OUT", type=Path, help="folder for the images; an interrupted rendering is gone on with"
    )
    parser.add_argument("--size", metavar="WxH", help="pixels, for --width and --height together (default: 640x360)")
    parser.add_argument(
        "--poses",
        type=Path,
        metavar="FILE",
        help="a KITTI pose file to drive, as --poses-file (default: a path through the world)",
    )
    parser.add_argument("--workers", type=at_least_one, metavar="N", help="threads (default: one per core)")
    parser.add_argument("--quiet", action="store_true", help="no progress")
    add_model_options(parser, RenderConfig())


def main(arguments: argparse.Namespace) -> None:
    """The command."""
    from ..common.compiling import COMPILING
    from .config import RenderConfig
    from .dataset import render_dataset

    base = RenderConfig()
    if arguments.size is not None:
        width, height = size(arguments.size)
        base = overlaid(base, {"width": width, "height": height}, f"--size {arguments.size}")
    if arguments.poses is not None:
        setattr(arguments, f"{DEST}poses_file", str(arguments.poses))
    config = build(base, arguments)
    with progress_on(quiet=arguments.quiet) as progress:
        count = counter(progress, "images")
        render_dataset(config, arguments.out, count, arguments.workers, counter(progress, COMPILING))
    pictures = f"{config.rig} {config.width}x{config.height}"
    print(f"{arguments.out}: {config.world}, {counted(config.agents, 'agent')}, {pictures}, seed {config.seed}")
