"""Folders that the user names: what is refused before any work."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path

from .errors import ToolError


def check_apart(source: Path, out: Path) -> None:
    """Refuse ``out`` where it is ``source``, would be read as one of its agents, or is a file.

    Another new folder inside ``source`` is free; what is there already is looked at by who writes to it.
    """
    if out.exists() and not out.is_dir():
        raise ToolError(f"{out}: is a file, not a folder")
    if out.resolve() == source.resolve():
        raise ToolError(f"{out}: is the folder of the images; choose another folder for the results")
    if out.resolve().parent == source.resolve() and out.name.startswith("agent"):
        raise ToolError(f"{out}: would be read as an agent of {source}; choose another folder for the results")


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


def check_file(path: Path, source: Path, suffixes: Sequence[str]) -> None:
    """Refuse, before the work, a file to write that is a folder, lacks the suffix, or is one of ``source``'s."""
    if path.is_dir():
        raise ToolError(f"{path}: is a folder; a file is meant")
    if path.suffix.lower() not in suffixes:
        raise ToolError(f"{path}: the name of the file to write ends in {' or '.join(suffixes)}")
    place, read = path.resolve(), source.resolve()
    if place == read or (path.exists() and path.suffix not in (".yaml", ".yml") and read in place.parents):
        raise ToolError(f"{path}: is one of the files that are read; choose another name")
