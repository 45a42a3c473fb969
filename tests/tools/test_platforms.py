"""What other systems lack is said in a line, or does not matter: simulated, by taking it away here."""

from __future__ import annotations

import ast
import hashlib
import io
import math
import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from concurrent.futures import Future
from pathlib import Path
from typing import Any

import pytest

from maslam.descriptors.published.isolation import limit_memory
from maslam.tools import cli
from maslam.tools.common import memory, parallel
from maslam.tools.common.digests import digest_of
from maslam.tools.common.errors import ToolError
from maslam.tools.common.progress import Silent
from maslam.tools.common.writing import writing

ROOT = Path(__file__).resolve().parents[2]
FOLDERS = ("frontend", "descriptors", "backend", "mas", "tools")
POSIX_ONLY = {"crypt", "fcntl", "grp", "posix", "pty", "pwd", "resource", "spwd", "syslog", "termios", "tty"}
GUARDED = {("memory.py", "resource"), ("isolation.py", "resource"), ("folder_lock.py", "fcntl")}
POSIX_CALLS = {
    "os.fork",
    "os.forkpty",
    "os.getuid",
    "os.geteuid",
    "os.getpgid",
    "os.killpg",
    "os.setsid",
    "os.mkfifo",
    "os.nice",
    "os.symlink",
    "os.getloadavg",
    "os.uname",
    "os.wait",
    "signal.SIGKILL",
    "signal.SIGHUP",
    "signal.SIGUSR1",
    "signal.SIGALRM",
    "signal.alarm",
    "os.sched_getaffinity",
    "os.sysconf",
}
GUARDED_CALLS = {("parallel.py", "os.sched_getaffinity"), ("memory.py", "os.sysconf")}


def test_nothing_else_needs_what_only_some_systems_have() -> None:
    """Who adds a use guards it, tests it here, and enters it above."""
    modules, calls = set(), set()
    for path in [path for folder in FOLDERS for path in (ROOT / folder).rglob("*.py")]:
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Import):
                modules |= {(path.name, alias.name) for alias in node.names if alias.name in POSIX_ONLY}
            elif isinstance(node, ast.ImportFrom) and node.module in POSIX_ONLY:
                modules.add((path.name, node.module))
            elif isinstance(node, ast.Attribute) and ast.unparse(node) in POSIX_CALLS:
                calls.add((path.name, ast.unparse(node)))
    assert modules == GUARDED
    assert calls == GUARDED_CALLS


@pytest.fixture
def bare_system(monkeypatch: pytest.MonkeyPatch) -> None:
    """No ``/proc``, no ``resource``, no affinity: as on Windows."""
    for name in ("_STATUS", "_STATM", "_CLEAR"):
        monkeypatch.setattr(memory, name, Path("nowhere") / name)
    monkeypatch.setattr(memory, "resource", None)
    monkeypatch.delattr(os, "sched_getaffinity", raising=False)
    monkeypatch.delattr(os, "sysconf", raising=False)


@pytest.mark.usefixtures("bare_system")
def test_memory_that_cannot_be_measured_is_no_number() -> None:
    assert math.isnan(memory.resident_mb()) and math.isnan(memory.peak_mb())
    memory.reset_peak()
    assert parallel.core_count() == os.cpu_count()


@pytest.mark.usefixtures("bare_system")
def test_the_memory_benchmark_refuses_in_a_line(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["bench", "memory", "--quiet"]) == 1
    assert (
        capsys.readouterr().err
        == "maslam: this system does not tell how much memory a process holds: run it on Linux\n"
    )


