"""Agents as processes over a real network on this machine: certificates, a team to one RUN folder, a killed agent."""

from __future__ import annotations

import contextlib
import json
import os
import shutil
import signal
import socket
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest
from test_predecessor import write_sequence

from maslam.mas.live.journal import EntryKind, read_journal
from maslam.mas.live.recorded_agent import met_in
from maslam.tools import cli

pytest.importorskip("zenoh", reason="the extra 'network' is not installed")
pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="signals")


@pytest.fixture(scope="module")
def sequences(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two agents that see the same places."""
    folder = tmp_path_factory.mktemp("five")
    for k, name in enumerate(("first", "second")):
        write_sequence(folder / "vo" / name, k)
    assert cli.main(["import", str(folder / "vo"), str(folder / "seqs"), "--quiet"]) == 0
    return folder / "seqs"


def kill_once(journal: Path) -> None:
    """kill -9 for the process that writes this journal, once it has begun."""
    until = time.monotonic() + 120
    while time.monotonic() < until:
        for entry in Path("/proc").iterdir() if Path("/proc").is_dir() else []:
            with contextlib.suppress(OSError):
                words = (entry / "cmdline").read_bytes().split(b"\0") if entry.name.isdigit() else []
                if b"agent" in words and os.fsencode(journal.parent) in words and journal.exists():
                    os.kill(int(entry.name), signal.SIGKILL)
                    return
        time.sleep(0.02)


def test_a_team_of_processes_makes_one_map(sequences: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """One of the two is killed on the way, and goes on from its journal."""
    out = tmp_path / "run"
    journal = out / "journals" / "agent_01" / "journal.bin"
    killer = threading.Thread(target=kill_once, args=(journal,), daemon=True)
    killer.start()
    assert cli.main(["team", str(sequences), str(out), "--speed", "2"]) == 0
    said = capsys.readouterr()
    summary = json.loads((out / "summary.json").read_text())
    assert summary["groups"] == [[0, 1]] and summary["matches"]["accepted"] > 0
    assert (out / "report" / "index.html").is_file()
    assert "2 of 2 agents share one frame" in said.out
    begun = [e for e in read_journal(journal) if e.kind is EntryKind.BEGIN]
    if Path("/proc").is_dir():
        assert not killer.is_alive() and begun
        assert "agent 1 was killed (signal 9); it goes on from its journal" in said.err


def test_wrong_certificates_are_said_within_seconds(sequences: Path, tmp_path: Path) -> None:
    """An agent that nobody answers says so, and ends by itself at a signal, with what it has."""
    assert cli.main(["keys", str(tmp_path / "keys"), "--agents", "1"]) == 0
    words = ["agent", str(sequences), str(tmp_path / "out"), "--credentials", str(tmp_path / "keys" / "agent_00")]
    command = [sys.executable, "-m", "maslam", *words, "--connect", "tls/127.0.0.1:9"]
    agent = subprocess.Popen(command, stderr=subprocess.PIPE, text=True)
    try:
        assert agent.stderr is not None
        for line in agent.stderr:
            if "nobody is connected: tls/127.0.0.1:9: nobody listens there" in line:
                break
        else:
            raise AssertionError("it ended without a word")
        agent.send_signal(signal.SIGTERM)
        assert agent.wait(30) == 143
    finally:
        agent.kill()
        agent.wait()
    assert (tmp_path / "out" / "journal.bin").is_file()


def test_keys_and_addresses_that_do_not_fit_are_named(
    sequences: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "keys"
    assert cli.main(["keys", str(folder), "--agents", "2", "--team", "red"]) == 0
    assert cli.main(["keys", str(folder), "--agents", "2", "--team", "red"]) == 1
    assert "agent_00: exists" in capsys.readouterr().err
    assert cli.main(["keys", str(tmp_path / "mistyped"), "--add", "3"]) == 1
    assert "no team to add an agent to" in capsys.readouterr().err
    words = ["agent", str(sequences), str(tmp_path / "out"), "--credentials", str(folder / "agent_01"), "--quiet"]
    assert cli.main([*words, "--listen", "tcp/127.0.0.1:0"]) == 1
    assert "addresses begin with tls/ or quic/" in capsys.readouterr().err
    assert cli.main([*words[:4], str(tmp_path), "--quiet", "--listen", "tls/127.0.0.1:0"]) == 1
    assert "ca.pem: missing; `maslam keys`" in capsys.readouterr().err
    assert cli.main([*words, "--speed", "0"]) == 2
    assert "--speed 0.0: input should be greater than 0" in capsys.readouterr().err
    assert cli.main([*words, "--faults.loss", "0.1"]) == 1
    assert "only a simulation makes faults" in capsys.readouterr().err


def test_who_starts_later_is_found(sequences: Path, tmp_path: Path) -> None:
    """The agent that connects is there first, and has said that nobody answers."""
    assert cli.main(["keys", str(tmp_path / "keys"), "--agents", "2"]) == 0
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        address = f"tls/127.0.0.1:{free.getsockname()[1]}"
    outs = [tmp_path / "0", tmp_path / "1"]

    def started(me: int, end: str) -> subprocess.Popen[str]:
        words = [
            str(sequences),
            str(outs[me]),
            "--credentials",
            str(tmp_path / "keys" / f"agent_{me:02d}"),
            end,
            address,
        ]
        return subprocess.Popen([sys.executable, "-m", "maslam", "agent", *words], stderr=subprocess.PIPE, text=True)

    first = started(1, "--connect")
    assert first.stderr is not None
    assert any("nobody is connected" in line for line in first.stderr)
    second = started(0, "--listen")
    second.communicate(timeout=120)
    first.communicate(timeout=120)
    assert (first.returncode, second.returncode) == (0, 0)
    assert [met_in(out / "journal.bin") for out in outs] == [{1}, {0}]
    assert (outs[1] / "trajectory.tum").is_file()


def test_other_settings_replace_a_run_only_on_request(
    sequences: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Before any agent starts; also where the earlier team was ended early, and left journals alone."""
    out = tmp_path / "run"
    words = ["team", str(sequences), str(out), "--speed", "20", "--quiet"]
    assert cli.main(words) == 0
    assert cli.main([*words, "--seed", "5"]) == 1
    assert "other settings (seed)" in capsys.readouterr().err
    for path in out.iterdir():
        if path.name != "journals":
            shutil.rmtree(path) if path.is_dir() else path.unlink()
    assert cli.main([*words, "--seed", "5", "--overwrite"]) == 0
    assert json.loads((out / "summary.json").read_text())["seed"] == 5
    assert cli.main([*words, "--seed", "6", "--overwrite"]) == 0
