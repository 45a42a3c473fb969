"""What a receiver knows of its surroundings takes off coded vectors most of what the code did to them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from maslam.descriptors.codebooks import train_codebooks
from maslam.descriptors.codes import Coder, Vectors
from maslam.descriptors.scene import Scene
from maslam.tools.netvlad.methods import asked_in_code, coded

DIM, SHA = 64, "ab" * 32


def unit(rows: np.ndarray) -> Vectors:
    return np.asarray(rows / np.linalg.norm(rows, axis=1, keepdims=True), dtype=np.float32)


@pytest.fixture(scope="module")
def coder(tmp_path_factory: pytest.TempPathFactory) -> Coder:
    """Made for vectors of every direction."""
    model: Path = tmp_path_factory.mktemp("books") / "any.onnx"
    train_codebooks(unit(np.random.default_rng(0).normal(size=(3000, DIM))), SHA, "noise").save(
        model.with_suffix(".codes.npz")
    )
    return Coder.make("pq16", DIM, SHA, model)


def corridor(count: int, seed: int) -> tuple[Vectors, Vectors]:
    """Two visits of ``count`` places that have most in common (their mean vector is .95 long), differ along eight
    directions, and look a little different each time."""
    always = np.random.default_rng(7)
    shared, axes = unit(always.normal(size=(1, DIM))), np.linalg.qr(always.normal(size=(DIM, 8)))[0].T
    rng = np.random.default_rng([7, seed])
    first = shared + 0.1 * rng.normal(size=(count, 8)) @ axes
    return unit(first), unit(first + 0.02 * rng.normal(size=first.shape))


def recall(asked: Vectors, known: Vectors) -> float:
    nearest = ((asked[:, None] - known[None]) ** 2).sum(axis=2).argmin(axis=1)
    return float(np.mean(nearest == np.arange(len(asked))))


def test_look_alike_places_are_found_that_the_code_alone_mixes_up(coder: Coder) -> None:
    asked, known = corridor(150, 1)
    decoded = coder.decode(coder.encode(known))
    sharpened = Scene.of(coder, asked).sharpened(decoded)
    assert recall(asked, known) > 0.9
    assert recall(asked, sharpened) > recall(asked, decoded) + 0.15
    assert np.linalg.norm(sharpened - known, axis=1).mean() < 0.65 * np.linalg.norm(decoded - known, axis=1).mean()


def test_the_receiver_needs_other_images_of_the_surroundings_not_the_same_ones(coder: Coder) -> None:
    (elsewhere, _), (asked, known) = corridor(150, 2), corridor(150, 3)
    decoded = coder.decode(coder.encode(known))
    assert recall(asked, Scene.of(coder, elsewhere).sharpened(decoded)) > recall(asked, decoded) + 0.1


def test_vectors_of_every_direction_lose_nothing(coder: Coder) -> None:
    rng = np.random.default_rng(4)
    known = unit(rng.normal(size=(300, DIM)))
    asked = unit(known + 0.05 * rng.normal(size=known.shape))
    decoded = coder.decode(coder.encode(known))
    assert recall(asked, Scene.of(coder, asked).sharpened(decoded)) >= recall(asked, decoded) - 0.01


def test_a_fine_code_is_left_as_it_is() -> None:
    asked, known = corridor(100, 5)
    fine = Coder.make("int8", DIM, SHA, None)
    decoded = fine.decode(fine.encode(known))
    assert np.abs(Scene.of(fine, asked).sharpened(decoded) - decoded).max() < 0.005


@pytest.mark.parametrize("count", [1, 2, 8])
def test_few_own_vectors_do_no_harm(coder: Coder, count: int) -> None:
    asked, known = corridor(100, 6)
    decoded = coder.decode(coder.encode(known))
    sharpened = Scene.of(coder, asked[:count]).sharpened(decoded)
    assert np.isfinite(sharpened).all()
    assert recall(asked, sharpened) >= recall(asked, decoded) - 0.02


def test_evaluation_compares_both_ways(coder: Coder) -> None:
    asked, known = corridor(20, 8)
    sharpened = Scene.of(coder, asked).sharpened(coder.decode(coder.encode(known)))
    announced, queried = (make(coder).distances(list(asked), list(known)) for make in (coded, asked_in_code))
    np.testing.assert_allclose(announced, np.linalg.norm(asked[:, None] - sharpened, axis=2), atol=2e-3)
    decoded = coder.decode(coder.encode(asked))
    np.testing.assert_allclose(queried, np.linalg.norm(decoded[:, None] - known, axis=2), atol=2e-3)
