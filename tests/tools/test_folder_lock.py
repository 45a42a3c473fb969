"""One process at a time writes to a folder: on Linux, on Windows, and where the file system has no locks."""

from __future__ import annotations

import errno
import logging
import os
import subprocess
import sys
import types
from pathlib import Path

import pytest

from maslam.tools import cli
from maslam.tools.common.errors import ToolError
from maslam.tools.common.folder_lock import locked
from maslam.tools.common.writing import writing, writing_whole

ROOT = Path(__file__).resolve().parents[2]
HOLD = """
import sys, time
from pathlib import Path
from maslam.tools.common.writing import writing
with writing(Path(sys.argv[1])):
    print("mine", flush=True)
    time.sleep(60)
"""


class Windows(types.ModuleType):
    """``msvcrt`` as far as locks go: a region of an open file, which a second descriptor of the file cannot lock."""

    LK_NBLCK = 2

    def __init__(self) -> None:
        super().__init__("msvcrt")
        self.held: dict[int, tuple[int, int]] = {}

    def locking(self, descriptor: int, mode: int, size: int) -> None:
        assert mode == self.LK_NBLCK and size == 1
        for other in list(self.held):  # closing a file lets go of it
            try:
                os.fstat(other)
            except OSError:
                del self.held[other]
        status = os.fstat(descriptor)
        if any(held == (status.st_dev, status.st_ino) for other, held in self.held.items() if other != descriptor):
            raise PermissionError(errno.EACCES, "Permission denied")
        self.held[descriptor] = (status.st_dev, status.st_ino)


@pytest.fixture(params=["this system", "Windows", "no locks on the folder's file system", "NFS"])
def system(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> str:
    (tmp_path / "temporary").mkdir()
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path / "temporary"))
    fcntl = pytest.importorskip("fcntl")
    if request.param == "Windows":
        monkeypatch.setitem(sys.modules, "fcntl", None)
        monkeypatch.setitem(sys.modules, "msvcrt", Windows())
        plain = os.open

        def open_no_folder(path: str | Path, flags: int, mode: int = 0o777, **more: int) -> int:
            if os.path.isdir(path):
                raise PermissionError(errno.EACCES, "Permission denied", str(path))
            return plain(path, flags, mode, **more)

        monkeypatch.setattr(os, "open", open_no_folder)
    elif request.param != "this system":
        number = errno.ENOLCK if request.param.startswith("no locks") else errno.EBADF
        whole = fcntl.flock

        def flock(descriptor: int, how: int) -> None:
            if os.path.isdir(f"/proc/self/fd/{descriptor}"):
                raise OSError(number, os.strerror(number))
            whole(descriptor, how)

        monkeypatch.setattr(fcntl, "flock", flock)
    return str(request.param)


def test_a_second_writer_is_refused_and_the_next_is_not(
    system: str, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    out = tmp_path / "out"
    with caplog.at_level(logging.WARNING), writing(out):
        with pytest.raises(ToolError, match="out: another run is writing to it; wait for its end"), writing(out):
            pass
        (tmp_path / "other").mkdir()
        with locked(tmp_path / "other"):
            pass
        (out / "result").touch()
    with writing(out):
        assert [path.name for path in out.iterdir()] == ["result"], "nothing but the result is there"
    warned = any("out: its file system has no locks" in record.message for record in caplog.records)
    assert warned == (system not in ("this system", "Windows"))


def test_a_folder_is_written_to_where_nothing_can_be_locked(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    fcntl = pytest.importorskip("fcntl")

    def no_locks(_descriptor: int, _how: int) -> None:
        raise OSError(errno.EOPNOTSUPP, "Operation not supported")

    monkeypatch.setattr(fcntl, "flock", no_locks)
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path / "gone"))
    with caplog.at_level(logging.WARNING), writing(tmp_path / "out"):
        (tmp_path / "out" / "file").touch()
    assert "cannot be locked" in caplog.text and "Operation not supported" in caplog.text


@pytest.mark.skipif(sys.platform == "win32", reason="kill")
def test_the_lock_ends_with_a_process_that_is_killed(tmp_path: Path) -> None:
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    holder = subprocess.Popen([sys.executable, "-c", HOLD, str(tmp_path)], env=environment, stdout=subprocess.PIPE)
    assert holder.stdout is not None and holder.stdout.readline() == b"mine\n"
    with pytest.raises(ToolError, match="another run"), writing(tmp_path):
        pass
    holder.kill()
    holder.wait()
    with writing(tmp_path):
        pass


def test_a_folder_made_whole_keeps_what_it_held_until_then(tmp_path: Path) -> None:
    out, stale = tmp_path / "out", tmp_path / ".out.123-4.part"
    out.mkdir()
    (out / "earlier").touch()
    stale.mkdir()
    (tmp_path / ".out.of.mine.part").touch()
    with pytest.raises(KeyboardInterrupt):
        _interrupted(out, stale)
    assert sorted(path.name for path in tmp_path.rglob("*")) == [".out.of.mine.part", "earlier", "out"]
    with writing_whole(out) as part:
        (part / "new").touch()
    assert sorted(path.name for path in tmp_path.rglob("*")) == [".out.of.mine.part", "new", "out"]


def _interrupted(out: Path, stale: Path) -> None:
    with writing_whole(out) as part:
        (part / "half").touch()
        assert not stale.exists() and part.parent == out.parent
        with pytest.raises(ToolError, match="another run"), writing_whole(out):
            pass
        raise KeyboardInterrupt


def test_two_sweeps_into_one_folder_are_refused_before_the_plan_changes(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "sweep"
    out.mkdir()
    (out / "plan.yaml").write_text("mine")
    with locked(out):
        assert cli.main(["sweep", str(out), "--experiment", "quick", "--sequences", "town", "--quiet"]) == 1
    assert capsys.readouterr().err == (
        f"maslam: {out}: another run is writing to it; wait for its end, or choose another folder\n"
    )
    assert (out / "plan.yaml").read_text() == "mine"
