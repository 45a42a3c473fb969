"""``maslam bench``: cost and accuracy of the odometry (``vo``), its memory (``memory``), cost of the search of place
vectors (``search``) and of distributed optimisation (``pgo``), and outcomes of place matches (``relpose``)."""

from __future__ import annotations

import argparse
from pathlib import Path

from maslam._suggestions import did_you_mean

from ..common.errors import UnknownName, UsageError
from ..common.figures import check_picture
from .relpose.command import add_relpose, run_relpose

SECTION = "odometry"
_VO = """\
Each sequence runs in a process of its own, one at a time, images decoded during the run as `maslam preprocess` does
it, but without place vectors. Processor time is that of all threads. The reference unit is one call of OpenCV's
ORB.create(2000).detectAndCompute on one thread, the median over images of the same sequence: taken before and after
the run, and the smaller counts, because other work on the machine only ever lengthens it. Compiled code is warmed up
on the first 60 frames before the clock starts: compiling (once per machine) and loading it (once per process, about a
second) are not in the figures. Short sequences run several times; the run of median cost is shown. Errors: ATE is the
RMSE of position after one alignment, SE(3), or Sim(3) for one camera; RPE over L metres is KITTI's drift, from every
frame to the first one at least L farther along the true path, mean error over L, after the one global scale for one
camera; RPE per frame is the RMSE from frame to frame."""

_MEMORY = """\
A closed path through a town is rendered once and driven lap after lap, each frame decoded again at a new time, in a
process of its own. No loop is closed: every lap makes key-frames and points of its own, so memory grows with them.
Memory per frame is the slope of resident memory over the last three quarters of the run, with and excluding the maps,
whose contents are counted array by array."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the actions."""
    from maslam.frontend.config import OdometryConfig

    from ..common.options import add_model_options

    actions = parser.add_subparsers(dest="action", metavar="ACTION", required=True)
    vo = actions.add_parser(
        "vo",
        help="accuracy, time and memory of the odometry on folders of images",
        description=_VO,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        allow_abbrev=False,
        usage="maslam bench vo [options] FOLDER...",
    )
    vo.add_argument("folders", metavar="FOLDER", type=Path, nargs="+", help="data sets; every sequence in each")
    vo.add_argument(
        "--rig", choices=["mono", "stereo", "rgbd"], help="use only this much of the sensors (default: all there is)"
    )
    vo.add_argument(
        "--compare",
        metavar="[SEQUENCE=]FILE",
        nargs="+",
        action="extend",
        default=[],
        help="other systems' trajectories, TUM or KITTI (12 numbers per frame, or 13 with the time), shown "
        "beside ours; SEQUENCE where there are several",
    )
    vo.add_argument("--files", action="store_true", help="also write the five files of each track, and count that")
    vo.add_argument("--runs", type=int, metavar="N", help="runs of each sequence (default: to 300 frames, at most 5)")
    vo.add_argument("--json", action="store_true", help="one JSON list instead of tables")
    vo.add_argument("--plot", type=Path, metavar="FILE", help="draw paths, errors and cost (.png, .svg or .pdf)")
    vo.add_argument(
        "--out", type=Path, metavar="DIR", help="keep bench.json, bench.png and the trajectories, a folder a sequence"
    )
    vo.add_argument(
        "--vocabulary", type=Path, metavar="FILE", help="DBoW2 vocabulary of ORB words (default: the shipped one)"
    )
    vo.add_argument("--config", type=Path, metavar="FILE", help="YAML with settings, `odometry: {...}`")
    vo.add_argument("--quiet", action="store_true", help="no progress")
    add_model_options(vo, OdometryConfig(), SECTION)
    memory = actions.add_parser(
        "memory",
        help="memory and time of the odometry over a long run",
        description=_MEMORY,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        allow_abbrev=False,
        usage="maslam bench memory [options]",
    )
    memory.add_argument(
        "--frames", type=int, default=10_000, metavar="N", help="frames to drive (default: %(default)s)"
    )
    memory.add_argument("--lap", type=int, default=500, metavar="N", help="frames of a lap (default: %(default)s)")
    memory.add_argument("--size", default="160x120", metavar="WxH", help="of the images, pixels (default: %(default)s)")
    memory.add_argument(
        "--rig", choices=["mono", "stereo", "rgbd"], default="stereo", help="cameras (default: %(default)s)"
    )
    memory.add_argument("--seed", type=int, default=0, metavar="N", help="seed of the town (default: %(default)s)")
    memory.add_argument("--images", type=Path, metavar="DIR", help="keep the rendered lap here, or take it from here")
    memory.add_argument("--json", action="store_true", help="one JSON object instead of a table")
    memory.add_argument("--plot", type=Path, metavar="FILE", help="draw memory and time over frames")
    memory.add_argument("--quiet", action="store_true", help="no progress")
    add_model_options(memory, OdometryConfig(), SECTION)

    search = actions.add_parser(
        "search",
        help="exact search of place vectors: time of a query and memory, by number of key-frames",
        allow_abbrev=False,
        usage="maslam bench search [options]",
    )
    search.add_argument(
        "--sizes", default="1000,10000,100000", metavar="LIST", help="key-frames searched (default: %(default)s)"
    )
    search.add_argument("--dim", type=int, default=256, metavar="N", help="numbers of a vector (default: %(default)s)")
    search.add_argument("--seed", type=int, default=0, help="of the vectors (default: %(default)s)")
    search.add_argument("--json", action="store_true", help="one JSON list instead of a table")
    search.add_argument("--quiet", action="store_true", help="no progress")
    add_relpose(actions)
    pgo = actions.add_parser(
        "pgo",
        help="distributed optimisation: bytes, time and gap to the optimum, by number of robots",
        allow_abbrev=False,
        usage="maslam bench pgo [options]",
    )
    pgo.add_argument("--robots", default="10,25,50,100", metavar="LIST", help="(default: %(default)s)")
    pgo.add_argument("--poses", type=int, default=200, metavar="N", help="of each robot (default: %(default)s)")
    pgo.add_argument("--methods", default="quick,rbcd,elected", metavar="LIST", help="(default: %(default)s)")
    pgo.add_argument("--seed", type=int, default=0, help="of the city (default: %(default)s)")
    pgo.add_argument("--json", action="store_true", help="one JSON list instead of a table")
    pgo.add_argument("--plot", type=Path, metavar="FILE", help="draw bytes, time and gap over robots")
    pgo.add_argument("--quiet", action="store_true", help="no progress")


