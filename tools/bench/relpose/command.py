"""Arguments of ``maslam bench relpose``; the work is in :mod:`maslam.tools.bench.relpose.run`."""

from __future__ import annotations

import argparse
from pathlib import Path

from ...common.errors import UsageError

_RELPOSE = """\
Rendered stereo pairs of single key-frames: ORB key-points and their depth as the odometry makes them, without any
window adjustment. Right pairs show one place twice, in lights and from poses of two agents; shared view is the smaller
share of the surface that one view sees of the other's, what is hidden left out. Look-alike pairs share no surface: of
all pairs in a world those with the nearest place vectors, and indoors also the same pose at another room's door. The
worlds are rendered once and kept in --cache."""


def add_relpose(actions: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Its arguments."""
    from maslam.backend.config import RelPoseConfig

    from ...common.options import add_model_options

    relpose = actions.add_parser(
        "relpose",
        help="right and look-alike place matches on rendered worlds: accepted, falsely accepted, errors, bytes",
        description=_RELPOSE,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        allow_abbrev=False,
        usage="maslam bench relpose [options]",
    )
    relpose.add_argument(
        "--worlds",
        default="town_51,town_52,indoor_52,indoor_53",
        metavar="LIST",
        help="town_SEED and indoor_SEED (default: %(default)s)",
    )
    relpose.add_argument(
        "--right", type=int, default=100, metavar="N", help="right pairs of each world (default: %(default)s)"
    )
    relpose.add_argument(
        "--look-alikes",
        type=int,
        default=2400,
        metavar="N",
        help="wrong pairs in all, hardest first (default: %(default)s)",
    )
    relpose.add_argument(
        "--points", type=int, default=0, metavar="N", help="points that the query sends, at most (default: all)"
    )
    relpose.add_argument(
        "--code",
        choices=["float", "grid"],
        default="float",
        help="transmitted points: float (12 bytes each) or grid (4 bytes each; default: %(default)s)",
    )
    relpose.add_argument(
        "--features", choices=["descriptors", "words"], default="descriptors", help="compared by (default: %(default)s)"
    )
    relpose.add_argument(
        "--descriptor-bytes", type=int, choices=[8, 16, 32], default=32, help="of each point (default: %(default)s)"
    )
    relpose.add_argument(
        "--size", default="480x360", metavar="WxH", help="of the images, pixels (default: %(default)s)"
    )
    relpose.add_argument(
        "--cache", type=Path, metavar="DIR", help="keep the rendered views here, or take them from here"
    )
    relpose.add_argument("--seed", type=int, default=0, metavar="N", help="seed of the searches (default: %(default)s)")
    relpose.add_argument("--json", action="store_true", help="one JSON object instead of tables")
    relpose.add_argument("--quiet", action="store_true", help="no progress")
    add_model_options(relpose, RelPoseConfig(), "relpose")


def run_relpose(arguments: argparse.Namespace) -> int:
    """Do it."""
    from maslam.backend.config import RelPoseConfig

    from ...common.options import build, size
    from ...common.progress import progress_on
    from .run import RelPoseSettings, bench_relpose, worlds_named

    if min(arguments.right, arguments.look_alikes) < 1 or arguments.points < 0:
        raise UsageError("--right, --look-alikes: at least 1; --points: at least 0")
    settings = RelPoseSettings(
        worlds=worlds_named(arguments.worlds),
        right=arguments.right,
        look_alikes=arguments.look_alikes,
        relpose=build(RelPoseConfig(), arguments, prefix="relpose"),
        points=arguments.points,
        code=arguments.code,
        features=arguments.features,
        descriptor_bytes=arguments.descriptor_bytes,
        size=size(arguments.size),
        cache=arguments.cache,
        seed=arguments.seed,
    )
    with progress_on(quiet=arguments.quiet) as progress:
        report = bench_relpose(settings, progress)
    print(report.json() if arguments.json else report.text())
    return 0
