"""Where image files show what the rectified image shows, against the maps that OpenCV rectifies with."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from maslam.backend.geometry import so3_exp
from maslam.frontend.cameras.calibration import Distortion, RawCamera
from maslam.frontend.cameras.lens import project
from maslam.frontend.cameras.models import PinholeCamera, Rig, RigKind
from maslam.frontend.cameras.rectification import _float_maps, common_camera
from maslam.frontend.datasets import open_dataset
from maslam.mas.manifest import CameraEntry, StoredCameraEntry
from maslam.mas.output.stored_camera import colmap_model, stored_pixels
from maslam.tools.pipeline.agent_folder import _stored, stand_in

SIZE = (640, 480)
CAMERAS = [
    RawCamera(450.0, 455.0, 330.0, 235.0, SIZE, Distortion.RADIAL_TANGENTIAL, (-0.3, 0.08, 0.0003, -0.0005, -0.01)),
    RawCamera(300.0, 300.0, 320.0, 240.0, SIZE, Distortion.EQUIDISTANT, (0.02, -0.01, 0.003, -0.0004)),
    RawCamera(300.0, 300.0, 320.0, 240.0, SIZE, Distortion.EQUIDISTANT, (0.0, 0.0, 0.0, 0.0)),
    RawCamera(330.0, 331.0, 322.0, 241.0, SIZE, Distortion.FIELD_OF_VIEW, (0.9,)),
    RawCamera(450.0, 455.0, 330.0, 235.0, SIZE),
]


def _entry_of(raw: RawCamera, rotation: NDArray[np.float64]) -> StoredCameraEntry:
    return StoredCameraEntry(
        distortion=raw.distortion.value,
        fx=raw.fx,
        fy=raw.fy,
        cx=raw.cx,
        cy=raw.cy,
        coefficients=raw.coefficients,
        rotation=tuple(rotation.ravel().tolist()),
    )


@pytest.mark.parametrize("raw", CAMERAS, ids=lambda raw: raw.distortion.value)
def test_rectified_pixels_come_from_where_opencv_takes_them(raw: RawCamera) -> None:
    rotation = so3_exp([0.02, -0.03, 0.01])
    ideal: PinholeCamera = common_camera([(raw, rotation)], SIZE)
    camera = CameraEntry.from_rig(Rig(RigKind.MONO, ideal), _entry_of(raw, rotation))
    u, v = (a.ravel() for a in np.meshgrid(np.arange(0, 640, 13), np.arange(0, 480, 11)))
    column, row = _float_maps(raw, rotation, ideal)
    expected = np.column_stack([column[v, u], row[v, u]])
    np.testing.assert_allclose(stored_pixels(np.column_stack([u, v]).astype(float), camera), expected, atol=2e-3)


@pytest.mark.parametrize("raw", CAMERAS, ids=lambda raw: raw.distortion.value)
def test_colmap_projects_with_the_model_as_the_file_s_camera_does(raw: RawCamera) -> None:
    pycolmap = pytest.importorskip("pycolmap")
    stored = _entry_of(raw, np.eye(3))
    model, parameters = colmap_model(CameraEntry.from_rig(Rig(RigKind.MONO, PinholeCamera(*SIZE, 1, 1, 0, 0)), stored))
    camera = pycolmap.Camera(model=pycolmap.CameraModelId(model), width=SIZE[0], height=SIZE[1], params=parameters)
    rays = np.random.default_rng(3).uniform([-0.6, -0.5, 1.0], [0.6, 0.5, 1.0], (50, 3))
    pixels = np.array([camera.img_from_cam(ray) for ray in rays])
    np.testing.assert_allclose(pixels - 0.5, project(raw, rays), atol=1e-6)


@pytest.mark.parametrize(
    ("distortion", "coefficients"),
    [
        (Distortion.DOUBLE_SPHERE, (-0.2, 0.6)),
        (Distortion.EXTENDED_UNIFIED, (0.6, 1.1)),
        (Distortion.OMNIDIRECTIONAL, (1.5, -0.1, 0.01, 0.0, 0.0)),
    ],
)
def test_the_rectified_camera_stands_for_a_lens_that_other_programs_lack(
    indoor_rgbd: Path, distortion: Distortion, coefficients: tuple[float, ...]
) -> None:
    raw = RawCamera(450.0, 455.0, 330.0, 235.0, SIZE, distortion, coefficients)
    sequence = open_dataset(indoor_rgbd).sequences[0]
    curved = replace(sequence, stored_camera=raw, R_rectified_left=np.eye(3))
    assert _stored(curved) is None
    assert f"its lens ({distortion.value}, " in stand_in(curved)
    assert stand_in(sequence) == "" and stand_in(replace(curved, stored_camera=CAMERAS[0])) == ""


@pytest.mark.parametrize(("tail", "kept"), [((), 5), ((0.0,) * 7, 8), ((0.0, 0.0, 0.0, 0.001, 0.0, 0.0, 0.0), None)])
def test_a_lens_of_any_number_of_coefficients_is_written(
    indoor_rgbd: Path, tail: tuple[float, ...], kept: int | None
) -> None:
    """12 and 14 coefficients, too; those beyond the eighth have no model elsewhere: the rectified camera stands."""
    raw = replace(CAMERAS[0], coefficients=(*CAMERAS[0].coefficients, *tail))
    sequence = open_dataset(indoor_rgbd).sequences[0]
    entry = _stored(replace(sequence, stored_camera=raw, R_rectified_left=np.eye(3)))
    assert (entry is None) == (kept is None)
    assert entry is None or entry.coefficients == raw.coefficients[:kept]
