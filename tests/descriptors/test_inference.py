"""The shipped model as agents use it: no torch, any image, the same bytes always."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from maslam.descriptors.card import MODELS, file_sha256, read_card
from maslam.descriptors.errors import DescriptorError
from maslam.descriptors.inference import NetVlad, to_working_size
from tests.descriptors.conftest import textured_image


@pytest.fixture(scope="module")
def model() -> NetVlad:
    return NetVlad.load()


def test_loading_and_describing_imports_no_torch() -> None:
    code = (
        "import sys, numpy as np; from maslam.descriptors.inference import NetVlad;"
        "NetVlad.load().describe([np.random.default_rng(0).integers(0, 255, (120, 160), dtype=np.uint8)]);"
        "print(sorted(m for m in ('torch', 'kornia', 'onnx', 'open3d', 'matplotlib') if m in sys.modules))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_the_shipped_model_is_small_and_says_what_it_is(model: NetVlad) -> None:
    path, card = read_card("default")
    assert path.stat().st_size <= 10_000_000
    assert card.sha256 == file_sha256(path) == model.sha256
    assert model.dim == 256
    assert 0 < model.threshold <= model.candidate_threshold < 2
    assert card.calibration is not None
    assert card.calibration.strict.precision >= 0.99
    assert card.calibration.strict.distance == pytest.approx(model.threshold)
    assert card.calibration.candidate.distance == pytest.approx(model.candidate_threshold)


def test_vectors_are_unit_and_the_same_in_any_company(model: NetVlad, images: list[NDArray[np.uint8]]) -> None:
    together = model.describe(images)
    assert together.shape == (8, model.dim)
    assert together.dtype == np.float32
    np.testing.assert_allclose(np.linalg.norm(together, axis=1), 1.0, atol=1e-5)
    for image, row in zip(images, together, strict=True):
        np.testing.assert_array_equal(model.describe([image])[0], row)
    np.testing.assert_array_equal(NetVlad.load().describe(np.stack(images)), together)
    assert model.describe([]).shape == (0, model.dim)


@pytest.mark.parametrize("size", [(48, 64), (120, 160), (376, 1241), (480, 640), (300, 200), (30, 90)])
def test_any_size_is_described(model: NetVlad, size: tuple[int, int]) -> None:
    vector = model.describe([textured_image(3, *size)])
    assert np.isfinite(vector).all()


def test_one_place_at_another_resolution_is_the_same_place(model: NetVlad) -> None:
    scenes = [textured_image(seed, 480, 640) for seed in range(12)]
    small = [cv2.resize(scene, (320, 240), interpolation=cv2.INTER_AREA) for scene in scenes]
    distances = np.sqrt(np.maximum(2 - 2 * model.describe(scenes) @ model.describe(small).T, 0))
    np.testing.assert_array_equal(distances.argmin(axis=1), np.arange(12))
    assert np.diag(distances).max() < 0.3


def test_colour_is_taken_as_grey(model: NetVlad, images: list[NDArray[np.uint8]]) -> None:
    colour = cv2.cvtColor(images[0], cv2.COLOR_GRAY2BGR)
    np.testing.assert_array_equal(model.describe([colour]), model.describe([images[0]]))


def test_container_of_a_sequence(model: NetVlad, images: list[NDArray[np.uint8]]) -> None:
    images[2] = np.full_like(images[2], 200)
    made = model.place_vectors(images, np.arange(8) * 100)
    assert made.sha256 == model.sha256
    assert made.textured.tolist() == [True, True, False, True, True, True, True, True]
    np.testing.assert_array_equal(made.vectors, model.describe(images))


@pytest.mark.parametrize(
    ("image", "said"),
    [
        (np.zeros((10, 10), dtype=np.float32), "float32"),
        (np.zeros((0, 10), dtype=np.uint8), "with pixels in it"),
        (np.zeros((10, 10, 4), dtype=np.uint8), "3 channels"),
        (np.zeros((10, 300), dtype=np.uint8), "300x10 px is too narrow"),
    ],
)
def test_what_is_no_image_is_an_error(model: NetVlad, image: NDArray[np.uint8], said: str) -> None:
    with pytest.raises(DescriptorError, match=said):
        model.describe([image])


def test_working_size_keeps_shape_and_cost() -> None:
    for height, width in ((480, 640), (376, 1241), (752, 480), (99, 56)):
        h, w = to_working_size(np.zeros((height, width), dtype=np.uint8), 43_200).shape
        assert h * w == pytest.approx(43_200, rel=0.02)
        assert w / h == pytest.approx(width / height, rel=0.02)


def test_models_are_checked(tmp_path: Path) -> None:
    with pytest.raises(DescriptorError, match=r"absent\.onnx: not found"):
        NetVlad.load("absent")
    copy = tmp_path / "mine.onnx"
    shutil.copy(MODELS / "default.onnx", copy)
    with pytest.raises(DescriptorError, match=r"mine\.json: not found"):
        NetVlad.load(copy)
    card = json.loads((MODELS / "default.json").read_text())
    copy.with_suffix(".json").write_text(json.dumps(card | {"min_stdd": 1.0}))
    with pytest.raises(DescriptorError, match="min_stdd"):
        NetVlad.load(copy)
    copy.with_suffix(".json").write_text(json.dumps(card))
    assert NetVlad.load(str(copy)).sha256 == card["sha256"]
    copy.write_bytes(copy.read_bytes()[:-1] + b"x")
    with pytest.raises(DescriptorError, match=r"not the weights that mine\.json describes"):
        NetVlad.load(copy)
    broken = tmp_path / "broken.onnx"
    broken.write_bytes(b"not onnx")
    broken.with_suffix(".json").write_text(json.dumps(card | {"sha256": file_sha256(broken)}))
    with pytest.raises(DescriptorError, match="onnxruntime cannot load it"):
        NetVlad.load(broken)
    with pytest.raises(DescriptorError, match="at least 1 thread"):
        NetVlad.load(threads=0)
