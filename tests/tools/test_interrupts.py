"""Ctrl-C, SIGTERM and a killed parent: one line, an exit code, no process and no half-written file left."""

import contextlib
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from maslam import __main__ as entry
from maslam.tools.common.interrupts import Terminated, held_back, interrupts
from maslam.tools.common.writing import remove_parts

ROOT = Path(__file__).resolve().parents[2]
pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="signals")


@pytest.fixture(autouse=True)
def nothing_ignored():
    """Whoever runs the tests in the background may ignore Ctrl-C, or under nohup a hang-up, and what they start would,
    too."""
    usual = {signal.SIGINT: signal.default_int_handler, signal.SIGHUP: signal.SIG_DFL}
    before = {number: signal.signal(number, how) for number, how in usual.items()}
    yield
    for number, how in before.items():
        signal.signal(number, how)


POOL = """
import argparse, sys
from maslam._temporary import kept_folder
from maslam.tools import cli
from maslam.tools.common.logs import logs_to
from maslam.tools.common.parallel import run_jobs
from maslam.tools.common.progress import CallbackProgress
import jobs

def work(arguments):
    kept_folder("of-the-command-")
    run_jobs(jobs.wait, {"a": (sys.argv[1], 1), "b": (sys.argv[1], 1)}, 2, CallbackProgress(None))

def run(argv, signals):
    with logs_to():
        return cli._run(argparse.Namespace(command_main=work, command="x"), signals)

cli._main = run
if __name__ == "__main__":
    sys.exit(cli.main())
"""
JOBS = """
import os, time
from pathlib import Path
from maslam._atomic import replacing
from maslam._temporary import kept_folder

def wait(folder, advance):
    kept_folder("of-a-worker-")
    with replacing(Path(folder) / f"result_{os.getpid()}") as part:
        part.write_text("half")
        Path(folder, f"pid_{os.getpid()}").touch()
        time.sleep(60)
"""


def started(tmp_path, *, processes=2):
    """A command with two workers, each in the middle of writing; and the workers' numbers."""
    (tmp_path / "pool.py").write_text(POOL)
    (tmp_path / "jobs.py").write_text(JOBS)
    out = tmp_path / "out"
    out.mkdir()
    environment = {
        **os.environ, "PYTHONPATH": os.pathsep.join([str(ROOT), str(tmp_path)]), "TMPDIR": str(tmp_path)
    }  # fmt: skip
    command = subprocess.Popen(
        [sys.executable, str(tmp_path / "pool.py"), str(out)],
        env=environment,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    while len(list(out.glob("pid_*"))) < processes:
        assert command.poll() is None, command.communicate()
        time.sleep(0.05)
    return command, [int(path.name[4:]) for path in out.glob("pid_*")], out


def gone(pids):
    """Whether the processes end, which takes a moment."""
    for _ in range(200):
        if not any(_alive(pid) for pid in pids):
            return True
        time.sleep(0.05)
    return False


def _alive(pid):
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


@pytest.mark.parametrize(
    ("name", "group", "code"),
    [("SIGINT", False, 130), ("SIGINT", True, 130), ("SIGTERM", False, 143), ("SIGHUP", False, 143)],
)
def test_a_signal_ends_everything_in_one_line(tmp_path, name, group, code):
    command, pids, _ = started(tmp_path)
    (os.killpg if group else os.kill)(command.pid, getattr(signal, name))
    _, said = command.communicate(timeout=30)
    assert command.returncode == code
    (line,) = said.strip().splitlines()
    assert line.startswith("maslam: " + ("interrupted" if code == 130 else "ended from outside"))
    assert gone(pids)
    assert not list(tmp_path.glob("of-the-command-*"))


@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="looks at processes")
def test_a_killed_parent_leaves_no_workers_and_its_half_written_files_can_be_told(tmp_path):
    command, pids, out = started(tmp_path)
    command.kill()
    command.wait()
    assert gone(pids)
    assert not list(tmp_path.glob("of-a-worker-*"))
    assert len(list(out.glob(".*.part"))) == 2
    (out / ".not.part").touch()
    remove_parts(out)
    assert [path.name for path in out.glob(".*.part")] == [".not.part"]


@pytest.mark.parametrize("delay", [0.0, 0.1, 0.2, 0.4])
def test_an_interruption_during_imports_is_one_line_too(tmp_path, delay):
    code = "import sys; print(1, flush=True); from maslam.tools import cli; print(2, flush=True); sys.exit(cli.main())"
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    words = [sys.executable, "-c", code, "slam", str(tmp_path / "none"), str(tmp_path / "out")]
    command = subprocess.Popen(
        words, env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, bufsize=1
    )
    assert command.stdout.readline() == "1\n" and command.stdout.readline() == "2\n"
    time.sleep(0.05 + delay)
    command.send_signal(signal.SIGINT)
    _, said = command.communicate(timeout=30)
    (line,) = said.strip().splitlines()
    assert command.returncode == (130 if "interrupted" in line else 1)  # where it was done before


def test_an_exception_that_compiled_code_loses_is_raised_again():
    with pytest.raises(KeyboardInterrupt), interrupts() as signals:
        _lose(signals)


def _lose(signals):
    with contextlib.suppress(KeyboardInterrupt):
        os.kill(os.getpid(), signal.SIGINT)
    assert signals.seen is KeyboardInterrupt
    begun = time.monotonic()
    while time.monotonic() < begun + 20:
        time.sleep(0.01)


def test_work_that_is_being_undone_is_left_in_peace():
    undone = []
    with pytest.raises(Terminated), interrupts():
        _undo_slowly(undone)
    assert undone
    assert signal.getitimer(signal.ITIMER_REAL)[0] == 0


def _undo_slowly(undone):
    try:
        os.kill(os.getpid(), signal.SIGTERM)
    finally:
        os.kill(os.getpid(), signal.SIGINT)
        time.sleep(1.3)  # the alarm too
        undone.append(True)


def test_a_signal_while_a_process_is_started_waits_until_it_is():
    """Else it would tell of the half of its orders that it got."""
    done = []
    with pytest.raises(Terminated), interrupts():
        _started(done)
    assert done == ["whole"]
    with pytest.raises(KeyboardInterrupt), interrupts():
        _started([])


def _started(done):
    with held_back():
        os.kill(os.getpid(), signal.SIGTERM)
        time.sleep(1.2)  # the alarm too
        done.append("whole")
    pytest.fail("went on after the signal")


def test_an_interrupt_while_the_command_is_loaded_is_one_line(monkeypatch, capsys):
    class Interrupted:
        @staticmethod
        def find_spec(name, path=None, target=None):
            if name == "maslam.tools.cli":
                raise KeyboardInterrupt

    monkeypatch.delitem(sys.modules, "maslam.tools.cli", raising=False)
    monkeypatch.setattr(sys, "meta_path", [Interrupted, *sys.meta_path])
    assert entry.main() == 130
    assert capsys.readouterr().err == "maslam: interrupted before it began\n"
