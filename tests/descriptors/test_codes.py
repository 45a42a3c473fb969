"""Place vectors as few bytes, against closed forms and exhaustive search; codebooks and what they refuse."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from maslam.descriptors.card import ModelCard, file_sha256, write_card
from maslam.descriptors.clusters import k_means
from maslam.descriptors.codebooks import Codebooks, ProductBook, balanced_groups, codebooks_path, train_codebooks
from maslam.descriptors.codes import CODES, INT4_STEP, Coder
from maslam.descriptors.errors import DescriptorError

SHA = "cd" * 32
DIM = 256


def unit(rows: NDArray) -> NDArray[np.float32]:
    return np.asarray(rows / np.linalg.norm(rows, axis=1, keepdims=True), dtype=np.float32)


def some(count: int, seed: int = 0, dim: int = DIM) -> NDArray[np.float32]:
    """Unit vectors whose numbers fall off in size, as those of principal axes do."""
    return unit(np.random.default_rng(seed).normal(size=(count, dim)) * np.linspace(2.0, 0.7, dim))


@pytest.fixture(scope="module")
def model(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A card with codebooks beside a file that no coder ever opens as a network."""
    path = tmp_path_factory.mktemp("model") / "made-up.onnx"
    path.write_bytes(b"weights")
    card = ModelCard(
        name="made-up",
        sha256=file_sha256(path),
        dim=DIM,
        input_pixels=100,
        threshold=1.0,
        candidate_threshold=1.0,
        min_std=0.0,
    )
    write_card(path, card)
    train_codebooks(some(2000, 7), card.sha256, "made up").save(codebooks_path(path))
    return path


@pytest.mark.parametrize("code", CODES)
class TestEveryCode:
    def test_sizes_and_unit_length(self, model: Path, code: str) -> None:
        coder, vectors = Coder.of(model, code), some(20)
        codes = coder.encode(vectors)
        assert codes.shape == (20, coder.bytes) and codes.dtype == np.uint8
        decoded = coder.decode(codes)
        assert decoded.dtype == np.float32 and decoded.shape == coder.cut(vectors).shape
        np.testing.assert_allclose(np.linalg.norm(decoded, axis=1), 1.0, atol=1e-5)

    def test_bytes_of_a_vector_depend_on_it_alone(self, model: Path, code: str) -> None:
        coder, vectors = Coder.of(model, code), some(9, 1)
        together = coder.encode(vectors)
        for row in range(9):
            np.testing.assert_array_equal(coder.encode(vectors[row : row + 1])[0], together[row])

    def test_decoding_points_the_same_way(self, model: Path, code: str) -> None:
        coder, vectors = Coder.of(model, code), some(200, 4)
        cosine = (coder.decode(coder.encode(vectors)) * coder.cut(vectors)).sum(axis=1)
        # A byte for 8 numbers leaves at least the 0.36 of a 1-bit scalar quantiser's loss behind (Max, 1960).
        assert cosine.min() > (0.995 if code.startswith(("float", "int8")) else 0.95 if code == "int4" else 0.7)

    def test_wrong_bytes_are_refused(self, model: Path, code: str) -> None:
        coder = Coder.of(model, code)
        for wrong in (np.zeros((1, coder.bytes + 1), np.uint8), np.zeros((1, coder.bytes - 1), np.uint8)):
            with pytest.raises(DescriptorError, match=f"{code} has {coder.bytes} bytes"):
                coder.decode(wrong)
        with pytest.raises(DescriptorError, match="vectors of 256 numbers"):
            coder.encode(some(2, dim=64))


def test_bytes_are_what_the_names_say(model: Path) -> None:
    sizes = {code: Coder.of(model, code).bytes for code in (*CODES, "int4x128", "int8x64")}
    assert sizes == {
        "float32": 1024,
        "float32x128": 512,
        "int8": 256,
        "int8x128": 128,
        "int4": 128,
        "pq32": 32,
        "pq16": 16,
        "int4x128": 64,
        "int8x64": 64,
    }


def test_float32_changes_nothing(model: Path) -> None:
    coder, vectors = Coder.of(model, "float32"), some(5)
    np.testing.assert_array_equal(coder.decode(coder.encode(vectors)), vectors)
    assert coder.encode(vectors).tobytes() == vectors.astype("<f4").tobytes()
    for bad in (np.full((1, DIM), np.nan, "<f4"), np.full((1, DIM), 3.0, "<f4")):
        with pytest.raises(DescriptorError, match="not of length 1"):
            coder.decode(bad.view(np.uint8).reshape(1, -1))


