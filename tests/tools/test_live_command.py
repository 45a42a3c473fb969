"""``maslam agent --live``: two processes track and join over a real network, from one command each."""

from __future__ import annotations

import json
import signal
import socket
import subprocess
import sys
import threading
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from itertools import pairwise
from pathlib import Path

import pytest

import maslam
from maslam.frontend.files.trajectory import read_tum
from maslam.mas.live.recorded_agent import met_in
from maslam.tools import cli

pytest.importorskip("zenoh", reason="the extra 'network' is not installed")


@contextmanager
def listening(keys: Path, address: str) -> Iterator[list[maslam.AgentPose | maslam.AgentMap]]:
    """What a listener gets meanwhile."""
    heard: list[maslam.AgentPose | maslam.AgentMap] = []
    over = threading.Event()

    def listen() -> None:
        with maslam.Watch(keys, connect=[address]) as watch:
            while not over.is_set():
                one = watch.next(0.1)
                if one is not None:
                    heard.append(one)
            assert (watch.refused, watch.reason) == (0, "")

    with ThreadPoolExecutor(1) as thread:
        listener = thread.submit(listen)
        try:
            yield heard
        finally:
            over.set()
        listener.result()


def test_agents_track_and_meet_while_they_drive(
    town_stereo: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """And a third process listens to where they are, and to their maps."""
    assert cli.main(["keys", str(tmp_path / "keys"), "--agents", "3"]) == 0
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        address = f"tls/127.0.0.1:{free.getsockname()[1]}"

    publish, window = ["--publish", "pose", "--publish", "map"], ["--odometry.mapping.window", "6"]

    def words(me: int, end: str) -> list[str]:
        source, keys = town_stereo / f"agent_{me:02d}", tmp_path / "keys" / f"agent_{me:02d}"
        given = [str(source), str(tmp_path / str(me)), "--credentials", str(keys), end, address]
        return ["agent", *given, "--live", "played", "--speed", "0.25", *publish, *window]

    other = subprocess.Popen([sys.executable, "-m", "maslam", *words(1, "--connect")], stderr=subprocess.DEVNULL)
    try:
        with listening(tmp_path / "keys" / "agent_02", address) as heard:
            assert cli.main(words(0, "--listen")) == 0
            assert other.wait(120) == 0
    finally:
        other.kill()
        other.wait()
    said = capsys.readouterr().err
    for me in range(2):
        poses = [one.pose for one in heard if isinstance(one, maslam.AgentPose) and one.agent == me]
        maps = [one.map for one in heard if isinstance(one, maslam.AgentMap) and one.agent == me]
        assert len(poses) >= 5 and len(maps) >= 1 and len(maps[0].points) > 500 and poses[-1].metric
        assert all(a.stamp_ns < b.stamp_ns for a, b in pairwise(poses))
        process = json.loads((tmp_path / str(me) / "process.json").read_text())
        assert process["topic_bytes"] > 0 and str(1 - me) in process["sent"] and process["peak_mb"] > 100
        figures = json.loads((tmp_path / str(me) / "live.json").read_text())
        assert {"odometry", "descriptor", "link", "steps", "other", "reading"} <= set(figures["cpu_s"])
        assert figures["received"] == 20 == figures["tracked"] + figures["lost"] + figures["dropped"]
        assert met_in(tmp_path / str(me) / "journal.bin") == {1 - me}
        assert len(read_tum(tmp_path / str(me) / "trajectory.tum")) >= figures["keyframes"]
    assert "20 frames: " in said and "from image to pose" in said and "joined with agents: " in said


@pytest.mark.skipif(sys.platform == "win32", reason="signals")
def test_ctrl_c_ends_the_drive_and_not_the_agents_results(town_stereo: Path, tmp_path: Path) -> None:
    """A folder to which nothing is added any more: the first Ctrl-C ends the drive."""
    assert cli.main(["keys", str(tmp_path / "keys"), "--agents", "1"]) == 0
    source, keys, out = (str(p) for p in (town_stereo / "agent_00", tmp_path / "keys" / "agent_00", tmp_path / "out"))
    command = ["agent", source, out, "--credentials", keys, "--live", "growing", "--connect", "tls/127.0.0.1:9"]
    # A shell's background job ignores Ctrl-C, and so would the agent: it inherits that.
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    agent = subprocess.Popen([sys.executable, "-m", "maslam", *command, "--json"], stdout=subprocess.PIPE, text=True)
    signal.signal(signal.SIGINT, before)
    try:
        assert agent.stdout is not None
        phases: list[str] = []
        for line in agent.stdout:
            phases.append(json.loads(line)["phase"])
            if len(phases) == 1:
                agent.send_signal(2)
            if phases[-1] != "driving":
                break
        assert phases[0] == "driving" and phases[-1] == "closing"
        agent.send_signal(2)  # again: at once
        agent.communicate(timeout=60)
        assert agent.returncode == 130
    finally:
        agent.kill()
        agent.wait()
    assert (tmp_path / "out" / "journal.bin").is_file()


def test_what_does_not_go_together_is_said(
    town_stereo: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert cli.main(["keys", str(tmp_path / "keys"), "--agents", "1"]) == 0
    words = ["--credentials", str(tmp_path / "keys" / "agent_00"), "--quiet"]
    one = ["agent", str(town_stereo / "agent_00"), str(tmp_path / "out"), *words]
    assert cli.main([*one, "--live", "growing", "--speed", "2"]) == 2
    assert "--speed 2: only a recording is played faster" in capsys.readouterr().err
    assert cli.main([*one, "--live", "camera"]) == 2
    assert "--live camera needs --calibration" in capsys.readouterr().err
    assert cli.main(["agent", str(town_stereo), str(tmp_path / "out"), *words, "--live", "played"]) == 2
    assert "2 sequences (agent_00, agent_01): name the one" in capsys.readouterr().err
