"""``maslam bench``: what the odometry costs and how good it is (``vo``), and what it keeps in memory (``memory``)."""

from __future__ import annotations

import argparse
from pathlib import Path

from tools.errors import ToolError, UsageError

SECTION = "odometry"
_VO = """\
Each sequence runs in a process of its own, one at a time, images decoded along the way as `maslam preprocess` does
it, but without place vectors. Processor time is that of all threads. The yard is one call of OpenCV's
ORB.create(2000).detectAndCompute on one thread, the median over images of the same sequence: taken before and after
the run, and the smaller counts, because other work on the machine only ever lengthens it. Compiled code is warmed up
on the first 60 frames before the clock starts: compiling (once a machine) and loading it (once a process, about a
second) are not in the figures. Short sequences run several times; the run of median cost is shown. Errors: ATE is the
RMSE of position after one alignment, SE(3), or Sim(3) for one camera; RPE over L metres is KITTI's drift, from every
frame to the first one at least L farther along the true way, mean error over L, after the one global scale for one
camera; RPE a frame is the RMSE from frame to frame."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the actions."""
    from frontend.config import OdometryConfig
    from tools.options import add_model_options

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
        help="other systems' trajectories, TUM or KITTI (12 numbers a row and frame, or 13 with the time), shown "
        "beside ours; SEQUENCE where there are several",
    )
    vo.add_argument("--files", action="store_true", help="also write the five files of each track, and count that")
    vo.add_argument("--runs", type=int, metavar="N", help="of each sequence (default: to 300 frames, at most 5)")
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


def main(arguments: argparse.Namespace) -> int:
    """Do the action asked for."""
    return {"vo": _vo}[arguments.action](arguments)


def _vo(arguments: argparse.Namespace) -> int:
    from frontend.config import OdometryConfig
    from tools.bench_vo import PICTURES, VoSettings, bench_vo
    from tools.options import build, read_yaml
    from tools.progress import progress_on

    if arguments.runs is not None and arguments.runs < 1:
        raise UsageError(f"--runs {arguments.runs}: at least 1")
    if arguments.plot is not None and arguments.plot.suffix not in PICTURES:
        raise UsageError(f"--plot {arguments.plot}: the name must end in {', '.join(PICTURES)}")
    content = read_yaml(arguments.config) if arguments.config else {}
    for name in sorted(set(content) - {SECTION})[:1]:
        raise ToolError(f"{arguments.config}: unknown setting '{name}'; this benchmark knows '{SECTION}'")
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
