"""A folder while it is written to: one run at a time, no leftovers of a run that was ended, errors that name it."""

from __future__ import annotations

import errno
import glob
import re
import shutil
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from maslam._atomic import part_stem, replacing

from .folder_lock import locked
from .folders import making

_OF_THE_DISK = {errno.ENOSPC, errno.EROFS, errno.EIO, errno.EFBIG, getattr(errno, "EDQUOT", errno.ENOSPC)}
_PART = re.compile(r"\..+\.\d+-\d+(\.old)?\.part")  # of maslam._atomic


@contextmanager
def writing(folder: Path) -> Iterator[None]:
    """``folder`` is this run's own within the block; it is made where it is not there, and goes again if nothing came
    of it. Half-written files of a run that was killed are removed before and after.

    :class:`ToolError` where another run is writing to it. An ``OSError`` that names no file names ``folder``.
    """
    try:
        with making(folder), locked(folder):
            remove_parts(folder)
            try:
                yield
            except BaseException:
                remove_parts(folder)
                raise
    except OSError as error:
        if error.filename is None and error.errno in _OF_THE_DISK:  # these tell no name
            error.filename = str(folder)
        raise


def remove_parts(folder: Path) -> None:
    """Remove what stands under a name that is not a result's yet; nobody may be writing to ``folder``."""
    for path in [path for path in folder.rglob(".*.part") if _PART.fullmatch(path.name)]:
        _remove(path)


def _remove(path: Path) -> None:
    with suppress(FileNotFoundError):
        shutil.rmtree(path) if path.is_dir() else path.unlink()


@contextmanager
def writing_whole(folder: Path) -> Iterator[Path]:
    """A new folder beside ``folder``, which takes its place when the block ends without an exception; meanwhile
    ``folder`` is this run's own, as by :func:`writing`, and keeps what it holds. What a run that was killed left beside
    it is removed."""
    place = folder.resolve()
    with writing(place):
        for path in place.parent.glob(f".{glob.escape(part_stem(place.name))}.*.part"):
            if _PART.fullmatch(path.name):
                _remove(path)
        with replacing(place) as part:
            part.mkdir()
            yield part
