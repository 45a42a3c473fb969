"""Agents with cameras that go on: they track, negotiate, know where they are, and go on from their journals."""

from __future__ import annotations

import time
from dataclasses import dataclass, field, replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from memory_links import MemoryNetwork
from test_agent_process import Clock

import maslam
from maslam._replaced import replaced
from maslam.backend.geometry import se3_inverse
from maslam.descriptors.inference import NetVlad
from maslam.frontend.config import OdometryConfig
from maslam.frontend.datasets import ImageSequence, open_dataset
from maslam.frontend.vocabulary.vocabulary import Vocabulary
from maslam.mas.live import process as process_module
from maslam.mas.live.authority import make_team
from maslam.mas.live.config import LINKS, LiveConfig
from maslam.mas.live.credentials import Credentials
from maslam.mas.live.framing import DrivePhase
from maslam.mas.live.journal import JournalError
from maslam.mas.live.process import LiveProgress
from maslam.mas.live.team_pose import TeamPose
from maslam.mas.policies.presets import preset
from maslam.tools.common.errors import ToolError
from maslam.tools.live.agent import JOURNAL, LiveAgent, LiveSetup
from maslam.tools.live.sources import stored_frame

pytest.importorskip("cryptography", reason="the extra 'network' is not installed")
PLAIN = preset("maslam")
CONFIG = replaced(PLAIN, link=LINKS["cable"], places=replaced(PLAIN.places, gap_keyframes=2))
ODOMETRY = OdometryConfig()
ODOMETRY = replaced(ODOMETRY, mapping=replaced(ODOMETRY.mapping, window=6, fixed=2))


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    clock = Clock()
    monkeypatch.setattr(process_module, "time", clock)
    monkeypatch.setattr("maslam.mas.live.neighbours.time", clock)
    return clock


@dataclass
class LiveTeam:
    """Two agents whose frames, threads and clocks a test moves on."""

    folder: Path
    clock: Clock
    sequences: list[ImageSequence]
    poses: dict[int, list[TeamPose]] = field(default_factory=lambda: {0: [], 1: []})

    def __post_init__(self) -> None:
        self.network = MemoryNetwork()
        self.credentials = [Credentials(place) for place in make_team(self.folder / "keys", "ours", [0, 1])]
        self.model, self.vocabulary = NetVlad.load(), Vocabulary.load(None)
        self.agents: dict[int, LiveAgent] = {}
        self.next = {0: 0, 1: 0}
        self.over: set[int] = set()

    def setup_of(self, me: int) -> LiveSetup:
        sequence = self.sequences[me]
        live = LiveConfig(settle_s=1.0, alone_s=3.0)
        return LiveSetup(sequence.rig, sequence.name, self.model, self.vocabulary, CONFIG, live, ODOMETRY)

    def start(self, me: int) -> LiveAgent:
        out = self.folder / str(me)
        out.mkdir(exist_ok=True)
        agent = LiveAgent(
            self.setup_of(me), out, self.credentials[me], self.network.link(me), self.poses[me].append
        ).__enter__()
        self.agents[me] = agent
        return agent

    def kill(self, me: int) -> LiveAgent:
        agent = self.agents.pop(me)
        agent.__exit__()
        self.network.leave(next(link for link in self.network.links if link.me == me))
        return agent

    def drive(self, me: int, until: int) -> None:
        """The next frames, tracked at once; at the end of the sequence the drive is over."""
        agent, sequence = self.agents[me], self.sequences[me]
        for index in range(self.next[me], until):
            assert agent.push(stored_frame(sequence, index))
            taken = agent.frames.take(0)
            assert taken is not None
            agent.tracker.track(taken)
            self.go_on(0.1)
        self.next[me] = until
        if until == len(sequence):
            agent.end()
            agent.tracker.finish()
            agent.drive.end()

    def go_on(self, seconds: float) -> None:
        end = self.clock.now + seconds
        while self.agents.keys() - self.over and self.clock.now < end:
            self.clock.now += 0.02
            for me, agent in self.agents.items():
                if me not in self.over and not agent.process.step(lambda _: None):
                    self.over.add(me)
                agent.between()


