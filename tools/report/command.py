"""``maslam report``: one self-contained HTML page of a run; a recording for rerun where that is wanted."""

from __future__ import annotations

import argparse
from pathlib import Path

from maslam._atomic import write_atomically

from ..common.drawing_folder import drawing_folder

PAGE = Path("report", "index.html")
RECORDING = "recording.rrd"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """``RUN``."""
    parser.add_argument("run", metavar="RUN", type=Path, help="folder that `maslam run` or `maslam slam` made")
    parser.add_argument("--rrd", action="store_true", help=f"write RUN/{RECORDING} for the rerun viewer as well")


def main(arguments: argparse.Namespace) -> None:
    """The command."""
    print(write_report(arguments.run))
    if arguments.rrd:
        from .rerun_recording import write_recording

        print(write_recording(arguments.run, arguments.run / RECORDING))


def write_report(run: Path) -> Path:
    """Write the page of a finished run in one move; returns its path."""
    from .html import page
    from .run_data import read_run
    from .sections import headline, sections, tiles

    data = read_run(run)
    path = run / PAGE
    path.parent.mkdir(parents=True, exist_ok=True)
    with drawing_folder(path.parent):
        write_atomically(path, page(*headline(data), tiles(data), sections(data)))
    return path
