"""Poses and times in arrays and JSON beside images are read, or named; several films of a folder are said."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from dataset_makers import BASELINE_M, COUNT, make_scene, numbered, own_camera, seconds, tum_rows, write_images
from recording_makers import write_film

from maslam.frontend.datasets import ImageSequence, open_dataset

SCENE = make_scene()
NAMES = numbered()
LISTED = SCENE.poses.tolist()


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    write_images(tmp_path, NAMES, SCENE.images)
    (tmp_path / "camera.yaml").write_text(own_camera())
    (tmp_path / "times.txt").write_text("".join(f"{seconds(t)}\n" for t in SCENE.stamps_ns.tolist()))
    return tmp_path


def opened(folder: Path) -> tuple[ImageSequence, str]:
    [sequence] = open_dataset(folder, strict=False).sequences
    return sequence, "\n".join(problem.message for problem in sequence.problems)


def in_parts(key: str, more: Any) -> list[dict[str, Any]]:
    return [{key: pose, **more(i)} for i, pose in enumerate(LISTED)]


JSON_FORMS: dict[str, Any] = {
    "a list": LISTED,
    "3x4": [pose[:3] for pose in LISTED],
    "flat": [[v for row in pose for v in row] for pose in LISTED],
    "by name": dict(zip(NAMES, LISTED, strict=True)),
    "by stem, in another order": {name[:-4]: pose for name, pose in reversed(list(zip(NAMES, LISTED, strict=True)))},
    "entries with names": {"frames": in_parts("c2w", lambda i: {"file_path": f"images/{NAMES[i]}"})},
    "entries with times": {"poses": in_parts("c2w", lambda i: {"timestamp": SCENE.stamps_ns[i] / 1e9})},
}


@pytest.mark.parametrize("form", JSON_FORMS)
def test_poses_in_json_are_ground_truth(folder: Path, form: str) -> None:
    (folder / "poses.json").write_text(json.dumps(JSON_FORMS[form]))
    sequence, said = opened(folder)
    assert said == "" and sequence.groundtruth is not None
    np.testing.assert_allclose(sequence.groundtruth.poses, SCENE.poses, atol=1e-9)
    np.testing.assert_allclose(sequence.groundtruth.stamps_ns, SCENE.stamps_ns, atol=1000)


@pytest.mark.parametrize("shape", [(COUNT, 4, 4), (COUNT, 16)])
def test_an_array_of_poses_without_those_that_are_not_known(folder: Path, shape: tuple[int, ...]) -> None:
    poses = SCENE.poses.copy()
    poses[2] = np.nan
    np.save(folder / "poses.npy", poses.reshape(shape))
    sequence, said = opened(folder)
    assert "1 of 6 rows hold no pose" in said and sequence.groundtruth is not None
    np.testing.assert_allclose(sequence.groundtruth.poses, np.delete(SCENE.poses, 2, axis=0), atol=1e-9)


@pytest.mark.parametrize("suffix", ["npy", "json"])
def test_a_matrix_for_each_image_in_a_file_of_its_own(folder: Path, suffix: str) -> None:
    (folder / "poses").mkdir()
    for name, pose in zip(NAMES, SCENE.poses, strict=True):
        path = folder / "poses" / f"{name[:-4]}.{suffix}"
        np.save(path, pose) if suffix == "npy" else path.write_text(json.dumps(pose.tolist()))
    sequence, said = opened(folder)
    assert said == "" and sequence.groundtruth is not None
    np.testing.assert_allclose(sequence.groundtruth.poses, SCENE.poses, atol=1e-9)


@pytest.mark.parametrize(
    ("name", "content", "said"),
    [
        ("poses.json", '{"parameters": 3}', "pose 1: in a form that is not read; a list of 4x4 matrices"),
        ("poses.json", "[[1, 2], [3]]", "pose 1: in a form that is not read"),
        ("poses.json", "[" * 20000, "nested too deep"),
        ("poses.json", "[1, 2", "not JSON"),
        ("poses.json", json.dumps({f"other_{i}.png": LISTED[0] for i in range(3)}), "no image here (first: 'other_0"),
        ("poses.npy", "text", "not an array of numbers"),
        ("CameraTrajectory.txt", "0 1 2 3 0 0 0 1\n", "CameraTrajectory.txt: by the name a trajectory that a program"),
    ],
)  # fmt: skip
def test_what_is_none_is_named_and_stops_nothing(folder: Path, name: str, content: str, said: str) -> None:
    (folder / name).write_text(content)
    sequence, messages = opened(folder)
    assert sequence.groundtruth is None and said in messages and messages.count("\n") == 0


def test_objects_of_python_are_not_unpacked(folder: Path) -> None:
    np.save(folder / "poses.npy", np.array([{"a": 1}], dtype=object), allow_pickle=True)
    assert "poses.npy: not an array of numbers" in opened(folder)[1]


def test_a_trajectory_is_the_truth_by_its_name_which_is_said(folder: Path) -> None:
    (folder / "trajectory.txt").write_text(tum_rows(SCENE.stamps_ns, SCENE.poses))
    sequence, said = opened(folder)
    assert sequence.groundtruth is not None and "trajectory.txt: taken as the ground truth by its name" in said
    (folder / "groundtruth.txt").write_text(tum_rows(SCENE.stamps_ns, SCENE.poses))
    assert "groundtruth.txt: taken as the ground truth; trajectory.txt beside it is not used" in opened(folder)[1]
    (folder / "poses.json").write_text("[]")
    assert "groundtruth.txt: taken as" in opened(folder)[1], "text goes before arrays"


WHOLE = SCENE.stamps_ns.tolist()
TIME_FORMS: dict[str, Any] = {
    "a list": [t / 1e9 for t in WHOLE],
    "whole nanoseconds": WHOLE,
    "in an object": {"timestamps": WHOLE},
    "by name": dict(zip(NAMES, WHOLE, strict=True)),
    "entries": [{"image": name, "timestamp_us": t / 1e3} for name, t in zip(NAMES, WHOLE, strict=True)],
}


@pytest.mark.parametrize("form", TIME_FORMS)
def test_times_in_json_are_the_images(folder: Path, form: str) -> None:
    (folder / "times.txt").unlink()
    (folder / "timestamps.json").write_text(json.dumps(TIME_FORMS[form]))
    sequence, said = opened(folder)
    assert said == ""
    np.testing.assert_allclose(sequence.stamps_ns, WHOLE, rtol=0, atol=1000)


def test_times_in_an_array(folder: Path) -> None:
    (folder / "times.txt").unlink()
    np.save(folder / "timestamps.npy", SCENE.stamps_ns)
    assert opened(folder)[0].stamps_ns.tolist() == WHOLE


@pytest.mark.parametrize("content", ['{"first": {"a": 1}}', "[1, 2]", "{"])
def test_json_that_holds_no_times_of_these_images_is_said(folder: Path, content: str) -> None:
    (folder / "timestamps.json").write_text(content)
    assert opened(folder)[1] == "", "where there is a list of times it is not looked at"
    (folder / "times.txt").unlink()
    sequence, said = opened(folder)
    assert "timestamps.json: " in said and ": not read as times" in said and len(sequence) == COUNT


def test_films_of_one_folder_are_robots_which_is_said(tmp_path: Path) -> None:
    for name in ("ride.mp4", "walk.mp4"):
        write_film(tmp_path / name, SCENE.images, 10.0)
    (tmp_path / "camera.yaml").write_text(own_camera())
    dataset = open_dataset(tmp_path)
    assert len(dataset.sequences) == 2
    assert dataset.notes[0].startswith("a robot for each of 2 films: ride, walk; name one to read it alone")
    assert open_dataset(tmp_path / "ride.mp4").notes == ()


def test_depth_in_files_that_are_not_read_is_named(folder: Path) -> None:
    (folder / "depth").mkdir()
    for name in NAMES:
        np.savez(folder / "depth" / name.replace(".png", ".npz"), depth=np.ones((4, 4)))
    assert "depth: depth in files that are not read (.npz), read as one camera" in opened(folder)[1]


def test_folders_of_images_that_nobody_reads_are_named(tmp_path: Path) -> None:
    for place in ("cam0", "cam2", "cam3", "masks"):
        write_images(tmp_path / place, NAMES, SCENE.images)
    (tmp_path / "camera.yaml").write_text(own_camera())
    [sequence] = open_dataset(tmp_path).sequences
    assert "images in cam2, cam3 are not read" in sequence.notes


@pytest.mark.parametrize(("left", "right"), [("Left", "Right"), ("CAM0", "CAM1"), ("Image_0", "Image_1")])
def test_capitals_in_the_names_of_folders_do_not_matter(tmp_path: Path, left: str, right: str) -> None:
    write_images(tmp_path / left, NAMES, SCENE.images)
    write_images(tmp_path / right, NAMES, SCENE.rights)
    (tmp_path / "camera.yaml").write_text(own_camera() + f"baseline_m: {BASELINE_M}\n")
    [sequence] = open_dataset(tmp_path).sequences
    frame = sequence.read(3)
    assert frame.right is not None
    np.testing.assert_array_equal(frame.image, SCENE.images[3])
    np.testing.assert_array_equal(frame.right, SCENE.rights[3])


def test_more_poses_than_images_go_by_number_and_are_said(folder: Path) -> None:
    rows = SCENE.poses[:, :3].reshape(-1, 12)
    np.savetxt(folder / "poses.txt", np.vstack([rows, rows[:2]]))
    sequence, said = opened(folder)
    assert f"{COUNT + 2} poses for {COUNT} images" in said and sequence.groundtruth is not None
    np.testing.assert_allclose(sequence.groundtruth.poses, SCENE.poses, atol=1e-9)
