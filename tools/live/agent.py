"""One agent with a camera that goes on: it tracks in one thread, and negotiates in another."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from pathlib import Path
from queue import Empty, SimpleQueue
from typing import TYPE_CHECKING

import numpy as np

from maslam._atomic import write_atomically
from maslam.errors import MaslamError
from maslam.frontend.config import OdometryConfig
from maslam.mas.config import MasConfig
from maslam.mas.live.config import LiveConfig
from maslam.mas.live.cpu_parts import CpuParts
from maslam.mas.live.credentials import Credentials, name_of_agent
from maslam.mas.live.drive import LiveDrive
from maslam.mas.live.journal import Journal
from maslam.mas.live.live_sequence import observed_in, sequence_of
from maslam.mas.live.neighbours import Neighbours
from maslam.mas.live.observed import Observed
from maslam.mas.live.one_agent import check_live, digest_of, inputs_of
from maslam.mas.live.process import AgentProcess, LiveProgress
from maslam.mas.live.recorded_agent import AgentInputs, RecordedAgent
from maslam.mas.live.restart import resume
from maslam.mas.live.revisits import Revisits
from maslam.mas.live.team_pose import LatestFrame, PlacedKeyFrames, TeamMap, TeamPose
from maslam.mas.live.topic_writer import TopicWriter
from maslam.mas.manifest import AgentEntry, CameraEntry, Manifest
from maslam.mas.sequence import AgentSequence

from ..common.errors import ToolError
from ..pipeline.descriptor_entry import descriptor_entry
from .frames import CameraFrame, LatestFrames
from .front_end import Beginning, LiveFrontEnd
from .own_results import write_own_results, write_process_figures
from .tracker import LiveFigures, LiveTracker

if TYPE_CHECKING:
    from maslam.descriptors.base import PlaceDescriptor
    from maslam.frontend.cameras.models import Rig
    from maslam.frontend.vocabulary.lookup import WordLookup
    from maslam.mas.transport.link import Link

JOURNAL = "journal.bin"
FIGURES = "live.json"
PLACING = "placing"
"""Part of CPU time: poses and maps for whoever asks."""
_MAP_S = 30.0


@dataclass(frozen=True)
class LiveSetup:
    """What a live agent is made of. ``source``: name of its camera or recording; ``model_name``: of ``model``, as
    product codes look for it; ``after``: newer key-frames that one waits for before the agent acts on it, None: until
    its pose is final; ``waiting``: frames that may wait for odometry."""

    rig: Rig
    source: str
    model: PlaceDescriptor
    vocabulary: WordLookup
    config: MasConfig
    live: LiveConfig = field(default_factory=LiveConfig)
    odometry: OdometryConfig = field(default_factory=OdometryConfig)
    model_name: str = "default"
    after: int | None = None
    waiting: int = 2

    def sequence(self, me: int, journal: Path | None = None) -> AgentSequence:
        """Agent ``me``'s sequence by its journal; without one as it is before the first frame."""
        observed = [] if journal is None else observed_in(journal)
        return sequence_of(observed, name_of_agent(me), self.source, self.rig.metric, descriptor_entry(self.model))

    def inputs(self, me: int) -> AgentInputs:
        """Agent ``me``, which has seen nothing and knows nobody."""
        camera = CameraEntry.from_rig(self.rig)
        entry = AgentEntry(
            name=name_of_agent(me),
            sequence=self.source,
            first_frame=0,
            frames=0,
            keyframes=0,
            tracks=0,
            start_ns=0,
            camera=camera,
        )
        manifest = Manifest(
            source=self.source,
            kind="live",
            scale="metric" if self.rig.metric else "arbitrary",
            descriptor=descriptor_entry(self.model),
            agents=(entry,),
            settings={"model": self.model_name},
        )
        inputs = inputs_of(me, manifest, entry, self.sequence(me), self.config)
        inputs.made_of = f"{self.source} {camera.model_dump_json()} {self.model.sha256}"
        return inputs


