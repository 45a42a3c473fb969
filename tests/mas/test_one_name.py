"""Two processes with one certificate, broken links that one side alone notices, and certificates that do not fit."""

from __future__ import annotations

import datetime as dt
import logging
import shutil
from pathlib import Path
from typing import Any

import pytest
from memory_links import MemoryNetwork

from maslam.mas.live import authority, credentials
from maslam.mas.live.acquaintance import TWICE
from maslam.mas.live.authority import make_team
from maslam.mas.live.credentials import Credentials, CredentialsError
from maslam.mas.live.framing import DrivePhase
from maslam.mas.live.neighbours import GREETING, SEALED, Met, Neighbours, Received
from maslam.mas.live.own_name import SAME_NAME, NameTakenError
from maslam.mas.live.seals import SessionKey

pytest.importorskip("cryptography", reason="the extra 'network' is not installed")
LANGUAGE = 7
YEAR = dt.timedelta(days=365)


class Clock:
    """Seconds of the machine's clock."""

    def __init__(self) -> None:
        self.now = 100.0

    def monotonic_ns(self) -> int:
        return round(self.now * 1e9)


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    clock = Clock()
    for module in ("neighbours", "own_name"):
        monkeypatch.setattr(f"maslam.mas.live.{module}.time", clock)
    return clock


@pytest.fixture(scope="module")
def team(tmp_path_factory: pytest.TempPathFactory) -> list[Credentials]:
    return [Credentials(place) for place in make_team(tmp_path_factory.mktemp("team"), "ours", [0, 1, 2])]


def started(network: MemoryNetwork, own: Credentials) -> Neighbours:
    return Neighbours(own, LANGUAGE, network.link(own.number), 10**6)


def talk(agents: list[Neighbours], clock: Clock, seconds: float) -> list[list[Received | Met]]:
    """What each gets, ten times a second. An agent whose name is taken ends, as its process does."""
    got: list[list[Received | Met]] = [[] for _ in agents]
    for _ in range(round(10 * seconds)):
        clock.now += 0.1
        for agent, into in zip(agents, got, strict=True):
            agent.flush()
            while (came := agent.receive(0.0)) is not None:
                into += came
    return got


@pytest.mark.parametrize("apart_s", [60.0, 0.0], ids=["a minute apart", "at the same time"])
def test_the_later_of_two_processes_with_one_certificate_ends(
    team: list[Credentials],
    clock: Clock,
    caplog: pytest.LogCaptureFixture,
    monkeypatch: pytest.MonkeyPatch,
    apart_s: float,
) -> None:
    """Both and a third notice within 5 s; the first stays as it was, whichever key is the smaller."""
    network = MemoryNetwork()
    keys = sorted((SessionKey() for _ in range(2)), key=lambda key: key.public)
    given = iter([SessionKey(), *(keys[1:] if apart_s else [SessionKey(), *keys[1:]]), keys[0]])
    monkeypatch.setattr("maslam.mas.live.neighbours.SessionKey", lambda: next(given))
    other, first = started(network, team[1]), started(network, team[0])
    talk([other, first], clock, 2.0)
    clock.now += apart_s
    if not apart_s:
        network.leave(network.links[-1])
        talk([other], clock, 1.0)
        first = started(network, team[0])
    later = started(network, team[0])
    agents = [other, first, later]
    ended: list[Neighbours] = []
    got: list[list[Received | Met]] = [[], [], []]
    reasons: list[str] = []
    for _ in range(50):
        clock.now += 0.1
        other.send(0, b"you")
        for agent in [a for a in agents if a not in ended]:
            try:
                agent.flush()
                while (came := agent.receive(0.0)) is not None:
                    got[agents.index(agent)] += came
            except NameTakenError as error:
                ended.append(agent)
                reasons.append(str(error))
    assert all("agent_00: name taken" in text and "agent 0 runs already" in text for text in reasons)
    assert len(ended) == 1 and (ended == [later] or not apart_s)
    if apart_s:
        assert (got[1].count(Received(1, b"you")), got[2].count(Received(1, b"you"))) == (50, 0)
    said = [record.getMessage() for record in caplog.records if record.levelno >= logging.WARNING]
    assert sum("another process with the certificate of agent 0, this one, runs" in t for t in said) in (1, 2)
    assert not apart_s or said.count(f"agent 0: {TWICE}") == 1
    network.leave(ended[0]._link)  # type: ignore[arg-type]
    stays = first if ended == [later] else later
    talk([other, stays], clock, 3.0)
    other.send(0, b"still you")
    stays.send(1, b"still me")
    got = talk([other, stays], clock, 1.0)
    assert Received(0, b"still me") in got[0] and Received(1, b"still you") in got[1]


def test_who_has_no_copy_of_the_key_takes_no_name(team: list[Credentials], clock: Clock) -> None:
    """A recorded greeting, frames sent back to me, another member's greeting and noise end nothing."""
    network = MemoryNetwork()
    earlier = started(network, team[0])
    twin = started(network, team[0])
    with pytest.raises(NameTakenError):
        talk([earlier, twin], clock, 5.0)
    recorded = [data for sender, to, data in network.sent if sender == to == 0]
    assert {data[:1] for data in recorded} == {GREETING, SAME_NAME}
    for link in list(network.links):
        network.leave(link)
    clock.now += 100.0
    victim = started(network, team[0])
    ghost = network.link(0)
    ghost.appear("00" * 8)
    others = GREETING + team[1].greeting(SessionKey(), LANGUAGE)
    for _ in range(5):
        for data in [*recorded, others, SAME_NAME + b"x" * 21, SAME_NAME, GREETING, b"", b"\xff"]:
            network.carry(0, 0, data)
        talk([victim], clock, 1.0)
        for sender, to, data in list(network.sent[-4:]):
            network.carry(sender, to, data)
    talk([victim], clock, 1.0)


