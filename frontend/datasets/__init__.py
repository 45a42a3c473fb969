"""Data sets of many kinds behind one interface; the kind is found from the folder's contents."""

from __future__ import annotations

import logging
import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from ..cameras.models import RigKind
from ..errors import FrontendError
from .base import Dataset, ImageSequence, Problem, Reader, Severity
from .images import natural_key
from .readers import ReaderLike, choose_readers

__all__ = ["Dataset", "ImageSequence", "Problem", "Reader", "Severity", "open_dataset"]

log = logging.getLogger(__name__)
_UNFINISHED = "unfinished.json"
"""What ``maslam render`` leaves in a folder until it is complete."""
_AGENT = re.compile(r"agent_\d+")


def open_dataset(
    path: Path,
    rig: RigKind | None = None,
    strict: bool = True,
    readers: Sequence[ReaderLike] = (),
    kind: str | None = None,
) -> Dataset:
    """Open the data set in folder ``path``: one sequence, or one for each sub-folder ``agent_<n>``, each of any kind.

    ``rig``: the rig to read it as, for example stereo images as mono; None takes the most that the files allow. With
    ``strict``, the first problem that would spoil a run is raised as :class:`FrontendError`; without, problems stay
    listed in each sequence. ``readers``: a user's own, tried before ours; ``kind``: the one to read with, instead of
    the first that recognises the folder. :class:`FrontendError` too where nothing in the folder is recognised.
    """
    path = Path(path)
    tried = choose_readers(readers, kind)
    if not path.is_dir():
        raise FrontendError(f"{path}: {'not a folder' if path.exists() else 'no such folder'}")
    if (path / _UNFINISHED).is_file():
        raise FrontendError(f"{path}: rendering was not finished; rerun the same `maslam render` to resume")
    agents = sorted(
        (p for p in path.iterdir() if p.is_dir() and _AGENT.fullmatch(p.name)), key=lambda p: natural_key(p.name)
    )
    if agents:
        dataset = _open_agents(path, agents, rig, strict, tried)
    else:
        reader = _reader(path, tried)
        dataset = Dataset(reader.kind, path, [reader.open(path, rig)])
    for sequence in dataset.sequences if strict else []:
        for problem in sequence.problems:
            if problem.severity is Severity.ERROR:
                raise FrontendError(problem.message)
    frames = sum(len(sequence) for sequence in dataset.sequences)
    log.info("%s: %s, %d sequences, %d frames", path, dataset.kind, len(dataset.sequences), frames)
    return dataset


def _open_agents(
    path: Path, folders: list[Path], rig: RigKind | None, strict: bool, readers: Sequence[Reader]
) -> Dataset:
    """All agents that can be opened; an error where none can, and with ``strict`` for the first that cannot."""
    sequences, problems = [], []
    for folder in folders:
        try:
            sequences.append(replace(_reader(folder, readers).open(folder, rig), name=folder.name))
        except FrontendError as error:
            if strict or (folder is folders[-1] and not sequences):
                raise
            problems.append(Problem(Severity.ERROR, str(error)))
    kinds = ", ".join(sorted({sequence.kind for sequence in sequences}))
    return Dataset(f"agents ({kinds})", path, sequences, tuple(problems))


def _reader(folder: Path, readers: Sequence[Reader]) -> Reader:
    for reader in readers:
        if reader.recognises(folder):
            return reader
    raise FrontendError(f"{folder}: {_why_unknown(folder, readers)}")


def _why_unknown(folder: Path, readers: Sequence[Reader]) -> str:
    inside = sorted((p for p in folder.iterdir() if p.is_dir()), key=lambda p: natural_key(p.name))
    usable = [p.name for p in inside if any(reader.recognises(p) for reader in readers)]
    if usable:
        return f"holds several sequences ({', '.join(usable[:5])}{', …' if len(usable) > 5 else ''}); name one of them"
    return f"no images of a known layout here ({', '.join(reader.kind for reader in readers)})"
