"""Machines with little of something: shared memory, processes, open files; and names as long as they get."""

from __future__ import annotations

import errno
import logging
import os
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from maslam._atomic import replacing, write_atomically
from maslam.tools.common import parallel
from maslam.tools.common.errors import ToolError, describe
from maslam.tools.common.progress import Silent
from maslam.tools.common.writing import writing, writing_whole

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="what Linux may lack")


def square(number: int, advance: Callable[[int], None]) -> int:
    return number**2


def touch(path: Path) -> None:
    path.touch(exist_ok=False)


@pytest.fixture(params=["no shared memory", "no semaphores in this Python", "no further process", "few open files"])
def scarce(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> str:
    import multiprocessing.util
    from multiprocessing.context import BaseContext

    def fail(error: Exception) -> Callable[..., Any]:
        def failing(*_: object, **__: object) -> None:
            raise error

        return failing

    if request.param == "no shared memory":
        monkeypatch.setattr(BaseContext, "Queue", fail(OSError(errno.EROFS, "Read-only file system")))
        return "/dev/shm (docker: --shm-size): Read-only file system"
    if request.param == "no semaphores in this Python":
        monkeypatch.setattr(BaseContext, "Queue", fail(ImportError("This platform lacks a functioning sem_open")))
        return "/dev/shm"
    number, words = {
        "no further process": (errno.EAGAIN, "the system starts no further process or thread: allow more (ulimit -u)"),
        "few open files": (errno.EMFILE, "too many files are open at once: allow more (ulimit -n 1024)"),
    }[request.param]
    monkeypatch.setattr(multiprocessing.util, "spawnv_passfds", fail(OSError(number, os.strerror(number))))
    return words


def test_without_worker_processes_this_one_does_the_work(
    scarce: str, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    with caplog.at_level(logging.WARNING):
        done = parallel.run_jobs(square, {f"job {k}": (k, 1) for k in range(5)}, 2, Silent())
    assert [outcome.result for outcome in done.values()] == [0, 1, 4, 9, 16]
    assert f"no worker processes can be started: {scarce}" in caplog.text
    assert "this one does all the work" in caplog.text
    assert len(list(parallel.each_finished(touch, (tmp_path / str(k) for k in range(9)), 2))) == 9
    assert len(list(tmp_path.iterdir())) == 9
    with pytest.raises(ToolError, match="no worker processes can be started"):
        parallel.run_jobs(square, {"a": (1, 1)}, 1, Silent(), fresh=True)


@pytest.mark.parametrize("name", ["x" * 255, "ü" * 127, "界" * 85])
def test_names_may_be_as_long_as_the_file_system_lets_them(name: str, tmp_path: Path) -> None:
    assert len(os.fsencode(name)) in (254, 255)
    write_atomically(tmp_path / name, "one")
    with pytest.raises(TypeError), replacing(tmp_path / name) as part:
        part.write_text(None)  # type: ignore[arg-type]  # whatever ends it
    assert [(path.name, path.read_text()) for path in tmp_path.iterdir()] == [(name, "one")]
    (tmp_path / name).unlink()
    stale = tmp_path / f".{name[:60]}.7-7.part"
    with writing_whole(tmp_path / name) as part:
        (part / "file").touch()
        stale = part.with_name(part.name.replace(str(os.getpid()), "7"))
        stale.mkdir()
    with writing_whole(tmp_path / name):
        assert not stale.exists(), "left by a run that was killed"
    assert [path.name for path in tmp_path.iterdir()] == [name]


def test_the_folder_is_not_blamed_for_what_the_process_lacks(tmp_path: Path) -> None:
    with pytest.raises(OSError) as few, writing(tmp_path / "out"):  # noqa: PT011 - its number is looked at
        raise OSError(errno.EMFILE, os.strerror(errno.EMFILE))
    assert describe(few.value).startswith("too many files are open at once: allow more (ulimit -n 1024)")
    with pytest.raises(OSError) as full, writing(tmp_path / "out"):  # noqa: PT011
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
    assert describe(full.value) == f"{tmp_path / 'out'}: No space left on device"


def test_little_memory_is_no_unexpected_error() -> None:
    for error in (MemoryError(), ImportError("cv2.abi3.so: failed to map segment from shared object")):
        assert describe(error).startswith("out of memory (ulimit -v, or the container's limit?)")
