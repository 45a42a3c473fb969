"""What commands print with ``--json``: one object, nothing beside it, with what a program needs to believe a figure."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from maslam.frontend.files.trajectory import read_tum
from maslam.tools import cli


def printed(capsys: pytest.CaptureFixture[str], *words: object, code: int = 0) -> dict[str, Any]:
    capsys.readouterr()
    assert cli.main([*map(str, words), "--json"]) == code
    found = json.loads(capsys.readouterr().out)
    assert isinstance(found, dict)
    return found


def test_a_run_says_what_its_figures_are_of(
    town_stereo: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    images = [len(list((town_stereo / f"agent_0{a}" / "image_0").iterdir())) for a in range(2)]
    out, again = tmp_path / "out", tmp_path / "again"
    found = printed(capsys, "slam", town_stereo, out, "--workers", "1")
    assert found == json.loads((out / "summary.json").read_text()) == printed(capsys, "eval", out)
    assert [c["read"] for c in found["coverage"]] == images
    for number, one in enumerate(found["coverage"]):
        lost = sum(entry["last_frame"] - entry["first_frame"] + 1 for entry in one["lost"])
        assert one["tracked"] + lost == one["read"] and one["missing"] == []
        placed = len(read_tum(out / f"agent_0{number}" / "trajectory.tum"))
        assert one["placed"] == placed == found["alignments"]["agents"][number]["frames"]
        assert found["alignments"]["odometry"][number]["frames"] == placed
    for column in ("agents", "odometry", "maps", "connected"):
        assert {(a["kind"], a["scale"]) for a in found["alignments"][column]} == {("SE(3)", 1.0)}
    assert found["left_out"] == [] and found["one_frame"]["of"] == 2
    for graph in found["graphs"]:
        assert graph["cost"] >= 0.0 and graph["dof"] >= 0 and isinstance(graph["fits"], bool)
        edges = [(out / f"agent_0{a}" / "graph.g2o").read_text().count("EDGE") for a in graph["agents"]]
        assert max(edges) <= graph["edges"] <= sum(edges)
    ran = printed(capsys, "run", out / "sequences", again)
    assert ran == json.loads((again / "summary.json").read_text()) and ran["coverage"] == found["coverage"]


def test_preprocessing_and_inspection(town_stereo: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    looked = printed(capsys, "inspect", town_stereo)
    assert (looked["frames"], looked["errors"], looked["sequences"][1]["kind"]) == (40, 0, "images")
    one = looked["sequences"][0]
    assert (one["name"], one["frames"], one["rig"], one["scale"], one["missing"]) == (
        "agent_00",
        20,
        "stereo",
        "metric",
        [],
    )
    assert (one["camera"]["width"], one["camera"]["height"]) == (320, 180) and one["rate_hz"] == pytest.approx(10.0)
    made = printed(capsys, "preprocess", town_stereo, tmp_path / "seqs", "--workers", "1")
    assert made == json.loads((tmp_path / "seqs" / "manifest.json").read_text())
    assert [agent["frames"] for agent in made["agents"]] == [20, 20]


def test_a_fault_is_in_the_object_and_in_the_exit_code(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    import cv2
    import numpy as np

    rng = np.random.default_rng(0)
    for number in (0, 1, 2, 4):
        cv2.imwrite(str(tmp_path / f"{number}.png"), rng.integers(0, 255, (24, 32), dtype=np.uint8))
    (tmp_path / "camera.yaml").write_text("{width: 48, height: 24, fx: 30, fy: 30, cx: 15.5, cy: 11.5, rate_hz: 10}\n")
    looked = printed(capsys, "inspect", tmp_path, code=1)
    (one,) = looked["sequences"]
    assert one["missing"] == [{"after": 2, "first": "3", "last": "3", "count": 1}]
    found = {problem["severity"]: problem["message"] for problem in one["problems"]}
    assert "calibration for 48x24" in found["error"] and "1 image missing" in found["warning"]
    assert looked["errors"] == 1
