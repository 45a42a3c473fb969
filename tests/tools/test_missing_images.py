"""An image missing from a numbered folder, from `inspect` to the report's coverage."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest

from maslam.frontend.files.trajectory import read_tum
from maslam.tools import cli

SAID = "3 images missing by the numbers in the file names: 000005, 000014 to 000015"


def test_missing_images_are_said_by_every_command(
    town_stereo: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    drive, seqs, run = tmp_path / "drive", tmp_path / "seqs", tmp_path / "run"
    shutil.copytree(town_stereo / "agent_00" / "image_0", drive / "image_0")
    shutil.copy(town_stereo / "agent_00" / "camera.yaml", drive)
    camera = (drive / "camera.yaml").read_text().splitlines()
    (drive / "camera.yaml").write_text("\n".join(line for line in camera if "baseline" not in line) + "\n")
    for number in (5, 14, 15):
        (drive / "image_0" / f"{number:06d}.png").unlink()
    assert cli.main(["inspect", str(drive)]) == 0
    assert sum(SAID in line for line in capsys.readouterr().out.splitlines()) == 1
    assert cli.main(["preprocess", str(drive), str(seqs), "--workers", "1", "--agents", "2"]) == 0
    assert sum(SAID in line for line in capsys.readouterr().err.splitlines()) == 1
    # Ten frames a second, of which three are missing: the last of the seventeen is the twentieth.
    last_s = read_tum(seqs / "agent_01" / "trajectory.tum").stamps_ns[-1] / 1e9
    assert last_s == pytest.approx(0.1 * (19 - 10))
    assert cli.main(["run", str(seqs), str(run), "--quiet"]) == 0
    console = capsys.readouterr().out
    assert "agent_00: 1 image missing by the numbers in the file names: 000005" in console
    assert "agent_01: 2 images missing by the numbers in the file names: 000014 to 000015" in console
    coverage = json.loads((run / "summary.json").read_text())["coverage"]
    assert [sum(m["count"] for m in c["missing"]) for c in coverage] == [1, 2]
    assert [c["read"] for c in coverage] == [9, 8]
    assert cli.main(["report", str(run)]) == 0
    assert "1 image missing by the numbers in the file names: 000005" in (run / "report" / "index.html").read_text()
