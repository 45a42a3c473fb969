"""Files of bags that are compressed as a whole: unpacked for as long as the program runs."""

from __future__ import annotations

import shutil
import tempfile
from functools import cache
from pathlib import Path

from ...errors import FrontendError

PACKED_SUFFIXES = frozenset({".zstd", ".zst"})


def unpacked(path: Path) -> Path:
    """A copy of the file as it was before zstd compressed it, in a temporary folder, which is deleted when the process
    ends that asked first. :class:`FrontendError` where the file is damaged or the disk is full."""
    status = path.stat()
    return Path(_unpacked(path, status.st_mtime_ns, status.st_size).name) / path.stem


@cache  # its values delete their folders when the process ends
def _unpacked(path: Path, changed_ns: int, size: int) -> tempfile.TemporaryDirectory[str]:
    folder = tempfile.TemporaryDirectory(prefix="maslam-bag-", ignore_cleanup_errors=True)
    try:
        with _zstd().open(path, "rb") as packed, open(Path(folder.name) / path.stem, "wb") as copy:
            shutil.copyfileobj(packed, copy)
    except OSError as error:
        raise FrontendError(
            f"{path}: cannot be unpacked to {tempfile.gettempdir()}: {error.strerror or error}; TMPDIR names another "
            "folder, or unpack the file yourself (`unzstd`), and delete compression_format and compression_mode in "
            "metadata.yaml"
        ) from error
    except Exception as error:  # of the library's own kinds
        folder.cleanup()
        raise FrontendError(f"{path}: not a whole file that zstd compressed: {error}") from error
    return folder


def _zstd():  # type: ignore[no-untyped-def]
    """The package that rosbags brings along, or Python itself from 3.14 on."""
    try:
        from compression import zstd
    except ImportError:
        from backports import zstd
    return zstd
