"""What is particular to one kind of data set."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from dataset_makers import (
    CX,
    FX,
    HEIGHT,
    WIDTH,
    make_scene,
    own_camera,
    seconds,
    write_euroc,
    write_images,
    write_kitti,
    write_seven_scenes,
    write_tum,
)

from maslam.frontend.datasets import Severity, open_dataset
from maslam.frontend.errors import FrontendError


def test_kitti_poses_in_their_published_place_and_moved_to_a_colour_camera(tmp_path: Path) -> None:
    scene = make_scene()
    folder = tmp_path / "sequences" / "07"
    write_kitti(folder, scene, colour=True)
    (tmp_path / "poses").mkdir()
    (folder / "poses.txt").rename(tmp_path / "poses" / "07.txt")
    calib = folder / "calib.txt"
    # Camera 2 stands 6 cm left of camera 0: P2 = K [I | (0.06, 0, 0)].
    calib.write_text(calib.read_text().replace(f"P2: {FX} 0 {CX} -0.0", f"P2: {FX} 0 {CX} {FX * 0.06}"))
    truth = open_dataset(folder).sequences[0].groundtruth
    assert truth is not None
    expected = [pose[:3, 3] + pose[:3, :3] @ [-0.06, 0, 0] for pose in scene.poses]
    np.testing.assert_allclose(truth.centres, expected, atol=1e-9)


def test_kitti_cut_out_images_keep_their_rows(tmp_path: Path) -> None:
    scene = make_scene()
    write_kitti(tmp_path, scene)
    for side in ("image_0", "image_1"):
        for i in (0, 1, 4):
            (tmp_path / side / f"{i:06d}.png").unlink()
    [sequence] = open_dataset(tmp_path).sequences
    np.testing.assert_array_equal(sequence.stamps_ns, np.array([2, 3, 5]) * 50_000_000)
    assert sequence.groundtruth is not None
    np.testing.assert_allclose(sequence.groundtruth.poses, scene.poses[[2, 3, 5]], atol=1e-9)
    assert [problem.severity for problem in sequence.problems] == [Severity.WARNING] * 2
    times, poses = (problem.message for problem in sequence.problems)
    assert "times for 3 images" in times and "poses for 3 images" in poses and "000002.png: row 3" in poses


def test_names_are_sorted_as_numbers(tmp_path: Path) -> None:
    names = ["frame2.png", "frame10.png", "frame1.png"]
    images = np.stack([np.full((HEIGHT, WIDTH), value, np.uint8) for value in (2, 10, 1)])
    write_images(tmp_path, names, images)
    (tmp_path / "my_camera.yaml").write_text(own_camera("rate_hz: 4\n"))
    [sequence] = open_dataset(tmp_path).sequences
    assert [int(frame.image[0, 0]) for frame in sequence.frames()] == [1, 2, 10]
    np.testing.assert_array_equal(sequence.stamps_ns, [0, 250_000_000, 500_000_000])
    assert sequence.problems == ()


@pytest.mark.parametrize(
    ("name", "stamp_ns"),
    [
        ("1403715274.25", 1403715274250000000),
        ("1403715274250", 1403715274250000000),
        ("1403715274250000", 1403715274250000000),
    ],
)
def test_times_in_file_names(tmp_path: Path, name: str, stamp_ns: int) -> None:
    write_images(tmp_path, [f"{name}.png", f"{name.replace('5274', '5275')}.png"], make_scene().images[:2])
    (tmp_path / "camera.yaml").write_text(own_camera())
    assert open_dataset(tmp_path).sequences[0].stamps_ns.tolist() == [stamp_ns, stamp_ns + 10**9]


def test_a_folder_without_any_time_is_read_with_a_warning(tmp_path: Path) -> None:
    write_images(tmp_path, ["a.png", "b.png"], make_scene().images[:2])
    (tmp_path / "camera.yaml").write_text(own_camera())
    [sequence] = open_dataset(tmp_path).sequences
    assert sequence.stamps_ns.tolist() == [0, 100_000_000] and "10 Hz taken" in sequence.problems[0].message


def test_euroc_leaves_out_frames_that_one_camera_dropped(tmp_path: Path) -> None:
    scene = make_scene()
    write_euroc(tmp_path, scene)
    table = tmp_path / "mav0/cam1/data.csv"
    table.write_text("".join(line for i, line in enumerate(table.read_text().splitlines(keepends=True)) if i != 3))
    [sequence] = open_dataset(tmp_path / "mav0").sequences
    np.testing.assert_array_equal(sequence.stamps_ns, np.delete(scene.stamps_ns, 2))
    assert "no right image for 1 of 6 frames" in sequence.problems[0].message
    np.testing.assert_allclose(sequence.read(2).right, scene.rights[3], atol=1)


def test_tum_pairs_by_time(tmp_path: Path) -> None:
    scene = make_scene()
    write_tum(tmp_path, scene)
    table = tmp_path / "depth.txt"
    gone = seconds(int(scene.stamps_ns[2]) + 7_000_000)
    table.write_text("".join(line for line in table.read_text().splitlines(keepends=True) if not line.startswith(gone)))
    [sequence] = open_dataset(tmp_path).sequences
    np.testing.assert_array_equal(sequence.stamps_ns, np.delete(scene.stamps_ns, 2))
    np.testing.assert_allclose(sequence.read(2).depth_m, scene.depth_mm[3] / 1000.0, atol=1e-6)
    assert "no depth image for 1 of 6 frames" in sequence.problems[0].message


def test_tum_camera_by_the_name_of_the_recording(tmp_path: Path) -> None:
    scene = make_scene()
    folder = tmp_path / "rgbd_dataset_freiburg3_office"
    write_tum(folder, scene)
    (folder / "camera.yaml").unlink()
    with pytest.raises(FrontendError, match=f"a calibration for 640x480 pixels, but .* has {WIDTH}x{HEIGHT}"):
        open_dataset(folder)


def test_seven_scenes_without_a_camera_file_takes_the_colour_cameras_focal_length(tmp_path: Path) -> None:
    write_seven_scenes(tmp_path, make_scene())
    (tmp_path / "camera.txt").unlink()
    [sequence] = open_dataset(tmp_path).sequences
    assert sequence.rig.camera.fx == pytest.approx(525.0 * WIDTH / 640)
    assert sequence.problems[0].severity is Severity.WARNING


def test_jpegs_that_stop_early(tmp_path: Path) -> None:
    image = np.random.default_rng(0).integers(0, 255, (HEIGHT, WIDTH), dtype=np.uint8)
    write_images(tmp_path, ["0.jpg", "1.jpg", "2.jpg"], np.stack([image] * 3))
    (tmp_path / "camera.yaml").write_text(own_camera("rate_hz: 1\n"))
    whole = (tmp_path / "1.jpg").read_bytes()
    (tmp_path / "1.jpg").write_bytes(whole[:-2])
    (tmp_path / "2.jpg").write_bytes(b"")
    [sequence] = open_dataset(tmp_path).sequences
    assert sequence.read(0).image.shape == (HEIGHT, WIDTH)
    with pytest.raises(FrontendError, match="cut off"):
        sequence.read(1)
    with pytest.raises(FrontendError, match="empty"):
        sequence.read(2)


def test_depth_of_the_wrong_type(tmp_path: Path) -> None:
    scene = make_scene()
    write_seven_scenes(tmp_path, scene)
    write_images(tmp_path, ["frame-000001.depth.png"], scene.images[:1])
    with pytest.raises(
        FrontendError, match=r"frame-000001.depth.png: a depth image has one channel of 16 bits, .* found 1 of 8"
    ):
        open_dataset(tmp_path).sequences[0].read(1)
