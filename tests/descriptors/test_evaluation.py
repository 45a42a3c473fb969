"""``maslam netvlad eval`` from the outside: foreign networks, chosen sets and methods, records, pictures."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from maslam.descriptors.card import Calibration, OperatingPoint, SetCurve
from maslam.descriptors.codes import Coder
from maslam.descriptors.errors import DescriptorError
from maslam.tools.cli import main
from maslam.tools.common.errors import ToolError
from maslam.tools.netvlad.foreign_model import InputForm, load_model
from maslam.tools.netvlad.methods import Method, coded, netvlad_methods
from maslam.tools.netvlad.score_figures import draw_evaluation, examples
from maslam.tools.netvlad.scores import evaluate
from maslam.tools.netvlad.training_figures import calibration_picture, training_picture
from maslam.tools.place_benchmarks.public_sets import PlaceBenchmark
from maslam.tools.place_benchmarks.rendered import HELD_OUT_SEEDS, cache_path, config_for, save_places
from tests.descriptors.test_benchmarks import _street
from tests.descriptors.test_posed import LAP, _drive


def _network(path: Path, channels: int, shape: tuple[Any, Any], kind: str = "FLOAT", rank: int = 2) -> Path:
    """A graph that gives the mean of each channel, after a cast where it takes bytes."""
    onnx = pytest.importorskip("onnx")
    helper, types = onnx.helper, onnx.TensorProto
    given = helper.make_tensor_value_info("pixels", getattr(types, kind), ["n", channels, *shape])
    made = helper.make_tensor_value_info("mean", types.FLOAT, None)
    nodes = [
        helper.make_node("Cast", ["pixels"], ["x"], to=types.FLOAT),
        helper.make_node("ReduceMean", ["x"], ["mean"], axes=[2, 3], keepdims=int(rank == 4)),
    ]
    graph = helper.make_graph(nodes, "means", [given], [made])
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 13)], ir_version=8)
    onnx.save(model, str(path))
    return path


COLOURS = ((200, 100, 90), (90, 140, 130), (60, 75, 190), (139, 119, 103), (0, 0, 1), (9, 0, 0))


def _flat(blue: int, green: int, red: int) -> NDArray[np.uint8]:
    return np.full((40, 60, 3), (blue, green, red), dtype=np.uint8)


@pytest.mark.parametrize(("kind", "shape"), [("FLOAT", ("h", "w")), ("UINT8", ("h", "w")), ("FLOAT", (30, 50))])
def test_a_bare_colour_network_gets_red_green_blue(tmp_path: Path, kind: str, shape: tuple[Any, Any]) -> None:
    net = load_model(str(_network(tmp_path / "bare.onnx", 3, shape, kind)))
    assert (net.name, net.dim, net.colour) == ("bare", 3, True)
    expected = np.array([30.0, 20.0, 10.0]) / np.linalg.norm([30.0, 20.0, 10.0])
    np.testing.assert_allclose(net.describe([_flat(10, 20, 30)])[0], expected, atol=1e-5)


def test_mean_and_deviation_are_taken_off_as_said(tmp_path: Path) -> None:
    path = str(_network(tmp_path / "bare.onnx", 3, ("h", "w")))
    net = load_model(path, InputForm(pixels=2400, mean=(10.0, 0.0, 0.0), std=(2.0, 1.0, 4.0)))
    expected = np.array([10.0, 20.0, 2.5])  # (30 - 10) / 2, 20, 10 / 4
    np.testing.assert_allclose(net.describe([_flat(10, 20, 30)])[0], expected / np.linalg.norm(expected), atol=1e-5)


def test_a_network_that_is_no_descriptor_is_said(tmp_path: Path) -> None:
    cases = [
        (_network(tmp_path / "a.onnx", 5, ("h", "w")), InputForm(), "takes 5 channels, images have 1"),
        (_network(tmp_path / "b.onnx", 1, (30, 50)), InputForm(size=(60, 100)), "50x30 alone, not 100x60"),
        (_network(tmp_path / "c.onnx", 1, ("h", "w")), InputForm(mean=(1.0, 2.0)), "1 channels, but 2 numbers"),
        (_network(tmp_path / "d.onnx", 1, ("h", "w"), rank=4), InputForm(), r"makes \(1, 1, 1, 1\) of one image"),
        (tmp_path / "none.onnx", InputForm(), "no such file"),
    ]
    for path, form, message in cases:
        with pytest.raises(ToolError, match=message):
            load_model(str(path), form)
    (tmp_path / "bad.onnx").write_bytes(b"no network")
    with pytest.raises(DescriptorError, match="onnxruntime cannot load it"):
        load_model(str(tmp_path / "bad.onnx"))
    with pytest.raises(ToolError, match="has a card that says what it takes"):
        load_model("default", InputForm(pixels=100))


@pytest.fixture
def cache(tmp_path: Path) -> Path:
    """A held-out town of twelve places before a wall, as if it had been rendered."""
    config = config_for("town").model_copy(update={"places": 12})
    save_places(cache_path(tmp_path, "town", HELD_OUT_SEEDS, config), _street(12))
    return tmp_path


def test_the_command_ranks_a_bare_network_beside_ours(cache: Path, capsys: pytest.CaptureFixture[str]) -> None:
    _drive(cache / "street", 2)
    model = _network(cache / "mine.onnx", 1, ("h", "w"), "UINT8")
    options = [
        *("--model", "default", "--model", str(model), "--input-pixels", "1000"),
        *("--methods", "netvlad,bag-of-words", "--sequence", str(cache / "street"), "--apart", "10", "--radius", "1"),
        *("--data", str(cache), "--cache", str(cache), "--worlds", "1", "--places", "12", "--kinds", "town", "--quiet"),
    ]
    # The shipped model has a card: options for bare files do not belong to it.
    assert main(["netvlad", "eval", *options, "--json"]) == 1
    assert "has a card" in capsys.readouterr().err
    del options[options.index("--input-pixels") : options.index("--input-pixels") + 2]
    assert main(["netvlad", "eval", *options, "--json", "--out", str(cache / "pictures")]) == 0
    records = json.loads(capsys.readouterr().out)
    keys = ["dataset", "method", "code", "bytes", "queries", "recall_at_1", "recall_at_5", "ap", "ms"]
    assert all(list(record) == keys for record in records)
    assert json.loads((cache / "pictures" / "scores.json").read_text()) == records
    assert list(dict.fromkeys(r["dataset"] for r in records)) == ["street", "town_9500"]
    methods = list(dict.fromkeys(r["method"] for r in records))
    assert methods[0].startswith("netvlad:") and methods[1:] == ["onnx:mine", "bag-of-words"]
    ours = [r for r in records if r["method"] == methods[0]]
    assert all(r["recall_at_1"] == 1.0 for r in ours if r["code"] in ("float32", "int8"))  # the pictures are the same
    assert {r["queries"] for r in records if r["dataset"] == "street"} == {LAP}
    for name in ("town_9500.png", "street.png", "bytes.png"):
        picture = cv2.imread(str(cache / "pictures" / name))
        assert picture is not None and picture.shape[1] > 300 and picture.std() > 10


def test_wishes_that_cannot_be_met_are_usage_errors(cache: Path, capsys: pytest.CaptureFixture[str]) -> None:
    base = ["netvlad", "eval", "--data", str(cache), "--cache", str(cache), "--quiet"]
    for wish, message in (
        (["--methods", "magic"], "--methods magic: not one of netvlad"),
        (["--sets", "moon_1"], "--sets moon_1: not one of"),
        (["--input-size", "320"], "--input-size 320: width and height in pixels"),
        (["--input-mean", "a,b"], "--input-mean a,b: expected numbers"),
    ):
        few = ["--worlds", "1", "--places", "12", "--kinds", "town"]
        assert main([*base, *few, *wish]) == 2
        assert message in capsys.readouterr().err
    assert main([*base, "--worlds", "0", "--sequence", str(cache / "nowhere")]) == 1
    few = ["--worlds", "1", "--places", "12", "--kinds", "town", "--methods", "rootsift-vlad", "--fit-worlds", "0"]
    assert main([*base, *few]) == 1
    assert "no photographs to fit the baselines on" in capsys.readouterr().err


def _by_number() -> tuple[Method, PlaceBenchmark]:
    """Images that are numbers on a half circle; the method reads them."""

    def describe(image: NDArray[np.uint8]) -> NDArray[np.float32]:
        angle = np.pi * float(image[0, 0]) / 255
        return np.array([np.cos(angle), np.sin(angle)], dtype=np.float32)

    levels = ([10, 60, 110, 160, 210], [12, 64, 118, 180, 130])
    references, queries = ([np.full((8, 8), n, dtype=np.uint8) for n in side] for side in levels)
    truth = np.eye(5, dtype=bool)
    truth[3], truth[4] = np.arange(5) == 4, False  # 180 answers 160 and is 210's place; 130 has no place to find
    method = Method("levels", describe, (coded(Coder.make("float32", 2, "", None)),))
    return method, PlaceBenchmark("line", queries, references, truth)


def test_hits_and_misses_are_told_apart() -> None:
    method, made = _by_number()
    (evaluation,) = evaluate(method, made)
    assert evaluation.score.queries == 4
    hits, misses = examples(made, evaluation)
    assert hits == [0, 1, 2]  # 2, 4 and 8 levels off: the surest first
    assert misses == [3]


def test_barred_answers_are_never_given() -> None:
    method, made = _by_number()
    barred = np.zeros((5, 5), dtype=bool)
    barred[3, 3] = True
    (evaluation,) = evaluate(method, PlaceBenchmark("line", made.queries, made.references, made.truth, barred=barred))
    assert evaluation.score.recall_at_1 == 1.0
    assert np.isinf(evaluation.distances[3, 3])


def test_the_same_evaluation_gives_the_same_pictures(tmp_path: Path) -> None:
    method, made = _by_number()
    results = [evaluate(method, made)]
    first, second = (draw_evaluation([made], results, tmp_path / name) for name in ("a", "b"))
    assert [p.name for p in first] == ["line.png", "bytes.png", "scores.json"]
    assert all(a.read_bytes() == b.read_bytes() for a, b in zip(first, second, strict=True))


def test_a_colour_network_sees_colours_of_real_sets(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = _network(tmp_path / "colours.onnx", 3, ("h", "w"), "UINT8")
    for side in ("gt", "query"):
        (tmp_path / "places_gardenspoint" / side).mkdir(parents=True)
        for k, colour in enumerate(COLOURS):
            cv2.imwrite(str(tmp_path / "places_gardenspoint" / side / f"{k}.png"), _flat(*colour))
    wanted = ["--model", str(path), "--methods", "netvlad", "--worlds", "0", "--data", str(tmp_path)]
    assert main(["netvlad", "eval", *wanted, "--json", "--quiet"]) == 0
    assert {r["recall_at_1"] for r in json.loads(capsys.readouterr().out)} == {1.0}
    first, second = netvlad_methods([load_model(str(path)), load_model(str(path))])
    assert first.colour and first.name == second.name  # the same weights have the same name
    assert first.name.startswith("onnx:colours@")


def _point(distance: float, precision: float, recall: float) -> OperatingPoint:
    return OperatingPoint(distance=distance, precision=precision, recall=recall)


def test_pictures_of_making_are_drawn(tmp_path: Path) -> None:
    curve = (_point(0.4, 1.0, 0.1), _point(0.8, 0.9, 0.6), _point(1.2, 0.5, 0.9))
    sets = (SetCurve(name="town", queries=10, findable=8, curve=curve), SetCurve(name="bare", queries=1, findable=0))
    calibration = Calibration(data="made up", queries=10, strict=curve[0], candidate=curve[1], curve=curve, sets=sets)
    calibration_picture(calibration, "model", tmp_path / "calibration.png")
    log = tmp_path / "log.jsonl"
    rows = [{"step": 50 * k, "loss": 3.0 / k, "right": 0.1 * k, "scale": 10.0} for k in range(1, 6)]
    rows[1]["indoor"], rows[3]["indoor"] = 0.5, 0.7
    log.write_text("".join(json.dumps(row) + "\n" for row in [*rows[:3], *rows[1:]]))
    training_picture(log, tmp_path / "training.png")
    for name in ("calibration.png", "training.png"):
        picture = cv2.imread(str(tmp_path / name))
        assert picture is not None and picture.shape[1] > 800 and picture.std() > 10
    log.write_text('{"step": 50, "loss": 1.0}\n')
    with pytest.raises(ToolError, match=r"log\.jsonl:1: not a line of a training's log"):
        training_picture(log, tmp_path / "training.png")
    with pytest.raises(ToolError, match="no such file"):
        training_picture(tmp_path / "none.jsonl", tmp_path / "training.png")
