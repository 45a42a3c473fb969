"""The command ``maslam``: its commands, and the one line in which each failure is reported.

A command is a module of this package with ``add_arguments(parser)`` and ``main(arguments) -> int | None`` (the exit
code; None is 0). It is imported only when it is called, so ``maslam --help`` costs no library.
"""

from __future__ import annotations

import argparse
import importlib
import io
import logging
import os
import sys
import traceback
from collections.abc import Sequence
from functools import partial
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from maslam._temporary import delete_kept_folders

from .common.errors import UnknownName, UsageError, describe
from .common.interrupts import INTERRUPTED, TERMINATED, Interrupts, Terminated, forget_semaphores, interrupts
from .common.logs import LEVELS, ON_CONSOLE, logs_to
from .common.parser import CommandParser

log = logging.getLogger(__name__)
COMMANDS: dict[str, tuple[str, str]] = {
    "demo": (".pipeline.demo", "render a small town, run four agents in it, write the report"),
    "render": (".worlds.command", "synthetic images, depth and ground truth of several agents"),
    "inspect": (".inspection.command", "what would be read from a folder of images, and what is wrong with it"),
    "calibrate": (".calibration.command", "a camera from a film or images of a board that is moved in front of it"),
    "preprocess": (".pipeline.preprocess", "images to agent sequences: odometry, map points, place vectors"),
    "import": (
        ".interchange.command",
        "another system's trajectory and its images to agent sequences",
    ),
    "run": (".pipeline.run", "the multi-agent system on agent sequences"),
    "slam": (".pipeline.slam", "preprocess, run, evaluate and report in one"),
    "team": (".network.team", "slam with each agent as a process of its own, over a network of this machine"),
    "agent": (".network.agent", "one agent of a team on a real network: this machine's"),
    "keys": (".network.keys", "certificates of a team: who may talk to its agents, and under which name"),
    "eval": (".report.summary_table", "error, exploration and bytes of a run, against ground truth where there is any"),
    "report": (".report.command", "one self-contained HTML page of a run; optionally a recording for rerun"),
    "export": (
        ".interchange.export",
        "a run for other programs: COLMAP, hloc, nerfstudio, gsplat, evo, Foxglove, tables",
    ),
    "sweep": (".sweep.command", "sequences x agents x presets x seeds, to tables and figures"),
    "pgo": (".pgo.command", "pose-graph optimisation of g2o files, central or distributed"),
    "bench": (".bench.command", "accuracy, time and memory of the odometry; time of the place search"),
    "netvlad": (".netvlad.command", "train, export, calibrate and evaluate the place descriptor"),
    "vocabulary": (".vocabulary", "train or show the vocabulary of ORB words"),
    "doctor": (".inspection.doctor", "versions, missing system libraries, what works on this machine"),
}
SUCCESS, FAILURE, USAGE = 0, 1, 2


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command line; returns the exit code: 0 success, 1 a failure reported in one line, 2 a usage error, 130
    interrupted (Ctrl-C), 143 ended from outside (SIGTERM, SIGHUP).
    """
    with interrupts() as signals:
        try:
            code = _main(argv, signals)
        except KeyboardInterrupt as error:
            code, line = _interrupted(error, signals)
            print(f"\nmaslam: {line}", file=sys.stderr)  # before there is a log
        if argv is None and code in (INTERRUPTED, TERMINATED):
            # All is closed; Python would end by the signal itself where compiled code saw it, or be interrupted again.
            sys.stdout.flush()
            sys.stderr.flush()
            forget_semaphores()
            delete_kept_folders()
            os._exit(code)
        return code


def _main(argv: Sequence[str] | None, signals: Interrupts) -> int:
    _print_whatever_it_is()
    words = [_with_dashes(word) for word in (sys.argv[1:] if argv is None else argv)]
    chosen = next((word for word in words if not word.startswith("-")), None)
    try:
        parser = build_parser(chosen)
        arguments = parser.parse_args(words)
    except SystemExit as stop:  # argparse ends by itself on --help and on a usage error
        return int(stop.code or 0)
    except UnknownName as error:
        print(f"maslam: {error}", file=sys.stderr)
        return USAGE
    except Exception as error:
        if signals.seen is not None:
            raise signals.seen from error
        return _fail(error, debug="--debug" in words)
    if arguments.command is None:
        parser.print_help()
        return USAGE
    try:
        with logs_to(getattr(arguments, "log_level", None), getattr(arguments, "log_file", None)):
            log.info("maslam %s: %s", _version(), " ".join(words))
            code = _run(arguments, signals)
            log.info("exit code %d", code)
            return code
    except OSError as error:  # the log file
        return _fail(error, getattr(arguments, "debug", False))


def _interrupted(error: KeyboardInterrupt, signals: Interrupts) -> tuple[int, str]:
    signals.arrived()
    ended = isinstance(error, Terminated)
    what = "ended from outside" if ended else "interrupted"
    line = f"{what}; nothing half-written; the same command goes on from what is finished"
    return (TERMINATED if ended else INTERRUPTED), line


def _say_interrupted(error: KeyboardInterrupt, signals: Interrupts) -> int:
    code, line = _interrupted(error, signals)
    _say(line, "\n")
    return code


def _run(arguments: argparse.Namespace, signals: Interrupts) -> int:
    """Call the command; every failure becomes a line and an exit code."""
    from .common.parallel import one_blas_thread  # what follows loads libraries; --help does not

    try:
        with one_blas_thread():
            return arguments.command_main(arguments) or SUCCESS
    except UsageError as error:
        usage = "" if isinstance(error, UnknownName) else f"usage: maslam {arguments.command} --help\n"
        _say(str(error), usage)
        return USAGE
    except KeyboardInterrupt as error:
        return _say_interrupted(error, signals)
    except BrokenPipeError:  # the reader of our output has enough: `maslam eval RUN | head`
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return SUCCESS
    except Exception as error:
        if signals.seen is not None:  # a library put its own in the place of the interruption
            return _say_interrupted(signals.seen(), signals)
        log.error("%s", describe(error), exc_info=error, extra=ON_CONSOLE)
        return _fail(error, getattr(arguments, "debug", False))


def build_parser(chosen: str | None = None) -> argparse.ArgumentParser:
    """The whole command line; only the ``chosen`` command's module is imported and fills in its arguments."""
    parser = CommandParser(
        prog="maslam",
        description="Multi-agent visual SLAM without a server: from folders of images to one shared map.",
        formatter_class=partial(argparse.HelpFormatter, max_help_position=16),
    )
    parser.everywhere.title = "options"
    parser.everywhere.add_argument(
        "--version", action="version", version=f"maslam {_version()}", help="show the version"
    )
    commands = parser.add_subparsers(dest="command", metavar="COMMAND", title="commands")
    for name, (module_name, summary) in COMMANDS.items():
        command = commands.add_parser(
            name,
            help=summary,
            description=summary[0].upper() + summary[1:] + ".",
            formatter_class=argparse.RawDescriptionHelpFormatter,
        )
        if name == chosen:
            module = importlib.import_module(module_name, __package__)
            module.add_arguments(command)
            command.set_defaults(command_main=module.main)
        for one in command.with_actions():
            _add_everywhere(one.everywhere)
    return parser


