"""``maslam import`` treats images and its folder as ``maslam preprocess`` does: settings, cache, lock, overwriting."""

from __future__ import annotations

import hashlib
import json
import os
from pathlib import Path

import cv2
import numpy as np
import pytest

import maslam
from maslam.errors import MaslamError
from maslam.frontend.files.trajectory import read_kitti_poses
from maslam.frontend.files.vo_files import read_tracks
from maslam.mas.manifest import read_manifest
from maslam.tools import cli

fcntl = pytest.importorskip("fcntl")
TEAM = ("agent_00", "agent_01")


@pytest.fixture(scope="module")
def poses(town_stereo: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("poses")
    for name in TEAM:
        times = np.loadtxt(town_stereo / name / "times.txt")
        T = read_kitti_poses(town_stereo / name / "poses.txt")[1]
        np.savetxt(folder / f"{name}.txt", np.column_stack([times, T[:, :3].reshape(-1, 12)]), "%.9f")
    return folder


@pytest.fixture(scope="module")
def words(town_stereo: Path, poses: Path) -> list[str]:
    """Of one agent with one camera, which is quick; the folder to be made comes behind."""
    return ["import", "--rig", "mono", "--quiet", str(poses / "agent_00.txt"), str(town_stereo / "agent_00")]


def digests(folder: Path) -> dict[str, str]:
    files = sorted(path for path in folder.rglob("*") if path.is_file() and "frontend" not in path.parts)
    return {str(f.relative_to(folder)): hashlib.sha256(f.read_bytes()).hexdigest() for f in files}


def test_the_same_command_again_takes_what_is_there(
    words: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "seqs"
    assert cli.main([*words, str(out)]) == 0
    made = digests(out)
    with monkeypatch.context() as patch:
        patch.setattr("maslam.tools.interchange.given_job.track_given", lambda *_: pytest.fail("made again"))
        assert cli.main([*words, str(out)]) == 0
    assert digests(out) == made
    # Other settings, or poses, are another thing: refused, but for --overwrite.
    capsys.readouterr()
    assert cli.main([*words, str(out), "--gap", "0.01"]) == 1
    assert "other settings (imports); choose another folder, or replace it with --overwrite" in capsys.readouterr().err
    assert cli.main([*words, str(out), "--odometry.features.tracks", "300"]) == 1
    assert "--overwrite" in capsys.readouterr().err
    assert digests(out) == made
    assert cli.main([*words, str(out), "--odometry.features.tracks", "300", "--overwrite"]) == 0
    assert digests(out) != made


def test_poses_that_changed_are_not_taken_from_the_store(words: list[str], tmp_path: Path) -> None:
    out, file = tmp_path / "seqs", tmp_path / "agent_00.txt"
    lines = Path(words[4]).read_text().splitlines()
    file.write_text("\n".join(lines) + "\n")
    again = [*words[:4], str(file), words[5], str(out)]
    assert cli.main(again) == 0
    file.write_text("\n".join(lines[2:]) + "\n")
    assert cli.main(again) == 0
    assert read_manifest(out).agents[0].lost[0].last_frame == 1


def test_a_folder_is_one_commands_at_a_time(
    words: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "seqs"
    out.mkdir()
    with open(out / "unfinished.json", "w") as other:
        other.write("{}")
    descriptor = os.open(out, 0)
    fcntl.flock(descriptor, fcntl.LOCK_EX)
    try:
        assert cli.main([*words, str(out), "--overwrite"]) == 1
    finally:
        os.close(descriptor)
    assert "another run is writing to it" in capsys.readouterr().err
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "letter.txt").write_text("Dear")
    assert cli.main([*words, str(tmp_path / "mine"), "--overwrite"]) == 1
    assert "not empty, and no folder of agent sequences" in capsys.readouterr().err


def test_images_are_read_as_they_are_by_preprocess(words: list[str], tmp_path: Path) -> None:
    """A part of the recording, masks, and a file of settings."""
    size = cv2.imread(next(str(p) for p in sorted(Path(words[5]).rglob("*.png")))).shape[:2]
    mask = np.full(size, 255, dtype=np.uint8)
    mask[:, : size[1] // 2] = 0
    cv2.imwrite(str(tmp_path / "mask.png"), mask)
    (tmp_path / "settings.yaml").write_text(
        f"images: {{masks: '{tmp_path / 'mask.png'}'}}\n"
        "recording: {stride: 2}\nodometry: {features: {tracks: 300}}\n"
    )
    out = tmp_path / "seqs"
    assert cli.main([*words, str(out), "--config", str(tmp_path / "settings.yaml")]) == 0
    manifest = read_manifest(out)
    assert manifest.agents[0].frames == 10
    assert manifest.settings["recording"]["stride"] == 2
    assert manifest.settings["odometry"]["features"]["tracks"] == 300
    views = np.load(out / "agent_00" / "views_0.npz")
    assert len(views["uv"]) > 50
    assert views["uv"][:, 0].min() >= size[1] // 2 - 1
    assert cli.main([*words, str(tmp_path / "all"), "--recording.rate-hz", "5"]) == 0
    assert read_manifest(tmp_path / "all").agents[0].frames == 10


def test_workers_change_nothing_and_python_takes_the_same(town_stereo: Path, poses: Path, tmp_path: Path) -> None:
    base = ["import", "--rig", "mono", "--quiet", str(poses), str(town_stereo)]
    assert cli.main([*base, str(tmp_path / "one"), "--workers", "1"]) == 0
    assert cli.main([*base, str(tmp_path / "two"), "--workers", "2"]) == 0
    assert digests(tmp_path / "one") == digests(tmp_path / "two")
    made = maslam.import_sequence(poses, town_stereo, tmp_path / "one", rig="mono")
    assert [entry.name for entry in made.manifest.agents] == list(TEAM)
    with pytest.raises(MaslamError, match="overwrite=True"):
        maslam.import_sequence(poses, town_stereo, tmp_path / "one", rig="mono", gap_s=0.2)
    maslam.import_sequence(poses, town_stereo, tmp_path / "one", rig="mono", gap_s=0.2, overwrite=True)
    assert json.loads((tmp_path / "one" / "manifest.json").read_text())["settings"]["imports"][0]["gap_s"] == 0.2
    assert len(read_tracks(tmp_path / "one" / "agent_00")) == 1
