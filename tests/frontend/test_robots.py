"""Folders of several robots under any names; cameras and recordings are not taken for robots."""

from __future__ import annotations

from pathlib import Path

import pytest
from dataset_makers import (
    COUNT,
    make_scene,
    numbered,
    own_camera,
    write_euroc,
    write_images,
    write_kitti,
    write_rendered,
)

from maslam.frontend.datasets import ReadingConfig, Severity, open_dataset
from maslam.frontend.errors import FrontendError

SCENE = make_scene()


def written(root: Path, names: list[str]) -> Path:
    for name in names:
        write_rendered(root / name, SCENE, "stereo")
    return root


@pytest.mark.parametrize(
    "names",
    [
        ["Alice", "Bob"],
        ["Alice", "Bob", "Carol"],
        ["robot_0", "robot_1"],
        ["agent0", "agent1"],
        ["husky-1", "spot"],
        ["acl_jackal", "acl_jackal2", "sparkal1", "thoth"],
        ["a", "b"],
        ["uav 1", "uav 2", "uav 10"],
        ["r1", "r2"],
    ],
)
def test_robots_have_any_name(tmp_path: Path, names: list[str]) -> None:
    (tmp_path / "notes").mkdir()
    dataset = open_dataset(written(tmp_path, names))
    assert [sequence.name for sequence in dataset.sequences] == names
    assert dataset.kind == "agents (images)"
    assert dataset.notes == (f"a robot for each of {len(names)} folders: {', '.join(names)}",)
    assert all(len(sequence) == COUNT for sequence in dataset.sequences)


def test_robots_of_different_kinds(tmp_path: Path) -> None:
    write_kitti(tmp_path / "Car", SCENE)
    write_euroc(tmp_path / "Drone", SCENE)
    write_rendered(tmp_path / "Walker", SCENE, "rgbd")
    dataset = open_dataset(tmp_path)
    assert [(s.name, s.kind, s.rig.kind.value) for s in dataset.sequences] == [
        ("Car", "kitti", "stereo"),
        ("Drone", "euroc", "stereo"),
        ("Walker", "images", "rgbd"),
    ]


@pytest.mark.parametrize(
    "names",
    [
        ["seq-01", "seq-02"],
        ["00", "05"],
        ["run1", "run_2"],
        ["MH_01_easy", "MH_02_easy"],
        ["V1_01_easy", "V2_01_easy"],
        ["rgbd_dataset_freiburg1_xyz", "rgbd_dataset_freiburg1_desk"],
        ["2011_09_26_drive_0001_sync", "2011_09_26_drive_0002_sync"],
        ["P000", "P001"],
        ["scene0000_00", "scene0001_00"],
        ["train", "test"],
    ],
)
def test_recordings_are_robots_only_where_it_is_asked_for(tmp_path: Path, names: list[str]) -> None:
    written(tmp_path, names)
    with pytest.raises(FrontendError, match=r"holds several sequences .* name one of them, or take each as a robot"):
        open_dataset(tmp_path)
    dataset = open_dataset(tmp_path, reading=ReadingConfig(robots=True))
    assert sorted(sequence.name for sequence in dataset.sequences) == sorted(names)
    assert len(dataset.notes) == 1


@pytest.mark.parametrize(
    "names",
    [
        ["cam_a", "cam_b"],
        ["left_eye", "right_eye"],
        ["front", "rear"],
        ["rgb_images", "depth_images"],
        ["thermal", "visible_camera"],
        ["Camera 1", "Camera 2"],
        ["image-0", "image-1"],
    ],
)
def test_cameras_are_no_robots(tmp_path: Path, names: list[str]) -> None:
    for name in names:
        write_images(tmp_path / name, numbered(), SCENE.images)
    (tmp_path / "camera.yaml").write_text(own_camera("rate_hz: 1\n"))
    with pytest.raises(FrontendError, match="seem to be the cameras of one sequence; name one of them, or call them"):
        open_dataset(tmp_path)


