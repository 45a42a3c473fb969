"""Graphs of other makers, small enough that what must come out can be said by hand; and all that can be wrong with
one."""

from __future__ import annotations

import ast
import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from maslam.descriptors.card import read_card
from maslam.descriptors.errors import DescriptorError
from maslam.descriptors.inference import NetVlad
from maslam.descriptors.session import available_providers, find_provider
from tests.descriptors.conftest import textured_image, tiny_model

ROOT = Path(__file__).resolve().parents[2]


def _one_colour(blue: int, green: int, red: int, size: tuple[int, int] = (40, 60)) -> NDArray[np.uint8]:
    return np.full((*size, 3), (blue, green, red), dtype=np.uint8)


def test_a_colour_network_gets_red_green_blue(tmp_path: Path) -> None:
    net = NetVlad.load(tiny_model(tmp_path / "c.onnx", channels=3))
    red_heavy = np.array([30.0, 20.0, 10.0])
    np.testing.assert_allclose(
        net.describe([_one_colour(10, 20, 30)])[0], red_heavy / np.linalg.norm(red_heavy), rtol=1e-5
    )
    np.testing.assert_allclose(net.describe([np.full((40, 60), 90, dtype=np.uint8)])[0], np.sqrt(1 / 3), rtol=1e-5)


def test_float_graphs_get_the_levels_standardised_as_their_card_says(tmp_path: Path) -> None:
    card = {"mean": [100.0, 50.0, 20.0], "std": [10.0, 5.0, 2.0]}
    net = NetVlad.load(tiny_model(tmp_path / "f.onnx", channels=3, floats=True, card=card))
    wanted = (np.array([130.0, 90.0, 24.0]) - card["mean"]) / card["std"]
    np.testing.assert_allclose(net.describe([_one_colour(24, 90, 130)])[0], wanted / np.linalg.norm(wanted), rtol=1e-5)
    bare = NetVlad.load(tiny_model(tmp_path / "bare.onnx", channels=3, floats=True))
    np.testing.assert_allclose(bare.describe([_one_colour(0, 40, 30)])[0], np.array([0.6, 0.8, 0.0]), atol=1e-6)


def test_texture_of_a_colour_image_is_that_of_its_grey_one(tmp_path: Path) -> None:
    net = NetVlad.load(tiny_model(tmp_path / "c.onnx", channels=3, card={"input_pixels": 19_200}))
    grey = textured_image(4)
    wall = _one_colour(200, 10, 60, (120, 160))
    images = [cv2.cvtColor(grey, cv2.COLOR_GRAY2BGR), wall]
    assert net.textured(images).tolist() == net.look(images)[1].tolist() == [True, False]


def test_rigid_graphs_get_their_one_size(tmp_path: Path) -> None:
    path = tiny_model(tmp_path / "r.onnx", size=(24, 32), card={"input_size": [24, 32]})
    np.testing.assert_allclose(NetVlad.load(path).describe([textured_image(1)]), 1.0, atol=1e-6)
    with pytest.raises(DescriptorError, match=r"r\.onnx: takes images of height 24 alone; its card's input_size says"):
        NetVlad.load(tiny_model(tmp_path / "r.onnx", size=(24, 32)))


def test_batches_hold_neighbours_of_one_size_and_lose_nobody(tmp_path: Path) -> None:
    sizes = [(40, 60)] * 5 + [(60, 40)] * 2 + [(40, 60)] * 3
    images = [_one_colour(10 * k, 7 * k, 255 - 20 * k, size) for k, size in enumerate(sizes)]
    path = tiny_model(tmp_path / "c.onnx", channels=3)
    alone = NetVlad.load(path).describe(images)
    for batch in (2, 4, 100):
        np.testing.assert_allclose(NetVlad.load(path, batch=batch).describe(images), alone, atol=1e-6)


@pytest.mark.parametrize(
    ("made", "said"),
    [
        ({"inputs": 2}, r"takes 2 inputs \(images, more_1\), a place descriptor takes one"),
        ({"channels": 3, "card": {"colour": False}}, "takes 3 channels, its card says grey"),
        ({"channels": 1, "card": {"colour": True}}, "takes 1 channels, its card says colour"),
        ({"card": {"dim": 2}}, r"makes an output of shape \['n', 1\], its card says \(N, 2\)"),
    ],
)
def test_a_graph_that_is_not_what_its_card_says_does_not_load(tmp_path: Path, made: dict[str, Any], said: str) -> None:
    with pytest.raises(DescriptorError, match=said) as caught:
        NetVlad.load(tiny_model(tmp_path / "m.onnx", **made))
    assert str(caught.value).startswith(f"{tmp_path / 'm.onnx'}: ")
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("scale", [np.nan, np.inf])
def test_vectors_that_are_not_finite_are_an_error(tmp_path: Path, scale: float) -> None:
    with pytest.raises(DescriptorError, match="makes vectors that are not finite"):
        NetVlad.load(tiny_model(tmp_path / "m.onnx", scale=scale)).describe([textured_image(0)])