def test_int8_is_off_by_half_a_step_at_most(model: Path) -> None:
    coder, vectors = Coder.of(model, "int8"), some(300, 5)
    levels = coder.encode(vectors).view(np.int8).astype(np.float64)
    step = np.abs(vectors).max(axis=1, keepdims=True) / 127.0
    assert np.abs(levels * step - vectors).max() <= 0.5 * step.max() * (1 + 1e-5)
    # The sine of the angle to the original is at most the length of the error.
    cosine = (coder.decode(coder.encode(vectors)) * vectors).sum(axis=1).clip(-1, 1)
    assert (np.sqrt(1 - cosine**2) <= 0.5 * np.sqrt(DIM) * step[:, 0] + 1e-3).all()
    with pytest.raises(DescriptorError, match="no direction"):
        coder.decode(np.zeros((1, DIM), np.uint8))


@pytest.mark.parametrize("dim", [256, 33])
def test_int4_is_off_by_half_a_step_where_it_reaches(dim: int) -> None:
    coder, vectors = Coder.make("int4", dim, SHA, None), some(300, 6, dim)
    assert coder.bytes == (dim + 1) // 2
    packed = coder.encode(vectors)
    levels = np.stack([packed & 15, packed >> 4], axis=2).reshape(300, -1)[:, :dim] - 7.5
    step = INT4_STEP / np.sqrt(dim)
    reached = np.abs(vectors) < 8 * step
    assert reached.mean() > 0.99
    assert np.abs(levels * step - vectors)[reached].max() <= 0.5 * step * (1 + 1e-4)
    assert (np.sign(levels) == np.sign(vectors))[~reached].all()


def test_product_code_names_the_nearest_centre_of_each_group(model: Path) -> None:
    book = Codebooks.load(codebooks_path(model)).books["pq32"]
    vectors = some(10, 8)
    codes = Coder.of(model, "pq32").encode(vectors)
    for row, vector in enumerate(vectors):
        for group, axes in enumerate(book.axes.reshape(32, -1)):
            apart = [float(np.sum((centre.astype(np.float64) - vector[axes]) ** 2)) for centre in book.centres[group]]
            assert apart[codes[row, group]] == pytest.approx(min(apart), rel=1e-5)


def test_product_code_finds_what_exact_search_finds(model: Path) -> None:
    """Places seen twice with noise: the neighbour by 32 bytes is the exact one nearly always, by 16 mostly."""
    first = some(1000, 9)
    again = unit(first + 0.9 * some(1000, 10))
    exact = (again @ first.T).argmax(axis=1)
    share = {}
    for code in ("pq32", "pq16"):
        coder = Coder.of(model, code)
        found = (coder.decode(coder.encode(again)) @ coder.cut(first).T).argmax(axis=1)
        share[code] = float((found == exact).mean())
    assert share["pq32"] > 0.97 and 0.8 < share["pq16"] <= share["pq32"]


def test_restored_distances_are_those_of_the_originals_on_average(model: Path) -> None:
    first = some(2000, 11)
    again = unit(first + 0.8 * some(2000, 12))
    exact = np.linalg.norm(first - again, axis=1)
    coder = Coder.of(model, "pq32")
    coded = np.linalg.norm(coder.decode(coder.encode(again)) - first, axis=1)
    restored = np.array([coder.restored(float(d)) for d in coded])
    assert abs(restored.mean() - exact.mean()) < 0.03 < coded.mean() - exact.mean()
    assert Coder.of(model, "int8").restored(0.7) == 0.7


# -- codebooks --------------------------------------------------------------------------------------------------------


def test_same_vectors_same_books(tmp_path: Path) -> None:
    vectors = some(400, 13, 32)
    for name in "ab":
        train_codebooks(vectors, SHA, "x").save(tmp_path / name)
    assert (tmp_path / "a").read_bytes() == (tmp_path / "b").read_bytes()
    loaded = Codebooks.load(tmp_path / "a")
    assert (loaded.sha256, loaded.dim, loaded.data, sorted(loaded.books)) == (SHA, 32, "x", ["pq16", "pq32"])


