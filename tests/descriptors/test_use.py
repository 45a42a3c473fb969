"""``maslam netvlad info``, ``describe`` and ``calibrate`` on images whose vectors and places can be said by hand."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from maslam.descriptors.card import MODELS, ModelCard, read_card
from maslam.descriptors.codebooks import codebooks_path
from maslam.descriptors.container import PlaceVectors
from maslam.descriptors.inference import NetVlad
from maslam.frontend.files.trajectory import write_kitti_poses
from maslam.tools.cli import main
from tests.descriptors.conftest import textured_image, tiny_model


def _means(images: list[NDArray[np.uint8]]) -> NDArray[np.float64]:
    """What ``tiny_model`` makes of colour images of 24x18: their mean red, green, blue, scaled to unit length."""
    rows = np.stack([image.mean(axis=(0, 1))[::-1] for image in images])
    return rows / np.linalg.norm(rows, axis=1, keepdims=True)


@pytest.fixture
def pictures(tmp_path: Path) -> tuple[Path, list[NDArray[np.uint8]]]:
    """A folder of 23 colour images and what is in them; names whose natural order is not that of their letters."""
    folder, rng = tmp_path / "pictures", np.random.default_rng(1)
    folder.mkdir()
    checks = 40 * np.kron(np.indices((6, 8)).sum(axis=0) % 2, np.ones((3, 3)))[:, :, None]
    images = [np.uint8(rng.integers(10, 150, 3) + checks + rng.integers(0, 60, (18, 24, 1)) // 20) for _ in range(23)]
    images[7][:] = (10, 200, 90)
    for i, image in enumerate(images):
        cv2.imwrite(str(folder / f"view{i}.png"), image)
    return folder, images


@pytest.fixture
def model(tmp_path: Path) -> Path:
    return tiny_model(tmp_path / "means.onnx", channels=3, card={"input_pixels": 432})


@pytest.mark.parametrize("extra", [[], ["--threads", "3"], ["--threads", "1", "--batch", "4"]])
def test_a_folder_of_images_is_described(
    pictures: tuple[Path, list[NDArray[np.uint8]]],
    model: Path,
    tmp_path: Path,
    extra: list[str],
    capsys: pytest.CaptureFixture[str],
) -> None:
    folder, images = pictures
    out = tmp_path / "v.npz"
    assert main(["netvlad", "describe", str(folder), "-o", str(out), "--model", str(model), "--quiet", *extra]) == 0
    made = PlaceVectors.load(out)
    np.testing.assert_allclose(made.vectors, _means(images), atol=1e-5)
    assert made.images == tuple(str(folder / f"view{i}.png") for i in range(23))
    assert made.sha256 == read_card(model)[1].sha256
    assert np.flatnonzero(~made.textured).tolist() == [7]
    assert made.stamps_ns.tolist() == list(range(23))
    assert "23 images, 3 numbers each by means" in capsys.readouterr().out
    assert sorted(p.name for p in tmp_path.glob("v*")) == ["v.npz"]


def test_named_images_and_each_nth(pictures: tuple[Path, list[NDArray[np.uint8]]], model: Path, tmp_path: Path) -> None:
    folder, images = pictures
    words = ["-o", str(tmp_path / "v"), "--model", str(model), "--quiet"]
    assert main(["netvlad", "describe", str(folder / "view9.png"), str(folder / "view2.png"), *words]) == 0
    np.testing.assert_allclose(PlaceVectors.load(tmp_path / "v.npz").vectors, _means([images[9], images[2]]), atol=1e-5)
    assert main(["netvlad", "describe", str(folder), "--every", "5", *words]) == 0
    np.testing.assert_allclose(PlaceVectors.load(tmp_path / "v.npz").vectors, _means(images[::5]), atol=1e-5)
    assert PlaceVectors.load(tmp_path / "v.npz").stamps_ns.tolist() == [0, 5, 10, 15, 20]


def test_interrupted_work_is_taken_up_again(
    pictures: tuple[Path, list[NDArray[np.uint8]]], model: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder, images = pictures
    out, looked = tmp_path / "v.npz", []
    words = ["netvlad", "describe", str(folder), "-o", str(out), "--model", str(model), "--threads", "1", "--quiet"]
    look = NetVlad.look

    def until_the_tenth(self: NetVlad, given: list[NDArray[np.uint8]]) -> object:
        if len(looked) >= 10:
            raise KeyboardInterrupt
        looked.extend(given)
        return look(self, given)

    with monkeypatch.context() as patch:
        patch.setattr(NetVlad, "look", until_the_tenth)
        assert main(words) == 130
    assert not out.exists() and (tmp_path / "v.npz.unfinished").is_file()
    again: list[NDArray[np.uint8]] = []
    with monkeypatch.context() as patch:
        patch.setattr(NetVlad, "look", lambda self, given: again.extend(given) or look(self, given))
        assert main(words) == 0
    assert len(looked) + len(again) == 23
    np.testing.assert_allclose(PlaceVectors.load(out).vectors, _means(images), atol=1e-5)
    assert not (tmp_path / "v.npz.unfinished").exists()


def test_unfinished_work_on_other_images_is_not_taken_up(
    pictures: tuple[Path, list[NDArray[np.uint8]]], model: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder, images = pictures
    words = ["netvlad", "describe", str(folder), "-o", str(tmp_path / "v.npz"), "--model", str(model), "--quiet"]
    calls: list[int] = []

    def failing(self: NetVlad, given: object) -> object:
        calls.append(1)
        if len(calls) > 2:
            raise KeyboardInterrupt
        return look(self, given)

    look = NetVlad.look
    with monkeypatch.context() as patch:
        patch.setattr(NetVlad, "look", failing)
        assert main([*words, "--threads", "1"]) == 130
    images[0] = images[0][::-1] // 2
    cv2.imwrite(str(folder / "view0.png"), images[0])
    assert main(words) == 0
    np.testing.assert_allclose(PlaceVectors.load(tmp_path / "v.npz").vectors, _means(images), atol=1e-5)


def test_damaged_images_are_left_out_and_many_are_an_error(
    pictures: tuple[Path, list[NDArray[np.uint8]]], model: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder, images = pictures
    words = ["netvlad", "describe", str(folder), "-o", str(tmp_path / "v.npz"), "--model", str(model), "--quiet"]
    (folder / "view3.png").write_bytes((folder / "view3.png").read_bytes()[:60])
    assert main(words) == 0
    said = capsys.readouterr()
    assert "view3.png: the image is cut off" in said.err and "1 could not be read" in said.out
    made = PlaceVectors.load(tmp_path / "v.npz")
    np.testing.assert_allclose(made.vectors, _means(images[:3] + images[4:]), atol=1e-5)
    assert made.stamps_ns.tolist() == [i for i in range(23) if i != 3]
    for i in (4, 5):
        (folder / f"view{i}.png").write_bytes(b"")
    assert main(words) == 1
    assert "3 of the first" in capsys.readouterr().err
    assert main(["netvlad", "describe", str(tmp_path / "none"), "-o", str(tmp_path / "v.npz"), "--quiet"]) == 1


def test_info_says_what_the_card_says(model: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["netvlad", "info", str(model)]) == 0
    shown = capsys.readouterr().out
    for word in ("means", read_card(model)[1].sha256, "3 numbers", "colour, about 432 pixels", "0.500", "ms an image"):
        assert word in shown
    assert main(["netvlad", "info", str(model), "--json"]) == 0
    record = json.loads(capsys.readouterr().out)
    assert ModelCard.model_validate(record["card"]) == read_card(model)[1]
    assert record["file_bytes"] == model.stat().st_size and record["speed"]["images"] >= 1
    assert main(["netvlad", "info", str(model), "--provider", "abacus"]) == 2
    assert "no provider 'abacus' here, only: CPU" in capsys.readouterr().err
    assert main(["netvlad", "info", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["card"]["name"] == read_card("default")[1].name


def test_a_bare_file_gets_a_card_that_works(
    model: Path, tmp_path: Path, pictures: tuple[Path, list[NDArray[np.uint8]]], capsys: pytest.CaptureFixture[str]
) -> None:
    folder, images = pictures
    model.with_suffix(".json").unlink()
    words = ["netvlad", "card", str(model)]
    assert main([*words, "--input-pixels", "432", "--name", "mine", "--data", "my photographs"]) == 0
    assert "mine, 3 numbers; thresholds not calibrated" in capsys.readouterr().out
    _, card = read_card(model)
    assert (card.name, card.dim, card.colour, card.licence) == ("mine", 3, True, "not stated")
    assert card.data == "my photographs"
    out = tmp_path / "v.npz"
    assert main(["netvlad", "describe", str(folder), "-o", str(out), "--model", str(model), "--quiet"]) == 0
    np.testing.assert_allclose(PlaceVectors.load(out).vectors, _means(images), atol=1e-5)
    row = {"dataset": "town_1", "code": "float32", "bytes": 12, "queries": 9, "recall_at_1": 0.75, "recall_at_5": 1.0}
    rows = [row | {"method": method, "ap": 0.5, "ms": 1.0} for method in ("netvlad:mine", "thumbnail")]
    (tmp_path / "e.json").write_text(json.dumps(rows))
    assert main([*words, "--figures", str(tmp_path / "e.json"), "--licence", "MIT"]) == 0
    _, card = read_card(model)
    assert (card.name, card.data, card.licence) == ("mine", "my photographs", "MIT")
    assert [(f.dataset, f.bytes, f.recall_at_1) for f in card.figures] == [("town_1", 12, 0.75)]
    capsys.readouterr()
    assert main(["netvlad", "info", str(model)]) == 0
    assert "town_1" in capsys.readouterr().out
    for wrong, said in (
        (["--input-pixels", "9"], "has a card that says what it takes"),
        (["--figures", str(model)], "not what `maslam netvlad eval --json` prints"),
        (["--figures", str(tmp_path / "none.json")], "No such file"),
        (["--figures", str(tmp_path / "e.json"), "--name", "other"], "no row about netvlad:other"),
    ):
        assert main([*words, *wrong]) == 1
        assert said in capsys.readouterr().err


def _round_trip(folder: Path, places: int = 40, laps: int = 2) -> Path:
    """A drive around a block whose every place is another picture, so often; metres, ten images a second."""
    (folder / "image_0").mkdir(parents=True)
    poses = np.tile(np.eye(4), (places * laps, 1, 1))
    for k in range(places * laps):
        angle = 2 * np.pi * (k % places) / places
        poses[k, 0, 3], poses[k, 2, 3] = 30 * np.cos(angle), 30 * np.sin(angle)
        view = textured_image(k % places, 60, 80)
        noise = np.random.default_rng(k).normal(0, 3, view.shape)
        cv2.imwrite(str(folder / "image_0" / f"{k:03d}.png"), np.clip(view + noise, 0, 255).astype(np.uint8))
    (folder / "camera.yaml").write_text("{width: 80, height: 60, fx: 70, fy: 70, cx: 39.5, cy: 29.5, rate_hz: 1}\n")
    write_kitti_poses(folder / "poses.txt", poses)
    return folder


def test_thresholds_come_from_ones_own_drive(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    drive, out = _round_trip(tmp_path / "block"), tmp_path / "mine.onnx"
    before = (MODELS / "default.json").read_bytes()
    words = ["netvlad", "calibrate", "default", "--sequence", str(drive), "--apart", "20", "--radius", "2", "--quiet"]
    assert main([*words, "--out", str(out)]) == 0
    shown = capsys.readouterr().out
    assert str(out.with_suffix(".json")) in shown and "strict, block alone (40 of" in shown
    assert "40 matches stand at the strict threshold; a precision of 0.99 takes 100 to tell" in shown
    assert (MODELS / "default.json").read_bytes() == before
    _, card = read_card(out)
    assert card.sha256 == read_card("default")[1].sha256, "vectors of both may be compared"
    assert codebooks_path(out).is_file() == codebooks_path(MODELS / "default.onnx").is_file()
    assert card.calibration is not None and "own sequences block" in card.calibration.data
    # Every place is another picture: all revisits are found, and nothing else is taken for one.
    assert card.calibration.strict.precision == card.calibration.strict.recall == 1.0
    one = card.calibration.sets[0]
    assert (one.findable, one.queries) == (40, 60), "frames of the first 20 seconds have nothing to be compared with"
    assert main([*words, "--out", str(out), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["strict"]["recall"] == 1.0


def test_calibration_that_cannot_be_is_said(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    once = _round_trip(tmp_path / "once", places=12, laps=1)
    words = ["netvlad", "calibrate", "default", "--sequence", str(once), "--out", str(tmp_path / "m.onnx"), "--quiet"]
    assert main(words) == 1
    assert "no place is visited again within 5 m and 30 degrees" in capsys.readouterr().err
    (once / "poses.txt").unlink()
    assert main(words) == 1
    assert "no ground truth" in capsys.readouterr().err
    assert main(["netvlad", "calibrate", "default", "--quiet"]) == 2
    assert "a shipped model keeps the card it came with; --out FILE.onnx" in capsys.readouterr().err
    assert main([*words[:-2], str(tmp_path / "m.json"), "--quiet"]) == 2
    assert not (tmp_path / "m.onnx").exists()
