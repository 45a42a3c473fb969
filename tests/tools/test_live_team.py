"""``maslam team --live``: agents as processes that track their images while they negotiate, to one RUN folder."""

from __future__ import annotations

import json
import threading
from pathlib import Path

import numpy as np
import pytest
from test_team import kill_once

from maslam.mas.live.journal import EntryKind, read_journal
from maslam.tools import cli
from maslam.tools.live.played import lost_between

pytest.importorskip("zenoh", reason="the extra 'network' is not installed")


def test_a_team_of_live_processes_ends_like_any_team(
    town_stereo: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """One of the two is killed on the way: it goes on after its latest key-frame, in a new track."""
    out = tmp_path / "run"
    journal = out / "journals" / "agent_01" / "journal.bin"
    killer = threading.Thread(target=kill_once, args=(journal,), daemon=True)
    killer.start()
    words = ["team", str(town_stereo), str(out), "--live", "--speed", "0.5", "--odometry.mapping.window", "6"]
    assert cli.main([*words, "--quiet"]) == 0
    said = capsys.readouterr()
    summary = json.loads((out / "summary.json").read_text())
    assert summary["groups"] == [[0, 1]] and summary["matches"]["false_accepted"] == 0
    assert 0 < summary["ate_rmse_m"]["mean_agents"] < 0.5
    begun = [e for e in read_journal(journal) if e.kind is EntryKind.BEGIN]
    if Path("/proc").is_dir():
        assert not killer.is_alive() and len(begun) == 2
    assert (out / "report" / "index.html").is_file() and (out / "agent_00" / "trajectory.tum").is_file()
    for me, coverage in enumerate(summary["coverage"]):
        figures = json.loads((out / "journals" / f"agent_{me:02d}" / "live.json").read_text())
        assert coverage["read"] == 20 and 0 < coverage["tracked"] <= 20
        assert figures["received"] <= 20 and f"agent {me}: {figures['received']} frames: " in said.err


def test_what_live_agents_do_not_know_is_refused(
    town_stereo: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["team", str(town_stereo), str(tmp_path / "out"), "--live", "--quiet"]
    assert cli.main([*words, "--agents", "4"]) == 2
    assert "none is cut for --agents" in capsys.readouterr().err
    assert cli.main([*words, "--recording.stride", "2", "--dataset", "kitti"]) == 2
    assert "do not know --dataset, --recording.*" in capsys.readouterr().err


def test_frames_without_a_pose_are_counted_in_intervals() -> None:
    stamps_ns = np.arange(10, dtype=np.int64) * 100
    lost = lost_between(stamps_ns, stamps_ns[[2, 3, 5, 9]])
    assert [(one.first_frame, one.last_frame) for one in lost] == [(0, 1), (4, 4), (6, 8)]
    assert lost_between(stamps_ns, stamps_ns) == ()
