"""Nobody takes another's name: certificates of one authority, sealed frames, greetings."""

from __future__ import annotations

import itertools
import os
from pathlib import Path

import pytest
from memory_links import MemoryNetwork

from maslam.mas.live.authority import make_team
from maslam.mas.live.credentials import Credentials, CredentialsError
from maslam.mas.live.framing import DrivePhase
from maslam.mas.live.neighbours import GREETING, SEALED, Met, Neighbours, Received
from maslam.mas.live.seals import SealError, SessionKey

pytest.importorskip("cryptography", reason="the extra 'network' is not installed")
LANGUAGE = 7


@pytest.fixture(scope="module")
def team(tmp_path_factory: pytest.TempPathFactory) -> list[Credentials]:
    folder = tmp_path_factory.mktemp("team")
    return [Credentials(place) for place in make_team(folder, "ours", [0, 1, 2])]


@pytest.fixture(scope="module")
def strangers(tmp_path_factory: pytest.TempPathFactory) -> list[Credentials]:
    """Certificates of the same names, of another authority."""
    folder = tmp_path_factory.mktemp("strangers")
    return [Credentials(place) for place in make_team(folder, "ours", [0, 1, 2])]


def exchange(agents: list[Neighbours], rounds: int = 6) -> list[list[Received | Met]]:
    """What each gets while all send what is due."""
    got: list[list[Received | Met]] = [[] for _ in agents]
    for _ in range(rounds):
        for agent, into in zip(agents, got, strict=True):
            agent.flush()
            while (came := agent.receive(0.0)) is not None:
                into += came
    return got


def meeting(network: MemoryNetwork, credentials: list[Credentials]) -> list[Neighbours]:
    return [Neighbours(c, LANGUAGE, network.link(c.number), 10**6) for c in credentials]


# -- certificates -----------------------------------------------------------------------------------------------------


def test_a_key_is_for_its_owner_alone(tmp_path: Path) -> None:
    (one,) = make_team(tmp_path / "keys", "ours", [3])
    assert one.name == "agent_03" and Credentials(one).number == 3 and Credentials(one).team == "ours"
    if os.name == "posix":
        assert (one / "key.pem").stat().st_mode & 0o077 == 0
        assert (tmp_path / "keys" / "authority" / "key.pem").stat().st_mode & 0o077 == 0


def test_agents_are_added_to_a_team(tmp_path: Path) -> None:
    make_team(tmp_path, "ours", [0])
    (late,) = make_team(tmp_path, "ours", [5])
    first, added = Credentials(tmp_path / "agent_00"), Credentials(late)
    assert first.check(added.greeting(SessionKey(), LANGUAGE)).number == 5
    with pytest.raises(CredentialsError, match=r"agent_05: exists"):
        make_team(tmp_path, "ours", [5])
    with pytest.raises(CredentialsError, match="authority of team 'ours', not 'theirs'"):
        make_team(tmp_path, "theirs", [6])


