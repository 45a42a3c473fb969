"""A cached kernel is taken only while everything that was compiled into it is as it was."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from maslam._kernels import kernel

INNER = """
import numpy as np
from maslam._kernels import kernel
from .values import FACTOR, TABLE

@kernel
def inner(x):
    return 2.0 * x + FACTOR + TABLE[1]
"""
VALUES = "import numpy as np\nFACTOR = 0.5\nTABLE = np.array([0.0, 10.0])\n"
OUTER = """
from maslam._kernels import kernel
from .inner import inner

@kernel
def outer(x):
    return inner(x) * 100.0
"""
CALL = """
from maslam._kernels import watch_compiling
from package.outer import outer
with watch_compiling() as compilations:
    print(outer(1.0), bool(compilations.seconds))
"""


@pytest.fixture
def package(tmp_path: Path) -> Path:
    folder = tmp_path / "package"
    folder.mkdir()
    for name, text in {"__init__": "", "inner": INNER, "values": VALUES, "outer": OUTER}.items():
        (folder / f"{name}.py").write_text(text, encoding="utf-8")
    return folder


def called(package: Path, **environment: str) -> tuple[float, bool]:
    """What a process of its own gets from ``outer``, and whether it compiled something."""
    paths = os.pathsep.join([str(package.parent), str(Path(__file__).resolve().parents[1])])
    variables = {k: v for k, v in os.environ.items() if k != "NUMBA_CACHE_DIR"}
    variables |= {"PYTHONPATH": paths, "PYTHONDONTWRITEBYTECODE": "1"} | environment
    done = subprocess.run([sys.executable, "-c", CALL], env=variables, capture_output=True, text=True, check=True)
    value, compiled = done.stdout.split()
    return float(value), compiled == "True"


def changed(file: Path, old: str, new: str) -> None:
    file.write_text(file.read_text(encoding="utf-8").replace(old, new), encoding="utf-8")


@pytest.mark.parametrize("elsewhere", [False, True])
def test_what_a_kernel_calls_and_reads_from_other_files_is_told(package: Path, tmp_path: Path, elsewhere: bool) -> None:
    environment = {"NUMBA_CACHE_DIR": str(tmp_path / "cache")} if elsewhere else {}
    assert called(package, **environment) == (1250.0, True)
    assert called(package, **environment) == (1250.0, False)
    changed(package / "inner.py", "2.0 * x", "3.0 * x")
    assert called(package, **environment) == (1350.0, True)
    changed(package / "values.py", "FACTOR = 0.5", "FACTOR = 1.5")
    assert called(package, **environment) == (1450.0, True)
    changed(package / "values.py", "10.0]", "20.0]")
    assert called(package, **environment) == (2450.0, True)
    assert called(package, **environment) == (2450.0, False)


def test_a_change_that_is_not_compiled_in_compiles_nothing(package: Path) -> None:
    called(package)
    changed(package / "values.py", "FACTOR", "OTHER = 3\nFACTOR")
    (package / "outer.py").touch()
    assert called(package) == (1250.0, False)


def test_older_code_is_neither_taken_nor_kept(package: Path) -> None:
    """An index whose data was never written, because the process was ended, must not find the data of older code."""
    called(package)
    cache = package / "__pycache__"
    old = {file: file.read_bytes() for file in cache.glob("*.nbc")}
    changed(package / "inner.py", "2.0 * x", "3.0 * x")
    called(package)
    assert not [file for file in old if file.exists()]
    new = [file for file in cache.glob("*.nbc") if file.name.startswith("outer")]
    assert len(new) == 1
    new[0].unlink()
    for file, data in old.items():
        file.write_bytes(data)
    assert called(package) == (1350.0, True)


def test_every_digit_of_a_long_array_is_told_also_in_a_tuple(package: Path) -> None:
    long = "TABLE = (np.arange(3000.0), np.arange(3000.0))\nFACTOR = 0.5\n"
    (package / "values.py").write_text("import numpy as np\n" + long, encoding="utf-8")
    changed(package / "inner.py", "TABLE[1]", "TABLE[1][1500]")
    assert called(package) == (150250.0, True)
    changed(package / "values.py", "np.arange(3000.0))", "np.where(np.arange(3000) == 1500, 7.0, np.arange(3000.0)))")
    assert called(package) == (950.0, True)


def test_variables_of_a_function_around_a_kernel_are_refused() -> None:
    factor = 2.0
    with pytest.raises(TypeError, match="scaled: variables of a function around it"):

        @kernel
        def scaled(x: float) -> float:
            return factor * x


def test_a_global_whose_changes_cannot_be_told_is_refused(package: Path) -> None:
    changed(package / "values.py", "FACTOR = 0.5", "FACTOR = {1: 0.5}")
    with pytest.raises(subprocess.CalledProcessError) as caught:
        called(package)
    assert "inner: FACTOR is a dict" in caught.value.stderr


ANYWHERE = """
from package.outer import outer
from maslam._kernels import make_ready
import logging
from numba import float64
logging.basicConfig(format="%(message)s")
make_ready([(outer, (float64,))])
print(outer(1.0), outer.stats.cache_path)
"""


def nowhere(package: Path, tmp_path: Path, temporary: str) -> subprocess.CompletedProcess[str]:
    """A process whose installation and home folder cannot be written, also not by root."""
    (package / "__pycache__").write_text("in the way")
    variables = {k: v for k, v in os.environ.items() if k not in ("NUMBA_CACHE_DIR", "XDG_CACHE_HOME")}
    paths = os.pathsep.join([str(package.parent), str(Path(__file__).resolve().parents[1])])
    variables |= {"PYTHONPATH": paths, "HOME": "/proc/none", "TMPDIR": temporary, "PYTHONDONTWRITEBYTECODE": "1"}
    done = subprocess.run([sys.executable, "-c", ANYWHERE], env=variables, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return done


def test_without_a_home_kernels_are_kept_in_a_temporary_folder_of_ones_own_and_that_is_said(
    package: Path, tmp_path: Path
) -> None:
    temporary = tmp_path / "tmp"
    temporary.mkdir()
    done = nowhere(package, tmp_path, str(temporary))
    (folder,) = temporary.glob("maslam-kernels-*")
    assert done.stdout.startswith(f"1250.0 {folder}") and list(folder.rglob("*.nbc"))
    (line,) = done.stderr.splitlines()
    assert str(folder) in line and "NUMBA_CACHE_DIR" in line


@pytest.mark.skipif(not hasattr(os, "getuid"), reason="owners of folders")
def test_a_folder_that_others_can_write_is_not_trusted(package: Path, tmp_path: Path) -> None:
    temporary = tmp_path / "tmp"
    (temporary / f"maslam-kernels-{os.getuid()}").mkdir(parents=True)
    (temporary / f"maslam-kernels-{os.getuid()}").chmod(0o777)
    done = nowhere(package, tmp_path, str(temporary))
    assert done.stdout == "1250.0 None\n"
    assert done.stderr.splitlines() == [
        "no folder can be written: kernels are compiled anew in each process; NUMBA_CACHE_DIR names a folder for them"
    ]


def test_a_damaged_cache_is_compiled_again(package: Path) -> None:
    assert called(package) == (1250.0, True)
    for file in (package / "__pycache__").glob("outer*.nb?"):
        file.write_bytes(file.read_bytes()[:40])
    assert called(package) == (1250.0, True)
    assert called(package) == (1250.0, False)


def test_a_full_disk_costs_the_cache_not_the_run(
    package: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    code = CALL.replace(
        "with watch",
        "from numba.core.caching import IndexDataCacheFile as F\n"
        "def full(*_): raise OSError(28, 'No space left on device')\nF._save_data = full\nwith watch",
    )
    monkeypatch.setitem(globals(), "CALL", code)
    assert called(package) == (1250.0, True)


def test_doctor_names_the_folder_and_the_cure() -> None:
    from maslam.tools.inspection.doctor import kernel_cache_check

    check = kernel_cache_check()
    assert "NUMBA_CACHE_DIR" in check.detail and not check.needed


def test_doctor_calls_a_fallback_that_works_no_absence(monkeypatch: pytest.MonkeyPatch) -> None:
    from maslam.tools.inspection.doctor import kernel_cache_check

    note = "kernels are kept in /somewhere/else"
    monkeypatch.setattr("maslam._kernel_cache.take_notes", lambda: [note])
    check = kernel_cache_check()
    assert check.works and check.detail == note