def test_books_of_long_vectors_stay_small(model: Path) -> None:
    assert codebooks_path(model).stat().st_size < 300_000
    vectors = unit(np.random.default_rng(0).normal(size=(300, 1024)) * np.where(np.arange(1024) % 4 == 1, 3.0, 1.0))
    book = train_codebooks(vectors, SHA, "x").books["pq32"]
    assert sorted(book.axes) == list(range(1, 1024, 4)), "the strongest axes, wherever they stand"


def test_groups_are_balanced() -> None:
    power = 2.0 ** -np.arange(8.0)
    groups = balanced_groups(power, 4).reshape(4, 2)
    assert sorted(groups.ravel()) == list(range(8))
    np.testing.assert_allclose(power[groups].prod(axis=1), power[0] * power[7])


def test_k_means_finds_clusters_that_lie_apart() -> None:
    rng = np.random.default_rng(0)
    truth = np.array([[0.0, 0.0], [10.0, 0.0], [0.0, 10.0]])
    rows = (np.repeat(truth, 50, axis=0) + rng.normal(0, 0.1, (150, 2))).astype(np.float32)
    best = min((k_means(rows, 3, 10, np.random.default_rng(s)) for s in range(5)), key=lambda c: _loss(rows, c))
    nearest = np.linalg.norm(truth[:, None] - best, axis=2).argmin(axis=1)
    np.testing.assert_allclose(best[nearest], truth, atol=0.1)


def _loss(rows: NDArray, centres: NDArray) -> float:
    return float(np.linalg.norm(rows[:, None] - centres, axis=2).min(axis=1).sum())


def test_too_few_or_too_short_vectors_are_said() -> None:
    with pytest.raises(DescriptorError, match=r"at least 285 vectors, got 100"):
        train_codebooks(some(100), SHA, "x")
    with pytest.raises(DescriptorError, match="too short"):
        train_codebooks(some(400, dim=8), SHA, "x")
    assert sorted(train_codebooks(some(400, dim=16), SHA, "x").books) == ["pq16"]


def test_missing_and_foreign_books_name_the_command(model: Path, tmp_path: Path) -> None:
    with pytest.raises(DescriptorError, match=r"needs codebooks.*maslam netvlad codes .*other\.onnx"):
        Coder.make("pq32", DIM, SHA, tmp_path / "other.onnx")
    with pytest.raises(DescriptorError, match=r"codebooks of other weights .*cdcdcdcdcdcd, 256\); make them"):
        Coder.make("pq32", DIM, SHA, model)
    train_codebooks(some(400, dim=16), SHA, "x").save(tmp_path / "short.codes.npz")
    with pytest.raises(DescriptorError, match="no codebook for pq32"):
        Coder.make("pq32", 16, SHA, tmp_path / "short.onnx")
    with pytest.raises(DescriptorError, match=r"no place code 'zip'; there are float32, .*pq16"):
        Coder.of(model, "zip")
    with pytest.raises(DescriptorError, match="first 300 numbers, but the vectors have 256"):
        Coder.of(model, "int8x300")


def test_damaged_books_are_one_line(tmp_path: Path) -> None:
    (tmp_path / "a").write_bytes(b"nonsense")
    with pytest.raises(DescriptorError, match="a: not a file of codebooks"):
        Codebooks.load(tmp_path / "a")
    train_codebooks(some(400, dim=16), SHA, "x").save(tmp_path / "b")
    (tmp_path / "b").write_bytes((tmp_path / "b").read_bytes()[:-500])
    with pytest.raises(DescriptorError, match="b: not a file of codebooks"):
        Codebooks.load(tmp_path / "b")
    with pytest.raises(DescriptorError, match="no codebook"):
        ProductBook(np.zeros(16, np.int64), np.zeros((16, 256, 1), np.float32), 0.8)


def test_another_book_has_another_key(model: Path, tmp_path: Path) -> None:
    one = Coder.of(model, "pq32")
    assert one.key.startswith("pq32-") and len(one.key) == 13
    other = train_codebooks(some(400, 99), SHA, "x")
    other.save(tmp_path / "m.codes.npz")
    assert Coder.make("pq32", DIM, SHA, tmp_path / "m.onnx").key != one.key
    assert Coder.of(model, "int8").key == "int8"
