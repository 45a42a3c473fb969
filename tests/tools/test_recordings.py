"""From a recording to a map by the command line: a film as a phone writes it, and a bag of two robots."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from recording_makers import (
    IMAGE,
    INFO,
    POSE,
    Channel,
    image_message,
    info_message,
    pose_message,
    turn_film,
    write_film,
)
from room import CAMERA, Room, walk

from maslam.frontend.cameras.models import RigKind
from maslam.frontend.datasets import open_dataset
from maslam.frontend.files.trajectory import Trajectory, write_tum
from maslam.mas.sequence import load_sequences
from maslam.tools import cli

pytestmark = pytest.mark.slow
FRAMES = 36
START_NS = 1_700_000_000_000_000_000


@pytest.fixture(scope="module")
def phone(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A film of a walk through a room, stored on its side, with a flag by which players turn it; a camera file and the
    true poses beside it."""
    folder, room, poses = tmp_path_factory.mktemp("phone"), Room(3), walk(FRAMES)
    upright = [room.frame(i, pose, RigKind.MONO).image for i, pose in enumerate(poses)]
    write_film(folder / "walk.mp4", [cv2.rotate(image, cv2.ROTATE_90_COUNTERCLOCKWISE) for image in upright], 10.0)
    turn_film(folder / "walk.mp4", 90)
    c = CAMERA
    camera = f"width: {c.width}\nheight: {c.height}\nfx: {c.fx}\nfy: {c.fy}\ncx: {c.cx}\ncy: {c.cy}\n"
    (folder / "walk.yaml").write_text(camera)
    write_tum(folder / "walk.tum", Trajectory(100_000_000 * np.arange(FRAMES), poses))
    return folder


def summary(run: Path) -> dict[str, Any]:
    content: dict[str, Any] = json.loads((run / "summary.json").read_text())
    return content


def test_a_film_to_a_map_in_two_commands(phone: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["inspect", str(phone / "walk.mp4")]) == 0
    shown = capsys.readouterr().out
    assert f"read from     walk.mp4, {FRAMES} frames of {CAMERA.height}x{CAMERA.width}, turned by 90 degrees" in shown
    assert "a flag says to turn the film by 90 degrees: it is turned, as players do" in shown
    assert cli.main(["slam", str(phone / "walk.mp4"), str(tmp_path / "run"), "--quiet"]) == 0
    result = summary(tmp_path / "run")
    (coverage,), (error,) = result["coverage"], result["ate_rmse_m"]["agents"]
    assert coverage["read"] == FRAMES and coverage["placed"] >= FRAMES - 4
    path_m = float(np.linalg.norm(np.diff(walk(FRAMES)[:, :3, 3], axis=0), axis=1).sum())
    assert error < 0.005 * path_m
    _, (sequence,) = load_sequences(tmp_path / "run" / "sequences")
    assert sequence.places.images[0] == "walk.mp4/000000"


def test_a_part_of_a_film(phone: Path, tmp_path: Path) -> None:
    options = ["--recording.start-s", "0.5", "--recording.stride", "2", "--quiet"]
    assert cli.main(["preprocess", str(phone / "walk.mp4"), str(tmp_path / "seqs"), *options]) == 0
    manifest = json.loads((tmp_path / "seqs" / "manifest.json").read_text())
    assert manifest["agents"][0]["frames"] == 16 and manifest["agents"][0]["start_ns"] == 500_000_000
    assert manifest["settings"]["recording"]["stride"] == 2


def channels_of(sequence: Any, robot: str) -> list[Channel]:
    """A rendered stereo agent as the topics of a robot."""
    stamps = (START_NS + sequence.stamps_ns).tolist()
    frames = [sequence.read(i) for i in range(len(sequence))]
    camera, baseline = sequence.rig.camera, sequence.rig.baseline_m
    K, size = camera.K, (camera.width, camera.height)
    P = np.hstack([K, [[-camera.fx * baseline], [0.0], [0.0]]])
    poses = sequence.groundtruth.poses
    received = [stamp + 3_000_000 for stamp in stamps]
    return [
        Channel(
            f"/{robot}/left/image_rect",
            IMAGE,
            received,
            lambda s, i: image_message(s, stamps[i], frames[i].image, "mono8"),
        ),
        Channel(
            f"/{robot}/right/image_rect",
            IMAGE,
            received,
            lambda s, i: image_message(s, stamps[i], frames[i].right, "mono8"),
        ),
        Channel(f"/{robot}/left/camera_info", INFO, received, lambda s, i: info_message(s, stamps[i], size, K)),
        Channel(f"/{robot}/right/camera_info", INFO, received, lambda s, i: info_message(s, stamps[i], size, K, P=P)),
        Channel(f"/{robot}/pose", POSE, received, lambda s, i: pose_message(s, stamps[i], poses[i])),
    ]


def test_a_bag_of_two_robots_to_one_map_in_one_command(town_stereo: Path, tmp_path: Path) -> None:
    pytest.importorskip("rosbags", reason="the extra `bags` is not installed")
    from recording_makers import write_ros2

    first, second = open_dataset(town_stereo).sequences
    write_ros2(tmp_path / "drive", [*channels_of(first, "alice"), *channels_of(second, "bob")])
    options = ["--quiet", "--recording.truth-topic", "pose"]
    assert cli.main(["slam", str(tmp_path / "drive"), str(tmp_path / "bag"), *options]) == 0
    assert cli.main(["slam", str(town_stereo), str(tmp_path / "folder"), "--quiet"]) == 0
    bag, folder = summary(tmp_path / "bag"), summary(tmp_path / "folder")
    np.testing.assert_allclose(bag["ate_rmse_m"]["agents"], folder["ate_rmse_m"]["agents"], rtol=1e-6)
    assert bag["ate_rmse_m"]["connected"] == pytest.approx(folder["ate_rmse_m"]["connected"], rel=1e-6)
    assert bag["matches"] == folder["matches"] and bag["matches"]["accepted"] > 0
    manifest, _ = load_sequences(tmp_path / "bag" / "sequences")
    assert [agent.sequence for agent in manifest.agents] == ["alice", "bob"]
    assert [agent.start_ns for agent in manifest.agents] == [START_NS, START_NS]
    page = (tmp_path / "bag" / "report" / "index.html").read_text()
    assert "data:image/jpeg;base64" in page  # the matches' images are found again in the bag
