"""The same command gives the same files: whatever the workers, threads, load and cache; and on other processors the
same accepted matches and trajectories."""

from __future__ import annotations

import csv
import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

from maslam.frontend.files.trajectory import read_tum
from maslam.tools import cli
from maslam.tools.common.parallel import one_blas_thread

pytestmark = pytest.mark.slow
MEASURED = "timing.json"
SHOWS_IT = Path("report/index.html")
"""The report shows measured times too."""
HOLDS_MM = 1.0
OTHER_PROCESSORS = {
    "OPENBLAS_CORETYPE": "Prescott",
    "NUMBA_CPU_NAME": "generic",
    "OPENCV_CPU_DISABLE": "AVX2,AVX,FP16,FMA3,SSE4.2",
}


@pytest.fixture(scope="module")
def images(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("worlds") / "house"
    words = ["render", str(out), "--agents", "2", "--frames", "24", "--size", "320x240", "--seed", "4", "--quiet"]
    assert cli.main(words) == 0
    return out


@pytest.fixture(scope="module")
def reference(images: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return slam(images, tmp_path_factory.mktemp("runs") / "reference", 1, {"OMP_NUM_THREADS": "1"})


def slam(images: Path, out: Path, workers: int, environment: dict[str, str]) -> Path:
    """The whole chain in a process of its own."""
    words = ["slam", str(images), str(out), "--workers", str(workers), "--quiet"]
    variables = {**os.environ, **environment}
    subprocess.run([sys.executable, "-m", "maslam", *words], env=variables, check=True, capture_output=True)
    return out


def files(run: Path) -> list[Path]:
    """Every file that holds results."""
    found = (path.relative_to(run) for path in run.rglob("*") if path.is_file() and path.name != MEASURED)
    return sorted(path for path in found if path != SHOWS_IT)


def differing(one: Path, other: Path) -> list[Path]:
    assert files(one) == files(other)
    return [name for name in files(one) if (one / name).read_bytes() != (other / name).read_bytes()]


@contextmanager
def load() -> Iterator[None]:
    """A process that keeps a core busy."""
    busy = subprocess.Popen([sys.executable, "-c", "while True: pass"])
    try:
        yield
    finally:
        busy.kill()
        busy.wait()


def accepted(run: Path) -> list[tuple[str, ...]]:
    with open(run / "matches.csv", newline="") as file:
        ends = ("query_agent", "query_keyframe", "match_agent", "match_keyframe", "outcome")
        rows = [tuple(row[name] for name in ends) for row in csv.DictReader(file)]
    return [row for row in rows if row[-1] == "accepted"]


def test_workers_threads_load_and_a_cold_cache_change_no_file(images: Path, reference: Path, tmp_path: Path) -> None:
    cold = {"OMP_NUM_THREADS": "2", "OPENBLAS_NUM_THREADS": "2", "NUMBA_CACHE_DIR": str(tmp_path / "cache")}
    with load():
        other = slam(images, tmp_path / "other", 2, cold)
    assert differing(reference, other) == []


def test_threads_alone_change_no_file(images: Path, reference: Path, tmp_path: Path) -> None:
    without = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "")  # as many as there are cores
    assert differing(reference, slam(images, tmp_path / "other", 1, without)) == []


def test_another_kind_of_processor_accepts_the_same_matches(images: Path, reference: Path, tmp_path: Path) -> None:
    elsewhere = {**OTHER_PROCESSORS, "NUMBA_CACHE_DIR": str(tmp_path / "cache")}
    other = slam(images, tmp_path / "other", 2, elsewhere)
    assert len(accepted(reference)) > 0 and accepted(reference) == accepted(other)
    for name in ("agent_00", "agent_01"):
        here, there = (read_tum(run / name / "trajectory.tum") for run in (reference, other))
        np.testing.assert_array_equal(here.stamps_ns, there.stamps_ns)
        assert np.linalg.norm(here.centres - there.centres, axis=1).max() < HOLDS_MM / 1e3


def test_blas_has_one_thread_inside_and_its_own_number_outside() -> None:
    from threadpoolctl import threadpool_info, threadpool_limits

    with threadpool_limits(2):
        with one_blas_thread():
            assert {pool["num_threads"] for pool in threadpool_info()} == {1}
            assert os.environ["OPENBLAS_NUM_THREADS"] == "1"
        assert {pool["num_threads"] for pool in threadpool_info() if pool["user_api"] == "blas"} == {2}
