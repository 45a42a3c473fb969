"""Preprocessing's own part, with a front end whose answers are known: folders, clocks, what is left out, what is
taken up again.
"""

from __future__ import annotations

import json
import shutil
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
import pytest

from maslam.backend.geometry import se3_exp
from maslam.frontend.errors import FrontendError
from maslam.frontend.files.point_views import PointViews
from maslam.frontend.files.trajectory import Trajectory, read_tum, write_kitti_poses
from maslam.frontend.files.vo_files import VoTrack, read_tracks
from maslam.frontend.frames import Frame
from maslam.frontend.reason import NO_REASON, Reason
from maslam.frontend.stopwatch import Stopwatch
from maslam.frontend.tracking.pose_log import MomentLog
from maslam.mas.sequence import load_sequences
from maslam.tools import cli
from maslam.tools.pipeline.agent_folder import lost_frames
from maslam.tools.pipeline.tracking import Gap

FRAMES, EVERY = 12, 2
TRUTH = se3_exp(np.column_stack([np.zeros((FRAMES, 2)), np.arange(FRAMES), np.zeros((FRAMES, 3))]))
BROKEN_RIGHT = "image_1/{:06d}.png: cut off"
calls: list[int] = []
broken_right: set[int] = set()


class KnownOdometry:
    """Follows the truth; each second frame is a key-frame that sees point ``index`` and the one before. Black frames
    are lost.
    """

    def __init__(self, *_: Any) -> None:
        self._seen: list[int] = []
        self._moments = MomentLog()
        self.stopwatch = Stopwatch()

    def process(self, frame: Frame) -> Any:
        calls.append(frame.index)
        tracked = frame.image.max() > 0
        if tracked:
            self._seen.append(frame.index)
        self._moments.note(frame.stamp_ns, NO_REASON if tracked else Reason("too dark", "too dark"))
        pose = TRUTH[frame.index] if tracked else None
        return SimpleNamespace(
            is_keyframe=tracked and frame.index % EVERY == 0,
            stays=tracked and frame.index % EVERY == 0,
            T_W_C=pose,
            reason="" if tracked else "too dark",
            kind="" if tracked else "too dark",
            first=None,
            problem=BROKEN_RIGHT.format(frame.index) if frame.index in broken_right else "",
        )

    def finish(self) -> Any:
        keyframes = np.array([i for i in self._seen if i % EVERY == 0], dtype=np.int64)
        k = len(keyframes)
        observations = np.array([[i, j] for i in range(k) for j in (i, i + 1)], dtype=np.int32).reshape(-1, 2)
        n = len(observations)
        points = np.column_stack([np.arange(k + 1), np.zeros(k + 1), np.zeros(k + 1)]).astype(float)
        descriptors = np.zeros((n, 32), dtype=np.uint8)
        track = VoTrack(
            keyframes * 0.1 + 5.0, TRUTH[keyframes], points, observations, descriptors, np.zeros((n, 2), np.int32)
        )
        seen = np.array(self._seen, dtype=np.int64)
        trajectory = Trajectory(seen * 100_000_000 + 5_000_000_000, TRUTH[seen])
        weak = SimpleNamespace(first_ns=5_400_000_000, last_ns=5_800_000_000, reason="7 points", kind="few points")
        return SimpleNamespace(
            tracks=[track],
            views=[PointViews(track.observations, np.float32(np.arange(2 * len(track.observations))).reshape(-1, 2))],
            keyframe_indices=[keyframes],
            trajectories=[trajectory],
            lost=self._moments.lost([trajectory.stamps_ns], lambda: NO_REASON),
            doubtful=[weak],
            stats={},
        )


