"""OpenLORIS packages, and ICL-NUIM as lists of associations."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from dataset_makers import FX, Scene, make_scene, own_camera
from layout_makers import write_icl_nuim, write_openloris
from test_datasets import Contract

from maslam.backend.geometry import se3, so3_exp
from maslam.frontend.cameras.models import RigKind
from maslam.frontend.datasets import open_dataset
from maslam.frontend.errors import FrontendError


class TestOpenLoris(Contract):
    kind, rigs, left = "openloris", (RigKind.RGBD, RigKind.MONO), "color/*.png"

    def write(self, folder: Path, scene: Scene) -> None:
        write_openloris(folder, scene)


def test_icl_nuim_has_its_own_camera_and_mirrored_poses(tmp_path: Path) -> None:
    """The scene's path seen with y up: only heights change their sign, and turns about x and z."""
    scene = make_scene()
    turned = np.stack([se3(so3_exp([0.1 * i, 0.2, -0.05 * i]), pose[:3, 3]) for i, pose in enumerate(scene.poses)])
    scene = replace(scene, poses=turned)
    write_icl_nuim(tmp_path, scene)
    for folder in ("rgb", "depth"):
        for path in (tmp_path / folder).iterdir():
            image = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
            cv2.imwrite(str(path), cv2.resize(image, (640, 480), interpolation=cv2.INTER_NEAREST))
    [sequence] = open_dataset(tmp_path).sequences
    camera = sequence.rig.camera
    assert (camera.fx, camera.fy, camera.cx, camera.cy) == (481.2, 480.0, 319.5, 239.5)
    assert sequence.rig.kind is RigKind.RGBD and sequence.groundtruth is not None
    np.testing.assert_allclose(sequence.groundtruth.poses, scene.poses, atol=1e-8)
    np.testing.assert_array_equal(sequence.groundtruth.stamps_ns, sequence.stamps_ns)
    assert [problem.message.partition(": ")[2] for problem in sequence.problems] == [
        "the times are frame numbers: 30 Hz taken"
    ]


def test_poses_of_icl_nuim_that_are_damaged_are_left_out(tmp_path: Path) -> None:
    write_icl_nuim(tmp_path, make_scene())
    (tmp_path / "camera.yaml").write_text(own_camera())
    (tmp_path / "livingRoom2.gt.freiburg").write_text("0 1 2\n")
    [sequence] = open_dataset(tmp_path).sequences
    assert sequence.groundtruth is None and sequence.rig.camera.fx == FX
    assert any("errors cannot be known" in problem.message for problem in sequence.problems)


def test_openloris_without_aligned_depth_is_said(tmp_path: Path) -> None:
    write_openloris(tmp_path, make_scene())
    (tmp_path / "aligned_depth.txt").unlink()
    [sequence] = open_dataset(tmp_path).sequences
    assert sequence.rig.kind is RigKind.MONO and "no aligned_depth.txt" in sequence.problems[0].message


def test_the_lens_of_openloris_is_named(tmp_path: Path) -> None:
    write_openloris(tmp_path, make_scene())
    path = tmp_path / "sensors.yaml"
    path.write_text(path.read_text().replace("radial-tangential", "Kannala-Brandt"))
    with pytest.raises(FrontendError, match=r"sensors.yaml: d400_color_optical_frame.model: pinhole with radial"):
        open_dataset(tmp_path)