def test_a_link_that_only_one_side_saw_broken_goes_on(team: list[Credentials], clock: Clock) -> None:
    """Messages, long ones and phases; and what was recorded before does not count a second time."""
    network = MemoryNetwork()
    one, other = started(network, team[0]), started(network, team[1])
    talk([one, other], clock, 2.0)
    for k in range(10):
        one.send(1, b"early %d" % k)
        one.send(1, b"x" * 9000)
        one.announce(DrivePhase.CLOSING)
        talk([one, other], clock, 0.5)
    recorded = [data for sender, to, data in network.sent if (sender, to) == (0, 1)]
    network.cut(network.links[0])  # other loses sight of one, not the other way round
    talk([one, other], clock, 1.0)
    assert other.phases() == {} and 1 in one.phases()
    for data in recorded:
        network.carry(0, 1, data)
    assert talk([one, other], clock, 1.0)[1] == []
    network.links[1].queue.append(network.seen(network.links[0]))
    talk([one, other], clock, 2.0)
    one.announce(DrivePhase.RESTING)
    one.send(1, b"y" * 9000)
    other.send(0, b"z" * 9000)
    got = talk([one, other], clock, 3.0)
    assert got == [[Received(1, b"z" * 9000)], [Received(0, b"y" * 9000)]]
    assert other.phases() == {0: DrivePhase.RESTING}
    for data in recorded:
        network.carry(0, 1, data)
    assert talk([one, other], clock, 2.0)[1] == []


def test_a_process_that_died_unseen_gives_way_to_the_next(team: list[Credentials], clock: Clock) -> None:
    """The link still shows the dead one, as QUIC does for a lease: the next is talked to within 5 s. What was recorded
    of the dead one does not bring it back."""
    network = MemoryNetwork()
    one, dead = started(network, team[0]), started(network, team[1])
    talk([one, dead], clock, 2.0)
    recorded = [data for sender, to, data in network.sent if (sender, to) == (1, 0)]
    network.links[1].queue.clear()
    again = started(network, team[1])
    talk([one, again], clock, 5.0)
    for data in recorded:
        network.carry(1, 0, data)
    again.send(0, b"back")
    one.send(1, b"welcome")
    got = talk([one, again], clock, 2.0)
    assert Received(1, b"back") in got[0] and Received(0, b"welcome") in got[1]


# -- certificates that do not fit -------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["ca.pem", "cert.pem", "key.pem"])
@pytest.mark.parametrize(
    "content", [b"", b"-----BEGIN CERTIFICATE-----\nAAAA\n", b"\xff\xfe"], ids=["empty", "torn", "noise"]
)
def test_a_file_that_is_no_certificate_is_named(tmp_path: Path, name: str, content: bytes) -> None:
    (one,) = make_team(tmp_path, "ours", [0])
    (one / name).write_bytes(content)
    with pytest.raises(
        CredentialsError, match=rf"agent_00.{name}: no (certificate|key) \(PEM.*`maslam keys` made"
    ) as raised:
        Credentials(one)
    assert "\n" not in str(raised.value) and "unable" not in str(raised.value)


@pytest.mark.parametrize(
    ("mixed", "said"),
    [("ca.pem", "cert.pem: not signed by the authority in "), ("key.pem", "key.pem: not the key of ")],
    ids=["authority", "key"],
)
def test_files_of_two_teams_are_noticed(tmp_path: Path, mixed: str, said: str) -> None:
    (one,), (other,) = make_team(tmp_path / "a", "ours", [0]), make_team(tmp_path / "b", "ours", [0])
    shutil.copy(other / mixed, one / mixed)
    with pytest.raises(CredentialsError, match=said):
        Credentials(one)


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        ({"_DAYS": -30}, r"cert.pem: the certificate expired on \d{4}-\d\d-\d\d"),
        ({"_BEFORE": -2 * YEAR}, r"is valid from \d{4}-\d\d-\d\d on; this machine's clock shows"),
    ],
    ids=["expired", "not yet"],
)
def test_certificates_out_of_their_time(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, changed: dict[str, Any], said: str
) -> None:
    """In the agent's own folder, and shown by another whose clock is wrong."""
    (mine,) = make_team(tmp_path, "ours", [0])
    for name, value in changed.items():
        monkeypatch.setattr(authority, name, value)
    (late,) = make_team(tmp_path, "ours", [1])
    with pytest.raises(CredentialsError, match=said):
        Credentials(late)
    with monkeypatch.context() as patched:
        patched.setattr(credentials, "_not_now", lambda certificate: "")
        greeting = Credentials(late).greeting(SessionKey(), LANGUAGE)
    with pytest.raises(CredentialsError, match=r"its certificate (expired on|is valid from)"):
        Credentials(mine).check(greeting)


def test_a_greeting_of_another_version_is_said_in_words(team: list[Credentials]) -> None:
    with pytest.raises(CredentialsError, match="of another version of maslam") as raised:
        team[0].check(b"\x92\xc4\x01a\xc4\x01b")
    assert "Expected" not in str(raised.value)
    assert SEALED != GREETING != SAME_NAME != SEALED
