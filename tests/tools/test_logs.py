"""Log lines: levels, the log file, worker processes, and the terminal with its progress bars."""

from __future__ import annotations

import ast
import logging
import os
import re
import subprocess
import sys
import time
import warnings
from collections.abc import Callable
from pathlib import Path

import pytest

from maslam.tools import cli
from maslam.tools.common import logs
from maslam.tools.common.errors import ToolError, UsageError
from maslam.tools.common.logs import LEVELS, OURS, logs_to
from maslam.tools.common.parallel import each_finished, run_jobs
from maslam.tools.common.progress import progress_on

ROOT = Path(__file__).resolve().parents[2]
FOLDERS = ("frontend", "descriptors", "backend", "mas", "tools")
LINE = re.compile(r"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d\.\d{3}Z (ERROR|WARNING|INFO|DEBUG) +\[(\d+)\] ([\w.]+): (.*)")
log = logging.getLogger("maslam.test_logs")


def log_at_every_level() -> None:
    for level in LEVELS.values():
        log.log(level, "at %s", logging.getLevelName(level).lower())


@pytest.mark.parametrize(("level", "count"), [("error", 1), ("warning", 2), ("info", 3), ("debug", 4)])
def test_levels_hold_on_the_console_and_in_the_file(
    level: str, count: int, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with logs_to(level, tmp_path / "log"):
        log_at_every_level()
    shown = capsys.readouterr().err.splitlines()
    written = (tmp_path / "log").read_text().splitlines()
    assert len(shown) == len(written) == count
    assert all(LINE.fullmatch(line) for line in written)
    assert shown[0] == "error: maslam.test_logs: at error"


def test_the_file_has_more_than_the_console_by_default_and_is_appended_to(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for _ in range(2):
        with logs_to(file=tmp_path / "log"):
            log_at_every_level()
    assert capsys.readouterr().err.splitlines() == ["error: maslam.test_logs: at error", "warning: at warning"] * 2
    levels = [LINE.fullmatch(line)[1] for line in (tmp_path / "log").read_text().splitlines()]  # type: ignore[index]
    assert levels == ["ERROR", "WARNING", "INFO"] * 2


def test_nothing_is_left_behind() -> None:
    before = list(logging.getLogger().handlers), [logging.getLogger(name).level for name in OURS]
    with logs_to("debug"):
        assert logging.getLogger().handlers != before[0]
    assert (list(logging.getLogger().handlers), [logging.getLogger(name).level for name in OURS]) == before
    assert warnings.showwarning.__module__ != "logging"


def test_libraries_are_heard_from_warnings_on(capsys: pytest.CaptureFixture[str]) -> None:
    with logs_to("debug"):
        logging.getLogger("matplotlib.font_manager").debug("scoring a font")
        logging.getLogger("matplotlib").warning("no such font")
        warnings.warn("overflow", RuntimeWarning, stacklevel=1)
    lines = capsys.readouterr().err.splitlines()
    assert lines[0] == "warning: no such font"
    assert len(lines) == 2 and "RuntimeWarning: overflow" in lines[1], "one line, its source behind it"


def test_what_is_said_beside_the_progress_is_in_the_file_and_once_on_the_console(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with logs_to("debug", tmp_path / "log"), progress_on() as progress:
        progress.say("warning: no ground truth")
        progress.say("two agents")
    assert capsys.readouterr().err.splitlines() == ["warning: no ground truth", "two agents"]
    found = [LINE.fullmatch(line).group(1, 4) for line in (tmp_path / "log").read_text().splitlines()]  # type: ignore[union-attr]
    assert found == [("WARNING", "no ground truth"), ("INFO", "two agents")]


@pytest.mark.parametrize(
    ("error", "code", "written"),
    [
        (ToolError("there is nothing here"), 1, "there is nothing here"),
        (UsageError("choose one"), 2, "choose one"),
        (KeyboardInterrupt(), 130, "interrupted"),
    ],
)
def test_a_failure_is_in_the_log_file_too(
    error: BaseException,
    code: int,
    written: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    def fail(_: object) -> None:
        raise error

    monkeypatch.setattr("maslam.tools.report.summary_table.main", fail)
    assert cli.main(["eval", "RUN", "--log-file", str(tmp_path / "log")]) == code
    text = (tmp_path / "log").read_text()
    assert written in text and f"exit code {code}" in text
    assert ("Traceback" in text) == (code == 1)
    said = capsys.readouterr().err
    assert said.count(written) == 1 and "Traceback" not in said


def test_a_log_file_that_cannot_be_written_is_said_in_a_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "missing" / "log"
    assert cli.main(["eval", "RUN", "--log-file", str(path)]) == 1
    assert capsys.readouterr().err == f"maslam: {path}: No such file or directory\n"


def square(number: int, advance: Callable[[int], None]) -> int:
    log.info("squaring %d", number)
    log.debug("in process %d", os.getpid())
    warnings.warn(f"number {number}", RuntimeWarning, stacklevel=1)
    advance(1)
    return number * number


@pytest.mark.parametrize("workers", [1, 2])
def test_lines_of_workers_reach_the_file_with_the_name_of_their_job(workers: int, tmp_path: Path) -> None:
    with logs_to("debug", tmp_path / "log"), progress_on(quiet=True) as progress:
        run_jobs(square, {f"agent_{k:02d}": (k, 1) for k in range(3)}, workers, progress)
    lines = [LINE.fullmatch(line) for line in (tmp_path / "log").read_text().splitlines() if line.startswith("20")]
    said = [line.group(1, 4) for line in lines if line and line[3] == log.name]
    for k in range(3):
        mine = [entry for entry in said if entry[1].startswith(f"agent_{k:02d}: ")]
        assert [level for level, _ in mine] == ["INFO", "DEBUG"], "in order"
    processes = {line[2] for line in lines if line and line[3] == log.name}
    assert (str(os.getpid()) in processes) == (workers == 1)
    assert (tmp_path / "log").read_text().count("RuntimeWarning: number") == 3


def note(number: int) -> None:
    log.info("part %d", number)


def test_no_line_of_many_small_jobs_is_lost(tmp_path: Path) -> None:
    with logs_to("info", tmp_path / "log"):
        assert len(list(each_finished(note, range(200), 2))) == 200
    text = (tmp_path / "log").read_text()
    assert sorted(int(n) for n in re.findall(r"part (\d+)", text)) == list(range(200))
    assert all(LINE.fullmatch(line) for line in text.splitlines()), "no line runs into another"


def burst(number: int) -> None:
    for k in range(100):
        log.info("line %d", k)


class SlowHandler(logging.Handler):
    """A log that takes longer to write than the workers take to end."""

    def __init__(self) -> None:
        super().__init__()
        self.lines: list[str] = []

    def emit(self, record: logging.LogRecord) -> None:
        time.sleep(0.02)
        self.lines.append(record.getMessage())


def test_the_last_lines_are_waited_for() -> None:
    slow = SlowHandler()
    with logs_to("info"):
        logging.getLogger().addHandler(slow)
        try:
            list(each_finished(burst, range(2), 2))
            assert len([line for line in slow.lines if line.startswith("line ")]) == 200
        finally:
            logging.getLogger().removeHandler(slow)


def test_workers_are_quiet_where_nobody_listens(capfd: pytest.CaptureFixture[str]) -> None:
    list(each_finished(note, range(4), 2))
    assert capfd.readouterr().err == ""


BESIDE_BARS = """
import logging, time
from maslam.tools.common.logs import logs_to
from maslam.tools.common.progress import progress_on
from maslam.tools.common.parallel import each_finished
from test_logs import note

if __name__ == "__main__":
    with logs_to("info"), progress_on() as progress:
        task = progress.start("working", 40)
        for done, _ in enumerate(each_finished(note, range(40), 2), 1):
            progress.advance(task, done)
            logging.getLogger("maslam.main").info("%d are done", done)
        progress.say("a line that was said")
"""


@pytest.mark.skipif(not hasattr(os, "openpty"), reason="no pseudo-terminals here")
def test_lines_stand_whole_above_the_bars_of_a_terminal(tmp_path: Path) -> None:
    (tmp_path / "script.py").write_text(BESIDE_BARS)
    text = on_a_terminal([sys.executable, str(tmp_path / "script.py")], [str(ROOT), str(Path(__file__).parent)])
    moved = re.sub(r"\x1b\[[0-9;?]*[a-zA-Z]", "\n", re.sub(r"\x1b\[[0-9;]*m", "", text))  # colours gone, cursor moves
    lines = [line.strip() for line in moved.replace("\r", "\n").splitlines()]
    whole = [line for line in lines if line.startswith("info: ")]
    expected = [f"info: maslam.test_logs: part {k}" for k in range(40)]
    expected += [f"info: maslam.main: {k} are done" for k in range(1, 41)]
    assert sorted(whole) == sorted(expected)
    assert "a line that was said" in lines
    assert any("working" in line and "40/40" in line for line in lines)


def on_a_terminal(command: list[str], path: list[str]) -> str:
    """What ``command`` writes to a terminal of 120 columns."""
    ours, its = os.openpty()
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(path), "TERM": "xterm", "COLUMNS": "120"}
    process = subprocess.Popen(command, stderr=its, stdout=its, stdin=its, env=environment)
    os.close(its)
    text = b""
    while True:
        try:
            part = os.read(ours, 65536)
        except OSError:  # the terminal is gone with its last user
            break
        if not part:
            break
        text += part
    os.close(ours)
    assert process.wait() == 0, text.decode()
    return text.decode()


def test_loggers_are_named_for_their_module_and_handlers_are_the_command_lines() -> None:
    for folder in FOLDERS:
        for path in sorted((ROOT / folder).rglob("*.py")):
            for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
                text = ast.unparse(node) if isinstance(node, ast.Call) else ""
                if text.startswith("logging.getLogger(") and path.name != Path(logs.__file__).name:
                    assert text == "logging.getLogger(__name__)", path
                assert not re.match(r"logging\.(basicConfig|info|warning|error|debug)\(", text), path
                assert not (text.startswith("logging.StreamHandler(")), path
    assert cli.__name__.split(".")[0] in OURS
