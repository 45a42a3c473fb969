"""``maslam demo``: a small town is rendered, four agents drive through it, and their shared map is reported."""

from __future__ import annotations

import argparse
import time
from pathlib import Path

from ..common.progress import counter, progress_on

AGENTS, FRAMES = 4, 120
WIDTH, HEIGHT = 512, 288
TOWN = "town"  # in OUT: the rendered images


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """``--out DIR``."""
    parser.add_argument(
        "--out", type=Path, default=Path("demo"), metavar="DIR", help="folder for images and results (default: demo)"
    )
    parser.add_argument(
        "--seed", type=int, default=0, help="seed of the town, its light and the agents' paths (default: 0)"
    )
    parser.add_argument("--quiet", action="store_true", help="no progress")


def main(arguments: argparse.Namespace) -> None:
    """The command."""
    from maslam.frontend.config import OdometryConfig
    from maslam.mas.output.run_folder import check_out
    from maslam.mas.policies.presets import preset

    from ..common.compiling import COMPILING
    from ..report.summary_table import table_of
    from ..worlds.config import RenderConfig
    from ..worlds.dataset import render_dataset
    from .preprocess_options import PreprocessSettings
    from .run import DEFAULT_PRESET
    from .slam import slam

    check_out(arguments.out)
    began = time.monotonic()
    town = RenderConfig(world="town", seed=arguments.seed, agents=AGENTS, frames=FRAMES, width=WIDTH, height=HEIGHT)
    with progress_on(quiet=arguments.quiet) as progress:
        count = counter(progress, "rendering")
        render_dataset(town, arguments.out / TOWN, count, compiling=counter(progress, COMPILING))
        settings = PreprocessSettings(OdometryConfig())
        page = slam(arguments.out / TOWN, arguments.out, settings, preset(DEFAULT_PRESET), progress)
    print(table_of(arguments.out))
    print(f"\nThe demo took {time.monotonic() - began:.0f} s. Its report: {page.resolve()}")