class LiveAgent:
    """``with LiveAgent(setup, out, credentials, link) as agent``: frames go to :meth:`push`, from any thread;
    :meth:`run` tracks and negotiates until :meth:`end` was called and nobody present has anything left to do.

    ``on_pose`` is called, in the thread that tracks, with each new pose. The journal in ``out`` has every key-frame and
    message before the agent acts on it; one that is there is gone on with.
    """

    def __init__(
        self,
        setup: LiveSetup,
        out: Path,
        credentials: Credentials,
        link: Link,
        on_pose: Callable[[TeamPose], None] | None = None,
    ) -> None:
        check_live(setup.config)
        self.setup, self.out, self.me = setup, out, credentials.number
        self.inputs = setup.inputs(self.me)
        self.earlier = resume(self.inputs, out / JOURNAL)
        beginning = Beginning.after(self.inputs.agent.state.keyframes)
        self._journal = Journal(out / JOURNAL)
        self._recorded = RecordedAgent(self.inputs, self._journal)
        language = self.inputs.agent.state.profile.language
        self.neighbours = Neighbours(credentials, language, link, self.inputs.max_message_bytes)
        self.drive = LiveDrive(self._recorded)
        self.cpu = CpuParts()
        self.process = AgentProcess(
            self._recorded, self.neighbours, setup.config, setup.live, self.earlier.now_ns, self.drive, self.cpu
        )
        self._revisits = Revisits(self.inputs.agent)
        self.frames = LatestFrames(setup.waiting)
        front_end = LiveFrontEnd(
            setup.rig, setup.odometry, setup.vocabulary, setup.model, setup.source, setup.after, beginning, self.cpu
        )
        self.tracker = LiveTracker(front_end, self.frames, self._passed_on, self._placed_latest)
        self.on_pose = on_pose
        self.topics = TopicWriter(setup.live.publish, credentials, link, setup.live.map_each_s)
        self._latest: LatestFrame | None = None
        self._placed = PlacedKeyFrames(self.inputs.agent.state)
        self._asked: SimpleQueue[Future[TeamMap]] = SimpleQueue()
        self._running = False

    def __enter__(self) -> LiveAgent:
        self._journal.__enter__()
        self._recorded.begin(digest_of(self.inputs), self.earlier.now_ns)
        self.tracker.front_end.warm_up()
        return self

    def __exit__(self, *_: object) -> None:
        self._journal.__exit__(None, None, None)

    # -- from any thread ----------------------------------------------------------------------------------------------

    def push(self, frame: CameraFrame) -> bool:
        """A frame of the camera, later than all before; returns at once. False: an older one, which odometry was not
        ready for, is dropped for it."""
        return self.frames.put(frame)

    def end(self) -> None:
        """No more frames come."""
        self.frames.end()

    def pose(self) -> TeamPose | None:
        """Where the camera was at the latest frame, in the team's frame; None before the first key-frame is passed on,
        and while the camera is lost."""
        latest = self._latest
        return None if latest is None else self._placed.place(latest)

    def map(self) -> TeamMap:
        """The agent's own map with the copies that it has of others', as it is between two steps of the agent.
        ``ToolError`` before the first key-frame is passed on."""
        if not self._running:
            return self._map()
        future: Future[TeamMap] = Future()
        self._asked.put(future)
        return future.result(_MAP_S)

    @property
    def played_until_ns(self) -> int | None:
        """Time stamp up to which an earlier process has used its recording: that of the latest key-frame, of a drive
        that was over the last there can be; None where nothing was."""
        if self.inputs.agent.context.closing:
            return int(np.iinfo(np.int64).max)
        return self.tracker.front_end.beginning.latest_ns

    @property
    def figures(self) -> LiveFigures:
        """Frames received, tracked and dropped, how long they took, revisits, and CPU time by part."""
        return replace(self.tracker.figures, revisits=self._revisits.times(), cpu_s=self.cpu.seconds())

    # -- the loop -----------------------------------------------------------------------------------------------------

    def run(self, progress: Callable[[LiveProgress], None] = lambda _: None) -> None:
        """Track in a thread of its own, negotiate in this one. An error of the odometry is raised in the end."""
        self._running = True
        with ThreadPoolExecutor(1, thread_name_prefix="odometry") as thread:
            tracking = thread.submit(self.tracker.run)
            tracking.add_done_callback(lambda _: self._tracked())
            try:
                self.process.run(progress, self.between)
            finally:
                self._running = False
                self.between()
                self.frames.end()
        tracking.result()

    def between(self) -> None:
        """Between two steps: poses as they are placed by now, and answers to other threads."""
        with self.cpu.part(PLACING):
            self._placed = PlacedKeyFrames(self.inputs.agent.state)
            self._revisits.look()
            self._answer()
            self._publish_map()

    def _answer(self) -> None:
        """Give other threads the map."""
        while True:
            try:
                future = self._asked.get_nowait()
            except Empty:
                return
            try:
                future.set_result(self._map())
            except MaslamError as error:  # for the thread that asked
                future.set_exception(error)

    def _publish_map(self) -> None:
        """Give out the map where somebody listens, part by part."""
        state = self.inputs.agent.state
        changes = state.version + sum(copy.version for copy in self.inputs.agent.maps.copies.values())
        if state.keyframes and self.topics.wants_map(changes):
            self.topics.map(self._map(), changes)
        self.topics.next_part()

    def write_results(self) -> None:
        """``trajectory.tum`` and the other files of one agent, and ``live.json``: what became of the frames."""
        write_own_results(self.out, self.inputs.agent, self.setup.sequence(self.me, self.out / JOURNAL))
        write_process_figures(self.out, self.process, self.topics.sent_bytes)
        write_atomically(self.out / FIGURES, self.figures.as_json())

    def _tracked(self) -> None:
        """Odometry has ended, by itself or by an error."""
        self.frames.end()
        self.drive.end()

    def _passed_on(self, observed: Observed, came_s: float) -> None:
        self._revisits.came(observed.keyframe.index, came_s)
        self.drive.put(observed)

    def _placed_latest(self, latest: LatestFrame | None) -> None:
        self._latest = latest
        pose = None if latest is None else self._placed.place(latest)
        if pose is None:
            return
        self.topics.pose(pose)
        if self.on_pose is not None:
            self.on_pose(pose)

    def _map(self) -> TeamMap:
        from maslam.mas.map_exchange.full_map import own_map
        from maslam.mas.output.fused_map import fused

        agent = self.inputs.agent
        if not agent.state.keyframes:
            raise ToolError("no map yet: the agent has no key-frame")
        one = fused([own_map(agent.state), *(copy for _, copy in sorted(agent.maps.copies.items()))])
        return TeamMap(agent.state.frame, one.points, one.owners)
