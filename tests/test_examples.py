"""The examples run, on small images, and are typed: nothing that the face gives them is ``Any``."""

from __future__ import annotations

import csv
import json
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
EXAMPLES = sorted((ROOT / "examples").glob("[0-9]*.py"))
pytestmark = pytest.mark.slow

REVEALED = """
import maslam

run = maslam.slam("images", "out", agents=4, preset="maslam", seed=0, settings={"places.threshold": 0.8})
reveal_type(run)
reveal_type(run.summary.ate_rmse_m.mean_agents)
reveal_type(run.summary.traffic["total"].wire_bytes)
reveal_type(run.timing.wall_s)
reveal_type(run.folder)
reveal_type(run.config.places.threshold)
reveal_type(run.agents[0].trajectory.poses)
reveal_type(run.trajectories)
reveal_type(run.matches[0].T_M_Q)
reveal_type(run.timeline)
sequences = maslam.preprocess("images", "out")
reveal_type(sequences.agents[0].keyframes)
reveal_type(sequences.read()[0].tracks)
reveal_type(maslam.run(sequences, "out", policy="directory"))
reveal_type(maslam.evaluate(run))
sequence = maslam.open_dataset("images").sequences[0]
odometry = maslam.Odometry(sequence.rig)
reveal_type([odometry.process(frame).T_W_C for frame in sequence.frames()])
trajectory = odometry.finish().trajectories[0]
reveal_type(maslam.evaluate(trajectory, trajectory).rmse_m)
reveal_type(maslam.NetVlad.load().describe([sequence.read_image(0)]))
reveal_type(maslam.optimise(maslam.read_g2o("a.g2o")).cost_after)
reveal_type(maslam.optimise_distributed(maslam.read_g2o("a.g2o")).traffic.wire_bytes)
reveal_type(maslam.preset("maslam").seed)
reveal_type(maslam.__version__)
"""
OF_NUMPY = re.compile(r"tuple\[Any, \.\.\.\]|dtype\[Any\]")
"""Shapes, which nothing knows."""


def run_example(name: str, *words: object) -> str:
    (path,) = (one for one in EXAMPLES if one.name.startswith(name))
    done = subprocess.run(
        [sys.executable, str(path), *map(str, words)], capture_output=True, text=True, timeout=600, check=False
    )
    assert done.returncode == 0, done.stderr
    assert done.stderr == ""
    return done.stdout


def strictly_typed(*files: Path) -> subprocess.CompletedProcess[str]:
    """As at a user's, who has none of our settings."""
    words = ["--strict", "--disallow-any-unimported", "--disallow-any-decorated", "--config-file="]
    cache = f"--cache-dir={ROOT / '.mypy_cache' / 'strict'}"
    return subprocess.run(
        [sys.executable, "-m", "mypy", *words, "--follow-imports=silent", cache, *map(str, files)],
        cwd=ROOT, capture_output=True, text=True, check=False,
    )  # fmt: skip


@pytest.fixture(scope="module")
def first(town_stereo: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What the first example makes."""
    out = tmp_path_factory.mktemp("examples") / "first"
    said = run_example("01", town_stereo, out)
    assert "1 group(s)" in said and "agent_01: 20 poses" in said and "ATE 0." in said
    return out


def test_numbers_are_those_of_the_list() -> None:
    listed = re.findall(r"`(\d\d_\w+\.py)", (ROOT / "examples" / "README.md").read_text())
    assert [path.name for path in EXAMPLES] == listed and len(listed) == 6


def test_own_policy(first: Path, tmp_path: Path) -> None:
    ours, own = run_example("02", first / "sequences", tmp_path).splitlines()
    assert ours.startswith("ours: policy directory") and own.startswith("own: policy __main__:AskTheLikeliest")
    assert "groups [[0, 1]]" in own


def test_own_descriptor(town_stereo: Path, tmp_path: Path) -> None:
    said = run_example("03", town_stereo, tmp_path / "out")
    assert re.match(r"descriptor edge-map: [1-9]\d* matches accepted", said)


def test_own_dataset(town_stereo: Path, tmp_path: Path) -> None:
    folder = tmp_path / "recording"
    shutil.copytree(town_stereo / "agent_00" / "image_0", folder / "shots")
    names = sorted(path.name for path in (folder / "shots").iterdir())
    with open(folder / "frames.csv", "w", newline="") as file:
        table = csv.writer(file)
        table.writerows([("time_s", "file"), *((f"{k / 10}", f"shots/{name}") for k, name in enumerate(names))])
    import yaml

    camera = yaml.safe_load((town_stereo / "agent_00" / "camera.yaml").read_text())
    wanted = {name: camera[name] for name in ("width", "height", "fx", "fy", "cx", "cy")}
    (folder / "camera.json").write_text(json.dumps(wanted))
    opened, made = run_example("04", folder, tmp_path / "out").splitlines()
    assert opened.startswith("csv: 20 frames") and made.startswith("csv: [")


def test_a_rendered_world(tmp_path: Path) -> None:
    pytest.importorskip("open3d")
    said = run_example("05", tmp_path / "town", 2, 12)
    assert "0 false" in said and "mean ATE 0." in said
    assert (tmp_path / "town" / "run" / "report" / "index.html").is_file()


def test_plot_a_run(first: Path, tmp_path: Path) -> None:
    import cv2

    run_example("06", first / "run", tmp_path / "run.png")
    drawn = cv2.imread(str(tmp_path / "run.png"))
    assert drawn is not None and drawn.shape[1] == 1200 and drawn.std() > 10


def test_they_are_typed() -> None:
    done = strictly_typed(*EXAMPLES)
    assert done.returncode == 0, done.stdout


def test_a_wrong_type_is_found_and_no_any_leaks_from_the_face(tmp_path: Path) -> None:
    path = tmp_path / "user.py"
    path.write_text(REVEALED + 'run.summary.seed + "x"\nmaslam.slam("a", "b", agnets=4)\nmaslam.Run.load(3)\n')
    said = strictly_typed(path).stdout
    revealed = re.findall(r'Revealed type is "(.*)"', said)
    assert len(revealed) == REVEALED.count("reveal_type")
    assert [kind for kind in revealed if "Any" in OF_NUMPY.sub("", kind)] == []
    errors = re.findall(r"error: .*\[([a-z-]+)\]", said)
    assert errors == ["operator", "call-arg", "arg-type"], said
