"""The whole chain through the command line, on two agents in one textured room and a third in a room of its own."""

from __future__ import annotations

import json
import re
import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest
from room import BASELINE_M, CAMERA, Room, walk

from maslam.backend.geometry import se3
from maslam.frontend.cameras.models import RigKind
from maslam.frontend.files.trajectory import read_tum, write_kitti_poses
from maslam.tools import cli
from maslam.tools.report.summary_table import table

FRAMES = 36
pytestmark = pytest.mark.slow


def write_agent(folder: Path, room: Room, poses: np.ndarray) -> None:
    for name in ("image_0", "image_1"):
        (folder / name).mkdir(parents=True)
    for i, pose in enumerate(poses):
        frame = room.frame(i, pose, RigKind.STEREO)
        cv2.imwrite(str(folder / "image_0" / f"{i:06d}.png"), frame.image)
        cv2.imwrite(str(folder / "image_1" / f"{i:06d}.png"), frame.right)
    c = CAMERA
    camera = f"width: {c.width}\nheight: {c.height}\nfx: {c.fx}\nfy: {c.fy}\ncx: {c.cx}\ncy: {c.cy}\n"
    (folder / "camera.yaml").write_text(f"{camera}baseline_m: {BASELINE_M}\nrate_hz: 10\n")
    (folder / "times.txt").write_text("".join(f"{i / 10:.6f}\n" for i in range(len(poses))))
    write_kitti_poses(folder / "poses.txt", poses)