class KnownModel:
    """A vector that tells the frame: the mean grey level."""

    name, sha256, dim, threshold, candidate_threshold, min_std = "known", "0" * 64, 2, 0.1, 0.3, 2.0
    colour = False

    @classmethod
    def load(cls, *_: Any, **__: Any) -> KnownModel:
        return cls()

    def look(self, images: list[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
        angle = np.array([image.mean() / 100 for image in images])
        return np.column_stack([np.cos(angle), np.sin(angle)]).astype(np.float32), np.ones(len(images), dtype=bool)


@pytest.fixture(autouse=True)
def known_front_end(monkeypatch: pytest.MonkeyPatch) -> None:
    calls.clear()
    monkeypatch.setitem(sys.modules, "maslam.frontend.odometry", SimpleNamespace(Odometry=KnownOdometry))
    monkeypatch.setattr("maslam.descriptors.choice.NetVlad", KnownModel)
    monkeypatch.setattr("maslam.tools.pipeline.tracking_cache.code_digest", lambda *parts: "one version of the code")


def write_agent(folder: Path, dark: bool = False) -> Path:
    (folder / "image_0").mkdir(parents=True)
    for i in range(FRAMES):
        cv2.imwrite(
            str(folder / "image_0" / f"{i:06d}.png"), np.full((24, 32), 0 if dark else 10 * (i + 1), dtype=np.uint8)
        )
    (folder / "camera.yaml").write_text("{width: 32, height: 24, fx: 30, fy: 30, cx: 15.5, cy: 11.5, rate_hz: 10}\n")
    (folder / "times.txt").write_text("".join(f"{5 + 0.1 * i:.6f}\n" for i in range(FRAMES)))
    write_kitti_poses(folder / "poses.txt", TRUTH)
    return folder


def preprocess(*words: object) -> int:
    return cli.main(["preprocess", *[str(word) for word in words], "--workers", "1", "--quiet"])


def test_one_sequence_is_one_agent(tmp_path: Path) -> None:
    assert preprocess(write_agent(tmp_path / "drive"), tmp_path / "seqs") == 0
    manifest, (agent,) = load_sequences(tmp_path / "seqs")
    assert (manifest.scale, manifest.split, manifest.descriptor.name) == ("arbitrary", None, "known")
    assert (manifest.agents[0].frames, manifest.agents[0].keyframes, manifest.agents[0].start_ns) == (
        12,
        6,
        5_000_000_000,
    )
    np.testing.assert_allclose(agent.tracks[0].stamps_s, np.arange(6) * 0.2, atol=1e-9)
    np.testing.assert_allclose(agent.trajectory.poses, TRUTH, atol=1e-9)
    assert agent.groundtruth is not None and len(agent.groundtruth) == FRAMES
    level = np.arctan2(agent.places.vectors[:, 1], agent.places.vectors[:, 0]) * 100
    np.testing.assert_allclose(level, [10, 30, 50, 70, 90, 110], atol=1e-3)
    assert agent.places.images == tuple(f"image_0/{i:06d}.png" for i in range(0, 12, 2))
    assert all((tmp_path / "drive" / name).is_file() for name in agent.places.images)


def test_ground_truth_of_other_images_is_said_and_noted(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Odometry goes straight ahead, the file to and fro."""
    folder = write_agent(tmp_path / "drive")
    assert preprocess(folder, tmp_path / "right") == 0
    assert "warning" not in capsys.readouterr().err
    write_kitti_poses(folder / "poses.txt", np.vstack([TRUTH[: FRAMES // 2], TRUTH[: FRAMES // 2][::-1]]))
    assert preprocess(folder, tmp_path / "wrong") == 0
    (line,) = (line for line in capsys.readouterr().err.splitlines() if "the ground truth has" in line)
    assert (
        line.startswith("warning: ")
        and "drive: the ground truth has a path of another shape" in line
        and "another recording" in line
    )
    assert line.removeprefix("warning: ") in load_sequences(tmp_path / "wrong")[0].settings["problems"]


def test_agents_with_one_camera_and_with_depth_make_one_team(tmp_path: Path) -> None:
    """A multi-agent folder in which one has depth maps: it alone is metric, and the manifest says so of each."""
    write_agent(tmp_path / "team" / "agent_00")
    folder = write_agent(tmp_path / "team" / "agent_01")
    (folder / "depth_0").mkdir()
    for i in range(FRAMES):
        cv2.imwrite(str(folder / "depth_0" / f"{i:06d}.png"), np.full((24, 32), 1000, dtype=np.uint16))
    camera = (folder / "camera.yaml").read_text().replace("}", ", depth_unit_m: 0.001}")
    (folder / "camera.yaml").write_text(camera)
    assert preprocess(tmp_path / "team", tmp_path / "seqs") == 0
    manifest, sequences = load_sequences(tmp_path / "seqs")
    assert manifest.scale == "metric", "lengths can be metres where one agent knows them"
    assert [a.camera.kind for a in manifest.agents] == ["mono", "rgbd"]
    assert [s.metric for s in sequences] == [False, True]


def test_a_split_gives_each_agent_its_own_origin_clock_and_vectors(tmp_path: Path) -> None:
    assert preprocess(write_agent(tmp_path / "drive"), tmp_path / "seqs", "--agents", 2, "--overlap", 1) == 0
    manifest, (first, second) = load_sequences(tmp_path / "seqs")
    assert [(a.first_frame, a.frames, a.keyframes) for a in manifest.agents] == [(0, 7, 4), (4, 8, 4)]
    assert manifest.split is not None and (manifest.split.agents, manifest.split.overlap) == (2, 1)
    assert second.start_ns == 5_400_000_000 and second.trajectory.stamps_ns[0] == 0
    np.testing.assert_allclose(second.tracks[0].poses[0], np.eye(4), atol=1e-9)
    np.testing.assert_allclose(second.trajectory.poses[:, 2, 3], np.arange(8), atol=1e-9)
    np.testing.assert_allclose(second.places.vectors, np.vstack([first.places.vectors[2:], second.places.vectors[2:]]))
    truth = read_tum(tmp_path / "seqs" / "agent_01" / "groundtruth.tum")
    assert truth.centres[0, 2] == pytest.approx(4.0)  # ground truth stays in the world
    assert len(read_tracks(tmp_path / "seqs" / "agent_00")[0].points) == 5


def test_doubtful_intervals_are_in_the_manifest_for_each_agents_frames(tmp_path: Path) -> None:
    source, out = write_agent(tmp_path / "drive"), tmp_path / "seqs"
    for _ in range(2):  # made, then taken up again
        assert preprocess(source, out, "--agents", 2, "--overlap", 0) == 0
        agents = load_sequences(out)[0].agents
        found = [(a.frames, [(d.first_frame, d.last_frame, d.reason) for d in a.doubtful]) for a in agents]
        # Frames 4 to 8 of twelve.
        assert found == [(6, [(4, 5, "few points: 7 points")]), (6, [(0, 2, "few points: 7 points")])]
        (out / "manifest.json").unlink()


def test_results_are_taken_up_again_and_made_anew_when_something_changed(tmp_path: Path) -> None:
    source, out = write_agent(tmp_path / "drive"), tmp_path / "seqs"
    assert preprocess(source, out) == 0
    before = {p: p.read_bytes() for p in sorted(out.rglob("*")) if p.is_file()}
    assert preprocess(source, out, "--agents", 3) == 1, "not without being asked"
    assert preprocess(source, out, "--agents", 3, "--overwrite") == 0
    assert len(calls) == FRAMES, "another split needs no new tracking"
    assert preprocess(source, out, "--overwrite") == 0
    assert {p: p.read_bytes() for p in sorted(out.rglob("*")) if p.is_file()} == before
    assert preprocess(source, out, "--odometry.mapping.window", 11, "--overwrite") == 0
    assert len(calls) == 2 * FRAMES, "other settings do"
    cv2.imwrite(str(source / "image_0" / "000003.png"), np.full((24, 32), 200, dtype=np.uint8))
    assert preprocess(source, out, "--odometry.mapping.window", 11) == 0
    assert len(calls) == 3 * FRAMES, "another image does"


def test_vectors_of_two_models_do_not_run_together(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    for name in ("agent_00", "agent_01"):
        write_agent(tmp_path / "town" / name)
    assert preprocess(tmp_path / "town", tmp_path / "one") == 0
    monkeypatch.setattr(KnownModel, "sha256", "1" * 64)
    monkeypatch.setattr(KnownModel, "name", "another")
    assert preprocess(tmp_path / "town", tmp_path / "two", "--model", "another.onnx") == 0
    assert cli.main(["run", str(tmp_path / "two"), str(tmp_path / "run"), "--quiet"]) == 0
    shutil.copytree(tmp_path / "two" / "agent_01", tmp_path / "one" / "agent_01", dirs_exist_ok=True)
    capsys.readouterr()
    assert cli.main(["run", str(tmp_path / "one"), str(tmp_path / "mixed"), "--quiet"]) == 1
    (line,) = capsys.readouterr().err.splitlines()
    place = tmp_path / "one" / "agent_01" / "netvlad.npz"
    assert line.startswith(f"maslam: {place}: made by model another (111111111111, 2 numbers)")
    assert "says known (000000000000, 2): make the folder anew" in line
    assert not (tmp_path / "mixed" / "summary.json").exists()


def test_a_sequence_that_cannot_be_tracked_does_not_stop_the_others(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for name, dark in (("agent_00", False), ("agent_01", True), ("agent_02", False)):
        write_agent(tmp_path / "town" / name, dark)
    assert preprocess(tmp_path / "town", tmp_path / "seqs") == 0
    manifest, _ = load_sequences(tmp_path / "seqs")
    assert [(a.name, a.sequence) for a in manifest.agents] == [("agent_00", "agent_00"), ("agent_01", "agent_02")]
    assert manifest.settings["problems"] == ["agent_01: no frame of 12 could be tracked: too dark (12 x)"]
    assert "agent_01: no frame of 12 could be tracked: too dark (12 x)" in capsys.readouterr().err
    (left_out,) = manifest.left_out
    assert (left_out.sequence, left_out.frames) == ("agent_01", 12)
    assert left_out.reason == "no frame of 12 could be tracked: too dark (12 x)"


def test_nothing_to_track_is_an_error_and_leaves_no_manifest(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert preprocess(write_agent(tmp_path / "drive", dark=True), tmp_path / "seqs") == 1
    assert capsys.readouterr().err.splitlines()[-1].endswith("no frame of 12 could be tracked: too dark (12 x)")
    assert not (tmp_path / "seqs").exists()


@pytest.mark.parametrize("command", ["preprocess", "slam"])
def test_fewer_agents_than_asked_for_is_an_error(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], command: str
) -> None:
    words = [command, str(write_agent(tmp_path / "drive")), str(tmp_path / "out"), "--agents", "9", "--quiet"]
    assert cli.main(words) == 1
    # Blocks of 12 frames for 9 begin at 0 1 2 4 5 6 8 9 10; the key-frames are 0 2 4 6 8 10.
    said = "12 frames make 6 agents, not 9: the others have no key-frame; ask for fewer"
    assert capsys.readouterr().err.splitlines()[-1].endswith(said)
    assert not list(tmp_path.rglob("manifest.json"))


def test_one_image_is_too_few(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    source = write_agent(tmp_path / "drive")
    for image in sorted((source / "image_0").iterdir())[1:]:
        image.unlink()
    for name in ("times.txt", "poses.txt"):
        (source / name).write_text((source / name).read_text().splitlines()[0] + "\n")
    camera = source / "camera.yaml"  # of a pair, whose missing half is a warning and not the reason
    camera.write_text(camera.read_text().replace("}", ", baseline_m: 0.5}"))
    assert preprocess(source, tmp_path / "out" / "sequences") == 1
    (line,) = capsys.readouterr().err.splitlines()
    assert line == f"maslam: drive: {source}: one image is too few; a camera is followed from image to image"
    assert not (tmp_path / "out").exists()


def test_a_truncated_image_is_left_out_and_said(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    source = write_agent(tmp_path / "drive")
    image = source / "image_0" / "000005.png"
    image.write_bytes(image.read_bytes()[:-20])
    assert preprocess(source, tmp_path / "seqs") == 0
    assert "000005.png" in capsys.readouterr().err
    manifest, (agent,) = load_sequences(tmp_path / "seqs")
    assert len(agent.trajectory) == FRAMES - 1 and manifest.agents[0].frames == FRAMES
    assert any("000005.png" in problem for problem in manifest.settings["problems"])
    (lost,) = agent.lost
    assert (lost.first_frame, lost.last_frame, lost.reason) == (5, 5, "the image could not be read")


def test_lost_intervals_are_those_of_the_agents_own_frames_without_a_pose() -> None:
    """Twenty frames: 3 to 8 lost for two reasons, 12 unreadable, 15 to 17 of a track whose key-frames are another's."""
    stamps = np.arange(20, dtype=np.int64) * 100
    track = Trajectory(stamps[15:18], np.tile(np.eye(4), (3, 1, 1)))
    rest = [k for k in range(20) if not 3 <= k <= 8 and k != 12 and not 15 <= k <= 17]
    main = Trajectory(stamps[rest], np.tile(np.eye(4), (len(rest), 1, 1)))
    lost = (Gap(3, 5, "too dark"), Gap(6, 8, "few points"))
    tracked = SimpleNamespace(trajectories=(main, track), lost=lost, other_size=())
    share = SimpleNamespace(first=4, last=19)
    plan: Any = SimpleNamespace(sequence=SimpleNamespace(stamps_ns=stamps), tracked=tracked, share=share)
    found = lost_frames(plan, main.stamps_ns)
    assert [(e.first_frame, e.last_frame, e.reason) for e in found] == [
        (0, 1, "too dark"),
        (2, 4, "few points"),
        (8, 8, "the image could not be read"),
        (11, 13, "tracked, but no key-frame of its track is the agent's"),
    ]
    assert lost_frames(plan, stamps) == ()


def test_a_key_frame_without_its_second_image_stays_and_is_said(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    source = write_agent(tmp_path / "drive")
    monkeypatch.setattr(sys.modules[__name__], "broken_right", {4})
    assert preprocess(source, tmp_path / "one") == 0
    _, (agent,) = load_sequences(tmp_path / "one")
    assert len(agent.trajectory) == FRAMES
    assert BROKEN_RIGHT.format(4) in capsys.readouterr().err
    monkeypatch.setattr(sys.modules[__name__], "broken_right", {2, 4, 6})
    assert preprocess(source, tmp_path / "many") == 1
    assert f"2 of the first 5 frames cannot be read: {BROKEN_RIGHT.format(4)}" in capsys.readouterr().err


def test_many_unreadable_images_are_an_error(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    source = write_agent(tmp_path / "drive")
    for i in (3, 5, 7):
        (source / "image_0" / f"{i:06d}.png").write_bytes(b"")
    assert preprocess(source, tmp_path / "seqs") == 1
    assert "2 of the first 6 frames cannot be read" in capsys.readouterr().err


def test_an_interrupted_run_leaves_no_folder_that_counts(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    source, out = write_agent(tmp_path / "drive"), tmp_path / "seqs"

    def interrupt(*_: object) -> None:
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr("maslam.tools.pipeline.agent_folder.write_manifest", interrupt)
        assert preprocess(source, out) == 130
    assert not (out / "manifest.json").exists()
    assert preprocess(source, out) == 0
    assert len(calls) == FRAMES


@pytest.mark.parametrize(
    ("words", "code"), [(["--agents", "2"], 2), (["--overlap", "-1"], 2), (["--odometry.nonsense", "3"], 2)]
)
def test_options_that_do_not_fit(words: list[str], code: int, tmp_path: Path) -> None:
    for name in ("agent_00", "agent_01"):
        write_agent(tmp_path / "town" / name)
    assert preprocess(tmp_path / "town", tmp_path / "seqs", *words) == code


def test_somebody_elses_folder_is_not_touched(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "seqs").mkdir()
    (tmp_path / "seqs" / "agent_00").write_text("mine")
    assert preprocess(write_agent(tmp_path / "drive"), tmp_path / "seqs") == 1
    assert "not empty" in capsys.readouterr().err
    assert (tmp_path / "seqs" / "agent_00").read_text() == "mine"


def test_the_manifest_is_plain_json(tmp_path: Path) -> None:
    preprocess(write_agent(tmp_path / "drive"), tmp_path / "seqs")
    content = json.loads((tmp_path / "seqs" / "manifest.json").read_text())
    assert content["version"] == 1 and content["source"] == str(tmp_path / "drive")


def test_workers_run_jobs_side_by_side_and_keep_their_order() -> None:
    from maslam.tools.common.parallel import run_jobs
    from maslam.tools.common.progress import Silent

    outcomes = run_jobs(square_or_fail, {"a": (3, 1), "b": (-1, 1), "c": (4, 1)}, 2, Silent())
    assert [(name, o.result) for name, o in outcomes.items()] == [("a", 9), ("b", None), ("c", 16)]
    assert isinstance(outcomes["b"].error, FrontendError)


def square_or_fail(number: int, advance: Any) -> int:
    advance(1)
    if number < 0:
        raise FrontendError("negative")
    return number * number


@pytest.mark.parametrize(
    ("text", "code", "said"),
    [
        ("relpose: {min_inliers: 3}", 2, ":1: unknown setting 'relpose'; there are odometry, recording, images"),
        (
            "odometry: {features: {track: 3}}",
            2,
            ":1: unknown setting 'odometry.features.track'; did you mean 'odometry.features.tracks'?",
        ),
        ("odometry: 3", 1, ": odometry: expected keys and values, found 3"),
    ],
)
def test_a_file_of_settings_is_checked(
    text: str, code: int, said: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "c.yaml").write_text(text)
    assert preprocess(write_agent(tmp_path / "drive"), tmp_path / "seqs", "--config", tmp_path / "c.yaml") == code
    line = capsys.readouterr().err.strip()
    assert line == f"maslam: {tmp_path / 'c.yaml'}{said}"
