"""``maslam netvlad`` from the command line: a tiny model from pictures to a calibrated card; and rendered places."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from maslam.descriptors.card import read_card
from maslam.descriptors.inference import NetVlad
from maslam.tools.cli import main
from maslam.tools.place_benchmarks.rendered import (
    HELD_OUT_SEEDS,
    INDOORS,
    build_world,
    cache_path,
    config_for,
    overlap,
    save_places,
    visit_places,
)
from tests.descriptors.conftest import textured_image
from tests.descriptors.test_benchmarks import _street

TINY = [
    *("--training.steps", "4", "--training.pairs", "6", "--training.width", "64", "--training.height", "48"),
    *(
        "--training.network.channels",
        "8,8,8",
        "--training.network.strides",
        "2,2,2",
        "--training.network.local-dim",
        "8",
    ),
    *("--training.network.clusters", "4", "--training.network.dim", "16", "--training.initial-images", "32"),
    *("--material.towns", "0", "--material.indoors", "0", "--quiet"),
]


@pytest.fixture(scope="module")
def photos(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("photos")
    for seed in range(24):
        cv2.imwrite(str(folder / f"{seed:02d}.png"), textured_image(seed))
    return folder


def test_train_export_calibrate_and_evaluate(tmp_path: Path, photos: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("torch")
    pytest.importorskip("onnx")
    assert main(["netvlad", "train", str(tmp_path / "made"), "--photos", str(photos), *TINY]) == 0
    checkpoint, model = tmp_path / "made" / "checkpoint.pt", tmp_path / "tiny.onnx"
    assert json.loads((tmp_path / "made" / "log.jsonl").read_text().splitlines()[-1])["step"] == 4
    assert main(["netvlad", "export", str(checkpoint), str(model), "--name", "tiny", "--pixels", "3072"]) == 0
    assert (NetVlad.load(model).name, NetVlad.load(model).dim, NetVlad.load(model).threshold) == ("tiny", 16, 2.0)
    config = config_for("town").model_copy(update={"places": 12})
    save_places(cache_path(tmp_path, "town", HELD_OUT_SEEDS, config), _street(12))
    options = ["--cache", str(tmp_path), "--worlds", "1", "--places", "12", "--kinds", "town", "--quiet"]
    assert main(["netvlad", "calibrate", str(model), *options]) == 0
    _, card = read_card(model)
    assert card.calibration is not None
    assert card.threshold == card.calibration.strict.distance < 2.0
    assert "town_9500" in card.calibration.data
    capsys.readouterr()
    wanted = ["--data", str(tmp_path), "--json", "--methods", "netvlad,thumbnail"]
    assert main(["netvlad", "eval", "--model", str(model), *wanted, *options]) == 0
    records = json.loads(capsys.readouterr().out)
    keys = {"dataset", "method", "code", "bytes", "queries", "recall_at_1", "recall_at_5", "ap", "ms"}
    assert [(r["dataset"], r["method"], r["bytes"], r.keys() == keys) for r in records] == [
        ("town_9500", "netvlad:tiny", 64, True),
        ("town_9500", "netvlad:tiny", 16, True),
        ("town_9500", "netvlad:tiny", 8, True),
        ("town_9500", "thumbnail", 768, True),
    ]
    # The wall's views of one place are the same picture: nothing may come out but full marks.
    assert {r["recall_at_1"] for r in records} == {1.0}


def test_mistakes_are_said_in_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["netvlad", "eval", "--data", str(tmp_path), "--worlds", "0", "--quiet"]) == 1
    assert "holds no place-recognition set" in capsys.readouterr().err
    assert main(["netvlad", "calibrate", str(tmp_path / "no.onnx"), "--quiet"]) == 1
    assert "no.onnx: not found" in capsys.readouterr().err
    assert main(["netvlad", "eval", "--kinds", "moon", "--quiet"]) == 2
    (tmp_path / "bad.pt").write_bytes(b"x")
    assert main(["netvlad", "export", str(tmp_path / "bad.pt"), str(tmp_path / "a.onnx")]) == 1
    assert "bad.pt: not a checkpoint" in capsys.readouterr().err


@pytest.mark.slow
def test_rendered_places_are_seen_twice_and_repeat() -> None:
    config = INDOORS.model_copy(update={"places": 4, "width": 96, "height": 72})
    world = build_world("indoor", 3)
    first, again = (visit_places(world, config, np.random.default_rng(5)) for _ in range(2))
    for visits, same in zip(first, again, strict=True):
        assert len(visits) == config.views
        assert all(a.image.tobytes() == b.image.tobytes() for a, b in zip(visits, same, strict=True))
        for other in visits[1:]:
            assert min(overlap([visits[0]], [other])[0, 0], overlap([other], [visits[0]])[0, 0]) >= config.min_overlap
            apart = np.linalg.norm(visits[0].T_W_C[:3, 3] - other.T_W_C[:3, 3])
            assert 0 < apart <= np.hypot(config.along_m, config.aside_m) + 0.3
            assert (visits[0].image != other.image).mean() > 0.5
