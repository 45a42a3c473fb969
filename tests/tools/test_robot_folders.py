"""Robots under any names, masks and deep images from the command line: what was understood is said, and kept."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from maslam.mas.manifest import read_manifest
from maslam.tools import cli
from tests.tools.test_preprocess import known_front_end, preprocess, write_agent

__all__ = ["known_front_end"]  # a fixture


def test_robots_keep_their_names(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Case 21."""
    for name in ("Alice", "Bob"):
        write_agent(tmp_path / "src" / name)
    assert preprocess(tmp_path / "src", tmp_path / "out") == 0
    manifest = read_manifest(tmp_path / "out")
    assert [(agent.name, agent.sequence) for agent in manifest.agents] == [("agent_00", "Alice"), ("agent_01", "Bob")]
    assert (tmp_path / "out/agent_01").is_dir()
    line = "a robot for each of 2 folders: Alice, Bob"
    assert manifest.settings["notes"] == [line]
    assert f"note: {line}" in capsys.readouterr().err
    assert cli.main(["inspect", str(tmp_path / "src"), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["notes"] == [line]


def test_recordings_become_robots_by_an_option_or_a_file(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for name in ("seq-01", "seq-02"):
        write_agent(tmp_path / "src" / name)
    assert preprocess(tmp_path / "src", tmp_path / "out") == 1
    assert "name one of them, or take each as a robot: --images.robots true" in capsys.readouterr().err
    assert preprocess(tmp_path / "src", tmp_path / "out", "--images.robots", "true") == 0
    (tmp_path / "settings.yaml").write_text("images: {robots: true}\n")
    assert preprocess(tmp_path / "src", tmp_path / "more", "--config", tmp_path / "settings.yaml") == 0
    for out in ("out", "more"):
        manifest = read_manifest(tmp_path / out)
        assert [agent.sequence for agent in manifest.agents] == ["seq-01", "seq-02"]
        assert manifest.settings["images"]["robots"] is True


def test_masks_are_said_and_belong_to_the_fingerprint(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    source = write_agent(tmp_path / "src")
    first = next(path for path in sorted(source.rglob("*.png")))
    height, width = cv2.imread(str(first), cv2.IMREAD_GRAYSCALE).shape
    mask = np.full((height, width), 255, np.uint8)
    mask[: height // 4] = 0
    assert cv2.imwrite(str(tmp_path / "robot.png"), mask)
    assert preprocess(source, tmp_path / "out") == 0
    assert "masks" not in capsys.readouterr().err
    options = ("--images.masks", tmp_path / "robot.png")
    assert preprocess(source, tmp_path / "out", *options) == 1
    assert "other settings (images.masks)" in capsys.readouterr().err
    assert preprocess(source, tmp_path / "out", "--overwrite", *options) == 0
    said = capsys.readouterr().err
    assert "robot.png: masks every image; 25.0 % of the pixels give no points" in said
    assert cli.main(["inspect", str(source), *map(str, options)]) == 0
    assert "masks every image" in capsys.readouterr().out
    nowhere = tmp_path / "nowhere.png"
    assert preprocess(source, tmp_path / "out", "--overwrite", "--images.masks", nowhere) == 1
    assert "nowhere.png: no such mask" in capsys.readouterr().err
