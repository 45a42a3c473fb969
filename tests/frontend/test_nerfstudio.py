"""nerfstudio's folders: images, camera and poses by ``transforms.json``."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from dataset_makers import COUNT, FX, HEIGHT, WIDTH, Scene, make_scene, own_camera
from layout_makers import write_nerfstudio
from test_datasets import Contract

from maslam.frontend.cameras.models import RigKind
from maslam.frontend.datasets import ImageSequence, open_dataset
from maslam.frontend.errors import FrontendError

SCENE = make_scene()


def opened(folder: Path) -> ImageSequence:
    [sequence] = open_dataset(folder).sequences
    return sequence


def messages(sequence: ImageSequence) -> str:
    return "\n".join(problem.message for problem in sequence.problems)


def change(folder: Path, frame: int | None = None, **values: Any) -> None:
    """Set keys of the file, or of one of its frames; None takes a key away."""
    path = folder / "transforms.json"
    content = json.loads(path.read_text())
    place = content if frame is None else content["frames"][frame]
    place.update(values)
    for key in [key for key, value in values.items() if value is None]:
        del place[key]
    path.write_text(json.dumps(content))


class TestNerfstudio(Contract):
    kind, rigs, left = "nerfstudio", (RigKind.RGBD, RigKind.MONO), "images/*.png"

    def write(self, folder: Path, scene: Scene) -> None:
        write_nerfstudio(folder, scene)
        (folder / "times.txt").write_text("".join(f"{t / 1e9:.9f}\n" for t in self.expected_stamps(scene)))

    def expected_stamps(self, scene: Scene) -> np.ndarray:
        return 10**9 + np.arange(COUNT) * 50_000_000

    def test_where_the_truth_comes_from_is_said(self, folder: Path) -> None:
        [note] = [note for note in self.open(folder).notes if "transform_matrix" in note]
        assert "the camera's axes turned from OpenGL's" in note and "need not be metres" in note


def test_an_angle_of_view_alone_takes_the_size_of_the_images(tmp_path: Path) -> None:
    """instant-ngp's and Blender's form: one angle, file names without a suffix."""
    angle = 2.0 * np.arctan(0.5 * WIDTH / FX)
    write_nerfstudio(tmp_path, SCENE, depth=False, camera_angle_x=angle)
    path = tmp_path / "transforms.json"
    path.write_text(path.read_text().replace(".png", "").replace('"images', '"./images'))
    sequence = opened(tmp_path)
    camera = sequence.rig.camera
    assert (camera.width, camera.height) == (WIDTH, HEIGHT)
    assert (camera.fx, camera.fy, camera.cx, camera.cy) == pytest.approx((FX, FX, WIDTH / 2 - 0.5, HEIGHT / 2 - 0.5))
    assert sequence.rig.kind is RigKind.MONO and sequence.groundtruth is not None
    np.testing.assert_allclose(sequence.groundtruth.poses, SCENE.poses, atol=1e-12)


def test_only_images_that_frames_name_are_read_and_in_the_order_of_their_names(tmp_path: Path) -> None:
    write_nerfstudio(tmp_path, SCENE, depth=False)
    content = json.loads((tmp_path / "transforms.json").read_text())
    content["frames"] = [one for one in content["frames"] if "00003" not in one["file_path"]]
    (tmp_path / "transforms.json").write_text(json.dumps(content))
    sequence = opened(tmp_path)
    assert [path.name for path in sequence.left] == [f"frame_{i:05d}.png" for i in (1, 2, 4, 5, 6)]
    assert sequence.groundtruth is not None
    np.testing.assert_allclose(sequence.groundtruth.poses, SCENE.poses[[0, 1, 3, 4, 5]], atol=1e-12)


def test_a_calibration_of_its_own_comes_first(tmp_path: Path) -> None:
    write_nerfstudio(tmp_path, SCENE)
    (tmp_path / "camera.yaml").write_text(own_camera("rate_hz: 20\ndepth_unit_m: 0.002\n").replace("80.0", "81.0"))
    sequence = opened(tmp_path)
    assert sequence.rig.camera.fx == 81.0 and sequence.stamps_ns[1] == 50_000_000 and sequence.groundtruth is not None
    np.testing.assert_allclose(sequence.read(0).depth_m, SCENE.depth_mm[0] * 0.002, atol=1e-5)


def test_a_scale_that_was_applied_is_taken_back(tmp_path: Path) -> None:
    write_nerfstudio(tmp_path, SCENE)
    change(tmp_path, applied_scale=0.25)
    sequence = opened(tmp_path)
    assert sequence.groundtruth is not None
    np.testing.assert_allclose(sequence.groundtruth.centres, SCENE.poses[:, :3, 3] / 0.25, atol=1e-12)


@pytest.mark.parametrize(
    ("frame", "values", "said"),
    [
        (2, {"transform_matrix": np.diag([2.0, 2.0, 2.0, 1.0]).tolist()}, r"frames\[2\].transform_matrix: a rigid 4x4"),
        (2, {"transform_matrix": [[1, 0, 0, "x"]]}, r"frames\[2\].transform_matrix: a list of numbers"),
        (1, {"depth_file_path": None}, "depth for 5 of 6 frames: read without depth"),
        (2, {"file_path": "images/frame_00001.png"}, "1 frames name the image of another"),
    ],
)
def test_what_is_left_out_is_said(tmp_path: Path, frame: int, values: dict[str, Any], said: str) -> None:
    write_nerfstudio(tmp_path, SCENE)
    change(tmp_path, frame, **values)
    sequence = opened(tmp_path)
    assert re.search(said, messages(sequence)), messages(sequence)
    assert sequence.groundtruth is not None and len(sequence.groundtruth.poses) >= COUNT - 1


def test_depth_of_another_size_is_not_used(tmp_path: Path) -> None:
    write_nerfstudio(tmp_path, SCENE)
    for i in range(COUNT):
        cv2.imwrite(str(tmp_path / f"depth/{i}.png"), SCENE.depth_mm[i, ::2, ::2])
    sequence = opened(tmp_path)
    assert sequence.rig.kind is RigKind.MONO and "depth of 48x32 pixels for images of 96x64" in messages(sequence)


def test_cameras_of_frames_a_hair_apart_are_their_median(tmp_path: Path) -> None:
    write_nerfstudio(tmp_path, SCENE, depth=False, w=WIDTH, h=HEIGHT, cx=48.0, cy=32.0)
    for i, focal in enumerate((80.0, 80.1, 80.05, 80.02, 80.08, 80.05)):
        change(tmp_path, i, fl_x=focal, fl_y=focal)
    sequence = opened(tmp_path)
    assert sequence.rig.camera.fx == pytest.approx(80.05)
    assert "each frame has a camera of its own, up to 0.12 % apart: the median is taken" in messages(sequence)


@pytest.mark.parametrize(
    ("frame", "values", "said"),
    [
        (4, {"fl_x": 85.0}, r"several cameras: fl_x is 80.0 in frames\[0\] and 85.0 in frames\[4\]; one folder"),
        (4, {"w": 2 * WIDTH}, rf"several cameras: w is {WIDTH} in frames\[0\] and {2 * WIDTH} in frames\[4\]"),
        (1, {"k1": 0.1}, r"several cameras: k1 is None in frames\[0\] and 0.1 in frames\[1\]"),
        (4, {"file_path": "other/frame_1.png"}, r"its images lie in 2 folders \(images, other\)"),
        (4, {"file_path": ""}, r"frames\[4\].file_path: the name of an image expected"),
    ],
)
def test_cameras_that_are_several_are_one_line(tmp_path: Path, frame: int, values: dict[str, Any], said: str) -> None:
    write_nerfstudio(tmp_path, SCENE, depth=False, cx=48.0, cy=32.0)
    for i in range(COUNT):
        change(tmp_path, i, fl_x=80.0, fl_y=80.0, w=WIDTH, h=HEIGHT)
    change(tmp_path, frame, **values)
    with pytest.raises(FrontendError, match=rf"transforms.json: .*{said}"):
        open_dataset(tmp_path)


def test_without_any_camera_the_keys_are_named(tmp_path: Path) -> None:
    write_nerfstudio(tmp_path, SCENE, aabb_scale=4)
    with pytest.raises(FrontendError, match=r"no camera in this file \(fl_x or camera_angle_x\), and no camera.yaml"):
        open_dataset(tmp_path)


def test_a_size_that_contradicts_the_images_is_refused(tmp_path: Path) -> None:
    write_nerfstudio(tmp_path, SCENE)
    change(tmp_path, w=2 * WIDTH, h=2 * HEIGHT)
    with pytest.raises(FrontendError, match=rf"a calibration for {2 * WIDTH}x{2 * HEIGHT} pixels"):
        open_dataset(tmp_path)


def test_a_file_without_frames_is_a_calibration_beside_images(tmp_path: Path) -> None:
    write_nerfstudio(tmp_path, SCENE, depth=False)
    change(tmp_path, frames=[])
    assert opened(tmp_path).kind == "images" and opened(tmp_path).rig.camera.fx == FX
