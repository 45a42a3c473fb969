"""Why nobody answers at an address: against listeners of Zenoh, of Python, and none."""

from __future__ import annotations

import socket
from pathlib import Path

import pytest

from maslam.mas.live import authority
from maslam.mas.live.authority import make_team
from maslam.mas.transport.reachability import reasons
from maslam.mas.transport.zenoh_link import LinkAddresses, ZenohLink

pytest.importorskip("zenoh", reason="the extra 'network' is not installed")


@pytest.fixture(scope="module")
def ours(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    return make_team(tmp_path_factory.mktemp("ours"), "ours", [0, 1])


@pytest.fixture(scope="module")
def theirs(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    return make_team(tmp_path_factory.mktemp("theirs"), "ours", [0])


@pytest.fixture
def free() -> int:
    """A port of this machine that nobody listens on."""
    with socket.socket() as one:
        one.bind(("127.0.0.1", 0))
        port = int(one.getsockname()[1])
    return port


def test_who_answers_is_no_reason(ours: list[Path], free: int) -> None:
    with ZenohLink(1, "ours", LinkAddresses([f"tls/127.0.0.1:{free}"], [], ours[1])):
        assert reasons([f"tls/127.0.0.1:{free}", f"tls/localhost:{free}"], ours[0]) == []


def test_another_authority_is_named(ours: list[Path], theirs: list[Path], free: int) -> None:
    address = f"tls/127.0.0.1:{free}"
    with ZenohLink(0, "ours", LinkAddresses([address], [], theirs[0])):
        assert reasons([address], ours[0]) == [f"{address}: its certificate is of another authority"]


def test_a_listener_that_refuses_this_agent_is_named(
    ours: list[Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, free: int
) -> None:
    """Its clock is ahead, or this agent's folder has expired: it is its word that counts."""
    monkeypatch.setattr(authority, "_DAYS", -30)
    home = ours[0].parent
    (late,) = make_team(home, "ours", [5])
    address = f"tls/127.0.0.1:{free}"
    with ZenohLink(1, "ours", LinkAddresses([address], [], ours[1])):
        assert ["refuses this agent's certificate" in text for text in reasons([address], late)] == [True]
    with ZenohLink(5, "ours", LinkAddresses([address], [], late)):
        assert reasons([address], ours[0]) == [f"{address}: its certificate has expired, by this machine's clock"]


def test_nobody_and_what_is_no_agent_are_told_apart(ours: list[Path], free: int) -> None:
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        silent = f"tls/127.0.0.1:{other.getsockname()[1]}"
        said = reasons([f"tls/127.0.0.1:{free}", f"quic/127.0.0.1:{free}", silent, "tls/nowhere"], ours[0])
    assert said[0] == f"tls/127.0.0.1:{free}: nobody listens there (yet)"
    assert said[1] == f"quic/127.0.0.1:{free}: nobody listens there (yet)"
    assert said[2].startswith(f"{silent}: no answer")
    assert said[3] == "tls/nowhere: not an address like tls/192.168.1.10:7447"
