"""Fingerprints of files: whether what a result was made from is still the same."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable
from pathlib import Path

ROOT = Path(__file__).parent.parent.parent
_SUFFIXES = {".py", ".npz", ".onnx", ".json"}


def digest_of(files: Iterable[Path], root: Path) -> str:
    """SHA-256 of the files' names under ``root`` and of their contents, in sorted order."""
    digest = hashlib.sha256()
    for path in sorted(files):
        digest.update(path.relative_to(root).as_posix().encode() + b"\0" + path.read_bytes())
    return digest.hexdigest()


def code_digest(*parts: str) -> str:
    """Of the sources and shipped models in ``parts`` of the program, folders or files."""
    files = [ROOT / part for part in parts if (ROOT / part).is_file()]
    for part in parts:
        files += [path for path in (ROOT / part).rglob("*") if path.suffix in _SUFFIXES]
    return digest_of(files, ROOT)


def sequences_digest(folder: Path) -> str:
    """Of a SEQS folder: its manifest and everything its agents are given."""
    from maslam.mas.manifest import MANIFEST

    files = [path for path in folder.glob("agent_*/*") if path.is_file()]
    return digest_of([folder / MANIFEST, *files], folder)
