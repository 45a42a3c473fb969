"""``maslam agent``: one agent of a team, as a process of its own on a real network."""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from ..common.folders import check_apart
from ..common.options import build, read_settings
from ..common.progress import Progress, progress_on
from ..live.options import SECTION, add_camera_arguments
from ..pipeline.run import add_run_arguments, config_from
from .nobody import NobodyThere

if TYPE_CHECKING:
    from maslam.mas.live.config import LiveConfig
    from maslam.mas.live.neighbours import Neighbours
    from maslam.mas.live.process import AgentProcess, LiveProgress

JOURNAL = "journal.bin"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """``SEQS OUT``, who the agent is and where others are, and everything that can be set."""
    parser.add_argument(
        "sequences",
        metavar="SEQS",
        type=Path,
        help="folder that `maslam preprocess` made; of it this agent's sequence; with --live the images themselves",
    )
    parser.add_argument(
        "out",
        metavar="OUT",
        type=Path,
        help="for this agent's results and its journal; with a journal there, the agent goes on where it ended",
    )
    parser.add_argument(
        "--credentials",
        type=Path,
        required=True,
        metavar="DIR",
        help="the agent's folder that `maslam keys` made: who it is, and whom it talks to",
    )
    parser.add_argument(
        "--listen",
        action="append",
        default=[],
        metavar="ADDRESS",
        help="e.g. tls/0.0.0.0:7447 or quic/0.0.0.0:7447 (default: nowhere)",
    )
    parser.add_argument(
        "--connect",
        action="append",
        default=[],
        metavar="ADDRESS",
        help="where another agent listens, e.g. tls/192.168.1.12:7447; one that is reached is enough (default: none)",
    )
    add_live_arguments(parser)
    add_camera_arguments(parser)
    parser.add_argument(
        "--config", type=Path, metavar="FILE", help=f"YAML with settings, with --live also `{SECTION}: {{...}}`"
    )
    parser.add_argument("--quiet", action="store_true", help="no progress")
    parser.add_argument("--json", action="store_true", help="print a line of JSON for each step: how far the agent is")
    add_run_arguments(parser)


def add_live_arguments(parser: argparse.ArgumentParser) -> None:
    """What ``maslam agent`` and ``maslam team`` share."""
    from maslam.mas.live.config import LINKS

    parser.add_argument(
        "--link",
        choices=sorted(LINKS),
        default="cable",
        help="kind of network: how long to wait for answers (default: %(default)s)",
    )
    parser.add_argument(
        "--speed",
        type=float,
        default=1.0,
        metavar="X",
        help="play the recording so many times as fast as it was made (default: 1)",
    )


def live_config(arguments: argparse.Namespace) -> LiveConfig:
    """The settings of :func:`add_live_arguments`."""
    from pydantic import ValidationError

    from maslam.mas.live.config import LiveConfig

    from ..common.errors import UsageError

    try:
        return LiveConfig(link=arguments.link, speed=arguments.speed)
    except ValidationError as error:
        first = error.errors()[0]
        raise UsageError(f"--{first['loc'][0]} {first['input']}: {first['msg'].lower()}") from error


def main(arguments: argparse.Namespace) -> None:
    """The command."""
    from maslam.frontend.config import OdometryConfig
    from maslam.mas.config import MasConfig
    from maslam.mas.kernels import agent_kernels
    from maslam.mas.live.config import LINKS
    from maslam.mas.live.credentials import Credentials
    from maslam.mas.live.journal import Journal
    from maslam.mas.live.neighbours import Neighbours
    from maslam.mas.live.one_agent import check_live, digest_of, own_sequence, read_agent
    from maslam.mas.live.process import AgentProcess
    from maslam.mas.live.recorded_agent import RecordedAgent
    from maslam.mas.live.restart import resume
    from maslam.mas.transport.zenoh_link import LinkAddresses, ZenohLink

    from ..common.compiling import compile_for
    from ..common.writing import writing
    from ..live.own_results import write_own_results, write_process_figures
    from .live_command import run_live

    live = live_config(arguments)
    content = read_settings(arguments.config, (SECTION, *MasConfig.model_fields))
    odometry = build(OdometryConfig(), arguments, content.pop(SECTION, None), arguments.config, SECTION)
    config = config_from(arguments, content, LINKS[live.link])
    check_live(config)
    check_apart(arguments.sequences, arguments.out)
    credentials = Credentials(arguments.credentials)
    me = credentials.number
    with progress_on(quiet=arguments.quiet or arguments.json) as progress, writing(arguments.out):
        if arguments.live:
            run_live(arguments, config, live, odometry, progress, partial(_shower, arguments, progress))
            return
        inputs = read_agent(arguments.sequences, me, config)
        compile_for(agent_kernels(2), progress)
        earlier = resume(inputs, arguments.out / JOURNAL)
        if earlier.begun:
            progress.say(f"goes on from its journal at {earlier.now_ns / 1e9:.1f} s")
        addresses = LinkAddresses(arguments.listen, arguments.connect, arguments.credentials)
        with ZenohLink(me, credentials.team, addresses) as link, Journal(arguments.out / JOURNAL) as journal:
            language = inputs.agent.state.profile.language
            neighbours = Neighbours(credentials, language, link, inputs.max_message_bytes)
            agent = RecordedAgent(inputs, journal)
            agent.begin(digest_of(inputs), earlier.now_ns)
            process = AgentProcess(agent, neighbours, config, live, earlier.now_ns)
            process.run(_shower(arguments, progress, process, lambda: link.connected))
        write_own_results(arguments.out, inputs.agent, own_sequence(arguments.sequences, me))
        write_process_figures(arguments.out, process)


def _shower(
    arguments: argparse.Namespace, progress: Progress, process: AgentProcess, connected: Callable[[], bool]
) -> Callable[[LiveProgress], None]:
    nobody = NobodyThere(arguments.connect, arguments.credentials, connected)
    return _shown_as_json(process, nobody) if arguments.json else _shown(progress, process.neighbours, nobody)


def _shown(progress: Progress, neighbours: Neighbours, nobody: NobodyThere) -> Callable[[LiveProgress], None]:
    """Progress on the console, and what is wrong with the link, within seconds and once."""
    task: list[int] = []

    def show(now: LiveProgress) -> None:
        if not task and now.seen < now.keyframes:  # of a live camera nobody knows how many come
            task.append(progress.start("key-frames", now.keyframes))
        if task:
            progress.advance(task[0], now.seen)
        if (wrong := nobody.check(now.neighbours, bool(neighbours.refusals()))) is not None:
            progress.say(f"warning: {wrong}")

    return show


def _shown_as_json(process: AgentProcess, nobody: NobodyThere) -> Callable[[LiveProgress], None]:
    from maslam.mas.live.link_bytes import total_bytes

    neighbours = process.neighbours

    def show(now: LiveProgress) -> None:
        all_sent = total_bytes(neighbours.out)
        sent = {
            "message_bytes": all_sent.message_bytes,
            "frame_bytes": all_sent.frame_bytes,
            "greeting_bytes": all_sent.greeting_bytes,
            "signature_bytes": process.signatures.sent_bytes,
        }
        line = {
            "time_s": now.now_ns / 1e9,
            "seen": now.seen,
            "keyframes": now.keyframes,
            "phase": now.phase.name.lower(),
            "neighbours": now.neighbours,
            **sent,
            "cpu_s": time.process_time(),
        }
        if (wrong := nobody.check(now.neighbours, bool(neighbours.refusals()))) is not None:
            line["warning"] = wrong
        print(json.dumps(line), flush=True)

    return show
