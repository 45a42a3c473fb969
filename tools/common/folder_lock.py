"""A folder for one process at a time: the system lets go of the lock when a process ends, however that ends."""

from __future__ import annotations

import errno
import hashlib
import logging
import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from .errors import ToolError

log = logging.getLogger(__name__)
_TAKEN_WINDOWS = {errno.EACCES, errno.EDEADLK}


@contextmanager
def locked(folder: Path) -> Iterator[None]:
    """``folder``, which is there, is this process's own within the block; :class:`ToolError` where another has it.

    Linux and macOS lock the folder itself. Windows locks a file of the temporary folder, named after the folder; so
    does any system where the folder's file system has no locks, with a warning: other machines do not see that one.
    """
    descriptor = _lock_itself(folder)
    if descriptor is None:
        descriptor = _lock_substitute(folder)
    try:
        yield
    finally:
        if descriptor is not None:
            os.close(descriptor)


def _lock_itself(folder: Path) -> int | None:
    """The open folder, locked; None where it cannot be."""
    try:
        import fcntl
    except ImportError:  # Windows opens no folder
        return None
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        os.close(descriptor)
        raise _taken(folder) from None
    except OSError as error:  # network file systems: ENOLCK, EOPNOTSUPP, EBADF where a folder cannot be opened to write
        os.close(descriptor)
        log.warning(
            "%s: its file system has no locks (%s): see to it that no other machine writes there meanwhile",
            folder,
            error.strerror,
        )
        return None
    return descriptor


def _lock_substitute(folder: Path) -> int | None:
    """A locked file that stands for ``folder`` on this machine, and stays there, empty: removing it would be a race.
    None where the temporary folder cannot be written to."""
    name = hashlib.sha256(os.fsencode(os.path.normcase(folder.resolve()))).hexdigest()[:24]
    path = Path(tempfile.gettempdir()) / f"maslam-lock-{name}"
    try:
        descriptor = os.open(path, os.O_RDWR | os.O_CREAT | getattr(os, "O_NOFOLLOW", 0), 0o600)
    except OSError as error:
        log.warning("%s: cannot be locked (%s: %s): see to it that nothing else writes there", folder, path, error)
        return None
    try:
        _lock_file(descriptor)
    except BlockingIOError:
        os.close(descriptor)
        raise _taken(folder) from None
    except OSError as error:
        os.close(descriptor)
        log.warning("%s: cannot be locked (%s): see to it that nothing else writes there", folder, error)
        return None
    return descriptor


def _lock_file(descriptor: int) -> None:
    """Lock an open file; ``BlockingIOError`` where another process has. Nothing where this Python has no means to."""
    try:
        import fcntl
    except ImportError:
        pass
    else:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        return
    try:
        import msvcrt
    except ImportError:
        return
    lock, at_once = msvcrt.locking, msvcrt.LK_NBLCK  # type: ignore[attr-defined]
    try:
        lock(descriptor, at_once, 1)
    except OSError as error:
        if error.errno in _TAKEN_WINDOWS:
            raise BlockingIOError(error.errno, error.strerror) from error
        raise


def _taken(folder: Path) -> ToolError:
    return ToolError(f"{folder}: another run is writing to it; wait for its end, or choose another folder")