@pytest.mark.parametrize("names", [["cam0", "cam1"], ["left", "right"], ["rgb", "depth"], ["image_0", "image_1"]])
def test_a_sequence_is_no_folder_of_robots(tmp_path: Path, names: list[str]) -> None:
    for name in names:
        write_images(tmp_path / name, numbered(), SCENE.depth_mm if name == "depth" else SCENE.images)
    (tmp_path / "camera.yaml").write_text(own_camera("rate_hz: 1\nbaseline_m: 0.25\ndepth_unit_m: 0.001\n"))
    dataset = open_dataset(tmp_path)
    assert len(dataset.sequences) == 1 and dataset.notes == ()


def test_robots_beside_a_recording(tmp_path: Path) -> None:
    written(tmp_path, ["Alice", "Bob", "test"])
    dataset = open_dataset(tmp_path)
    assert [sequence.name for sequence in dataset.sequences] == ["Alice", "Bob"]
    assert "not test, which by the name is no robot (--images.robots true takes all)" in dataset.notes[0]
    assert len(open_dataset(tmp_path, reading=ReadingConfig(robots=True)).sequences) == 3


@pytest.mark.parametrize("inside", ["Alice", "day/drive_0001", "seq-01"])
def test_the_only_sequence_in_a_folder_is_read(tmp_path: Path, inside: str) -> None:
    written(tmp_path, [inside])
    dataset = open_dataset(tmp_path)
    [sequence] = dataset.sequences
    assert sequence.name == Path(inside).name and dataset.notes == (f"{tmp_path / inside} is the only sequence in it",)


def test_one_camera_of_several_is_not_taken_for_the_sequence(tmp_path: Path) -> None:
    write_images(tmp_path / "rear_camera", numbered(), SCENE.images)
    with pytest.raises(FrontendError, match="holds one sequence, rear_camera; name it"):
        open_dataset(tmp_path)


def test_agents_by_number_stay_agents(tmp_path: Path) -> None:
    written(tmp_path, ["agent_0", "agent_1", "Alice"])
    dataset = open_dataset(tmp_path)
    assert [sequence.name for sequence in dataset.sequences] == ["agent_0", "agent_1"]
    assert dataset.notes[0].startswith("Alice beside agent_0: not read")


def test_a_broken_robot_is_named(tmp_path: Path) -> None:
    written(tmp_path, ["Alice", "Bob"])
    camera = tmp_path / "Bob" / "camera.yaml"
    camera.write_text(camera.read_text().replace("fx: ", "fx: -"))
    with pytest.raises(FrontendError, match=r"Bob/camera.yaml: focal lengths"):
        open_dataset(tmp_path)
    dataset = open_dataset(tmp_path, strict=False)
    assert [sequence.name for sequence in dataset.sequences] == ["Alice"]
    assert "Bob/camera.yaml: focal lengths" in dataset.problems[0].message


def test_a_robot_without_any_calibration_is_read_with_a_guess_that_is_said(tmp_path: Path) -> None:
    written(tmp_path, ["Alice", "Bob"])
    (tmp_path / "Bob" / "camera.yaml").unlink()
    alice, bob = open_dataset(tmp_path).sequences
    assert not alice.focal_guess and bob.focal_guess
    assert f"{tmp_path / 'Bob'}: no calibration file" in bob.problems[0].message


@pytest.mark.parametrize("name", ["Bob.yaml", "calibration/bob.yaml", "camera.yaml"])
def test_a_calibration_beside_the_robots_is_taken_and_said(tmp_path: Path, name: str) -> None:
    written(tmp_path, ["Alice", "Bob"])
    (tmp_path / name).parent.mkdir(exist_ok=True)
    (tmp_path / "Bob" / "camera.yaml").rename(tmp_path / name)
    alice, bob = open_dataset(tmp_path).sequences
    assert alice.problems == () and bob.rig.baseline_m == alice.rig.baseline_m
    assert f"{tmp_path / name}: taken as the calibration of Bob" in bob.problems[0].message


def test_robots_whose_images_lie_deeper(tmp_path: Path) -> None:
    """As Kimera-Multi's topics are unpacked: robot/forward/infra1 and infra2."""
    for name in ("acl_jackal", "thoth"):
        write_images(tmp_path / name / "forward/infra1", numbered(), SCENE.images)
        write_images(tmp_path / name / "forward/infra2", numbered(), SCENE.rights)
        (tmp_path / name / "forward/camera.yaml").write_text(own_camera("baseline_m: 0.25\nrate_hz: 20\n"))
    dataset = open_dataset(tmp_path)
    assert [(s.name, s.rig.kind.value, len(s)) for s in dataset.sequences] == [
        ("acl_jackal", "stereo", COUNT),
        ("thoth", "stereo", COUNT),
    ]


