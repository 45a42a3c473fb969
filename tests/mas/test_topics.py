"""Topics: whoever listens gets what the agent said, proven to be of it; nobody else's word, nothing twice."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from memory_links import MemoryLink, MemoryNetwork

import maslam
from maslam.api import watch as watch_module
from maslam.mas.live import topic_writer as topic_writer_module
from maslam.mas.live.authority import make_team, revoke
from maslam.mas.live.credentials import Credentials
from maslam.mas.live.team_pose import TeamMap, TeamPose
from maslam.mas.live.topic_reader import AgentMap, AgentPose, TopicReader
from maslam.mas.live.topic_writer import TopicWriter
from maslam.mas.live.topics import (
    MOST_PARTS,
    PART_POINTS,
    LiveTopic,
    MapPartBody,
    PoseBody,
    TopicError,
    TopicSample,
    decode_map_part,
    decode_pose,
    decode_sample,
    encode_map,
    encode_pose,
    topics_named,
)
from maslam.mas.protocol.ids import FrameId
from maslam.mas.transport.zenoh_topics import TopicArrived

pytest.importorskip("cryptography", reason="the extra 'network' is not installed")


def pose_at(x: float, stamp_ns: int = 5) -> TeamPose:
    angle = 0.3
    T_F_C = np.eye(4)
    T_F_C[:2, :2] = [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
    T_F_C[:3, 3] = x, -2.0, 1e3 / 3
    return TeamPose(stamp_ns, T_F_C, FrameId(2, 1), frozenset({0, 2, 7}), True)


def map_of(count: int) -> TeamMap:
    rng = np.random.default_rng(count)
    return TeamMap(FrameId(1, 0), rng.normal(0, 50, (count, 3)), rng.integers(0, 9, count).astype(np.int32))


class Clock:
    def __init__(self) -> None:
        self.now = 100.0

    def monotonic(self) -> float:
        return self.now

    def time_ns(self) -> int:
        return round(self.now * 1e9)


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    clock = Clock()
    monkeypatch.setattr(topic_writer_module, "time", clock)
    return clock


@pytest.fixture(scope="module")
def folders(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """Agents 0 to 2, and with 9 somebody who listens."""
    return make_team(tmp_path_factory.mktemp("keys") / "keys", "ours", [0, 1, 2, 9])


@pytest.fixture
def link() -> MemoryLink:
    link = MemoryNetwork().link(0)
    link.listened = {"pose", "map"}
    return link


def writer_of(folder: Path, link: MemoryLink, *topics: LiveTopic) -> TopicWriter:
    return TopicWriter(frozenset(topics or LiveTopic), Credentials(folder), link, 10.0)


def test_what_is_read_is_what_was_given_out(folders: list[Path], link: MemoryLink, clock: Clock) -> None:
    writer, reader = writer_of(folders[0], link), TopicReader(Credentials(folders[3]))
    given, whole = pose_at(4.0), map_of(2 * PART_POINTS + 17)
    writer.pose(given)
    assert writer.wants_map(1)
    writer.map(whole, 1)
    for _ in range(5):
        writer.next_part()
    assert [topic for topic, _ in link.published] == ["pose", "map", "map", "map"]
    found = [reader.take(LiveTopic(topic), 0, data) for topic, data in link.published]
    assert found[1] is found[2] is None
    assert isinstance(found[0], AgentPose) and isinstance(found[3], AgentMap)
    read = found[0].pose
    assert (read.stamp_ns, read.frame, read.members, read.metric) == (5, given.frame, given.members, True)
    assert np.array_equal(read.T_F_C, given.T_F_C) and found[0].agent == found[3].agent == 0
    assert found[3].total == len(whole.points) and found[3].map.frame == whole.frame
    assert np.array_equal(found[3].map.points, whole.points.astype(np.float32))
    assert np.array_equal(found[3].map.owners, whole.owners)
    assert writer.sent_bytes == sum(len(data) for _, data in link.published)
    assert reader.refused == 0


def test_topics_go_by_their_names(folders: list[Path]) -> None:
    assert topics_named(["map", "pose"]) == set(LiveTopic) and topics_named([]) == frozenset()
    with pytest.raises(TopicError, match="no topic 'poses': only pose, map"):
        topics_named(["poses"])
    with pytest.raises(maslam.MaslamError, match="no topic 'x'"):
        maslam.Watch(folders[3], topics=["x"])  # type: ignore[list-item]


class Flood:
    """Topics on which somebody puts what nobody believes, without end."""

    dropped = 7

    def __init__(self, clock: Clock) -> None:
        self.taken, self._clock = 0, clock

    def receive(self, wait_s: float) -> TopicArrived:
        self.taken += 1
        self._clock.now += 0.1
        assert self.taken < 1000, "it would go on for ever"
        return TopicArrived("pose", 0, b"nothing")


def test_a_listener_gets_its_time_back_from_a_flood(
    folders: list[Path], clock: Clock, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(watch_module, "time", clock)
    watch, flood = maslam.Watch(folders[3]), Flood(clock)
    monkeypatch.setattr(watch, "_topics", flood)
    assert watch.next(1.0) is None
    assert watch.refused == flood.taken <= 11 and "cannot be read" in watch.reason
    assert watch.dropped == 7


def test_nothing_is_sent_where_nobody_listens(folders: list[Path], link: MemoryLink, clock: Clock) -> None:
    link.listened = set()
    writer = writer_of(folders[0], link)
    writer.pose(pose_at(0.0))
    assert not writer.wants_map(1) and link.published == [] and writer.sent_bytes == 0
    link.listened = {"pose", "map"}
    only_map = writer_of(folders[0], link, LiveTopic.MAP)
    only_map.pose(pose_at(0.0))
    assert link.published == [] and only_map.wants_map(1)
    assert not writer_of(folders[0], link, LiveTopic.POSE).wants_map(1)


def test_a_map_is_given_out_when_it_has_changed_and_not_too_often(
    folders: list[Path], link: MemoryLink, clock: Clock
) -> None:
    writer = writer_of(folders[0], link)
    writer.map(map_of(PART_POINTS + 1), 1)
    writer.next_part()
    clock.now += 60
    assert not writer.wants_map(2)  # the second part is still to go
    writer.next_part()
    assert not writer.wants_map(1)
    assert writer.wants_map(2)
    writer.map(map_of(3), 2)
    writer.next_part()
    assert not writer.wants_map(3)
    clock.now += 10
    assert writer.wants_map(3)


def test_the_certificate_goes_along_once_a_second(folders: list[Path], link: MemoryLink, clock: Clock) -> None:
    writer = writer_of(folders[0], link)
    for _ in range(11):
        writer.pose(pose_at(0.0))
        clock.now += 0.2
    shown = [bool(decode_sample(data).certificate) for _, data in link.published]
    assert shown == [k % 5 == 0 for k in range(11)]
    late = TopicReader(Credentials(folders[3]))
    found = [late.take(LiveTopic.POSE, 0, data) for _, data in link.published[3:]]
    assert [one is not None for one in found] == [False, False] + [True] * 6
    assert late.refused == 0
    assert len(link.published[1][1]) < 300


def test_old_samples_and_those_of_an_earlier_process_are_not_taken(
    folders: list[Path], link: MemoryLink, clock: Clock
) -> None:
    writer_of(folders[0], link).pose(pose_at(1.0))
    clock.now += 5
    later = writer_of(folders[0], link)
    later.pose(pose_at(2.0))
    later.pose(pose_at(3.0))
    first, second, third = (data for _, data in link.published)
    reader = TopicReader(Credentials(folders[3]))
    found = [reader.take(LiveTopic.POSE, 0, data) for data in (second, second, first, third, second)]
    assert [one is not None for one in found] == [True, False, False, True, False]
    assert reader.take(LiveTopic.POSE, 0, first) is None


def test_only_the_agent_itself_speaks_in_its_name(
    folders: list[Path], link: MemoryLink, clock: Clock, tmp_path: Path
) -> None:
    """Another agent of the team, another team, another topic, a changed body or number: refused, and nothing of them
    is in the way of the next true sample."""
    writer_of(folders[1], link).pose(pose_at(1.0))
    (_, of_another) = link.published.pop()
    (stranger,) = make_team(tmp_path / "others", "ours", [0])
    writer_of(stranger, link).pose(pose_at(1.0))
    (_, of_stranger) = link.published.pop()
    writer_of(folders[0], link).pose(pose_at(1.0))
    (_, true) = link.published.pop()
    sample = decode_sample(true)
    changed = [
        msgspec.structs.replace(sample, body=encode_pose(pose_at(9.0))),
        msgspec.structs.replace(sample, number=7),
        msgspec.structs.replace(sample, began_ns=sample.began_ns + 1),
        msgspec.structs.replace(sample, certificate=Credentials(folders[1]).certificate),
    ]
    wrong = [of_another, of_stranger, *(msgspec.msgpack.encode(one) for one in changed), b"", b"\x00" * 200]
    reader = TopicReader(Credentials(folders[3]))
    for count, data in enumerate(wrong, 1):
        assert reader.take(LiveTopic.POSE, 0, data) is None
        assert reader.refused == count and reader.reason.startswith("agent 0: ")
    assert reader.take(LiveTopic.MAP, 0, true) is None and reader.refused == len(wrong) + 1
    assert "signature that is not its own" in reader.reason
    assert isinstance(reader.take(LiveTopic.POSE, 0, true), AgentPose)


def test_a_revoked_agent_is_no_longer_believed(tmp_path: Path, link: MemoryLink, clock: Clock) -> None:
    folder = tmp_path / "keys"
    mine, listener = make_team(folder, "ours", [0, 9])
    writer, reader = writer_of(mine, link), TopicReader(Credentials(listener))
    writer.pose(pose_at(1.0))
    assert reader.take(LiveTopic.POSE, 0, link.published[-1][1]) is not None
    assert listener / "revoked.pem" in revoke(folder, 0)
    clock.now += 2.0
    reader = TopicReader(Credentials(listener))
    writer.pose(pose_at(2.0))
    assert reader.take(LiveTopic.POSE, 0, link.published[-1][1]) is None
    assert "revoked" in reader.reason


def test_a_large_map_is_thinned_and_says_so(folders: list[Path]) -> None:
    most = PART_POINTS * MOST_PARTS
    whole = TeamMap(FrameId(0, 0), np.zeros((most + 5, 3)), np.zeros(most + 5, dtype=np.int32))
    bodies = list(encode_map(whole, 3))
    assert len(bodies) == MOST_PARTS and max(len(b) for b in bodies) < 30_000
    part = decode_map_part(bodies[-1])
    assert (part.total, part.part, part.parts, len(part.points)) == (most + 5, MOST_PARTS - 1, MOST_PARTS, PART_POINTS)


def test_bodies_that_make_no_sense_are_refused() -> None:
    pose = msgspec.msgpack.decode(encode_pose(pose_at(1.0)), type=PoseBody)
    part = msgspec.msgpack.decode(next(encode_map(map_of(9), 0)), type=MapPartBody)
    encode, change = msgspec.msgpack.encode, msgspec.structs.replace
    for k, value in ((0, float("nan")), (0, 1.2), (3, 1e12), (3, float("inf"))):
        wrong = [*pose.T_F_C]
        wrong[k] = value
        with pytest.raises(TopicError):
            decode_pose(encode(change(pose, T_F_C=tuple(wrong))))
    mirrored = tuple(-x for x in pose.T_F_C)
    bodies = [
        change(pose, T_F_C=mirrored),
        change(pose, T_F_C=pose.T_F_C[:11]),
        change(pose, members=(-1,)),
        change(pose, stamp_ns=2**63),
    ]
    for one in bodies:
        with pytest.raises(TopicError):
            decode_pose(encode(one))
    nowhere = np.full((9, 3), np.nan, dtype="<f4").tobytes()
    bounds = [{"part": 1}, {"parts": MOST_PARTS + 1}, {"owners": part.owners[:-1]}, {"points": nowhere}]
    for fields in [*bounds, {"points": part.points[:-4]}, {"points": bytes(12 * (PART_POINTS + 1))}]:
        with pytest.raises(TopicError):
            decode_map_part(encode(change(part, **fields)))


@settings(max_examples=200, deadline=None)
@given(st.binary(max_size=300), st.integers(0, 10_000), st.integers(0, 255))
def test_damaged_bytes_are_refused_or_read(noise: bytes, at: int, byte: int) -> None:
    """Whatever comes: a value or a :class:`TopicError`."""
    sample = TopicSample(3, 4, encode_pose(pose_at(1.0)), b"s" * 70)
    whole = [msgspec.msgpack.encode(sample), sample.body, next(encode_map(map_of(20), 0))]
    for decode, data in zip((decode_sample, decode_pose, decode_map_part), whole, strict=True):
        damaged = bytearray(data)
        damaged[at % len(damaged)] = byte
        for one in (bytes(damaged), noise, data[: at % len(data)]):
            try:
                decode(one)
            except TopicError:
                continue


def test_two_agents_do_not_disturb_each_other(folders: list[Path], clock: Clock) -> None:
    """Maps of two agents whose parts come in turns."""
    network = MemoryNetwork()
    links = [network.link(k) for k in range(2)]
    reader = TopicReader(Credentials(folders[3]))
    maps = [replace(map_of(PART_POINTS + 3 + k), frame=FrameId(k, 0)) for k in range(2)]
    writers = []
    for folder, link, whole in zip(folders, links, maps, strict=False):
        link.listened = {"map"}
        writers.append(writer_of(folder, link))
        writers[-1].map(whole, 0)
    found = []
    for _ in range(2):
        for agent, (writer, link) in enumerate(zip(writers, links, strict=True)):
            writer.next_part()
            found.append(reader.take(LiveTopic.MAP, agent, link.published[-1][1]))
    assert found[0] is found[1] is None
    for agent, one in enumerate(found[2:]):
        assert isinstance(one, AgentMap) and one.agent == agent and one.map.frame == FrameId(agent, 0)
        assert len(one.map.points) == PART_POINTS + 3 + agent
