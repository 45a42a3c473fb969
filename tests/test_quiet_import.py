"""Libraries that are imported late leave this process's signals as they were."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="no such signals")
ROOT = Path(__file__).resolve().parents[1]
START = "import os, signal, sys, time\n"
LIBRARY = "from maslam._pycolmap import _library; _library()\n"


def run(code: str) -> subprocess.CompletedProcess[str]:
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    return subprocess.run(
        [sys.executable, "-c", START + code], env=environment, capture_output=True, text=True, timeout=120, check=False
    )


@pytest.mark.parametrize("name", ["SIGTERM", "SIGINT", "SIGHUP"])
def test_a_handler_is_called_after_the_import_as_before(name: str) -> None:
    ended = run(
        f"signal.signal(signal.{name}, lambda *_: (print('handled', flush=True), sys.exit(7)))\n"
        f"{LIBRARY}os.kill(os.getpid(), signal.{name}); time.sleep(5)"
    )
    assert (ended.returncode, ended.stdout, ended.stderr) == (7, "handled\n", "")


def test_what_no_handler_awaits_ends_the_process_without_a_word() -> None:
    ended = run(f"{LIBRARY}os.kill(os.getpid(), signal.SIGTERM); time.sleep(5)")
    assert (ended.returncode, ended.stdout, ended.stderr) == (-signal.SIGTERM, "", "")


def test_a_signal_during_the_import_waits_for_its_end() -> None:
    ended = run(
        "signal.signal(signal.SIGTERM, lambda *_: (print('handled', flush=True), sys.exit(7)))\n"
        "from maslam._quiet_import import signals_kept\n"
        "with signals_kept():\n"
        "    os.kill(os.getpid(), signal.SIGTERM); import pycolmap; print('imported', flush=True)\n"
        "time.sleep(5)"
    )
    assert (ended.returncode, ended.stdout, ended.stderr) == (7, "imported\nhandled\n", "")


def test_the_mask_of_signals_is_that_of_before() -> None:
    ended = run(f"before = signal.pthread_sigmask(0, [])\n{LIBRARY}print(before == signal.pthread_sigmask(0, []))")
    assert ended.stdout == "True\n"
