"""Temporary folders that are kept to the end of the program are gone after it, however it ended."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import pytest

from maslam._temporary import delete_folder, kept_folder

HOLD = (
    "import sys, time; from maslam._temporary import kept_folder; folder = kept_folder('maslam-test-');"
    "(folder / 'big').write_text('x'); print(folder, flush=True)"
)


@pytest.fixture(autouse=True)
def temporary(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    return tmp_path


def started(code: str) -> tuple[subprocess.Popen[str], Path]:
    process = subprocess.Popen([sys.executable, "-c", f"{HOLD}; {code}"], stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    return process, Path(process.stdout.readline().strip())


def grow_old(folder: Path) -> None:
    os.utime(folder, (time.time() - 300,) * 2)


@pytest.mark.parametrize("ending", ["", "raise KeyError(1)", "sys.exit(3)", "import os; os.fork() or time.sleep(1)"])
def test_a_program_that_ends_deletes_its_own(ending: str) -> None:
    process, folder = started(ending)
    process.wait()
    assert not folder.exists()


def test_a_fork_deletes_nothing_of_its_parent() -> None:
    code = "import os; p = os.fork(); p or sys.exit(); os.waitpid(p, 0); print(folder.exists(), flush=True)"
    process, _ = started(code)
    assert process.stdout is not None and process.stdout.read().strip() == "True"
    process.wait()


@pytest.mark.skipif(sys.platform == "win32", reason="folders cannot be locked there")
def test_what_a_killed_program_left_goes_with_the_next_one_and_nothing_else() -> None:
    killed, left = started("time.sleep(60)")
    running, held = started("time.sleep(60)")
    try:
        killed.kill()
        killed.wait()
        young = Path(tempfile.mkdtemp(prefix="maslam-test-"))  # of a program that is about to lock it
        other = Path(tempfile.mkdtemp(prefix="maslam-other-"))
        for folder in (left, held, other):
            grow_old(folder)
        mine = kept_folder("maslam-test-")
        assert not left.exists()
        assert all((held.exists(), young.exists(), other.exists(), mine.exists()))
        delete_folder(mine)
        assert not mine.exists()
    finally:
        running.kill()
        running.wait()