def test_robots_with_cameras_called_left_and_right(tmp_path: Path) -> None:
    """As S3E's topics are unpacked."""
    for name in ("Alice", "Bob", "Carol"):
        write_images(tmp_path / name / "left_camera", numbered(), SCENE.images)
        write_images(tmp_path / name / "right_camera", numbered(), SCENE.rights)
        (tmp_path / f"{name.lower()}.yaml").write_text(own_camera("baseline_m: 0.25\nrate_hz: 10\n"))
    dataset = open_dataset(tmp_path)
    assert [(s.name, s.rig.kind.value) for s in dataset.sequences] == [(n, "stereo") for n in ("Alice", "Bob", "Carol")]


@pytest.mark.parametrize("inside", ["", "images/", "mav0/cam0/data/", "camera.yaml", "times.txt", "shot.heic"])
def test_a_robot_without_images_is_left_out_with_a_warning(tmp_path: Path, inside: str) -> None:
    written(tmp_path, ["Alice", "Bob"])
    place = tmp_path / "Carol" / inside
    if inside and not inside.endswith("/"):
        place.parent.mkdir()
        place.write_text("fx: 1\n")
    else:
        place.mkdir(parents=True)
    dataset = open_dataset(tmp_path)
    assert [sequence.name for sequence in dataset.sequences] == ["Alice", "Bob"]
    [problem] = dataset.problems
    assert problem.severity is Severity.WARNING
    assert problem.message.startswith(f"{tmp_path / 'Carol'}: no robot, left out: ")
    assert ("HEIC" in problem.message) == (inside == "shot.heic")


def test_a_robot_whose_images_lie_deeper_than_the_others_is_left_out_with_a_warning(tmp_path: Path) -> None:
    written(tmp_path, ["Alice", "Bob", "Carol/forward"])
    [problem] = open_dataset(tmp_path).problems
    assert f"{tmp_path / 'Carol'}: no robot, left out" in problem.message


def test_one_robot_beside_one_without_images_is_read_with_a_warning(tmp_path: Path) -> None:
    written(tmp_path, ["Alice"])
    (tmp_path / "Carol" / "images").mkdir(parents=True)
    dataset = open_dataset(tmp_path)
    assert len(dataset.sequences) == 1 and f"{tmp_path / 'Carol'}: no robot, left out" in dataset.problems[0].message


def test_a_recording_called_like_the_others_that_are_robots_is_left_out_with_a_warning(tmp_path: Path) -> None:
    written(tmp_path, ["run_1", "run_2"])
    (tmp_path / "run_3").mkdir()
    (tmp_path / "run_3" / "notes.txt").write_text("the camera failed\n")
    [problem] = open_dataset(tmp_path, reading=ReadingConfig(robots=True)).problems
    assert f"{tmp_path / 'run_3'}: no robot, left out" in problem.message


@pytest.mark.parametrize("name", ["notes", "calibration", "ground_truth", "results", "plots", "weather"])
def test_folders_beside_robots_that_are_none_cause_no_warning(tmp_path: Path, name: str) -> None:
    written(tmp_path, ["Alice", "Bob"])
    (tmp_path / name).mkdir()
    (tmp_path / name / "readings.csv").write_text("1,2\n")
    assert open_dataset(tmp_path).problems == ()


def test_images_beside_folders_of_agents_are_said_to_be_left(tmp_path: Path) -> None:
    scene = make_scene()
    for folder in (tmp_path, tmp_path / "agent_00", tmp_path / "agent_01"):
        write_rendered(folder, scene, "mono")
    dataset = open_dataset(tmp_path)
    assert [sequence.name for sequence in dataset.sequences] == ["agent_00", "agent_01"]
    assert dataset.notes == (
        "its own images beside agent_00: not read; where folders agent_<n> are, only these are robots",
    )
