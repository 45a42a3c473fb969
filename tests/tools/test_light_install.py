"""What works without the extras: everything but rendering, training, recordings and comparisons."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
FOLDERS = ("backend", "frontend", "descriptors", "mas", "tools")
BLOCKED = """
import sys
for name in ("open3d", "torch", "kornia", "onnx", "rerun", "evo"):
    sys.modules[name] = None  # as if it were not installed
"""
EVERY_MODULE = """
import importlib, pkgutil
for name in sys.argv[1:]:
    package = importlib.import_module(name)
    for found in pkgutil.walk_packages(package.__path__, name + "."):
        try:
            importlib.import_module(found.name)
        except ModuleNotFoundError as error:
            print(found.name, error.name)
"""
COMMAND = """
from maslam.tools.cli import main
sys.exit(main(sys.argv[1:]))
"""


def without_extras(code: str, *arguments: str | Path) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-c", BLOCKED + code, *map(str, arguments)]
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    return subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, check=False)


def test_only_training_cannot_be_imported_without_the_extras() -> None:
    done = without_extras(EVERY_MODULE, *(f"maslam.{folder}" for folder in FOLDERS))
    assert done.returncode == 0, done.stderr
    failed = [line.split() for line in done.stdout.splitlines()]
    assert failed, "nothing was blocked"
    assert {missing for _, missing in failed} <= {"torch", "kornia", "onnx"}
    assert {module.split(".")[1] for module, _ in failed} == {"descriptors"}


def test_images_become_a_map_without_the_extras(town_stereo: Path, tmp_path: Path) -> None:
    done = without_extras(COMMAND, "slam", town_stereo, tmp_path / "out", "--workers", "1", "--quiet")
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "out" / "report" / "index.html").is_file()
    done = without_extras(COMMAND, "run", tmp_path / "out" / "sequences", tmp_path / "again", "--quiet")
    assert done.returncode == 0, done.stderr
    maps = [tmp_path / run / "agent_00" / "map.ply" for run in ("out", "again")]
    assert maps[0].read_bytes() == maps[1].read_bytes()


@pytest.mark.parametrize(
    "arguments",
    [
        ("render", "OUT"),
        ("demo", "--out", "OUT"),
        ("bench", "relpose", "--cache", "OUT"),
        ("netvlad", "eval", "--cache", "OUT", "--workers", "1", "--sets", "indoor_9500"),
    ],
)
def test_who_wants_to_render_is_told_what_to_install(arguments: tuple[str, ...], tmp_path: Path) -> None:
    out = tmp_path / "out"
    done = without_extras(COMMAND, *(out if word == "OUT" else word for word in arguments), "--quiet")
    assert done.returncode == 1
    assert done.stderr.splitlines()[-1].endswith("rendering needs open3d: pip install 'maslam[worlds]'")
    assert "Traceback" not in done.stderr
    assert not out.exists(), "left something behind"


def test_the_lock_files_keep_the_core_light() -> None:
    core, worlds, dev = (pins(name) for name in ("core", "worlds", "dev"))
    assert len(core) <= 40
    assert "setuptools" in core, "make builds the project without isolation"
    assert "open3d" in worlds
    assert not core & worlds and not (core | worlds) & dev


def pins(name: str) -> set[str]:
    text = (ROOT / "requirements" / f"{name}.txt").read_text(encoding="utf-8")
    return set(re.findall(r"^([a-z0-9-]+)==", text, re.MULTILINE))
