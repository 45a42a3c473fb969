"""The command line: quick to answer, and every failure is one line with the right exit code."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from maslam.tools import cli
from maslam.tools.common.errors import ToolError, UsageError
from maslam.tools.common.text_table import counted


def test_help_loads_no_library() -> None:
    heavy = {"numpy", "cv2", "rich", "pydantic"}
    code = (
        "import sys; from maslam.tools import cli; rc = cli.main(['--help']);"
        f"print(rc, sorted(set(sys.modules) & {heavy}))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.splitlines()[-1] == "0 []"
    assert all(name in done.stdout for name in cli.COMMANDS)


def test_usage_errors_exit_with_2(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main([]) == 2
    assert cli.main(["no-such-command"]) == 2
    assert cli.main(["eval"]) == 2
    assert "RUN" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("error", "code", "words"),
    [
        (ToolError("there is nothing here"), 1, "maslam: there is nothing here"),
        (UsageError("choose one"), 2, "choose one"),
        (KeyboardInterrupt(), 130, "nothing half-written; the same command goes on from what is finished"),
        (FileNotFoundError(2, "No such file or directory", "a/b"), 1, "maslam: a/b: No such file or directory"),
        (ValueError("two\nlines"), 1, "unexpected ValueError: two lines (--debug shows where)"),
    ],
)
def test_failures_are_one_line(
    error: BaseException, code: int, words: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def fail(_: object) -> None:
        raise error

    monkeypatch.setattr("maslam.tools.report.summary_table.main", fail)
    assert cli.main(["eval", "RUN"]) == code
    said = capsys.readouterr().err
    assert words in said and "Traceback" not in said


@pytest.mark.parametrize("command", ["slam a b", "preprocess a b", "render a", "sweep a", "netvlad calibrate a"])
@pytest.mark.parametrize("number", ["0", "-1"])
def test_no_workers_is_a_usage_error(command: str, number: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main([*command.split(), f"--workers={number}"]) == 2
    assert f"--workers: at least 1, not {number}" in capsys.readouterr().err


@pytest.mark.parametrize("command", ["run nope out", "eval nope", "report nope"])
def test_a_folder_that_is_not_there(
    command: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert cli.main(command.split()) == 1
    assert capsys.readouterr().err == "maslam: nope: no such folder\n"


@pytest.mark.parametrize(
    "command", ["slam a b --config", "preprocess a b --config", "run a b --config", "sweep a --plan"]
)
def test_a_settings_file_that_is_not_there(command: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main([*command.split(), "nope.yaml"]) == 2
    assert capsys.readouterr().err.splitlines()[-1] == "maslam: nope.yaml: no such file"


def test_a_size_that_cannot_be_is_said_of_the_option(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["render", str(tmp_path / "new"), "--size", "100000x100000"]) == 2
    assert "maslam: --size 100000x100000: width: input should be less than or equal to 4096" in capsys.readouterr().err


@pytest.mark.parametrize("command", ["slam", "preprocess", "run"])
def test_help_says_what_becomes_of_an_earlier_result(command: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main([command, "--help"]) == 0
    said = " ".join(capsys.readouterr().out.split())
    assert "a new folder, or an earlier" in said and "of the same" in said and "--overwrite" in said


def test_one_agent_is_no_plural() -> None:
    assert (counted(1, "agent"), counted(2, "agent"), counted(0, "agent")) == ("1 agent", "2 agents", "0 agents")
