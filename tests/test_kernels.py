"""Kernels are compiled before the work begins, once, and no clock counts that."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from numba import float64, int64, njit
from numba.core import event

from maslam._kernels import make_ready, watch_compiling
from maslam.frontend.cameras.models import RigKind
from maslam.frontend.kernels import odometry_kernels

LEFT_OVER = """
import sys
from numba.core.dispatcher import Dispatcher
from maslam._kernels import make_ready
from maslam.frontend.cameras.models import RigKind
from maslam.frontend.kernels import odometry_kernels
from maslam.mas.kernels import agent_kernels
from maslam.tools.cli import main

def taken():
    found = {}
    for module in [m for name, m in sys.modules.items() if name.startswith("maslam.")]:
        for kernel in vars(module).values():
            if isinstance(kernel, Dispatcher):
                found[kernel.py_func.__qualname__] = len(kernel.overloads)
    return found

if sys.argv[1] == "render":
    from maslam.tools.worlds.rendering.kernels import RENDERING_KERNELS
    make_ready(RENDERING_KERNELS)
else:
    make_ready([*odometry_kernels([RigKind(sys.argv[1])]), *agent_kernels(2)])
before = taken()
assert main(sys.argv[2:]) == 0
print(sorted(name for name, count in taken().items() if count > before.get(name, 0)))
"""


@contextmanager
def compiling(seconds: float) -> Iterator[None]:
    """As if numba compiled for so long."""
    event.start_event("numba:compile")
    time.sleep(seconds)
    yield
    event.end_event("numba:compile")


def test_progress_is_shown_only_where_something_is_compiled() -> None:
    half, square = njit(lambda x: x / 2), njit(lambda x: x * x)
    half(3.0)
    told: list[tuple[int, int]] = []
    kernels = [(half, (float64,)), (square, (float64,)), (square, (int64,))]
    make_ready(kernels, lambda done, total: told.append((done, total)))
    assert told == [(1, 3), (2, 3), (3, 3)]
    make_ready(kernels, lambda done, total: told.append((done, total)))
    assert told == [(1, 3), (2, 3), (3, 3)], "all of them are there"
    assert square.signatures == [(float64,), (int64,)]


def test_time_within_a_compilation_counts_once() -> None:
    with watch_compiling() as compilations:
        with compiling(0.1), compiling(0.1):  # a kernel compiles those that it calls
            pass
        with compiling(0.1):
            pass
    with compiling(0.1):
        pass
    assert 0.29 < compilations.seconds < 0.6


@pytest.mark.parametrize("rig", list(RigKind))
def test_a_rig_needs_no_other_rigs_kernels(rig: RigKind) -> None:
    names = {kernel.py_func.__name__ for kernel, _ in odometry_kernels([rig])}
    assert ("depth_at" in names) == (rig is RigKind.RGBD)
    assert ("_search_rows" in names) == (rig is RigKind.STEREO)
    assert not odometry_kernels([])


def left_over(*words: str) -> str:
    """The kernels that a command compiled or took beside those that are listed for it."""
    root = Path(__file__).resolve().parents[1]
    command, environment = [sys.executable, "-c", LEFT_OVER, *words], {**os.environ, "PYTHONPATH": str(root)}
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout.splitlines()[-1]


@pytest.mark.parametrize(("rig", "command"), [("stereo", "slam"), ("mono", "preprocess"), ("rgbd", "preprocess")])
def test_nothing_is_left_to_compile_during_the_work(
    rig: str, command: str, town_stereo: Path, indoor_rgbd: Path, tmp_path: Path
) -> None:
    """A kernel that is called with other types than ``kernels.py`` lists would be compiled at an image, and again in
    each worker."""
    source = indoor_rgbd if rig == "rgbd" else town_stereo
    options = ["--rig", rig, "--workers", "1", "--quiet"]
    assert left_over(rig, command, str(source), str(tmp_path / "out"), *options) == "[]"


def test_nothing_is_left_to_compile_while_worlds_are_drawn(tmp_path: Path) -> None:
    small = ["--world", "indoor", "--size", "64x48", "--frames", "1", "--agents", "1", "--cheap", "true"]
    assert left_over("render", "render", str(tmp_path / "out"), *small, "--workers", "1", "--quiet") == "[]"
