"""``maslam netvlad codes``: from pictures to codebooks beside a model, and what each code costs."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest

from maslam.descriptors.card import MODELS
from maslam.descriptors.codebooks import Codebooks
from maslam.descriptors.codes import CODES, PRODUCT_CODES, Coder
from maslam.descriptors.inference import NetVlad
from maslam.tools.cli import main
from maslam.tools.place_benchmarks.rendered import HELD_OUT_SEEDS, TRAINING_SEEDS, cache_path, config_for, save_places
from tests.descriptors.conftest import textured_image
from tests.descriptors.test_benchmarks import _street


@pytest.fixture
def model(tmp_path: Path) -> Path:
    for suffix in (".onnx", ".json"):
        shutil.copyfile(MODELS / f"default{suffix}", tmp_path / f"mine{suffix}")
    return tmp_path / "mine.onnx"


def test_codebooks_from_pictures_and_worlds(model: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    photos, cache = tmp_path / "photos", tmp_path / "cache"
    photos.mkdir()
    cache.mkdir()
    for seed in range(90):
        cv2.imwrite(str(photos / f"{seed:02d}.png"), textured_image(seed, 60, 80))
    for seed in (TRAINING_SEEDS, HELD_OUT_SEEDS):
        config = config_for("town").model_copy(update={"places": 12})
        save_places(cache_path(cache, "town", seed, config), _street(12))
    options = ["--photos", str(photos), "--cache", str(cache)]
    assert main(["netvlad", "codes", str(model), *options, "--quiet", "--json"]) == 0
    records = json.loads(capsys.readouterr().out)
    turned = [f"{code}-query" for code in PRODUCT_CODES]  # the query coded instead of the references
    assert [(r["dataset"], r["code"]) for r in records] == [("town_9500", code) for code in (*CODES, *turned)]
    assert [r["bytes"] for r in records[-4:]] == [32, 16, 32, 16]
    # Every view of a place of this street is the same picture: no code may lose it.
    assert {r["recall_at_1"] for r in records} == {1.0}
    books = Codebooks.load(model.with_suffix(".codes.npz"))
    assert books.data == "90 photographs with 2 pieces each and 36 views of rendered training worlds"
    assert books.sha256 == NetVlad.load(model).sha256
    net = NetVlad.load(model)
    vectors = net.describe([textured_image(seed, 60, 80) for seed in range(30)])
    coder = Coder.of(net, "pq32")
    decoded = coder.decode(coder.encode(vectors))
    np.testing.assert_array_equal((decoded @ vectors.T).argmax(axis=1), np.arange(30))


def test_what_is_missing_is_said(model: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    empty = ["--cache", str(tmp_path / "none"), "--quiet"]
    assert main(["netvlad", "codes", str(model), *empty]) == 1
    assert "nothing to make codebooks from: no --photos" in capsys.readouterr().err
    (tmp_path / "few").mkdir()
    cv2.imwrite(str(tmp_path / "few" / "a.png"), textured_image(0))
    assert main(["netvlad", "codes", str(model), "--photos", str(tmp_path / "few"), *empty]) == 1
    assert "at least 285 vectors, got 3" in capsys.readouterr().err
    assert main(["netvlad", "codes", str(tmp_path / "no.onnx"), *empty]) == 1
    assert "no.onnx: not found" in capsys.readouterr().err
    assert not model.with_suffix(".codes.npz").exists()
