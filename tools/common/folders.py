"""Folders that the user names: what is refused before any work."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from .errors import ToolError


def check_apart(source: Path, out: Path) -> None:
    """Refuse results among the images: ``out`` may not be ``source``, inside it, or a file."""
    if out.exists() and not out.is_dir():
        raise ToolError(f"{out}: is a file, not a folder")
    if out.resolve() == source.resolve():
        raise ToolError(f"{out}: is the folder of the images; choose another folder for the results")
    if out.resolve().is_relative_to(source.resolve()):
        raise ToolError(f"{out}: is inside the folder of the images, {source}; choose a folder outside it")


@contextmanager
def making(folder: Path) -> Iterator[None]:
    """Make ``folder`` and those above it; where the block raises, the new ones that are still empty go again."""
    new = [path for path in (folder, *folder.parents) if not path.exists()]
    folder.mkdir(parents=True, exist_ok=True)
    try:
        yield
    except BaseException:
        with suppress(OSError):  # one that is not empty stays, and so do those above it
            for path in new:
                path.rmdir()
        raise
