"""A folder for matplotlib where there is neither a home nor a temporary folder."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

_VARIABLE = "MPLCONFIGDIR"


@contextmanager
def drawing_folder(beside: Path) -> Iterator[None]:
    """matplotlib ends where it can write no folder of its own: where there is none, it has one in the folder
    ``beside``, which can be written, for as long as the block lasts."""
    try:
        tempfile.gettempdir()
    except FileNotFoundError:
        pass
    else:
        yield
        return
    before = os.environ.get(_VARIABLE)
    with tempfile.TemporaryDirectory(prefix=".matplotlib-", dir=beside) as folder:
        os.environ[_VARIABLE] = before or folder
        try:
            yield
        finally:
            if before is None:
                del os.environ[_VARIABLE]
