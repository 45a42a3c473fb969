"""``maslam agent --live``: an agent that tracks its camera's images while it negotiates."""

from __future__ import annotations

import argparse
import signal
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path
from threading import Event
from typing import TYPE_CHECKING

from ..common.errors import UsageError
from ..common.progress import Progress
from ..live.options import CAMERA, GROWING

if TYPE_CHECKING:
    from maslam.frontend.config import OdometryConfig
    from maslam.mas.config import MasConfig
    from maslam.mas.live.config import LiveConfig
    from maslam.mas.live.cpu_parts import CpuParts
    from maslam.mas.live.process import AgentProcess, LiveProgress
    from maslam.mas.state.agent_state import AgentState

    from ..live.frames import CameraFrame
    from ..live.sources import FrameSource
    from ..live.tracker import LiveFigures

READING = "reading"
"""Part of CPU time: images as they come."""
Shown = Callable[["AgentProcess", Callable[[], bool]], Callable[["LiveProgress"], None]]


def run_live(
    arguments: argparse.Namespace,
    config: MasConfig,
    live: LiveConfig,
    odometry: OdometryConfig,
    progress: Progress,
    shown: Shown,
) -> None:
    """Track and negotiate until the source is at its end, or until Ctrl-C; write OUT."""
    from maslam._replaced import replaced
    from maslam.descriptors.choice import load_descriptor
    from maslam.frontend.kernels import odometry_kernels
    from maslam.frontend.vocabulary.vocabulary import Vocabulary
    from maslam.mas.kernels import agent_kernels
    from maslam.mas.live.credentials import Credentials
    from maslam.mas.live.topics import topics_named
    from maslam.mas.transport.zenoh_link import LinkAddresses, ZenohLink

    from ..common.compiling import compile_for
    from ..common.parallel import one_blas_thread
    from ..live.agent import LiveAgent, LiveSetup

    live = replaced(live, publish=topics_named(arguments.publish))
    credentials = Credentials(arguments.credentials)
    model = load_descriptor(arguments.model)
    source = source_of(arguments, live.speed)
    compile_for((*odometry_kernels({source.rig.kind}), *agent_kernels(2)), progress)
    setup = LiveSetup(
        rig=source.rig,
        source=source.name,
        model=model,
        vocabulary=Vocabulary.load(None),
        config=config,
        live=live,
        odometry=odometry,
        model_name=arguments.model,
        after=arguments.settle,
    )
    addresses = LinkAddresses(arguments.listen, arguments.connect, arguments.credentials)
    with (
        one_blas_thread(),
        ZenohLink(credentials.number, credentials.team, addresses) as link,
        LiveAgent(setup, arguments.out, credentials, link) as agent,
    ):
        source.after_ns = agent.played_until_ns
        if agent.earlier.begun:
            progress.say(f"goes on from its journal at {agent.earlier.now_ns / 1e9:.1f} s, in a new track")
        with fed(source, agent.push, agent.end, progress, agent.cpu):
            agent.run(shown(agent.process, lambda: link.connected))
        agent.write_results()
    progress.say(figures_line(agent.figures))
    progress.say(joined_line(agent.inputs.agent.state))


@contextmanager
def fed(
    source: FrameSource,
    push: Callable[[CameraFrame], object],
    end: Callable[[], None],
    progress: Progress,
    cpu: CpuParts,
) -> Iterator[None]:
    """Frames of ``source`` go to ``push`` in a thread of their own; ``end`` is called when there are no more, or at the
    first Ctrl-C. The second one ends the program as usual. ``cpu`` takes the CPU time of reading them."""
    stop = Event()

    def interrupted(*_: object) -> None:
        signal.signal(signal.SIGINT, before)
        progress.say("the drive ends here; the agent settles what it knows (Ctrl-C again: at once)")
        stop.set()
        end()

    before = signal.getsignal(signal.SIGINT)
    signal.signal(signal.SIGINT, interrupted)
    try:
        with ThreadPoolExecutor(1, thread_name_prefix="camera") as thread:
            feeding = thread.submit(_run, source, push, stop, cpu)
            feeding.add_done_callback(lambda _: end())
            try:
                yield
            finally:
                stop.set()
        feeding.result()
    finally:
        signal.signal(signal.SIGINT, before)


def _run(source: FrameSource, push: Callable[[CameraFrame], object], stop: Event, cpu: CpuParts) -> None:
    with cpu.part(READING):
        source.run(push, stop)


def source_of(arguments: argparse.Namespace, speed: float) -> FrameSource:
    """The camera of a command line."""
    from maslam.frontend.cameras.calibration_files import read_calibration
    from maslam.frontend.cameras.models import RigKind
    from maslam.frontend.datasets import open_dataset

    from ..live.sources import GrowingFolder, OpenCvCamera, PlayedRecording

    given: Path = arguments.sequences
    rig = RigKind(arguments.rig) if arguments.rig else None
    if arguments.live in (GROWING, CAMERA) and speed != 1:
        raise UsageError(f"--speed {speed:g}: only a recording is played faster than it was made")
    if arguments.live == GROWING:
        return GrowingFolder(given, rig, arguments.idle)
    if arguments.live == CAMERA:
        if arguments.calibration is None:
            raise UsageError("--live camera needs --calibration FILE")
        device = str(given)
        return OpenCvCamera(int(device) if device.isdigit() else device, read_calibration(arguments.calibration))
    found = open_dataset(given, rig).sequences
    named = [sequence for sequence in found if arguments.sequence in (None, sequence.name)]
    if len(named) != 1:
        names = ", ".join(sequence.name for sequence in found)
        raise UsageError(f"{given}: {len(found)} sequences ({names}): name the one of this agent, by --sequence")
    return PlayedRecording(named[0], speed)


def figures_line(figures: LiveFigures) -> str:
    """What became of the frames, in a line."""
    return (
        f"{figures.received} frames: {figures.tracked} tracked, {figures.lost} lost, {figures.dropped} dropped, "
        f"{figures.unreadable} unreadable; {figures.keyframes} key-frames; from image to pose "
        f"{1e3 * figures.lag_mean_s:.0f} ms on average, {1e3 * figures.lag_most_s:.0f} ms at most"
    )


def joined_line(state: AgentState) -> str:
    """Whose frame the agent's poses are in, and who else is in it as far as it knows."""
    others = ", ".join(str(a) for a in sorted(state.group - {state.me})) or "nobody"
    return (
        f"joined with agents: {others}; poses are in the frame of agent {state.frame.agent}, track {state.frame.track}"
    )
