"""``maslam vocabulary train`` and ``info``."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from maslam.frontend.vocabulary.vocabulary import Vocabulary
from maslam.tools.cli import main


@pytest.fixture
def pictures(tmp_path: Path) -> Path:
    rng = np.random.default_rng(0)
    for name in ("a/one.png", "a/two.png", "a/depth_0/three.png", "b.jpg"):
        path = tmp_path / "pictures" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        blocks = rng.integers(0, 255, (30, 40)).astype(np.uint8)
        cv2.imwrite(str(path), cv2.resize(blocks, (320, 240), interpolation=cv2.INTER_NEAREST))
    return tmp_path / "pictures"


def test_train_and_info(pictures: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = ["vocabulary", "train", "--branching", "4", "--depth", "3", "--seed", "5", "--quiet"]
    for name in ("one.npz", "two.npz", "voc.txt"):
        assert main([*words, str(tmp_path / name), str(pictures)]) == 0
    assert "3 images" in capsys.readouterr().err  # the depth image is none
    assert (tmp_path / "one.npz").read_bytes() == (tmp_path / "two.npz").read_bytes()
    first, text = Vocabulary.load(tmp_path / "one.npz"), Vocabulary.load(tmp_path / "voc.txt")
    np.testing.assert_array_equal(first.parents, text.parents)
    assert main(["vocabulary", "info", str(tmp_path / "voc.txt")]) == 0
    printed = capsys.readouterr().out
    assert "branching 4, depth 3" in printed and "level 1: 4 nodes, 0 of them words" in printed
    assert main(["vocabulary", "info"]) == 0


def test_what_cannot_be_trained(pictures: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "nothing").mkdir()
    assert main(["vocabulary", "train", str(tmp_path / "v.npz"), str(tmp_path / "nothing"), "--quiet"]) == 1
    assert "too few for a vocabulary" in capsys.readouterr().err
    assert main(["vocabulary", "train", str(tmp_path / "v.npz"), str(tmp_path / "nowhere"), "--quiet"]) == 1
    assert "no such folder" in capsys.readouterr().err
    assert main(["vocabulary", "train", str(tmp_path / "v.npz"), str(pictures), "--branching", "1", "--quiet"]) == 1
    assert not (tmp_path / "v.npz").exists()
