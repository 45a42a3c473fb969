"""The container of place vectors, and the predecessor's file."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from maslam.descriptors.container import PREDECESSOR_DIM, PlaceVectors, import_predecessor
from maslam.descriptors.errors import DescriptorError


def _vectors(count: int = 5, dim: int = 16, sha: str = "a" * 64) -> PlaceVectors:
    rows = np.random.default_rng(1).normal(size=(count, dim)).astype(np.float32)
    rows /= np.linalg.norm(rows, axis=1, keepdims=True)
    return PlaceVectors("test", sha, dim, np.arange(count, dtype=np.int64) * 10, rows, np.arange(count) % 2 == 0)


@pytest.mark.parametrize("count", [0, 1, 5])
def test_what_is_saved_is_loaded(tmp_path: Path, count: int) -> None:
    saved = _vectors(count)
    saved.save(tmp_path / "netvlad.npz")
    loaded = PlaceVectors.load(tmp_path / "netvlad.npz")
    assert (loaded.name, loaded.sha256, loaded.dim) == (saved.name, saved.sha256, saved.dim)
    for field in ("stamps_ns", "vectors", "textured"):
        np.testing.assert_array_equal(getattr(loaded, field), getattr(saved, field))
    assert [p.name for p in tmp_path.iterdir()] == ["netvlad.npz"]


def test_equal_vectors_make_equal_files(tmp_path: Path) -> None:
    for name in ("a.npz", "b.npz"):
        _vectors().save(tmp_path / name)
    assert (tmp_path / "a.npz").read_bytes() == (tmp_path / "b.npz").read_bytes()


def test_wrong_shapes_and_values_are_errors() -> None:
    good = _vectors()
    with pytest.raises(DescriptorError, match="dimension 16"):
        PlaceVectors("test", "a" * 64, 16, good.stamps_ns[:4], good.vectors, good.textured)
    broken = good.vectors.copy()
    broken[3, 2] = np.nan
    with pytest.raises(DescriptorError, match="vector 3 is not finite"):
        PlaceVectors("test", "a" * 64, 16, good.stamps_ns, broken, good.textured)


def test_broken_files_are_one_line_errors(tmp_path: Path) -> None:
    path = tmp_path / "netvlad.npz"
    with pytest.raises(DescriptorError, match="not found"):
        PlaceVectors.load(path)
    _vectors().save(path)
    whole = path.read_bytes()
    path.write_bytes(whole[: len(whole) // 2])
    with pytest.raises(DescriptorError, match="not a file of place vectors"):
        PlaceVectors.load(path)
    np.savez(path, vectors=np.zeros((2, 3)))
    with pytest.raises(DescriptorError, match="not a file of place vectors"):
        PlaceVectors.load(path)


def test_the_predecessors_file_is_read_by_nearest_image(tmp_path: Path) -> None:
    rng = np.random.default_rng(2)
    values = rng.normal(size=(4, PREDECESSOR_DIM)).astype("<f4")
    path = tmp_path / "netvlad_feats.bin"
    path.write_bytes(values.tobytes())
    stamps = np.array([0, 100, 200, 300])
    imported = import_predecessor(path, stamps, np.array([-5, 140, 160, 290, 1000]))
    assert imported.dim == 128
    for row, image in zip(imported.vectors, [0, 1, 2, 3, 3], strict=True):
        expected = values[image, :128].astype(np.float64)
        np.testing.assert_allclose(row, expected / np.linalg.norm(expected), atol=1e-6)
    with pytest.raises(DescriptorError, match="3 images of 4096 float32 make 49152"):
        import_predecessor(path, stamps[:3], stamps)


def test_one_image_is_enough_for_the_predecessors_file(tmp_path: Path) -> None:
    path = tmp_path / "netvlad_feats.bin"
    path.write_bytes(np.ones(PREDECESSOR_DIM, dtype="<f4").tobytes())
    assert len(import_predecessor(path, np.array([7]), np.array([1, 2]))) == 2
