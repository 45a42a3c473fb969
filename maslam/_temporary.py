"""Temporary folders that are kept until the program ends, however it ends: those of a program that was killed are
deleted by the next one that asks for one."""

from __future__ import annotations

import atexit
import os
import shutil
import stat
import tempfile
import time
from contextlib import suppress
from pathlib import Path

_SETTLED_S = 60.0  # a folder this young may be between being made and being locked
_held: dict[Path, tuple[int, int | None]] = {}
"""Of this process: the process that made each folder (a fork inherits the rest), and the descriptor of its lock."""


def kept_folder(prefix: str) -> Path:
    """A new temporary folder called ``prefix`` and something, for this process until it ends or
    :func:`delete_kept_folders`; left-over ones of this user and ``prefix`` go first. ``OSError`` where none can be
    made."""
    _delete_left_over(prefix)
    folder = Path(tempfile.mkdtemp(prefix=prefix))
    _held[folder] = os.getpid(), _lock(folder)
    return folder


def delete_folder(folder: Path) -> None:
    """Delete a folder of :func:`kept_folder`, in the process that made it."""
    process, lock = _held.pop(folder, (0, None))
    if process == os.getpid():
        shutil.rmtree(folder, ignore_errors=True)
        if lock is not None:
            os.close(lock)


def delete_kept_folders() -> None:
    """Delete all that this process made: to be called before ``os._exit``, which runs nothing else."""
    for folder in list(_held):
        delete_folder(folder)


atexit.register(delete_kept_folders)


def _delete_left_over(prefix: str) -> None:
    """Folders of this user and ``prefix`` that no process holds locked; none where folders cannot be locked."""
    for folder in Path(tempfile.gettempdir()).glob(f"{prefix}*"):
        with suppress(OSError):
            status = folder.lstat()
            mine = not hasattr(os, "getuid") or status.st_uid == os.getuid()
            if not stat.S_ISDIR(status.st_mode) or not mine or time.time() - status.st_mtime < _SETTLED_S:
                continue
            lock = _lock(folder)
            if lock is not None:
                shutil.rmtree(folder, ignore_errors=True)
                os.close(lock)


def _lock(folder: Path) -> int | None:
    """The descriptor that holds the folder locked; None where another process does, or locks are not to be had."""
    try:
        import fcntl
    except ImportError:  # Windows
        return None
    try:
        descriptor = os.open(folder, os.O_RDONLY)
    except OSError:
        return None
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        os.close(descriptor)
        return None
    return descriptor