@pytest.fixture
def team(tmp_path: Path, clock: Clock, town_stereo: Path) -> LiveTeam:
    return LiveTeam(tmp_path, clock, open_dataset(town_stereo).sequences)


def true_pose(sequence: ImageSequence, stamp_ns: int) -> np.ndarray:
    assert sequence.groundtruth is not None
    return sequence.groundtruth.poses[int(np.searchsorted(sequence.groundtruth.stamps_ns, stamp_ns))]


def test_agents_join_while_they_drive_and_know_where_they_are(team: LiveTeam) -> None:
    first, second = team.start(0), team.start(1)
    assert first.pose() is None
    for until in (5, 10, 15, 20):
        team.drive(0, until)
        team.drive(1, until)
    team.go_on(60)
    assert team.over == {0, 1}
    here = [agent.pose() for agent in (first, second)]
    assert here[0] is not None and here[1] is not None
    assert here[0].frame == here[1].frame and here[0].members == here[1].members == {0, 1}
    # Between two cameras of one frame, as ground truth has them.
    apart = se3_inverse(here[0].T_F_C) @ here[1].T_F_C
    true = se3_inverse(true_pose(team.sequences[0], here[0].stamp_ns)) @ true_pose(team.sequences[1], here[1].stamp_ns)
    assert np.linalg.norm(apart[:3, 3] - true[:3, 3]) < 0.3
    shared = second.map()
    assert shared.frame == here[1].frame and set(shared.owners.tolist()) == {0, 1}
    assert shared.points.shape == (len(shared.owners), 3)
    for agent in (first, second):
        figures = agent.figures
        assert (figures.received, figures.tracked, figures.dropped, figures.lost) == (20, 20, 0, 0)
        assert figures.keyframes == len(agent.inputs.agent.state.keyframes) >= 6
    # Each accepted match was one agent's query, and all are in its poses by now.
    times = [agent.figures.revisits for agent in (first, second)]
    asked = [sum(m.query_agent == k for m in a.inputs.agent.state.accepted) for k, a in enumerate((first, second))]
    assert [one.revisits for one in times] == asked and sum(asked) > 0
    for one in times:
        assert one.uncorrected == 0 and one.passed_on_mean_s <= one.accepted_mean_s <= one.corrected_mean_s
        assert one.corrected_mean_s <= one.corrected_most_s


def test_poses_come_by_callback_as_the_agent_has_them(team: LiveTeam) -> None:
    """Alone, in its own frame: where odometry is, which ground truth bears out."""
    agent = team.start(0)
    team.drive(0, 20)
    poses, (sequence, _) = team.poses[0], team.sequences
    assert len(poses) >= 8 and poses[-1].stamp_ns == sequence.stamps_ns[19]
    begin = se3_inverse(true_pose(sequence, int(sequence.stamps_ns[0])))
    for pose in poses:
        assert (pose.frame.agent, pose.frame.track, pose.members) == (0, 0, {0}) and pose.metric
        true = begin @ true_pose(sequence, pose.stamp_ns)
        assert np.linalg.norm(pose.T_F_C[:3, 3] - true[:3, 3]) < 0.1
    latest = agent.pose()
    assert latest is not None and np.allclose(latest.T_F_C, poses[-1].T_F_C, atol=0.05)


def test_a_key_frame_is_in_the_journal_before_the_agent_acts_on_it(team: LiveTeam) -> None:
    """Killed on the way, it goes on with all its key-frames, in a new track; its results are of both."""
    team.start(0)
    team.drive(0, 12)
    team.go_on(1.0)
    before = team.kill(0)
    seen = before.inputs.seen
    assert seen >= 3
    again = team.start(0)
    assert again.inputs.seen == seen and again.earlier.begun == 1
    assert np.array_equal(again.inputs.agent.state.poses, before.inputs.agent.state.poses)
    team.drive(0, 20)
    team.go_on(60)
    keyframes = again.inputs.agent.state.keyframes
    assert [k.index for k in keyframes] == list(range(len(keyframes))) and len(keyframes) > seen
    assert {k.track for k in keyframes} == {0, 1}
    assert all(a.stamp_ns < b.stamp_ns for a, b in pairwise(keyframes))
    again.write_results()
    rows = (again.out / "trajectory.tum").read_text().splitlines()
    assert len(rows) >= seen and (again.out / "map.ply").is_file() and (again.out / "live.json").is_file()
    sequence = again.setup.sequence(0, again.out / JOURNAL)
    assert [len(track) for track in sequence.tracks] == [seen, len(keyframes) - seen]
    assert len(sequence.trajectory) >= seen + 8


