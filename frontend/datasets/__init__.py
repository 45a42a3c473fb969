"""Data sets of many kinds behind one interface; the kind is found from the folder's contents."""

from __future__ import annotations

import logging
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

from ..cameras.models import RigKind
from ..errors import FrontendError
from ..recording_config import RecordingConfig
from .base import Dataset, ImageSequence, Problem, Reader, Severity
from .images import natural_key
from .readers import ReaderLike, choose_readers
from .selection import select

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
    recording: RecordingConfig | None = None,
) -> Dataset:
    """Open the data set in folder ``path``, or the recording that it names: one sequence, or one for each sub-folder
    ``agent_<n>``, each of any kind, or for each robot in a recording.

    ``rig``: the rig to read it as, for example stereo images as mono; None takes the most that the files allow. With
    ``strict``, the first problem that would spoil a run is raised as :class:`FrontendError`; without, problems stay
    listed in each sequence. ``readers``: a user's own, tried before ours; ``kind``: the one to read with, instead of
    the first that recognises the folder; ``recording``: which part of it is read, by default all.
    :class:`FrontendError` too where nothing in the folder is recognised.
    """
    path = Path(path)
    recording = recording or RecordingConfig()
    tried = choose_readers(readers, kind, recording)
    if not path.exists():
        raise FrontendError(f"{path}: no such folder")
    if (path / _UNFINISHED).is_file():
        raise FrontendError(f"{path}: rendering was not finished; rerun the same `maslam render` to resume")
    inside = path.iterdir() if path.is_dir() else ()
    agents = sorted((p for p in inside if p.is_dir() and _AGENT.fullmatch(p.name)), key=lambda p: natural_key(p.name))
    openers: Mapping[str, Callable[[], ImageSequence]]
    if agents:
        openers = {folder.name: partial(_open_agent, folder, rig, tried) for folder in agents}
    else:
        openers = _reader(path, tried).openers(path, rig)
    dataset = _opened(path, openers, strict, recording, bool(agents) or len(openers) > 1)
    for sequence in dataset.sequences if strict else []:
        for problem in sequence.problems:
            if problem.severity is Severity.ERROR:
                raise FrontendError(problem.message)
    frames = sum(len(sequence) for sequence in dataset.sequences)
    log.info("%s: %s, %d sequences, %d frames", path, dataset.kind, len(dataset.sequences), frames)
    return dataset


def _opened(
    path: Path,
    openers: Mapping[str, Callable[[], ImageSequence]],
    strict: bool,
    recording: RecordingConfig,
    agents: bool,
) -> Dataset:
    """All sequences that can be opened; an error where none can, and with ``strict`` for the first that cannot."""
    sequences, problems = [], []
    for number, (name, opener) in enumerate(openers.items(), 1):
        try:
            sequence = select(opener(), recording)
            sequences.append(replace(sequence, name=name) if agents else sequence)
        except FrontendError as error:
            if strict or (number == len(openers) and not sequences):
                raise
            problems.append(Problem(Severity.ERROR, str(error)))
    kinds = ", ".join(sorted({sequence.kind for sequence in sequences}))
    return Dataset(f"agents ({kinds})" if agents else kinds, path, sequences, tuple(problems))


def _open_agent(folder: Path, rig: RigKind | None, readers: Sequence[Reader]) -> ImageSequence:
    openers = _reader(folder, readers).openers(folder, rig)
    if len(openers) > 1:
        raise FrontendError(f"{folder}: {len(openers)} sequences ({', '.join(openers)}), one is expected for an agent")
    return next(iter(openers.values()))()


def _reader(path: Path, readers: Sequence[Reader]) -> Reader:
    if path.is_file():
        suffix = path.suffix.lower()
        for reader in readers:
            if suffix in reader.suffixes:
                return reader
        known = sorted(suffix for reader in readers for suffix in reader.suffixes)
        raise FrontendError(f"{path}: not a folder, and no recording of a known kind ({', '.join(known)})")
    for reader in readers:
        if reader.recognises(path):
            return reader
    raise FrontendError(f"{path}: {_why_unknown(path, readers)}")


def _why_unknown(folder: Path, readers: Sequence[Reader]) -> str:
    inside = sorted((p for p in folder.iterdir() if p.is_dir()), key=lambda p: natural_key(p.name))
    usable = [p.name for p in inside if any(reader.recognises(p) for reader in readers)]
    if usable:
        return f"holds several sequences ({', '.join(usable[:5])}{', …' if len(usable) > 5 else ''}); name one of them"
    return f"no images of a known layout here ({', '.join(reader.kind for reader in readers)})"
