"""From rendered images of a camera that is carried off and back, through `maslam preprocess`, to the five files, read
by a program that knows nothing but their description; then on to an agent that joins its tracks."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "frontend"))
import room

from maslam.backend.central.optimise import optimise
from maslam.backend.config import CentralConfig
from maslam.backend.geometry import se3, so3_exp, umeyama
from maslam.backend.pose_graph.g2o import read_g2o
from maslam.frontend.cameras.models import RigKind
from maslam.frontend.files.trajectory import read_tum, write_kitti_poses
from maslam.frontend.files.vo_files import read_tracks, write_track
from maslam.frontend.vocabulary.vocabulary import Vocabulary
from maslam.mas.policies.presets import preset
from maslam.mas.sequence import load_sequences
from maslam.mas.simulation import run
from maslam.tools import cli

pytestmark = pytest.mark.slow

HOME, ELSEWHERE = 3, 77
WALK = room.walk(60)
ASIDE = se3(so3_exp([0.0, 0.03, 0.0]), [0.05, 0.02, 0.0])
SHOTS = [
    *((HOME, T) for T in WALK[:30]),
    *((ELSEWHERE, T) for T in WALK[:26]),
    *((HOME, T @ ASIDE) for T in WALK[2:36]),
]
FIVE = ("poses", "times", "lm_pos", "lm_obs", "descs")


@pytest.fixture(scope="module")
def sequences(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The SEQS folder of one agent with three tracks: a room, another room, the first again."""
    base = tmp_path_factory.mktemp("carried")
    folder = base / "images" / "agent_00"
    rooms = {seed: room.Room(seed) for seed in (HOME, ELSEWHERE)}
    for name in ("image_0", "image_1"):
        (folder / name).mkdir(parents=True)
    for i, (seed, T_W_C) in enumerate(SHOTS):
        frame = rooms[seed].frame(i, T_W_C, RigKind.STEREO)
        assert frame.right is not None
        cv2.imwrite(str(folder / "image_0" / f"{i:06d}.png"), frame.image)
        cv2.imwrite(str(folder / "image_1" / f"{i:06d}.png"), frame.right)
    c = room.CAMERA
    (folder / "camera.yaml").write_text(
        f"{{width: {c.width}, height: {c.height}, fx: {c.fx}, fy: {c.fy}, cx: {c.cx}, cy: {c.cy}, "
        f"baseline_m: {room.BASELINE_M}, rate_hz: 10}}\n"
    )
    (folder / "times.txt").write_text("".join(f"{7 + 0.1 * i:.6f}\n" for i in range(len(SHOTS))))
    away = se3(np.eye(3), [100.0, 0.0, 0.0])
    write_kitti_poses(folder / "poses.txt", np.array([T if seed == HOME else away @ T for seed, T in SHOTS]))
    words = [str(base / "images"), str(base / "seqs"), "--workers", "1", "--quiet"]
    assert cli.main(["preprocess", *words]) == 0
    return base / "seqs"


@dataclass
class FiveFiles:
    """What the description promises, nothing more."""

    poses: list[list[float]]
    times: list[float]
    points: list[list[float]]
    seen: list[tuple[int, int]]
    descriptors: list[list[int]]
    nodes: list[tuple[int, int]]


def read_five(folder: Path, k: int) -> FiveFiles:
    """Written from ``formats.md`` alone: ASCII, one row a line, space separated."""

    def rows(name: str, columns: int) -> list[list[str]]:
        lines = (folder / f"{name}_{k}.txt").read_bytes().decode("ascii").split("\n")
        assert lines.pop() == "", "the last line ends too"
        table = [line.split(" ") for line in lines]
        assert all(len(row) == columns for row in table)
        return table

    described = [[int(field) for field in row] for row in rows("descs", 34)]
    return FiveFiles(
        poses=[[float(field) for field in row] for row in rows("poses", 16)],
        times=[float(row[0]) for row in rows("times", 1)],
        points=[[float(field) for field in row] for row in rows("lm_pos", 3)],
        seen=[(int(a), int(b)) for a, b in rows("lm_obs", 2)],
        descriptors=[row[:32] for row in described],
        nodes=[(row[32], row[33]) for row in described],
    )


@pytest.mark.parametrize("k", [0, 1, 2])
def test_a_reader_written_from_the_description_accepts_every_track(sequences: Path, k: int) -> None:
    files = read_five(sequences / "agent_00", k)
    assert len(files.poses) == len(files.times) >= 2
    assert all(a < b for a, b in zip(files.times, files.times[1:], strict=False))
    assert len(files.seen) == len(files.descriptors) == len(files.nodes) > 300
    assert len(set(files.seen)) == len(files.seen)
    assert {a for a, _ in files.seen} == set(range(len(files.poses)))
    assert {b for _, b in files.seen} == set(range(len(files.points)))
    assert all(0 <= byte <= 255 for row in files.descriptors for byte in row)
    assert all(0 <= node < 65536 for pair in files.nodes for node in pair)
    for row in files.poses:
        assert row[12:] == [0.0, 0.0, 0.0, 1.0]
    # T_W_C maps camera to world: what a key-frame sees lies before it and inside its image.
    c = room.CAMERA
    inside = 0
    for keyframe, point in files.seen:
        T = np.array(files.poses[keyframe]).reshape(4, 4)
        x, y, z = T[:3, :3].T @ (np.array(files.points[point]) - T[:3, 3])
        u, v = c.fx * x / z + c.cx, c.fy * y / z + c.cy
        inside += z > 0 and -2 < u < c.width + 1 and -2 < v < c.height + 1
    assert inside == len(files.seen)


