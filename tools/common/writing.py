"""A folder while it is written to: one run at a time, no leftovers of a run that was ended, errors that name it."""

from __future__ import annotations

import errno
import os
import re
import shutil
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from .errors import ToolError
from .folders import making

_PART = re.compile(r"\..+\.\d+-\d+(\.old)?\.part")  # of maslam._atomic
_NO_LOCKS = {errno.ENOLCK, errno.EOPNOTSUPP, errno.ENOSYS, errno.EINVAL}  # some network file systems


@contextmanager
def writing(folder: Path) -> Iterator[None]:
    """``folder`` is this run's own within the block; it is made where it is not there, and goes again if nothing came
    of it. Half-written files of a run that was killed are removed before and after.

    :class:`ToolError` where another run is writing to it. The system lets go of the lock when a process ends, however
    that ends. An ``OSError`` that names no file names ``folder``.
    """
    try:
        with making(folder), _locked(folder):
            remove_parts(folder)
            try:
                yield
            except BaseException:
                remove_parts(folder)
                raise
    except OSError as error:
        if error.filename is None:  # a full disk tells no name
            error.filename = str(folder)
        raise


@contextmanager
def _locked(folder: Path) -> Iterator[None]:
    try:
        import fcntl
    except ImportError:  # Windows: a folder cannot be locked there
        yield
        return
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise ToolError(
                f"{folder}: another run is writing to it; wait for its end, or choose another folder"
            ) from None
        except OSError as error:
            if error.errno not in _NO_LOCKS:
                raise
        yield
    finally:
        os.close(descriptor)


def remove_parts(folder: Path) -> None:
    """Remove what stands under a name that is not a result's yet; nobody may be writing to ``folder``."""
    for path in [path for path in folder.rglob(".*.part") if _PART.fullmatch(path.name)]:
        with suppress(FileNotFoundError):
            shutil.rmtree(path) if path.is_dir() else path.unlink()
