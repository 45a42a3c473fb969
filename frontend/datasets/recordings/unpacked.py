"""Files of bags that are compressed as a whole: unpacked for as long as the program runs."""

from __future__ import annotations

import shutil
import tempfile
from pathlib import Path

from maslam._temporary import delete_folder, kept_folder

from ...errors import FrontendError

PACKED_SUFFIXES = frozenset({".zstd", ".zst"})
_copies: dict[Path, tuple[int, int, Path]] = {}
"""Of each file: when it was changed, its size, and the folder of its copy."""


def unpacked(path: Path) -> Path:
    """A copy of the file as it was before zstd compressed it, in a temporary folder, which is deleted when the process
    ends that asked first. :class:`FrontendError` where the file is damaged or the disk is full."""
    status = path.stat()
    key = path.resolve()
    changed_ns, size, folder = _copies.get(key, (0, 0, None))
    if folder is None or (changed_ns, size) != (status.st_mtime_ns, status.st_size):
        if folder is not None:
            delete_folder(folder)
            del _copies[key]
        folder = _unpack(path)
        _copies[key] = status.st_mtime_ns, status.st_size, folder
    return folder / path.stem


def _unpack(path: Path) -> Path:
    folder: Path | None = None
    whole = False
    try:
        folder = kept_folder("maslam-bag-")
        with _zstd().open(path, "rb") as packed, open(folder / path.stem, "wb") as copy:
            shutil.copyfileobj(packed, copy)
        whole = True
    except OSError as error:
        raise FrontendError(
            f"{path}: cannot be unpacked to {tempfile.gettempdir()}: {error.strerror or error}; TMPDIR names another "
            "folder, or unpack the file yourself (`unzstd`), and delete compression_format and compression_mode in "
            "metadata.yaml"
        ) from error
    except Exception as error:  # of the library's own kinds
        raise FrontendError(f"{path}: not a whole file that zstd compressed: {error}") from error
    finally:
        if folder is not None and not whole:
            delete_folder(folder)
    return folder


def _zstd():  # type: ignore[no-untyped-def]
    """The package that rosbags brings along, or Python itself from 3.14 on."""
    try:
        from compression import zstd
    except ImportError:
        from backports import zstd
    return zstd
