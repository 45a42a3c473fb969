"""Data sets of many kinds behind one interface; the kind is found from the folder's contents."""

from __future__ import annotations

import logging
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

from ..cameras.models import RigKind
from ..errors import FrontendError
from ..recording_config import RecordingConfig
from .base import Dataset, ImageSequence, Problem, Reader, Severity
from .content import look_into
from .image_headers import UNREAD, not_read
from .readers import ReaderLike, choose_readers
from .reading_config import ReadingConfig
from .recordings.films import FilmReader, robots_note
from .robots import SubFolders, agent_folders, only_sequence, sub_folders, without_images
from .selection import select
from .unread_sources import cure_of_file, hint_in

__all__ = ["Dataset", "ImageSequence", "Problem", "Reader", "ReadingConfig", "Severity", "open_dataset"]

log = logging.getLogger(__name__)
_UNFINISHED = "unfinished.json"
"""What ``maslam render`` leaves in a folder until it is complete."""
_AS_IT_IS = ReadingConfig()
_SHOWN = 5


@dataclass(frozen=True)
class _How:
    """How sequences are opened: the arguments of :func:`open_dataset`."""

    rig: RigKind | None
    strict: bool
    readers: Sequence[Reader]
    recording: RecordingConfig
    reading: ReadingConfig


def open_dataset(
    path: Path,
    rig: RigKind | None = None,
    strict: bool = True,
    readers: Sequence[ReaderLike] = (),
    kind: str | None = None,
    recording: RecordingConfig | None = None,
    reading: ReadingConfig = _AS_IT_IS,
) -> Dataset:
    """Open the data set in folder ``path``, or the recording that it names: one sequence, or one for each sub-folder
    that is a robot, each of any kind, or for each robot in a recording.

    Sub-folders ``agent_<n>`` are robots; where there are none and ``path`` is no sequence itself, those that hold
    images and are called neither as cameras nor as recordings are (see :func:`~.robots.sub_folders`).
    ``rig``: the rig to read it as, for example stereo images as mono; None takes the most that the files allow. With
    ``strict``, the first problem that would spoil a run is raised as :class:`FrontendError`; without, problems stay
    listed in each sequence. ``readers``: a user's own, tried before ours; ``kind``: the one to read with, instead of
    the first that recognises the folder; ``recording``: which part of it is read, by default all. ``reading``: masks,
    and how folders and images are to be understood.
    :class:`FrontendError` too where nothing in the folder is recognised.
    """
    path = Path(path)
    recording = recording or RecordingConfig()
    tried = choose_readers(readers, kind, recording)
    if not path.exists():
        raise FrontendError(f"{path}: no such folder")
    if (path / _UNFINISHED).is_file():
        raise FrontendError(f"{path}: rendering was not finished; rerun the same `maslam render` to resume")
    how = _How(rig, strict, tried, recording, reading)
    agents = agent_folders(path) if path.is_dir() else []
    recognised = path.is_file() or any(reader.recognises(path) for reader in tried)
    if agents:
        dataset = _open_folders(path, agents, how)
        others = ["its own images"] * recognised + [p.name for p in sub_folders(path, tried).robots if p not in agents]
        note = f"{_names(others)} beside {agents[0].name}: not read; where folders agent_<n> are, only these are robots"
        dataset = replace(dataset, notes=(note,) if others else ())
    elif recognised and not reading.robots:
        reader = _reader(path, tried)
        openers = reader.openers(path, rig)
        looked = {name: partial(_looked, opener, path, how) for name, opener in openers.items()}
        dataset = _opened(path, looked, strict, len(openers) > 1)
        if len(openers) > 1 and reader.kind == FilmReader.kind:
            dataset = replace(dataset, notes=(robots_note(list(openers)),))
    else:
        dataset = _open_robots(path, how)
    for sequence in dataset.sequences if strict else []:
        for problem in sequence.problems:
            if problem.severity is Severity.ERROR:
                raise FrontendError(problem.message)
    frames = sum(len(sequence) for sequence in dataset.sequences)
    log.info("%s: %s, %d sequences, %d frames", path, dataset.kind, len(dataset.sequences), frames)
    return dataset


def _opened(path: Path, openers: Mapping[str, Callable[[], ImageSequence]], strict: bool, agents: bool) -> Dataset:
    """All sequences that can be opened; an error where none can, and with ``strict`` for the first that cannot."""
    sequences, problems = [], []
    for number, (name, opener) in enumerate(openers.items(), 1):
        try:
            sequence = opener()
            sequences.append(replace(sequence, name=name) if agents else sequence)
        except FrontendError as error:
            if strict or (number == len(openers) and not sequences):
                raise
            problems.append(Problem(Severity.ERROR, str(error)))
    kinds = ", ".join(sorted({sequence.kind for sequence in sequences}))
    return Dataset(f"agents ({kinds})" if agents else kinds, path, sequences, tuple(problems))


