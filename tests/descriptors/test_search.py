"""The growing index gives what comparing with every vector gives."""

from __future__ import annotations

import json

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from maslam.descriptors.errors import DescriptorError
from maslam.descriptors.search import NearestIndex
from maslam.tools.cli import main


def unit(rows: NDArray) -> NDArray[np.float32]:
    return np.asarray(rows / np.linalg.norm(rows, axis=1, keepdims=True), dtype=np.float32)


def brute(vectors: NDArray[np.float32], query: NDArray[np.float32]) -> tuple[int, float]:
    apart = np.linalg.norm(vectors - query, axis=1)
    return int(np.argmin(apart)), float(apart.min())


def filled(vectors: NDArray[np.float32]) -> NearestIndex:
    index = NearestIndex()
    for key, vector in enumerate(vectors):
        index.add(key, vector)
    return index


@pytest.mark.parametrize("dim", [256, 128, 31])
def test_nearest_is_the_exact_one_to_the_bit(dim: int) -> None:
    """Across several blocks, for queries near and far."""
    rng = np.random.default_rng(dim)
    vectors = unit(rng.normal(size=(9000, dim)) * np.linspace(2, 0.5, dim) + 0.3)
    index = filled(vectors)
    near = unit(vectors[rng.integers(0, 9000, 40)] + 0.05 * rng.normal(size=(40, dim)))
    for query in np.concatenate([near, unit(rng.normal(size=(40, dim)))]):
        assert index.nearest(query) == brute(vectors, query)


def test_nearly_equal_vectors_are_told_apart() -> None:
    """Differences far below what int8 can hold."""
    rng = np.random.default_rng(1)
    vectors = unit(np.ones((500, 64)) + 1e-4 * rng.normal(size=(500, 64)))
    index = filled(vectors)
    for query in unit(np.ones((30, 64)) + 1e-4 * rng.normal(size=(30, 64))):
        assert index.nearest(query) == brute(vectors, query)


def test_the_older_of_equals() -> None:
    vectors = np.tile(unit(np.random.default_rng(2).normal(size=(3, 16))), (2000, 1))
    index = filled(vectors)
    for row in range(3):
        assert index.nearest(vectors[row]) == (row, 0.0)


def test_while_it_grows_and_below_a_key() -> None:
    rng = np.random.default_rng(3)
    vectors = unit(rng.normal(size=(300, 32)))
    keys = np.cumsum(rng.integers(1, 4, 300))
    index = NearestIndex()
    assert index.nearest(vectors[0]) is None
    for count, (key, vector) in enumerate(zip(keys.tolist(), vectors, strict=True), 1):
        index.add(key, vector)
        query = unit(rng.normal(size=(1, 32)))[0]
        row, apart = brute(vectors[:count], query)
        assert index.nearest(query) == (keys[row], apart)
        limit = int(rng.integers(0, keys[-1] + 2))
        seen = int((keys[:count] < limit).sum())
        if seen:
            row, apart = brute(vectors[:seen], query)
            assert index.nearest(query, below=limit) == (keys[row], apart)
        else:
            assert index.nearest(query, below=limit) is None
    assert len(index) == 300


@given(st.integers(0, 2**32 - 1), st.integers(1, 40), st.integers(1, 60), st.sampled_from([1e-3, 0.1, 1.0, 30.0]))
@settings(max_examples=60, deadline=None)
def test_any_vectors(seed: int, dim: int, count: int, spread: float) -> None:
    """Bounds hold for vectors of any direction, near each other or not, with a few numbers that dwarf the rest."""
    rng = np.random.default_rng(seed)
    vectors = unit(rng.normal(size=dim) + spread * rng.standard_t(2, size=(count, dim)))
    index = filled(vectors)
    query = unit(rng.normal(size=(1, dim)) if seed % 2 else vectors[:1] + spread * rng.normal(size=(1, dim)))[0]
    assert index.nearest(query) == brute(vectors, query)


def test_the_benchmark_prints_a_line_for_each_size(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["bench", "search", "--sizes", "10,5000", "--dim", "32", "--json", "--quiet"]) == 0
    records = json.loads(capsys.readouterr().out)
    assert [r["vectors"] for r in records] == [10, 5000]
    # The room of a block, and twice that: float32, int8 and four figures for each of 4096 vectors.
    assert records[1]["megabytes"] == pytest.approx(2 * 4096 * (5 * 32 + 4 * 8) / 1e6, rel=0.15)
    assert main(["bench", "search", "--sizes", "10,many", "--quiet"]) == 2


def test_what_does_not_belong_is_refused() -> None:
    index = filled(unit(np.ones((2, 8))))
    with pytest.raises(DescriptorError, match="does not belong"):
        index.add(2, np.ones(9, np.float32))
    with pytest.raises(DescriptorError, match="comes after 1"):
        index.add(1, np.ones(8, np.float32))
    with pytest.raises(DescriptorError, match="not finite"):
        index.add(2, np.full(8, np.nan, np.float32))
    with pytest.raises(DescriptorError, match="a query of shape"):
        index.nearest(np.ones(4, np.float32))
    assert len(index) == 2
