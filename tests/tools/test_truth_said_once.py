"""Ground truth that cannot be of the images is said once by a command, wherever it is noted."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
from room import BASELINE_M, CAMERA, Room, walk

from maslam.frontend.cameras.models import RigKind
from maslam.frontend.files.trajectory import write_kitti_poses
from maslam.tools import cli

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def in_millimetres(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A pair of cameras in a room, whose ground truth is in millimetres."""
    folder, room, poses = tmp_path_factory.mktemp("room"), Room(3), walk(16)
    for side, name in (("image", "left"), ("right", "right")):
        (folder / name).mkdir()
        for i, pose in enumerate(poses):
            cv2.imwrite(str(folder / name / f"{i:06d}.png"), getattr(room.frame(i, pose, RigKind.STEREO), side))
    c = CAMERA
    camera = f"width: {c.width}\nheight: {c.height}\nfx: {c.fx}\nfy: {c.fy}\ncx: {c.cx}\ncy: {c.cy}\n"
    (folder / "camera.yaml").write_text(f"{camera}baseline_m: {BASELINE_M}\nrate_hz: 10\n")
    longer = poses.copy()
    longer[:, :3, 3] *= 1000.0
    write_kitti_poses(folder / "poses.txt", np.asarray(longer))
    return folder


@pytest.mark.parametrize("words", [["slam"], ["preprocess"], ["slam", "--json"]])  # in JSON it is a cause
def test_it_is_said_once_and_noted(
    words: list[str], in_millimetres: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    assert cli.main([words[0], str(in_millimetres), str(out), *words[1:]]) == 0
    printed = capsys.readouterr()
    assert (printed.out + printed.err).count("the positions may be in millimetres") == 1
    found = sorted(out.rglob("manifest.json"))
    assert any("millimetres" in str(json.loads(path.read_text())["settings"].get("problems")) for path in found)
