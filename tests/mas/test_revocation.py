"""A certificate that the authority takes back: the list spreads, the agent is refused, and only the authority can."""

from __future__ import annotations

import contextlib
import os
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
from memory_links import MemoryNetwork
from test_one_name import Clock, clock, started, talk  # noqa: F401

from maslam.mas.live.authority import make_team, revoke
from maslam.mas.live.credentials import Credentials, CredentialsError
from maslam.mas.live.framing import RevokedNotice
from maslam.mas.live.neighbours import REVOKED as LIST
from maslam.mas.live.neighbours import Received
from maslam.mas.live.revocation import REVOKED, RevokedError, UnsignedListError
from maslam.mas.live.seals import SessionKey
from maslam.tools import cli


@pytest.fixture
def folders(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, clock: Clock) -> list[Path]:  # noqa: F811
    """Robots' folders, copied away from home."""
    monkeypatch.setattr("maslam.mas.live.revocation.time", clock)
    robots = [tmp_path / "robots" / place.name for place in make_team(tmp_path / "home", "ours", [0, 1, 2, 3])]
    for robot in robots:
        shutil.copytree(tmp_path / "home" / robot.name, robot)
    return robots


def home_of(folders: list[Path]) -> Path:
    return folders[0].parents[1] / "home"


@pytest.mark.parametrize("loss", [0.0, 0.3], ids=["no loss", "30 % loss"])
def test_a_revoked_agent_is_refused_by_all_within_seconds(folders: list[Path], clock: Clock, loss: float) -> None:  # noqa: F811
    """The list reaches one robot; it comes to the others, also to one that starts later."""
    rng = np.random.default_rng(3)
    network = MemoryNetwork(lambda *_: rng.random() < loss)
    agents = [started(network, Credentials(folder)) for folder in folders[:3]]
    talk(agents, clock, 10.0)
    assert all(len(agent.phases()) == 2 for agent in agents)
    revoke(home_of(folders), 2)
    shutil.copy(home_of(folders) / "agent_00" / REVOKED, folders[0] / REVOKED)
    with contextlib.suppress(RevokedError) if loss else pytest.raises(RevokedError, match="certificate was revoked"):
        talk(agents, clock, 5.0)
    agents[2].flush = lambda: None  # type: ignore[method-assign]  # its process has ended, and says nothing
    agents[2].receive = lambda wait_s: None  # type: ignore[method-assign]
    talk(agents[:2], clock, 5.0)
    assert [set(agent.phases()) for agent in agents[:2]] == [{1}, {0}]
    late = started(network, Credentials(folders[3]))
    talk([*agents[:2], late], clock, 5.0)
    assert [set(agent.phases()) for agent in (*agents[:2], late)] == [{1, 3}, {0, 3}, {0, 1}]
    again = started(network, Credentials(folders[2]))
    agents[0].send(2, b"secret")
    with pytest.raises(RevokedError):
        talk([*agents[:2], late, again], clock, 5.0)
    again.flush = lambda: None  # type: ignore[method-assign]
    again.receive = lambda wait_s: None  # type: ignore[method-assign]
    assert talk([*agents[:2], late, again], clock, 2.0)[3] == []
    assert all("was revoked" in agent.refusals()[2] for agent in (*agents[:2], late))


def test_only_the_authority_takes_back(folders: list[Path], clock: Clock, tmp_path: Path) -> None:  # noqa: F811
    """A member signs a list, an older list comes again, bytes are changed: nothing changes."""
    home = home_of(folders)
    first = revoke(home, 3)[0].read_bytes()
    second = revoke(home, 2)[0].read_bytes()
    make_team(tmp_path / "other", "ours", [0, 1, 2, 3])
    foreign = [revoke(tmp_path / "other", agent)[0].read_bytes() for agent in range(4)][-1]
    network = MemoryNetwork()
    (folders[0] / REVOKED).write_bytes(second)
    one, liar = started(network, Credentials(folders[0])), started(network, Credentials(folders[1]))
    talk([one, liar], clock, 3.0)
    known = one._credentials.revocations
    assert known.newest.number == 2 and len(known.newest.serials) == 2
    assert liar._credentials.revocations.newest == known.newest
    long_ones = sum(len(data) > 200 for *_, data in network.sent)
    talk([one, liar], clock, 3.0)
    assert sum(len(data) > 200 for *_, data in network.sent) == long_ones  # both have it: it is not sent again
    changed = bytearray(known.newest.der)
    changed[-1] ^= 1
    for der in (first, foreign, bytes(changed), b"", b"-", b"x" * 70_000):
        session = liar._known[0].session
        assert session is not None
        session.answer(RevokedNotice(der))
        network.carry(1, 0, LIST + der)
        talk([one, liar], clock, 0.5)
        assert known.newest.number == 2
    liar.send(0, b"still me")
    assert talk([one, liar], clock, 1.0)[0] == [Received(1, b"still me")]


def test_a_list_is_checked_when_it_is_loaded(folders: list[Path], tmp_path: Path) -> None:
    home = home_of(folders)
    revoke(home, 1)
    for folder in folders[:2]:
        shutil.copy(home / "authority" / REVOKED, folder / REVOKED)
    greeting = Credentials(folders[2]).greeting(SessionKey(), 7)
    assert Credentials(folders[0]).check(greeting).number == 2
    with pytest.raises(RevokedError):
        Credentials(folders[1])
    with pytest.raises(CredentialsError, match="revoked already"):
        revoke(home, 1)
    (folders[2] / REVOKED).write_bytes(b"-----BEGIN X509 CRL-----\nAAAA")
    with pytest.raises(UnsignedListError, match=r"agent_02.revoked.pem: no list of revoked certificates"):
        Credentials(folders[2])
    # openssl reads it as what it is.
    text = home / "authority" / REVOKED
    if shutil.which("openssl"):
        words = ["openssl", "crl", "-in", str(text), "-CAfile", str(home / "authority" / "cert.pem"), "-text", "-noout"]
        said = subprocess.run(words, capture_output=True, text=True, check=True)
        assert "verify OK" in said.stdout + said.stderr and said.stdout.count("Serial Number:") == 1


def test_the_command_revokes_and_a_new_certificate_of_the_name_counts(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    keys = tmp_path / "keys"
    assert cli.main(["keys", str(keys), "--agents", "3"]) == 0
    taken = tmp_path / "taken"
    shutil.move(keys / "agent_01", taken)  # it is on the robot, and not at home
    assert cli.main(["keys", str(keys), "--revoke", "agent_01"]) == 0
    assert f"agent_00{os.sep}revoked.pem" in capsys.readouterr().out
    assert cli.main(["keys", str(keys), "--add", "1"]) == 0
    judge = Credentials(keys / "agent_00")
    assert judge.check(Credentials(keys / "agent_01").greeting(SessionKey(), 7)).number == 1
    with pytest.raises(CredentialsError, match="its certificate was revoked"):
        judge.check(Credentials(taken).greeting(SessionKey(), 7))
    for name, said in (("agent_09", "agent_09"), ("robot", "is like agent_03")):
        assert cli.main(["keys", str(keys), "--revoke", name]) in (1, 2)
        assert said in capsys.readouterr().err
