"""What our descriptor is measured against: each baseline against an evaluation of its definition by other means."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from maslam.descriptors.clusters import whitening
from maslam.descriptors.codes import Coder
from maslam.descriptors.inference import NetVlad
from maslam.frontend.vocabulary.vocabulary import BagOfWords, Vocabulary
from maslam.tools.common.errors import ToolError
from maslam.tools.netvlad.methods import coded, netvlad_method, sift_method, word_distances, words_method
from maslam.tools.netvlad.sift_vlad import SIZE_PX, STEP_PX, SiftVlad, fitted, root_sift
from tests.descriptors.conftest import textured_image

IMAGES = [textured_image(seed, 48, 64) for seed in range(258)]


@pytest.fixture(scope="module")
def cache(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("cache")


@pytest.fixture(scope="module")
def model(cache: Path) -> SiftVlad:
    return fitted(IMAGES[:40], IMAGES, cache)


def test_the_grid_covers_the_image_and_lies_upright() -> None:
    image = textured_image(1)
    found = root_sift(image)
    assert len(found) == (120 // STEP_PX) * (160 // STEP_PX)
    np.testing.assert_allclose(np.linalg.norm(found, axis=1), 1.0, atol=1e-5)
    # Each one is what SIFT says of that point alone, in the histogram of square roots (L1-normalised).
    point = cv2.KeyPoint(STEP_PX * 3.5, STEP_PX * 5.5, SIZE_PX, 0.0, 1.0, 0, -1)
    _, alone = cv2.SIFT.create().compute(image, [point])
    row = 5 * int(160 // STEP_PX) + 3
    np.testing.assert_allclose(np.square(found[row]), alone[0] / alone[0].sum(), atol=1e-6)


def test_vlad_is_the_papers_formula(model: SiftVlad) -> None:
    image = textured_image(7, 120, 160)  # of working size: nothing is resized
    expected = np.zeros((64, 64))
    for feature in root_sift(image).astype(np.float64):
        local = model.axes.astype(np.float64) @ (feature - model.mean)
        local /= np.linalg.norm(local)
        nearest = int(np.argmin([np.linalg.norm(local - centre) for centre in model.centres]))
        expected[nearest] += local - model.centres[nearest]
    for row in expected:
        row /= max(np.linalg.norm(row), 1e-12)
    np.testing.assert_allclose(model.describe(image), expected.ravel() / np.linalg.norm(expected), atol=2e-5)


@pytest.mark.parametrize(("count", "size"), [(40, 60), (200, 30)])
def test_whitening_is_principal_axes_over_a_power_of_their_variance(count: int, size: int) -> None:
    rng = np.random.default_rng(2)
    vectors = (rng.normal(size=(count, size)) * np.linspace(3, 0.5, size)).astype(np.float32)
    mean, axes, _ = whitening(vectors, 8, 0.5)
    out = (vectors - mean) @ axes.T
    np.testing.assert_allclose(out.mean(axis=0), 0.0, atol=1e-4)
    cov = np.cov(out.T)
    np.testing.assert_allclose(cov / cov[0, 0], np.eye(8), atol=1e-3)
    singular = np.linalg.svd(vectors - vectors.mean(axis=0), compute_uv=False)
    plain = np.var((vectors - mean) @ whitening(vectors, 8, 0.0)[1].T, axis=0) * count
    np.testing.assert_allclose(plain, singular[:8] ** 2, rtol=1e-3)


def test_a_place_is_found_with_every_code(model: SiftVlad) -> None:
    method = sift_method(model)
    sizes = {code.name: code.bytes_each([]) for code in method.codes}
    assert sizes == {
        "float32": 16384,
        "pca256-float32": 1024,
        "pca256-int8": 256,
        "pca256-int8x128": 128,
        "pca256-int4": 128,
    }
    references = [method.describe(textured_image(seed)) for seed in range(6)]
    dimmed = [method.describe((0.6 * textured_image(seed) + 30).astype(np.uint8)) for seed in range(6)]
    for code in method.codes:
        assert code.distances(dimmed, references).argmin(axis=1).tolist() == list(range(6))


def test_the_fit_is_kept_and_belongs_to_its_images(model: SiftVlad, cache: Path) -> None:
    again = fitted(IMAGES[:40], IMAGES, cache, lambda done: pytest.fail("fitted a second time"))
    np.testing.assert_array_equal(model.vlad_axes, again.vlad_axes)
    assert len(list(cache.glob("rootsift_vlad_*.npz"))) == 1
    with pytest.raises(ToolError, match="more than 256 images to be fitted on, got 100"):
        fitted(IMAGES[:40], IMAGES[:100], cache)


def _vocabulary() -> Vocabulary:
    """Three words: all bits clear, all set, the first half set; worth 1, 2 and 4."""
    octets = np.zeros((4, 32), dtype=np.uint8)
    octets[2], octets[3, :16] = 255, 255
    return Vocabulary(3, 1, np.array([-1, 0, 0, 0], dtype=np.int32), octets, np.array([0.0, 1.0, 2.0, 4.0]))


def test_bag_of_words_score_by_hand() -> None:
    vocabulary = _vocabulary()
    dark, light, half = (vocabulary.descriptors[k] for k in (1, 2, 3))
    query = vocabulary.bag(np.stack([dark, dark, light]))  # 2 x 1, 1 x 2: halves
    same = vocabulary.bag(np.stack([light, dark, dark]))
    mixed = vocabulary.bag(np.stack([light, half]))  # 2 and 4: a third, two thirds
    other = vocabulary.bag(half[None])
    got = word_distances([query], [same, mixed, other])
    # DBoW2: 1 - |v - w| / 2, summed: halves on words 1 and 2 against 0, 1/3, 2/3 on words 1, 2, 3.
    expected = 1 - 0.5 * (abs(0.5 - 0) + abs(0.5 - 1 / 3) + abs(0 - 2 / 3))
    np.testing.assert_allclose(1 - got[0], [1.0, expected, 0.0], atol=1e-6)


def test_bag_of_words_of_an_image_without_key_points() -> None:
    method = words_method(_vocabulary())
    blank = method.describe(np.full((120, 160), 90, dtype=np.uint8))
    assert isinstance(blank, BagOfWords) and not len(blank.words)
    (code,) = method.codes
    assert code.distances([blank], [method.describe(textured_image(0))])[0, 0] == 1.0
    assert code.bytes_each([method.describe(textured_image(0)), blank]) == round(8 * 3 / 2)


def _unit(count: int, dim: int) -> list[NDArray[np.float32]]:
    rows = np.random.default_rng(3).normal(size=(count, dim)).astype(np.float32)
    return list(rows / np.linalg.norm(rows, axis=1, keepdims=True))


def test_codes_are_compared_as_they_go_over_the_wire() -> None:
    queries, references = _unit(5, 16), _unit(7, 16)
    half = coded(Coder.make("float32x8", 16, "", None))
    assert half.bytes_each(references) == 32
    a, b = queries[2][:8], references[4][:8]
    expected = np.linalg.norm(a / np.linalg.norm(a) - b / np.linalg.norm(b))
    assert half.distances(queries, references)[2, 4] == pytest.approx(expected, abs=1e-5)
    coder = Coder.make("int4", 16, "", None)
    sent = coder.encode(np.stack(references))
    decoded = coder.decode(sent)
    expected_rows = np.stack([np.linalg.norm(decoded - coder.cut(query[None]), axis=1) for query in queries])
    np.testing.assert_allclose(coded(coder).distances(queries, references), expected_rows, atol=1e-5)


def test_a_model_is_tried_with_each_of_its_codes() -> None:
    sizes = {code.name: code.bytes_each([]) for code in netvlad_method().codes}
    dim = NetVlad.load().dim
    assert sizes["float32"] == 4 * dim and sizes["int8"] == dim and sizes["int4"] == dim // 2
    assert sizes["int8x128"] == 128 and sizes.get("pq32", 32) == 32 and sizes.get("pq16", 16) == 16