def _add_everywhere(group: argparse._ArgumentGroup) -> None:
    """The options of every command; what is not given leaves no trace, so that a command and its action can have
    both."""
    group.add_argument(
        "--debug", action="store_true", default=argparse.SUPPRESS, help="show the traceback of a failure"
    )
    group.add_argument(
        "--log-level",
        choices=list(LEVELS),
        default=argparse.SUPPRESS,
        help="log lines that are shown, and written to the log file (default: warning; in the file info)",
    )
    group.add_argument(
        "--log-file",
        type=Path,
        metavar="FILE",
        default=argparse.SUPPRESS,
        help="append log lines, and the traceback of a failure, to this file",
    )


def _with_dashes(word: str) -> str:
    """``--relpose.min_inliers=20``, spelled like the setting in a file, is the option ``--relpose.min-inliers=20``."""
    name, equals, value = word.partition("=")
    return name.replace("_", "-") + equals + value if name.startswith("--") else word


def _print_whatever_it_is() -> None:
    """A letter that the terminal's code page lacks becomes a question mark, not a failure (Windows)."""
    if isinstance(sys.stdout, io.TextIOWrapper) and sys.stdout.errors == "strict":
        sys.stdout.reconfigure(errors="replace")


def _fail(error: Exception, debug: bool) -> int:
    if debug:
        traceback.print_exception(error)
    print(f"maslam: {describe(error)}", file=sys.stderr)
    return FAILURE


def _say(line: str, before: str = "") -> None:
    print(f"{before}maslam: {line}", file=sys.stderr)
    log.error("%s", line, extra=ON_CONSOLE)


def _version() -> str:
    try:
        return version("maslam")
    except PackageNotFoundError:
        return "(not installed)"


if __name__ == "__main__":
    sys.exit(main())