@pytest.mark.parametrize("name", ["ca.pem", "cert.pem", "key.pem"])
def test_missing_and_damaged_certificates_are_named(tmp_path: Path, name: str) -> None:
    (one,) = make_team(tmp_path, "ours", [0])
    text = (one / name).read_bytes()
    (one / name).write_bytes(text[: len(text) // 2])
    with pytest.raises(CredentialsError, match=rf"{name}: no (certificate|key) "):
        Credentials(one)
    (one / name).unlink()
    with pytest.raises(CredentialsError, match=rf"{name}: missing; `maslam keys`"):
        Credentials(one)


def test_an_authority_is_no_agent(tmp_path: Path) -> None:
    make_team(tmp_path, "ours", [0])
    with pytest.raises(CredentialsError, match="names no agent"):
        Credentials(tmp_path / "authority")


# -- greetings and seals ----------------------------------------------------------------------------------------------


def test_two_agents_meet_and_know_each_other(team: list[Credentials]) -> None:
    agents = meeting(MemoryNetwork(), team[:2])
    assert exchange(agents) == [[Met(1)], [Met(0)]]
    agents[0].send(1, b"short")
    agents[0].send(1, b"long" * 5000)
    assert exchange(agents)[1] == [Received(0, b"short"), Received(0, b"long" * 5000)]
    agents[1].announce(DrivePhase.RESTING)
    exchange(agents)
    assert agents[0].phases() == {1: DrivePhase.RESTING} and not agents[1].busy


def test_they_meet_although_first_words_are_lost(team: list[Credentials], monkeypatch: pytest.MonkeyPatch) -> None:
    """Each greeting and each first sealed frame in turn; what is not acknowledged is sent again in its time."""
    seconds = itertools.count()
    monkeypatch.setattr("maslam.mas.live.neighbours.time.monotonic_ns", lambda: next(seconds) * 50_000_000)
    for lost in range(5):
        sent = itertools.count()
        agents = meeting(MemoryNetwork(lambda *_, sent=sent, lost=lost: next(sent) == lost), team[:2])
        got = exchange(agents, 200)
        assert got == [[Met(1)], [Met(0)]] and all(a.phases() for a in agents)


def test_another_authoritys_agent_is_not_talked_to(team: list[Credentials], strangers: list[Credentials]) -> None:
    agents = meeting(MemoryNetwork(), [team[0], strangers[1]])
    assert exchange(agents) == [[], []]
    assert "another authority" in agents[0].refusals()[1] and agents[0].phases() == {}
    agents[0].send(1, b"secret")
    exchange(agents)
    sent = agents[0].out[1]
    assert sent.greeting_bytes > 0 == sent.message_bytes == sent.frame_bytes


def test_a_name_of_another_is_refused(team: list[Credentials]) -> None:
    """Agent 2 says that it is agent 1: with its own certificate, with agent 1's greeting, and with frames it made."""
    network = MemoryNetwork()
    victim, real = meeting(network, team[:2])
    exchange([victim, real])
    real.send(0, b"mine")
    real.flush()
    genuine = [data for sender, to, data in network.sent if (sender, to) == (1, 0)]
    greeting = next(data for data in genuine if data[:1] == GREETING)
    sealed = [data for data in genuine if data[:1] == SEALED]
    exchange([victim, real])
    own = GREETING + team[2].greeting(SessionKey(), LANGUAGE)
    made = SEALED + SessionKey().seals(2, 0, b"\5" * 32).seal(sealed[-1][13:])
    for forged in (own, greeting, *sealed, made, SEALED, GREETING, b"", b"\xff", GREETING + b"\x95" * 5000):
        network.carry(1, 0, forged)
        assert exchange([victim, real])[0] == []
    real.send(0, b"still mine")
    assert exchange([real, victim])[1] == [Received(1, b"still mine")]


def test_a_changed_frame_is_refused(team: list[Credentials]) -> None:
    network = MemoryNetwork()
    agents = meeting(network, team[:2])
    exchange(agents)
    agents[1].send(0, b"ten metres")
    agents[1].flush()
    frame = bytearray(next(d for s, t, d in reversed(network.sent) if (s, t) == (1, 0)))
    frame[-1] ^= 1
    network.links[0].queue.clear()
    network.carry(1, 0, bytes(frame))
    assert exchange(agents)[0] == [] and agents[0].refused == 1


def test_a_process_that_began_anew_is_met_again(team: list[Credentials]) -> None:
    network = MemoryNetwork()
    agents = meeting(network, team[:2])
    exchange(agents)
    network.leave(network.links[1])
    exchange(agents[:1])
    assert agents[0].phases() == {}
    agents[1] = meeting(network, team[1:2])[0]
    assert exchange(agents) == [[Met(1)], [Met(0)]]
    agents[0].send(1, b"welcome back")
    assert exchange(agents)[1] == [Received(0, b"welcome back")]


def test_another_model_and_another_version_are_said(team: list[Credentials], monkeypatch: pytest.MonkeyPatch) -> None:
    network = MemoryNetwork()
    one = Neighbours(team[0], LANGUAGE, network.link(0), 10**6)
    other = Neighbours(team[1], LANGUAGE + 1, network.link(1), 10**6)
    exchange([one, other])
    assert "descriptor model" in one.refusals()[1] and "descriptor model" in other.refusals()[0]
    monkeypatch.setattr("maslam.mas.live.credentials.VERSION", 99)
    agents = meeting(MemoryNetwork(), team[:2])
    exchange(agents)
    assert "version 99 of the protocol" in agents[0].refusals()[1]


def test_frames_are_taken_once_and_in_any_order() -> None:
    mine, theirs = SessionKey(), SessionKey()
    out, into = mine.seals(0, 1, theirs.public), theirs.seals(1, 0, mine.public)
    sealed = [out.seal(bytes([k])) for k in range(200)]
    order = [3, 1, 0, 2, *range(199, 3, -1)]
    assert [into.open(sealed[k]) for k in order] == [bytes([k]) for k in order]
    assert all(into.open(one) is None for one in sealed)
    late = out.seal(b"late")
    for _ in range(2000):
        assert into.open(out.seal(b"x")) == b"x"
    assert into.open(late) is None  # too far behind to know whether it came before
    assert out.open(sealed[0]) is None  # my own, sent back to me


def test_a_weak_public_key_is_refused() -> None:
    """A point of small order would make a key that everybody knows."""
    with pytest.raises(SealError):
        SessionKey().seals(0, 1, bytes(32))
    with pytest.raises(SealError):
        SessionKey().seals(0, 1, b"short")


def test_greetings_cannot_keep_an_agent_busy(team: list[Credentials], monkeypatch: pytest.MonkeyPatch) -> None:
    looked_at = 0
    check = Credentials.check

    def counted(self: Credentials, data: bytes) -> object:
        nonlocal looked_at
        looked_at += 1
        return check(self, data)

    monkeypatch.setattr(Credentials, "check", counted)
    network = MemoryNetwork()
    (one,) = meeting(network, team[:1])
    for _ in range(500):
        network.carry(1, 0, GREETING + b"x" * 100)
    exchange([one])
    assert looked_at <= 5 and len(network.sent) - 500 <= 1
