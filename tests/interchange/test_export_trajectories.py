"""Trajectories, transforms, recordings and tables: read back by evo, mcap and rosbags, held against the run's files."""

from __future__ import annotations

import csv
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from maslam.backend.geometry import rotation_from_quat_wxyz, se3
from maslam.frontend.files.trajectory import read_tum
from maslam.tools import cli

AGENTS = ("agent_00", "agent_01")


def export(run: Path, out: Path, program: str, *words: str) -> Path:
    assert cli.main(["export", str(run), str(out), "--quiet", "--for", program, *words]) == 0
    return out


def table(path: Path) -> list[dict[str, str]]:
    with open(path, newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


def summary(run: Path) -> dict[str, Any]:
    return json.loads((run / "summary.json").read_text())


# -- evo ---------------------------------------------------------------------------------------------------------------


def ape(truth: Any, estimate: Any) -> float:
    """Root mean square of evo's position error after SE(3) alignment."""
    from evo.core import metrics

    estimate.align(truth, correct_scale=False)
    error = metrics.APE(metrics.PoseRelation.translation_part)
    error.process_data((truth, estimate))
    return float(error.get_statistic(metrics.StatisticsType.rmse))


def test_evo_measures_the_errors_of_the_run(finished: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file_interface = pytest.importorskip("evo.tools.file_interface")
    from evo.core import sync

    out, said = export(finished, tmp_path / "out", "evo"), summary(finished)
    assert f"evo_ape tum {out}/agent_01_truth.tum {out}/agent_01.tum -a\n" in capsys.readouterr().out
    read = file_interface.read_tum_trajectory_file
    for agent, known in zip(AGENTS, said["ate_rmse_m"]["agents"], strict=True):
        pair = sync.associate_trajectories(read(out / f"{agent}_truth.tum"), read(out / f"{agent}.tum"))
        assert len(pair[0].timestamps) == 20 and ape(*pair) == pytest.approx(known, rel=1e-3)
        rows = [file_interface.read_kitti_poses_file(out / f"{agent}{e}_kitti.txt") for e in ("_truth", "")]
        assert ape(*rows) == pytest.approx(known, rel=1e-3)


def test_evo_aligns_a_whole_group_at_once(finished: Path, tmp_path: Path) -> None:
    """What is measured is how the agents stand to each other, too: by hand, one alignment of all positions."""
    file_interface = pytest.importorskip("evo.tools.file_interface")
    from evo.core import sync

    out, read = export(finished, tmp_path / "out", "evo"), file_interface.read_tum_trajectory_file
    pair = sync.associate_trajectories(read(out / "group_00_truth.tum"), read(out / "group_00.tum"))
    assert len(pair[0].timestamps) == 40
    estimate, truth = (
        np.concatenate([read_tum(finished / agent / name).centres for agent in AGENTS])
        for name in ("trajectory.tum", "groundtruth.tum")
    )
    a, b = truth - truth.mean(axis=0), estimate - estimate.mean(axis=0)
    U, _, Vt = np.linalg.svd(a.T @ b)
    R = U @ np.diag([1.0, 1.0, np.linalg.det(U @ Vt)]) @ Vt
    expected = np.sqrt((np.linalg.norm(a - b @ R.T, axis=1) ** 2).mean())
    assert ape(*pair) == pytest.approx(expected, rel=1e-3)


def test_agents_apart_have_no_file_together(apart: Path, tmp_path: Path) -> None:
    names = {path.name for path in export(apart, tmp_path / "out", "evo").iterdir()}
    assert "agent_01.tum" in names and not {n for n in names if n.startswith("group")}


# -- transforms --------------------------------------------------------------------------------------------------------


def transform(row: dict[str, str]) -> NDArray[np.float64]:
    x, y, z, qx, qy, qz, qw = (float(row[k]) for k in ("x", "y", "z", "qx", "qy", "qz", "qw"))
    return se3(rotation_from_quat_wxyz([qw, qx, qy, qz]), [x, y, z])


def test_transforms_compose_to_the_trajectory(finished: Path, tmp_path: Path) -> None:
    out = export(finished, tmp_path / "out", "tf")
    rows = table(out / "tf.csv")
    stamps = [int(row["stamp_ns"]) for row in rows]
    assert stamps == sorted(stamps)
    for agent in AGENTS:
        path = read_tum(finished / agent / "trajectory.tum")
        odom = [row for row in rows if (row["frame_id"], row["child_frame_id"]) == ("map", f"{agent}/odom")]
        camera = [r for r in rows if (r["frame_id"], r["child_frame_id"]) == (f"{agent}/odom", f"{agent}/camera")]
        assert [int(row["stamp_ns"]) for row in camera] == path.stamps_ns.tolist() and len(odom) == len(camera)
        np.testing.assert_allclose(transform(camera[0]), np.eye(4), atol=1e-7)
        for first, second, pose in zip(odom, camera, path.poses, strict=True):
            np.testing.assert_allclose(transform(first) @ transform(second), pose, atol=1e-6)
    lines = [json.loads(line) for line in (out / "tf.jsonl").read_text().splitlines()]
    assert len(lines) == len(rows)
    for line, row in zip(lines, rows, strict=True):
        stamp = line["header"]["stamp"]
        assert stamp["sec"] * 10**9 + stamp["nanosec"] == int(row["stamp_ns"]) and 0 <= stamp["nanosec"] < 10**9
        assert (line["header"]["frame_id"], line["child_frame_id"]) == (row["frame_id"], row["child_frame_id"])
        assert line["transform"]["translation"]["z"] == pytest.approx(float(row["z"]), abs=1e-7)
        assert line["transform"]["rotation"]["w"] == pytest.approx(float(row["qw"]), abs=1e-7)


def test_frames_that_nothing_joins_have_maps_of_their_own(
    apart: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rows = table(export(apart, tmp_path / "out", "tf") / "tf.csv")
    parents = {row["child_frame_id"]: row["frame_id"] for row in rows}
    assert parents["agent_00/odom"] == "map" and parents["agent_01/odom"] == "map_1"
    assert "2 frames that no match joins: map, map_1" in capsys.readouterr().out


# -- recordings --------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def bag(two_cameras: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    pytest.importorskip("rosbags")
    return export(two_cameras, tmp_path_factory.mktemp("bag") / "out", "mcap", "--with-images") / "rosbag2"


def test_another_reader_finds_poses_paths_points_and_images(bag: Path, two_cameras: Path) -> None:
    """Decoded by the package mcap, with the message definitions that the file itself holds."""
    import cv2

    reader = pytest.importorskip("mcap.reader")
    decoder = pytest.importorskip("mcap_ros2.decoder")
    found: dict[str, list[Any]] = {}
    with open(bag / "rosbag2.mcap", "rb") as file:
        made = reader.make_reader(file, decoder_factories=[decoder.DecoderFactory()])
        assert made.get_header().profile == "ros2"
        times = []
        for _, channel, message, content in made.iter_decoded_messages(log_time_order=False):
            found.setdefault(channel.topic, []).append(content)
            times.append(message.log_time)
    assert times == sorted(times)
    for agent in AGENTS:
        path = read_tum(two_cameras / agent / "trajectory.tum")
        (whole,) = found[f"/{agent}/path"]
        assert whole.header.frame_id == "map"
        for said in (whole.poses, found[f"/{agent}/pose"]):
            at = np.array([[p.pose.position.x, p.pose.position.y, p.pose.position.z] for p in said])
            np.testing.assert_allclose(at, path.centres, atol=1e-9)
            assert [p.header.stamp.sec * 10**9 + p.header.stamp.nanosec for p in said] == path.stamps_ns.tolist()
        (cloud,) = found[f"/{agent}/points"]
        xyz = np.frombuffer(bytes(cloud.data), dtype="<f4").reshape(-1, 3)
        assert len(xyz) == cloud.width > 300 and [f.name for f in cloud.fields] == ["x", "y", "z"]
        info, image = found[f"/{agent}/camera/camera_info"][0], found[f"/{agent}/camera/image/compressed"]
        pixels = cv2.imdecode(np.frombuffer(bytes(image[0].data), dtype=np.uint8), cv2.IMREAD_COLOR)
        assert pixels.shape == (info.height, info.width, 3) and len(image) == len(path) and image[0].format == "png"
    fixed = {t.child_frame_id for m in found["/tf_static"] for t in m.transforms}
    moving = {(t.header.frame_id, t.child_frame_id) for m in found["/tf"] for t in m.transforms}
    assert fixed == {"agent_00/odom", "agent_01/odom"}
    assert moving == {(f"{a}/odom", f"{a}/camera") for a in AGENTS}


def test_truth_in_a_recording_lies_beside_the_path(bag: Path, two_cameras: Path) -> None:
    """Brought into the map by the alignment that the errors are measured after: apart by no more than they say."""
    from rosbags.highlevel import AnyReader
    from rosbags.typesys import Stores, get_typestore

    known = summary(two_cameras)["ate_rmse_m"]["connected"]
    with AnyReader([bag], default_typestore=get_typestore(Stores.ROS2_HUMBLE)) as reader:
        paths = {
            c.topic: reader.deserialize(raw, c.msgtype)
            for c, _, raw in reader.messages(c for c in reader.connections if c.msgtype == "nav_msgs/msg/Path")
        }
    for agent, error in zip(AGENTS, known, strict=True):
        at, true = (
            np.array([[p.pose.position.x, p.pose.position.y, p.pose.position.z] for p in paths[f"/{agent}/{n}"].poses])
            for n in ("path", "truth")
        )
        assert np.sqrt((np.linalg.norm(at - true, axis=1) ** 2).mean()) < 2.0 * error + 0.01


def test_without_rosbags_a_line_says_what_to_install(
    finished: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(__import__("sys").modules, "rosbags.rosbag2", None)
    assert cli.main(["export", str(finished), str(tmp_path / "out"), "--for", "mcap", "--quiet"]) == 1
    assert "pip install 'maslam[bags]'" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


# -- tables ------------------------------------------------------------------------------------------------------------


def test_tables_hold_what_the_report_plots(finished: Path, tmp_path: Path) -> None:
    out, said = export(finished, tmp_path / "out", "csv"), summary(finished)
    rows = table(out / "trajectories.csv")
    for agent, known in zip(AGENTS, said["ate_rmse_m"]["agents"], strict=True):
        mine = [row for row in rows if row["agent"] == agent]
        xyz = np.array([[float(row[k]) for k in ("x", "y", "z")] for row in mine])
        true = np.array([[float(row[f"truth_{k}"]) for k in ("x", "y", "z")] for row in mine])
        np.testing.assert_allclose(true, read_tum(finished / agent / "groundtruth.tum").centres, atol=1e-6)
        off = np.linalg.norm(xyz - true, axis=1)
        np.testing.assert_allclose([float(row["error"]) for row in mine], off, atol=1e-6)
        assert {row["unit"] for row in mine} == {"metres"} and known <= np.sqrt((off**2).mean()) + 1e-9
    by_operation = {row["operation"]: row for row in table(out / "bytes.csv")}
    assert int(by_operation["total"]["wire_bytes"]) == said["traffic"]["total"]["wire_bytes"]
    between = sum(int(row["wire_bytes"]) for row in table(out / "bytes_between_agents.csv"))
    assert between == said["traffic"]["total"]["wire_bytes"]
    outcomes = {row["outcome"]: int(row["count"]) for row in table(out / "match_outcomes.csv")}
    assert outcomes["accepted"] == said["matches"]["accepted"]
    assert len(table(out / "match_links.csv")) == said["matches"]["accepted"]
    assert (out / "timeline.csv").read_bytes() == (finished / "timeline.csv").read_bytes()
    assert {row["holder"] for row in table(out / "map_copies.csv")} == set(AGENTS)
    assert [float(row["ate_rmse_m"]) for row in table(out / "errors.csv")] == pytest.approx(
        said["ate_rmse_m"]["agents"]
    )
