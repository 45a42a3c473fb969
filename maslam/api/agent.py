"""One agent with a camera that goes on, as an object: frames in, poses and the team's map out."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import ExitStack
from pathlib import Path
from typing import Literal

from maslam._replaced import replaced
from maslam.descriptors.choice import DescriptorLike, load_descriptor
from maslam.frontend.cameras.models import Rig
from maslam.frontend.config import OdometryConfig
from maslam.frontend.frames import Frame
from maslam.frontend.kernels import odometry_kernels
from maslam.frontend.vocabulary.vocabulary import Vocabulary
from maslam.mas.kernels import agent_kernels
from maslam.mas.live.config import LINKS, LiveConfig
from maslam.mas.live.credentials import Credentials
from maslam.mas.live.team_pose import TeamMap, TeamPose
from maslam.mas.live.topics import topics_named
from maslam.mas.policies.presets import preset as preset_named
from maslam.mas.transport.link import Link
from maslam.mas.transport.zenoh_link import LinkAddresses, ZenohLink
from maslam.tools.common.compiling import compile_for
from maslam.tools.common.parallel import one_blas_thread
from maslam.tools.common.progress import CallbackProgress
from maslam.tools.common.writing import writing
from maslam.tools.live.agent import LiveAgent, LiveSetup
from maslam.tools.live.frames import CameraFrame
from maslam.tools.live.tracker import LiveFigures
from maslam.tools.pipeline.run import DEFAULT_PRESET

from .common import PathLike, Settings, changed, nested


class Agent:
    """An agent of a team on a real network, whose camera is yours::

        with maslam.Agent(rig, "out", "keys/agent_00", listen=["tls/0.0.0.0:7447"]) as agent:
            for frame in camera:
                agent.push(frame)
                print(agent.pose())

    It tracks and negotiates in threads of its own. At the end of the block no more frames come: the agent settles with
    the others what it knows, and writes ``out`` (as ``maslam agent`` does). With a journal in ``out`` it goes on where
    that ends, in a new track.

    Args:
        rig: the rectified camera, pair, or camera with depth.
        out: folder for its journal and results.
        credentials: the agent's folder that ``maslam keys`` made.
        listen, connect: addresses, as ``maslam agent`` takes them.
        source: name of the camera or recording. Agents that were given the very same images have the same.
        preset, settings: of agents, and ``{"odometry": {...}}``.
        descriptor: place descriptor, the same for all agents.
        settle: newer key-frames that one waits for before the agent acts on it; None: until its pose is final.
        on_pose: called with each new pose, in the thread that tracks.
        publish: what is given out on the network while somebody listens (:class:`~maslam.Watch`).
        live: kind of network and times of waiting.
        link: carries bytes in the place of Zenoh; ``listen`` and ``connect`` are not used then.

    Raises:
        MaslamError: no such credentials, an address that cannot be used, an unknown setting, another agent's journal.
    """

    def __init__(
        self,
        rig: Rig,
        out: PathLike,
        credentials: PathLike,
        *,
        listen: Sequence[str] = (),
        connect: Sequence[str] = (),
        source: str = "camera",
        preset: str = DEFAULT_PRESET,
        settings: Settings | None = None,
        descriptor: DescriptorLike | str | Path = "default",
        settle: int | None = None,
        on_pose: Callable[[TeamPose], None] | None = None,
        publish: Sequence[Literal["pose", "map"]] = (),
        live: LiveConfig | None = None,
        link: Link | None = None,
    ) -> None:
        content, live = nested(settings), live or LiveConfig()
        live = replaced(live, publish=live.publish | topics_named(publish))
        odometry = changed(OdometryConfig(), content.pop("odometry", {}))
        base = preset_named(preset)
        self._setup = LiveSetup(
            rig=rig,
            source=source,
            model=load_descriptor(descriptor),
            vocabulary=Vocabulary.load(None),
            config=changed(replaced(base, link=LINKS[live.link]), content),
            live=live,
            odometry=odometry,
            model_name=str(descriptor) if isinstance(descriptor, str | Path) else "default",
            after=settle,
        )
        self._out, self._on_pose, self._link = Path(out), on_pose, link
        self._credentials = Credentials(Path(credentials))
        self._addresses = LinkAddresses(listen, connect, Path(credentials))
        self._open = ExitStack()
        self._agent: LiveAgent | None = None
        self._running: Future[None] | None = None

    def __enter__(self) -> Agent:
        compile_for((*odometry_kernels({self._setup.rig.kind}), *agent_kernels(2)), CallbackProgress(None))
        with ExitStack() as opened:
            opened.enter_context(one_blas_thread())
            opened.enter_context(writing(self._out))
            mine = self._credentials
            link = self._link or opened.enter_context(ZenohLink(mine.number, mine.team, self._addresses))
            self._agent = opened.enter_context(LiveAgent(self._setup, self._out, mine, link, self._on_pose))
            thread = opened.enter_context(ThreadPoolExecutor(1, thread_name_prefix="agent"))
            self._running = thread.submit(self._agent.run)
            self._open = opened.pop_all()
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        with self._open:
            self.end()
            self.wait()
            self._inside.write_results()

    def push(self, frame: Frame) -> bool:
        """A frame, rectified, later than all before; its ``index`` does not matter. Returns at once: False where an
        older frame, for which odometry was not ready yet, is dropped for it."""
        taken = CameraFrame(frame.image, frame.stamp_ns, frame.right, frame.depth_m, frame.name)
        return self._inside.push(taken)

    def pose(self) -> TeamPose | None:
        """Where the camera was at the latest frame that was tracked: odometry since the latest key-frame, from where
        that is placed by now. None before the first key-frame (the window of the odometry must be full) and while the
        camera is lost. Any thread may ask."""
        return self._inside.pose()

    def map(self) -> TeamMap:
        """The agent's map with the copies of others' that it bought, each point once, in the frame of its own.

        Raises:
            MaslamError: there is no key-frame yet.
        """
        return self._inside.map()

    @property
    def figures(self) -> LiveFigures:
        """Frames received, tracked, lost and dropped; seconds from a frame's coming to its pose."""
        return self._inside.figures

    def end(self) -> None:
        """No more frames come; the end of the block says it, too."""
        self._inside.end()

    def wait(self, timeout_s: float | None = None) -> None:
        """Until nobody present has anything left to do.

        Raises:
            TimeoutError: not within ``timeout_s``, seconds.
            MaslamError: what ended the agent early.
        """
        assert self._running is not None
        self._running.result(timeout_s)

    @property
    def _inside(self) -> LiveAgent:
        if self._agent is None:
            raise RuntimeError("use the agent in a `with` block")
        return self._agent