def test_times_are_the_images_and_poses_the_cameras(sequences: Path) -> None:
    """Counted from the agent's own first frame, as splitting demands; the track's origin is its first key-frame."""
    last = -1.0
    for k in range(3):
        files = read_five(sequences / "agent_00", k)
        frames = [round(10 * t) for t in files.times]
        np.testing.assert_allclose(files.times, np.array(frames) / 10.0, atol=1e-6)
        assert files.times[0] > last
        last = files.times[-1]
        np.testing.assert_allclose(np.array(files.poses[0]).reshape(4, 4), np.eye(4), atol=1e-9)
        centres = np.array(files.poses).reshape(-1, 4, 4)[:, :3, 3]
        truth = np.array([np.linalg.inv(SHOTS[frames[0]][1]) @ SHOTS[i][1] for i in frames])[:, :3, 3]
        assert np.abs(centres - truth).max() < 0.05
        assert len({SHOTS[i][0] for i in frames}) == 1, "no track spans two rooms"
    assert not (sequences / "agent_00" / "poses_3.txt").exists()


def test_node_ids_are_the_nearest_children_of_the_vocabulary(sequences: Path, tmp_path: Path) -> None:
    """Level 3 and level 4 of a descent written here, in DBoW2's text form of the vocabulary."""
    Vocabulary.load().save(tmp_path / "vocabulary.txt")
    lines = (tmp_path / "vocabulary.txt").read_text().splitlines()[1:]
    table = np.array([line.split()[:34] for line in lines], dtype=np.int64)
    files = read_five(sequences / "agent_00", 0)
    for row in range(0, len(files.seen), 131):
        bits = np.unpackbits(np.array(files.descriptors[row], np.uint8))
        node, path = 0, []
        for _ in range(4):
            children = np.flatnonzero(table[:, 0] == node)
            if len(children):
                apart = (np.unpackbits(table[children, 2:].astype(np.uint8), axis=1) != bits).sum(axis=1)
                node = int(children[apart.argmin()]) + 1
            path.append(node)
        assert files.nodes[row] == (path[2], path[3])


def test_a_round_trip_gives_the_same_bytes(sequences: Path, tmp_path: Path) -> None:
    folder = sequences / "agent_00"
    for k, track in enumerate(read_tracks(folder)):
        write_track(tmp_path, k, track)
        for name in FIVE:
            assert (tmp_path / f"{name}_{k}.txt").read_bytes() == (folder / f"{name}_{k}.txt").read_bytes()


def test_lost_intervals_are_in_the_manifest(sequences: Path) -> None:
    manifest, _ = load_sequences(sequences)
    [agent] = manifest.agents
    assert agent.tracks == 3 and [lost.first_frame for lost in agent.lost] == [30, 56]
    assert all("agree on a pose" in lost.reason for lost in agent.lost)
    frames = len(read_tum(sequences / "agent_00" / "trajectory.tum"))
    assert frames + sum(lost.last_frame - lost.first_frame + 1 for lost in agent.lost) == agent.frames == len(SHOTS)


def test_the_essential_graph_is_whole_and_agrees_with_the_poses(sequences: Path) -> None:
    for k in range(3):
        files = read_five(sequences / "agent_00", k)
        graph = read_g2o(sequences / "agent_00" / f"essential_{k}.g2o")
        assert [node.index for node in graph.nodes] == list(range(len(files.poses)))
        np.testing.assert_allclose(
            [graph.poses[n] for n in graph.nodes], np.array(files.poses).reshape(-1, 4, 4), atol=1e-9
        )
        assert {(i, i + 1) for i in range(len(files.poses) - 1)} <= {(e.i.index, e.j.index) for e in graph.edges}
        assert optimise(graph, CentralConfig()).cost_before < 1e-12


def test_the_agent_joins_the_tracks_of_the_same_room(sequences: Path, tmp_path: Path) -> None:
    manifest, agents = load_sequences(sequences)
    assert [len(track) for track in agents[0].tracks] and len(agents[0].tracks) == 3
    summary = run(manifest, agents, preset("maslam"), tmp_path / "run")
    home = len(agents[0].tracks[0]) + len(agents[0].tracks[2])
    assert summary.keyframes_placed == [home] and summary.matches.false_accepted == 0
    written = read_tum(tmp_path / "run" / "agent_00" / "trajectory.tum")
    frames = np.rint((written.stamps_ns - agents[0].start_ns) / 1e8).astype(int)
    assert {SHOTS[i][0] for i in frames} == {HOME} and frames.min() < 30 and frames.max() > 60
    truth = np.array([SHOTS[i][1][:3, 3] for i in frames])
    aligned = umeyama(truth, written.centres, False) @ written.centres
    assert np.sqrt(((aligned - truth) ** 2).sum(axis=1).mean()) < 0.05