def _looked(opener: Callable[[], ImageSequence], folder: Path, how: _How) -> ImageSequence:
    """The part that is read of the sequence, with what its files say."""
    return look_into(select(opener(), how.recording), folder, how.reading)


def _open_folders(path: Path, folders: Sequence[Path], how: _How) -> Dataset:
    """A robot for each of ``folders``."""
    return _opened(path, {folder.name: partial(_open_agent, folder, how) for folder in folders}, how.strict, True)


def _open_agent(folder: Path, how: _How) -> ImageSequence:
    known = any(reader.recognises(folder) for reader in how.readers)
    inside = folder if known else only_sequence(folder, how.readers) or folder
    openers = _reader(inside, how.readers).openers(inside, how.rig)
    if len(openers) > 1:
        raise FrontendError(f"{folder}: {len(openers)} sequences ({', '.join(openers)}), one is expected for an agent")
    opener = next(iter(openers.values()))
    return _looked(lambda: replace(opener(), name=folder.name), inside, how)


def _open_robots(path: Path, how: _How) -> Dataset:
    """The sub-folders that are robots, by their names or because ``reading`` says so; or the only sequence inside."""
    readers, robots = how.readers, how.reading.robots
    found, only = sub_folders(path, readers), None if robots else only_sequence(path, readers)
    if only is not None:
        dataset = _opened(path, {only.name: partial(_open_agent, only, how)}, how.strict, False)
        left_out = _left_out(path, [only], readers) if only in found.robots else []
        return replace(dataset, notes=(f"{only} is the only sequence in it",), problems=tuple(left_out))
    taken = found.all if robots else found.robots
    if not taken or (not robots and (len(taken) < 2 or found.cameras)):
        raise FrontendError(f"{path}: {_why_unknown(path, found, readers)}")
    others = [p.name for p in found.all if p not in taken]
    note = f"a robot for each of {len(taken)} folders: {_names([p.name for p in taken])}"
    note += f"; not {_names(others)}, which by the name is no robot (--images.robots true takes all)" if others else ""
    dataset = _open_folders(path, taken, how)
    return replace(dataset, notes=(note,), problems=(*dataset.problems, *_left_out(path, taken, readers)))


def _left_out(path: Path, taken: Sequence[Path], readers: Sequence[Reader]) -> list[Problem]:
    """A warning for each folder that seems to be a robot's and holds no images beside those ``taken``."""
    return [
        Problem(
            Severity.WARNING,
            f"{p}: no robot, left out: {_foreign(p) or 'no images of a known layout directly in it'}",
        )
        for p in without_images(path, taken, readers)
    ]


def _reader(path: Path, readers: Sequence[Reader]) -> Reader:
    if path.is_file():
        suffix = path.suffix.lower()
        for reader in readers:
            if suffix in reader.suffixes:
                return reader
        known = sorted(suffix for reader in readers for suffix in reader.suffixes)
        cure = cure_of_file(path)
        raise FrontendError(
            f"{path}: not a folder, and no recording of a known kind ({', '.join(known)}){cure and f': {cure}'}"
        )
    for reader in readers:
        if reader.recognises(path):
            return reader
    raise FrontendError(f"{path}: {_why_unknown(path, sub_folders(path, readers), readers)}")


def _why_unknown(folder: Path, found: SubFolders, readers: Sequence[Reader]) -> str:
    """Why nothing can be read from ``folder``, and what helps."""
    names = [p.name for p in found.all]
    if len(names) == 1:
        return f"holds one sequence, {names[0]}; name it"
    if found.cameras and not found.recordings:
        return (
            f"holds folders of images ({_names(names)}) that seem to be the cameras of one sequence; name one of them, "
            "or call them left and right (or image_0 and depth_0) and put the calibration beside them; if each is a "
            "robot, --images.robots true takes them as such"
        )
    if names:
        return (
            f"holds several sequences ({_names(names)}); name one of them, or take each as a robot: "
            "--images.robots true"
        )
    foreign = _foreign(folder) or hint_in(folder)
    if foreign:
        return foreign
    return f"no images of a known layout here ({', '.join(reader.kind for reader in readers)})"


def _foreign(folder: Path) -> str:
    """What to say of a folder of pictures in formats that are not read; empty where there are none."""
    for place in (folder, *sorted(p for p in folder.iterdir() if p.is_dir())):
        kinds = Counter(UNREAD[p.suffix.lower()] for p in place.iterdir() if p.suffix.lower() in UNREAD)
        for kind, count in kinds.most_common(1):
            inside = "" if place == folder else f"{place.name} holds "
            return f"{inside}{count} file{'s'[count == 1 :]}, each {not_read(kind)}"
    return ""


def _names(names: Sequence[str]) -> str:
    return ", ".join(names[:_SHOWN]) + (", …" if len(names) > _SHOWN else "")
