"""The folder above another one, named as its user named that."""

from __future__ import annotations

from pathlib import Path


def folder_above(folder: Path) -> Path:
    """The folder that ``folder`` lies in, where the disk has it; relative where ``folder`` is."""
    written = folder.parent if folder.name not in ("", "..") else folder / ".."
    real = folder.resolve().parent
    return written if written.resolve() == real else real
