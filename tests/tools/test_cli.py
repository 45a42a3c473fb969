"""The command line: quick to answer, and every failure is one line with the right exit code."""

from __future__ import annotations

import subprocess
import sys

import pytest

from maslam.tools import cli
from maslam.tools.common.errors import ToolError, UsageError


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
        (KeyboardInterrupt(), 130, "interrupted"),
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