@pytest.fixture(scope="module")
def house(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """agent_00 and agent_01 cross one room, a third of the way apart; agent_02 never meets anyone."""
    folder = tmp_path_factory.mktemp("house")
    shared, far = Room(3), Room(11)
    path = walk(FRAMES + FRAMES // 3)
    elsewhere = se3(np.eye(3), [500.0, 0.0, 0.0]) @ path[:FRAMES]
    write_agent(folder / "agent_00", shared, path[:FRAMES])
    write_agent(folder / "agent_01", shared, path[FRAMES // 3 :])
    write_agent(folder / "agent_02", far, path[:FRAMES])
    write_kitti_poses(folder / "agent_02" / "poses.txt", elsewhere)
    return folder


@pytest.fixture(scope="module")
def run(house: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("slam") / "first"
    assert cli.main(["slam", str(house), str(out), "--seed", "4", "--quiet"]) == 0
    return out


def test_the_folder_holds_what_was_promised(run: Path) -> None:
    files = {path.relative_to(run).as_posix() for path in run.rglob("*") if path.is_file()}
    for name in (
        "summary.json",
        "config.yaml",
        "timeline.csv",
        "events.jsonl",
        "matches.csv",
        "traffic.csv",
        "report/index.html",
    ):
        assert name in files
    for agent in ("agent_00", "agent_01", "agent_02"):
        assert {
            f"{agent}/{name}" for name in ("trajectory.tum", "trajectory_keyframes.tum", "graph.g2o", "map.ply")
        } <= files
        five = {f"sequences/{agent}/{name}_0.txt" for name in ("poses", "times", "lm_pos", "lm_obs", "descs")}
        assert five | {f"sequences/{agent}/netvlad.npz", f"sequences/{agent}/trajectory.tum"} <= files
        assert len(read_tum(run / agent / "trajectory.tum")) == FRAMES
    assert not list(run.parent.rglob("*.part"))


def test_who_can_meet_shares_a_frame_and_who_cannot_keeps_its_own(run: Path) -> None:
    summary = json.loads((run / "summary.json").read_text())
    assert summary["groups"] == [[0, 1], [2]]
    assert summary["matches"]["false_accepted"] == 0
    assert summary["matches"]["between_agents"] >= 1
    assert max(summary["ate_rmse_m"]["connected"]) < 0.05
    assert summary["exploration_percent"][2] < 50 < summary["exploration_percent"][0]
    assert (summary["preset"], summary["seed"], summary["agents"]) == ("maslam", 4, 3)


def test_traffic_adds_up(run: Path) -> None:
    total = json.loads((run / "summary.json").read_text())["traffic"]["total"]
    rows = (run / "traffic.csv").read_text().splitlines()
    wire = rows[0].split(",").index("wire_bytes")
    assert total["messages"] == len(rows) - 1
    assert total["wire_bytes"] == sum(int(row.split(",")[wire]) for row in rows[1:])


def test_the_same_command_gives_the_same_bytes(run: Path, house: Path, tmp_path: Path) -> None:
    again = tmp_path / "second"
    assert cli.main(["slam", str(house), str(again), "--seed", "4", "--quiet", "--workers", "1"]) == 0
    names = sorted(path.relative_to(run) for path in run.rglob("*") if path.is_file())
    assert names == sorted(path.relative_to(again) for path in again.rglob("*") if path.is_file())
    timed = {Path("timing.json"), Path("report/index.html")}
    different = [
        name for name in names if name not in timed and (run / name).read_bytes() != (again / name).read_bytes()
    ]
    assert different == []


def test_a_runs_own_configuration_repeats_it(run: Path, tmp_path: Path) -> None:
    words = ["run", str(run / "sequences"), str(tmp_path / "again"), "--config", str(run / "config.yaml"), "--quiet"]
    assert cli.main(words) == 0
    for name in ("matches.csv", "traffic.csv", "config.yaml"):
        assert (tmp_path / "again" / name).read_bytes() == (run / name).read_bytes()


def test_a_truth_that_all_matches_contradict_is_doubted(run: Path) -> None:
    summary, timing = (json.loads((run / name).read_text()) for name in ("summary.json", "timing.json"))
    accepted = summary["matches"]["accepted"]
    for false in (0, accepted - 1, accepted):
        summary["matches"]["false_accepted"] = false
        assert ("all false" in table(summary, timing)) == (false == accepted)


def test_eval_prints_the_figures(run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["eval", str(run), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["agents"] == 3
    assert cli.main(["eval", str(run)]) == 0
    said = capsys.readouterr().out
    assert "2 of 3 agents share one frame" in said and "0 of them false" in said
    lines = said.splitlines()
    errors, coverage = (
        [line for line in lines if re.match(rf"agent_0\d +{of}", line)] for of in (r"\d+\.\d+ m", r"\d+ ")
    )
    assert len(errors) == len(coverage) == 3 and all(line.split()[1:4] == [str(FRAMES)] * 3 for line in coverage)
    assert f"errors measured on {3 * FRAMES} of {3 * FRAMES} frames read, after SE(3) alignment" in said


def test_the_report_stands_alone(run: Path) -> None:
    page = (run / "report" / "index.html").read_text()
    assert not re.findall(r"""https?:|<script|<link|url\(|src="(?!data:)|href=""", page)
    for title in ("Map copies", "Error over time", "Bytes by operation", "Exploration", "Images of accepted matches"):
        assert f"<h2>{title}</h2>" in page
    assert page.count("data:image/jpeg;base64,") >= 2
    assert "<h2>Agents in 2 frames that no match joins</h2>" in page
    assert all(page.count(f"<{tag}") == page.count(f"</{tag}>") for tag in ("section", "table", "svg", "figure"))


def test_a_report_without_the_images_says_so(run: Path, tmp_path: Path) -> None:
    moved = tmp_path / "moved"
    shutil.copytree(run, moved)
    manifest = json.loads((moved / "manifest.json").read_text())
    (moved / "manifest.json").write_text(json.dumps({**manifest, "source": str(tmp_path / "gone")}))
    assert cli.main(["report", str(moved)]) == 0
    page = (moved / "report" / "index.html").read_text()
    assert "The images are not where they were" in page and "data:image" not in page


def test_a_recording_is_written_where_rerun_is_installed(run: Path) -> None:
    pytest.importorskip("rerun", reason="the extra 'rerun' is not installed")
    assert cli.main(["report", str(run), "--rrd"]) == 0
    assert (run / "recording.rrd").read_bytes()[:4] in (b"RRF2", b"RRIO")


def test_slam_again_replaces_the_run_and_keeps_the_sequences(run: Path, house: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    shutil.copytree(run, out)
    before = (out / "sequences" / "frontend" / "agent_00.npz").stat().st_mtime_ns
    assert cli.main(["slam", str(house), str(out), "--quiet", "--overwrite", "--merge.enabled", "false"]) == 0
    assert (out / "sequences" / "frontend" / "agent_00.npz").stat().st_mtime_ns == before
    assert json.loads((out / "summary.json").read_text())["traffic"]["mapmerge"]["messages"] == 0


@pytest.mark.parametrize(
    ("words", "code", "said"),
    [
        (["--preset", "best"], 2, "no preset 'best'; there are"),
        (["--seed", "-1"], 2, "--seed -1: seed: input should be greater than or equal to 0"),
        (["--config", "missing.yaml"], 2, "missing.yaml: no such file"),
        (["--relpose.min-inlierz", "3"], 2, "did you mean '--relpose.min-inliers'?"),
    ],
)
def test_what_cannot_be_set(
    words: list[str], code: int, said: str, run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert cli.main(["run", str(run / "sequences"), str(tmp_path / "out"), "--quiet", *words]) == code
    assert said in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_half_made_folders_are_refused(run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    shutil.copytree(run, tmp_path / "half")
    (tmp_path / "half" / "summary.json").unlink()
    (tmp_path / "half" / "sequences" / "manifest.json").unlink()
    for words in (["eval", "half"], ["report", "half"], ["run", "half/sequences", "out"], ["eval", "nowhere"]):
        assert cli.main([words[0], *(str(tmp_path / word) for word in words[1:])]) == 1
        assert capsys.readouterr().err.count("\n") == 1
