"""The rendered data set: layout, determinism, resuming, clear errors."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path

import cv2
import numpy as np
import pytest
from pydantic import ValidationError

from maslam.frontend.files.trajectory import read_kitti_poses
from maslam.tools.worlds.config import RenderConfig
from maslam.tools.worlds.dataset import render_dataset
from maslam.tools.worlds.errors import RenderError

TINY = RenderConfig(world="indoor", rig="stereo", seed=8, agents=2, frames=3, width=96, height=64, cheap=True)


def _digest(folder: Path) -> dict[str, str]:
    files = sorted(p for p in folder.rglob("*") if p.is_file())
    return {str(p.relative_to(folder)): hashlib.sha256(p.read_bytes()).hexdigest() for p in files}


@pytest.fixture(scope="module")
def tiny(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("tiny") / "out"
    render_dataset(TINY, out, workers=1)
    return out


def test_layout_is_the_documented_one(town_stereo: Path) -> None:
    world = json.loads((town_stereo / "world.json").read_text())
    assert world["world"] == "town" and world["seed"] == 5 and len(world["lights"]) == 2
    assert world["lights"][0] != world["lights"][1]
    for agent in ("agent_00", "agent_01"):
        folder = town_stereo / agent
        for side in ("image_0", "image_1"):
            names = sorted(p.name for p in (folder / side).iterdir())
            assert names == [f"{k:06d}.png" for k in range(20)]
        image = cv2.imread(str(folder / "image_0" / "000000.png"))
        assert image.shape == (180, 320, 3) and image.dtype == np.uint8
        times = [float(t) for t in (folder / "times.txt").read_text().split()]
        assert np.allclose(times, np.arange(20) / 10)
        stamps, poses = read_kitti_poses(folder / "poses.txt")
        assert stamps is None and poses.shape == (20, 4, 4)
        camera = (folder / "camera.yaml").read_text()
        assert "baseline_m: 0.54" in camera and "width: 320" in camera


def test_depth_images_hold_metres(indoor_rgbd: Path) -> None:
    depth = cv2.imread(str(indoor_rgbd / "agent_00" / "depth_0" / "000000.png"), cv2.IMREAD_UNCHANGED)
    assert depth.dtype == np.uint16 and depth.shape == (240, 320)
    assert 0.2 < np.median(depth[depth > 0]) * 0.001 < 10.0 and depth.max() <= 10_000


def test_same_seed_same_bytes_with_one_or_two_workers(tiny: Path, tmp_path: Path) -> None:
    render_dataset(TINY, tmp_path / "again", workers=2)
    assert _digest(tmp_path / "again") == _digest(tiny)
    render_dataset(TINY.model_copy(update={"seed": 9}), tmp_path / "other", workers=2)
    assert _digest(tmp_path / "other") != _digest(tiny)


def test_an_interrupted_rendering_is_not_whole_and_is_gone_on_with(tiny: Path, tmp_path: Path) -> None:
    class Stop(Exception):
        pass

    def stop(done: int, total: int) -> None:
        if done == 5:
            raise Stop

    out = tmp_path / "out"
    with pytest.raises(Stop):
        render_dataset(TINY, out, stop, workers=1)
    assert not (out / "world.json").exists()
    finished = {p: p.stat().st_mtime_ns for p in sorted(out.rglob("*.png"))}
    assert 0 < len(finished) < 12
    counts: list[tuple[int, int]] = []
    render_dataset(TINY, out, lambda done, total: counts.append((done, total)), workers=2)
    assert counts[0] == (len(finished), 12) and counts[-1] == (12, 12)
    assert all(p.stat().st_mtime_ns == t for p, t in finished.items())
    assert _digest(out) == _digest(tiny)


def test_a_finished_rendering_is_left_alone_and_another_one_refused(tiny: Path) -> None:
    before = _digest(tiny)
    render_dataset(TINY, tiny)
    assert _digest(tiny) == before
    with pytest.raises(RenderError, match=r"other settings \(seed\)"):
        render_dataset(TINY.model_copy(update={"seed": 1}), tiny)


def test_a_folder_of_something_else_is_refused(tmp_path: Path) -> None:
    (tmp_path / "thesis.txt").write_text("not pictures")
    with pytest.raises(RenderError, match="not a rendering"):
        render_dataset(TINY, tmp_path)
    assert [p.name for p in tmp_path.iterdir()] == ["thesis.txt"]


@pytest.mark.parametrize("wrong", [{"agents": 0}, {"world": "moon"}, {"fov_deg": 200}, {"speed": 3}, {"frames": -1}])
def test_bad_settings_are_refused(wrong: dict[str, object]) -> None:
    with pytest.raises(ValidationError):
        RenderConfig(**wrong)


def test_a_pose_file_with_a_gap_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "poses.txt"
    path.write_text("".join(f"1 0 0 {x} 0 1 0 0 0 0 1 0\n" for x in (0, 1, 2, 60, 61)))
    with pytest.raises(RenderError, match=r"poses 2 and 3 are 58\.0 m apart"):
        render_dataset(RenderConfig(poses_file=path, agents=1), tmp_path / "out")


def test_moving_cars_need_the_town(tmp_path: Path) -> None:
    with pytest.raises(RenderError, match="moving"):
        render_dataset(TINY.model_copy(update={"moving_cars": 2}), tmp_path / "out")