def test_a_cut_file_is_an_error_in_one_line(tmp_path: Path) -> None:
    path, card = tiny_model(tmp_path / "m.onnx"), tmp_path / "m.json"
    path.write_bytes(path.read_bytes()[:-40])
    with pytest.raises(DescriptorError, match="SHA-256 differs"):
        NetVlad.load(path)
    from maslam.descriptors.card import file_sha256

    card.write_text(json.dumps(json.loads(card.read_text()) | {"sha256": file_sha256(path)}))
    with pytest.raises(DescriptorError, match="onnxruntime cannot load it") as caught:
        NetVlad.load(path)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"mean": [1.0, 2.0, 3.0]}, "mean has 3 values for 1 channels"),
        ({"candidate_threshold": 0.1}, "candidate_threshold 0.1 is under threshold 0.5"),
        ({"input_size": [0, 3]}, "input_size.0: Input should be greater than 0"),
        ({"dim": "many"}, "dim: Input should be a valid integer"),
    ],
)
def test_cards_that_contradict_themselves_are_said(tmp_path: Path, change: dict[str, Any], said: str) -> None:
    path, card = tiny_model(tmp_path / "m.onnx"), tmp_path / "m.json"
    card.write_text(json.dumps(json.loads(card.read_text()) | change))
    with pytest.raises(DescriptorError, match=said):
        read_card(path)
    card.write_text("{")
    with pytest.raises(DescriptorError, match=r"m\.json: the card: Invalid JSON"):
        read_card(path)


def test_providers_are_found_by_either_name_and_unknown_ones_said_with_what_there_is() -> None:
    assert available_providers()[0] == find_provider("cpu") == find_provider("cpuexecutionprovider")
    with pytest.raises(DescriptorError, match=r"onnxruntime has no provider 'Abacus' here, only: CPU"):
        NetVlad.load(provider="Abacus")
    with pytest.raises(DescriptorError, match="at least 1 image in a batch, got 0"):
        NetVlad.load(batch=0)


def _written_at_home(code: str, home: Path, **environment: str) -> list[str]:
    """Files below the home directory after ``code`` ran in a process of its own."""
    home.mkdir(exist_ok=True)
    unset = ("ORT_DISABLE_TELEMETRY", "XDG_CACHE_HOME")
    kept = {name: value for name, value in os.environ.items() if name not in unset}
    paths = {"HOME": str(home), "TMPDIR": str(home), "PYTHONPATH": str(ROOT), "MPLCONFIGDIR": str(home.parent)}
    done = subprocess.run(
        [sys.executable, "-c", code], env={**kept, **paths, **environment}, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    return sorted(str(path.relative_to(home)) for path in home.rglob("*") if path.is_file())


@pytest.mark.parametrize(
    "code",
    [
        "from maslam.descriptors.inference import NetVlad; NetVlad.load('default')",
        "from maslam.tools.cli import main; assert main(['doctor']) == 0",
    ],
)
def test_onnxruntime_reports_nothing_about_its_user(code: str, tmp_path: Path) -> None:
    """With its telemetry on it would write an identifier of the machine and a data base of events there."""
    assert _written_at_home(code, tmp_path / "home") == []


def test_who_has_set_telemetry_keeps_it() -> None:
    code = (
        "import os; from maslam.descriptors.session import load_onnxruntime as load; load(); print(os.environ[{0!r}])"
    )
    done = subprocess.run(
        [sys.executable, "-c", code.format("ORT_DISABLE_TELEMETRY")],
        env={**os.environ, "ORT_DISABLE_TELEMETRY": "true", "PYTHONPATH": str(ROOT)},
        capture_output=True, text=True, check=True,
    )  # fmt: skip
    assert done.stdout.strip() == "true"


def test_onnxruntime_is_imported_in_one_place() -> None:
    places = [
        str(path.relative_to(ROOT))
        for package in ("backend", "frontend", "descriptors", "mas", "tools")
        for path in sorted((ROOT / package).rglob("*.py"))
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if (isinstance(node, ast.Import) and any(name.name.startswith("onnxruntime") for name in node.names))
        or (isinstance(node, ast.ImportFrom) and (node.module or "").startswith("onnxruntime"))
    ]
    assert places == ["descriptors/session.py"]
