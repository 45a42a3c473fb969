"""Folders with something in them: the same command goes on or replaces, another is refused; one run at a time."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

import maslam
from maslam import MaslamError
from maslam._atomic import replacing
from maslam.tools import cli
from maslam.tools.common.writing import writing

ROOT = Path(__file__).resolve().parents[2]
HOLDS = """
import sys
from pathlib import Path
from maslam.tools.common.writing import writing
with writing(Path(sys.argv[1])):
    print("in", flush=True)
    sys.stdin.readline()
"""


@pytest.fixture(scope="module")
def drives(tmp_path_factory):
    """Two small sources."""
    folder = tmp_path_factory.mktemp("drives")
    for k in range(2):
        words = ["render", str(folder / f"drive_{k}"), "--agents", "1", "--frames", "20", "--rig", "stereo"]
        assert cli.main([*words, "--size", "160x120", "--seed", str(k), "--workers", "1", "--quiet"]) == 0
    return folder


def holder(folder):
    """A process that writes to ``folder``."""
    process = subprocess.Popen(
        [sys.executable, "-c", HOLDS, str(folder)],
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )
    assert process.stdout.readline() == "in\n"
    return process


@pytest.mark.skipif(sys.platform == "win32", reason="no locks of folders")
def test_two_runs_into_one_folder_and_a_lock_that_a_killed_run_leaves(drives, tmp_path, capsys):
    out = tmp_path / "run"
    other = holder(out)
    assert cli.main(["slam", str(drives / "drive_0"), str(out), "--workers", "1", "--quiet"]) == 1
    assert f"{out}: another run is writing to it" in capsys.readouterr().err
    assert list(out.iterdir()) == []
    other.kill()
    other.wait()
    with writing(out):
        pass


def test_a_folder_that_nothing_came_of_goes_again_and_half_written_files_too(tmp_path):
    with pytest.raises(RuntimeError), writing(tmp_path / "a" / "b"):
        _half_written(tmp_path / "a" / "b" / ".file.npz.123-4.part")
    assert not (tmp_path / "a").exists()


def _half_written(path):
    path.write_text("half")
    raise RuntimeError


def test_a_full_disk_is_said_with_the_file_or_folder(tmp_path):
    with pytest.raises(OSError, match="No space") as caught, writing(tmp_path / "run"):
        raise OSError(28, "No space left on device")
    assert caught.value.filename == str(tmp_path / "run")
    with pytest.raises(OSError, match="No space") as caught, replacing(tmp_path / "agent_00") as part:
        raise OSError(28, "No space left on device", str(part / "poses_0.txt"))
    assert caught.value.filename == str(tmp_path / "agent_00" / "poses_0.txt")


def said(capsys, words, code=1):
    assert cli.main([*map(str, words), "--quiet"]) == code
    return capsys.readouterr().err


def test_a_run_of_another_source_or_other_settings_is_not_replaced(drives, tmp_path, capsys):
    out, one, two = tmp_path / "out", drives / "drive_0", drives / "drive_1"
    slam = ["slam", one, out, "--workers", "1"]
    said(capsys, slam, 0)
    before = (out / "summary.json").read_bytes(), (out / "sequences" / "manifest.json").read_bytes()
    said(capsys, slam, 0)  # the same command
    assert before == ((out / "summary.json").read_bytes(), (out / "sequences" / "manifest.json").read_bytes())
    assert "holds a run with other settings (seed); choose another folder" in said(capsys, [*slam, "--seed", "3"])
    line = said(capsys, ["slam", two, out, "--workers", "1"])
    assert f"holds agent sequences of {one.resolve()}, not of {two.resolve()}" in line and line.endswith(
        "or replace it with --overwrite\n"
    )
    assert "other settings (odometry.features.tracks)" in said(capsys, [*slam, "--odometry.features.tracks", "300"])
    assert "other settings (split)" in said(capsys, [*slam, "--agents", "2"])
    assert before == ((out / "summary.json").read_bytes(), (out / "sequences" / "manifest.json").read_bytes())
    with pytest.raises(MaslamError, match=r"or replace it with overwrite=True$"):  # what who calls it can write
        maslam.slam(two, out, workers=1)
    sequences = tmp_path / "sequences"
    said(capsys, ["preprocess", two, sequences, "--workers", "1"], 0)
    assert "holds a run of" in said(capsys, ["run", sequences, out])
    said(capsys, ["run", sequences, out, "--overwrite"], 0)
    assert json.loads((out / "manifest.json").read_text())["source"] == str(two.resolve())


def test_a_beginning_of_something_else_is_not_gone_on_with(drives, tmp_path, capsys, monkeypatch):
    from maslam.tools.pipeline import agent_folder

    out, one, two = tmp_path / "out", drives / "drive_0", drives / "drive_1"

    def interrupted(*_):
        raise KeyboardInterrupt

    with monkeypatch.context() as patched:
        patched.setattr(agent_folder, "plan_agents", interrupted)
        assert "interrupted" in said(capsys, ["preprocess", one, out, "--workers", "1"], 130)
    assert "holds agent sequences of" in said(capsys, ["preprocess", two, out, "--workers", "1"])
    said(capsys, ["preprocess", one, out, "--workers", "1"], 0)
    assert not (out / "unfinished.json").exists()


def test_what_could_not_be_begun_leaves_nothing(drives, tmp_path, capsys):
    (tmp_path / "images").mkdir()
    said(capsys, ["slam", tmp_path / "images", tmp_path / "out"])
    assert not (tmp_path / "out").exists()


def test_a_pgo_folder_of_other_graphs_is_not_replaced_and_no_robot_of_them_stays(tmp_path, capsys):
    from maslam.backend.pose_graph.g2o import write_g2o
    from maslam.tools.pgo.city import city

    for robots in (2, 3):
        (tmp_path / f"in_{robots}").mkdir()
        graph, _ = city(robots, 40, seed=1)
        for robot in graph.robots:
            write_g2o(tmp_path / f"in_{robots}" / f"{robot}.g2o", graph.of_robot(robot))
    out = tmp_path / "out"
    for _ in range(2):
        said(capsys, ["pgo", tmp_path / "in_3", out, "--method", "elected"], 0)
    line = said(capsys, ["pgo", tmp_path / "in_2", out, "--method", "elected"], 2)
    assert "holds a result of" in line and "--overwrite" in line
    said(capsys, ["pgo", tmp_path / "in_2", out, "--method", "elected", "--overwrite"], 0)
    assert sorted(path.name for path in out.glob("*.g2o")) == ["0.g2o", "1.g2o"]