def test_memory_without_proc_is_the_peak_on_a_mac(monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("resource")
    for name in ("_STATUS", "_STATM", "_CLEAR"):
        monkeypatch.setattr(memory, name, Path("nowhere") / name)
    here = memory.peak_mb()
    monkeypatch.setattr(sys, "platform", "darwin")  # counts bytes, not kilobytes
    assert memory.resident_mb() == pytest.approx(here / 1024, rel=0.5)


def test_every_command_starts_without_posix_modules() -> None:
    """Imported and parsed in a fresh process in which none of them can be imported."""
    code = f"""
import os, sys
for name in {sorted(POSIX_ONLY - {"posix"})}:
    sys.modules[name] = None
del os.sched_getaffinity, os.sysconf
from maslam.tools import cli
from maslam.tools.common import memory
for command in cli.COMMANDS:
    assert cli.main([command, "--help-all"]) == 0, command
assert memory.resource is None
"""
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


def test_doctor_does_not_ask_for_what_is_not_made_for_a_system(monkeypatch: pytest.MonkeyPatch) -> None:
    from maslam.tools.inspection.doctor import library_checks

    wanted = [
        "numpy>=2",
        f"no-such-thing>=1; sys_platform != '{sys.platform}'",
        "neither>=1",
        "torch; extra == 'train'",
    ]
    monkeypatch.setattr("maslam.tools.inspection.doctor.requires", lambda _: wanted)
    found = {check.name: (check.works, check.needed) for check in library_checks()}
    assert found == {"numpy": (True, True), "no-such-thing": (False, False), "neither": (False, True)}


def test_without_gtsam_central_optimisation_works_and_what_needs_it_says_so(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(sys.modules, "gtsam", None)
    graph, solved = tmp_path / "graph.g2o", tmp_path / "solved.g2o"
    edge = " ".join(["1 0 0 0 0 0 1", *("1" if i == j else "0" for i in range(6) for j in range(i, 6))])
    graph.write_text(f"EDGE_SE3:QUAT 0 1 {edge}\nEDGE_SE3:QUAT 1 2 {edge}\n")
    assert cli.main(["pgo", str(graph), str(solved), "--method", "central", "--quiet"]) == 0
    capsys.readouterr()
    assert cli.main(["pgo", str(graph), str(tmp_path / "e.g2o"), "--method", "central", "--central.cost", "E"]) == 1
    said = capsys.readouterr().err
    assert said.count("\n") == 1 and said.startswith("maslam: Levenberg-Marquardt needs gtsam")


@pytest.mark.usefixtures("bare_system")
def test_doctor_tells_what_this_system_lacks(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    import onnxruntime  # noqa: F401 - it asks for the system while it is imported

    monkeypatch.setattr("platform.system", lambda: "Windows")
    monkeypatch.setattr("maslam.tools.inspection.doctor.library_checks", lambda: [])
    assert cli.main(["doctor"]) == 0, "nothing that is needed is missing"
    said = capsys.readouterr().out
    assert "absent   system" in said and "Windows: not tested" in said
    assert "absent   memory figures" in said


class FewProcesses:
    """A pool of processes as Windows has it: of 61 at most."""

    def __init__(self, most: int, *_: object, **__: object) -> None:
        if most > 61:
            raise ValueError("max_workers must be <= 61")

    def submit(self, work: Callable[..., Any], *arguments: Any) -> Future[Any]:
        future: Future[Any] = Future()
        future.set_result(parallel.JobOutcome(None, None))
        return future

    def shutdown(self, **_: object) -> None:
        return


def nothing(number: int, advance: Callable[[int], None]) -> None:
    return


def test_no_more_processes_than_windows_can_wait_for(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(parallel, "ProcessPoolExecutor", FewProcesses)
    monkeypatch.setattr(sys, "platform", "win32")
    jobs = {f"job {k}": (k, 1) for k in range(100)}
    assert len(parallel.run_jobs(nothing, jobs, 100, Silent())) == 100


def give_up(number: int, advance: Callable[[int], None]) -> None:
    os._exit(3)


def test_a_worker_that_dies_is_said_in_a_line() -> None:
    with pytest.raises(ToolError, match="a worker process ended: killed, or out of memory"):
        parallel.run_jobs(give_up, {"a": (1, 1), "b": (2, 1)}, 2, Silent())


def test_a_script_without_the_guard_is_told_so_and_nothing_else(tmp_path: Path) -> None:
    """Each worker imports the script, which starts workers again: Python's own words are a page for each worker."""
    (tmp_path / "mine.py").write_text(
        "from maslam.tools.common.progress import Silent\n"
        "from maslam.tools.common.parallel import run_jobs\n"
        "from maslam.tools.common.errors import ToolError\n"
        "def work(number, advance):\n    return number\n"
        "try:\n    run_jobs(work, {'a': (1, 1), 'b': (2, 1)}, 2, Silent())\n"
        "except ToolError as error:\n    print(error)\n"
    )
    done = subprocess.run(
        [sys.executable, str(tmp_path / "mine.py")],
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        timeout=60,
    )
    assert done.stdout.count("\n") == 1 and '`if __name__ == "__main__":`' in done.stdout
    assert done.stderr == ""


def test_letters_that_the_terminal_lacks_are_no_failure(monkeypatch: pytest.MonkeyPatch) -> None:
    """A Windows console has a code page; names of folders come in all letters."""
    written = io.BytesIO()
    monkeypatch.setattr(sys, "stdout", io.TextIOWrapper(written, encoding="cp1252", errors="strict"))
    monkeypatch.setattr("maslam.tools.report.summary_table.main", lambda _: sys.stdout.write("Übung → 界\n") and None)
    assert cli.main(["eval", "RUN"]) == 0
    sys.stdout.flush()
    assert written.getvalue().decode("cp1252").strip() == "Übung ? ?"


def test_a_sequences_name_is_one_folder_on_every_system() -> None:
    from maslam.tools.bench.vo.run import _as_folder

    assert _as_folder("town/agent_00") == "town_agent_00"
    assert _as_folder(r"C:\data\town/agent_00") == "C__data_town_agent_00"


@pytest.fixture
def checkout_without_links(tmp_path: Path) -> Path:
    """As git for Windows makes it where it may not make links: a file that holds the link's target."""
    (tmp_path / "maslam").mkdir()
    for path in (ROOT / "maslam").iterdir():
        if path.is_symlink():
            (tmp_path / "maslam" / path.name).write_text(os.readlink(path))
        elif path.suffix == ".py":
            shutil.copy(path, tmp_path / "maslam")
    return tmp_path


def test_a_checkout_without_links_is_told_in_a_line(checkout_without_links: Path) -> None:
    environment = {**os.environ, "PYTHONPATH": str(checkout_without_links), "PYTHONSAFEPATH": "1"}
    command = [sys.executable, "-m", "maslam", "--version"]
    done = subprocess.run(command, env=environment, cwd=checkout_without_links, capture_output=True, text=True)
    assert done.returncode == 1 and done.stdout == ""
    assert done.stderr.count("\n") == 1 and done.stderr.startswith("maslam: this checkout lacks the symbolic links")
    code = "try:\n    import maslam\nexcept ImportError as error:\n    print(error)"
    done = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=True)
    assert done.stdout.startswith("this checkout lacks the symbolic links")


def test_paths_in_fingerprints_do_not_depend_on_the_separator(tmp_path: Path) -> None:
    (tmp_path / "agent_00").mkdir()
    (tmp_path / "agent_00" / "a.txt").write_text("1")
    assert digest_of([tmp_path / "agent_00" / "a.txt"], tmp_path) == hashlib.sha256(b"agent_00/a.txt\x001").hexdigest()


def test_folders_are_written_to_where_they_cannot_be_locked(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "fcntl", None)
    with writing(tmp_path / "out"), writing(tmp_path / "out"):
        (tmp_path / "out" / "file").touch()


def test_a_reader_without_a_limit_of_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "resource", None)
    limit_memory()