def main(arguments: argparse.Namespace) -> int:
    """Do the action asked for."""
    if arguments.action == "relpose":
        return run_relpose(arguments)
    return {"vo": _vo, "memory": _memory, "search": _search, "pgo": _pgo}[arguments.action](arguments)


def _search(arguments: argparse.Namespace) -> int:
    from ..common.progress import progress_on
    from .search import as_json, as_text, bench_search

    sizes = tuple(int(part) if part.strip().isdigit() else 0 for part in arguments.sizes.split(","))
    if min(sizes) < 1 or arguments.dim < 1:
        raise UsageError(f"--sizes {arguments.sizes} --dim {arguments.dim}: numbers of at least 1 are meant")
    with progress_on(quiet=arguments.quiet) as progress:
        results = bench_search(sizes, arguments.dim, arguments.seed, progress)
    print(as_json(results) if arguments.json else as_text(results))
    return 0


def _pgo(arguments: argparse.Namespace) -> int:
    from ..common.progress import counter, progress_on
    from ..pgo.methods import CENTRAL, METHODS
    from .pgo import as_json, draw, measure, table

    sizes = tuple(int(part) if part.strip().isdigit() else 0 for part in arguments.robots.split(","))
    methods = tuple(arguments.methods.split(","))
    if min(sizes) < 2 or arguments.poses < 2:
        raise UsageError(f"--robots {arguments.robots} --poses {arguments.poses}: numbers of at least 2 are meant")
    for method in methods:
        if method not in METHODS or method == CENTRAL:
            known = [one for one in METHODS if one != CENTRAL]
            raise UnknownName(f"--methods {method}: there is no such method{did_you_mean(method, known)}")
    check_picture(arguments.plot)
    with progress_on(quiet=arguments.quiet) as progress:
        results = measure(sizes, arguments.poses, methods, arguments.seed, counter(progress, "solving"))
    if arguments.plot is not None:
        draw(results, arguments.plot)
    print(as_json(results) if arguments.json else table(results))
    return 0


def _memory(arguments: argparse.Namespace) -> int:
    from maslam.frontend.config import OdometryConfig

    from ..common.options import build, size
    from ..common.progress import progress_on
    from .memory import MemorySettings, bench_memory

    check_picture(arguments.plot)
    width, height = size(arguments.size)
    settings = MemorySettings(
        odometry=build(OdometryConfig(), arguments, prefix=SECTION),
        frames=arguments.frames,
        lap=arguments.lap,
        width=width,
        height=height,
        rig=arguments.rig,
        seed=arguments.seed,
        images=arguments.images,
    )
    with progress_on(quiet=arguments.quiet) as progress:
        report = bench_memory(settings, progress)
    if arguments.plot is not None:
        from .memory_figure import draw_memory

        draw_memory(report, arguments.plot)
    print(report.json() if arguments.json else report.text())
    return 0


def _vo(arguments: argparse.Namespace) -> int:
    from maslam.frontend.config import OdometryConfig

    from ..common.options import build, read_settings
    from ..common.progress import progress_on
    from .vo.run import VoSettings, bench_vo

    if arguments.runs is not None and arguments.runs < 1:
        raise UsageError(f"--runs {arguments.runs}: at least 1")
    check_picture(arguments.plot)
    content = read_settings(arguments.config, [SECTION])
    settings = VoSettings(
        odometry=build(OdometryConfig(), arguments, content.get(SECTION), arguments.config, SECTION),
        rig=arguments.rig,
        vocabulary=arguments.vocabulary,
        files=arguments.files,
        runs=arguments.runs,
        compare=tuple(arguments.compare),
        out=arguments.out,
        plot=arguments.plot,
    )
    with progress_on(quiet=arguments.quiet) as progress:
        report = bench_vo(arguments.folders, settings, progress)
    print(report.json() if arguments.json else report.text())
    return 1 if report.failed else 0