def test_another_cameras_journal_is_refused(team: LiveTeam) -> None:
    team.start(0)
    team.drive(0, 2)
    team.kill(0)
    team.sequences[0] = replace(team.sequences[0], name="another drive")
    with pytest.raises(JournalError, match="another sequence"):
        team.start(0)


def test_an_agent_runs_in_two_threads_until_its_drive_is_over(team: LiveTeam, monkeypatch: pytest.MonkeyPatch) -> None:
    """By the machine's own clock: frames from another thread, more than odometry is ready for."""
    monkeypatch.setattr(process_module, "time", time)
    monkeypatch.setattr("maslam.mas.live.neighbours.time", time)
    agent = team.start(0)
    agent.process.live = LiveConfig(settle_s=0.0, alone_s=0.0)
    for index in range(20):
        agent.push(stored_frame(team.sequences[0], index))
    agent.end()
    with pytest.raises(ToolError, match="no map yet"):
        agent.map()
    steps: list[LiveProgress] = []
    agent.run(steps.append)
    figures = agent.figures
    assert figures.received == 20 and figures.dropped == 18 and figures.tracked + figures.lost == 2
    assert agent.drive.over and steps[-1].phase is DrivePhase.RESTING


def test_an_error_of_the_odometry_ends_the_agent(team: LiveTeam, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(process_module, "time", time)
    monkeypatch.setattr("maslam.mas.live.neighbours.time", time)
    agent = team.start(0)
    agent.process.live = LiveConfig(settle_s=0.0, alone_s=0.0)
    monkeypatch.setattr(agent.tracker.front_end, "process", lambda *_: 1 // 0)
    agent.push(stored_frame(team.sequences[0], 0))
    with pytest.raises(ZeroDivisionError):
        agent.run()
    assert agent.drive.over and agent.frames.over


def test_the_face_has_an_agent_that_takes_frames(town_stereo: Path, tmp_path: Path) -> None:
    """``maslam.Agent``: frames in; pose, map and figures at any time; results at the end of the block."""
    (keys,) = make_team(tmp_path / "keys", "ours", [0])
    sequence = open_dataset(town_stereo).sequences[0]
    settings = {"odometry": {"mapping.window": 6, "mapping.fixed": 2}}
    poses: list[maslam.TeamPose] = []
    link = MemoryNetwork().link(0)
    link.listened = {"pose", "map"}
    agent = maslam.Agent(
        sequence.rig,
        tmp_path / "out",
        keys,
        settings=settings,
        on_pose=poses.append,
        publish=["pose"],
        live=LiveConfig(settle_s=0.0, alone_s=0.0),
        link=link,
    )
    with pytest.raises(RuntimeError, match="in a `with` block"):
        agent.pose()
    with agent:
        with pytest.raises(maslam.MaslamError, match="no map yet"):
            agent.map()
        for index in range(20):
            assert agent.push(sequence.read(index))
            while agent.figures.tracked <= index:
                time.sleep(0.002)
        pose = agent.pose()
        assert pose is not None and pose.stamp_ns == sequence.stamps_ns[19] and pose.members == {0}
        agent.end()
        agent.wait(60)
        one = agent.map()
        assert len(one.points) > 1000 and set(one.owners.tolist()) == {0}
    assert len(poses) >= 8 and (tmp_path / "out" / "trajectory.tum").is_file()
    assert [topic for topic, _ in link.published] == ["pose"] * len(poses)
