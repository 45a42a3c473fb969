"""An earlier RUN folder as the beginning of a later run: its agents are there from the start and answer.

They keep their numbers, so that their frames and matches keep their names; the later run's agents are numbered after
them. Their sequences are looked for beside the run (``sequences/``, of a run onto an earlier one also ``earlier/``),
and kept beside the later run, which can be the beginning of the next one.
"""

from __future__ import annotations

import shutil
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from maslam._atomic import replacing
from maslam._replaced import replaced

from ..errors import MasError
from ..manifest import AgentEntry, Manifest, read_manifest, write_manifest
from ..sequence import AgentSequence, load_agent
from .run_folder import EARLIER, SEQUENCES, SUMMARY
from .saved_agent import SAVED, SavedAgent, read_saved


@dataclass(frozen=True, eq=False)
class EarlierRun:
    """A finished run. ``manifest``: of its agents, each with the folder its images came from; ``folders``: of their
    sequences; ``known``: what each knew at its end."""

    folder: Path
    manifest: Manifest
    sequences: tuple[AgentSequence, ...]
    folders: tuple[Path, ...]
    known: tuple[SavedAgent, ...]


def read_earlier_run(folder: Path) -> EarlierRun:
    """The run in ``folder``; ``MasError`` where there is none, or not all of it."""
    if not (folder / SUMMARY).is_file():
        raise MasError(f"{folder}: no {SUMMARY}: not the folder of a run, or the run did not finish")
    manifest = read_manifest(folder)
    parts = [(part, read_manifest(part)) for name in (EARLIER, SEQUENCES) if (part := folder / name).is_dir()]
    if not parts:
        raise MasError(f"{folder}: its agent sequences are not beside it: copy the folder SEQS to {folder / SEQUENCES}")
    stored = [(part, its, entry) for part, its in parts for entry in its.agents]
    if [_made(entry) for _, _, entry in stored] != [_made(entry) for entry in manifest.agents]:
        names = ", ".join(str(part) for part, _ in parts)
        raise MasError(f"{names}: not the agent sequences that the run was made of")
    agents, sequences, folders = [], [], []
    for (part, its, entry), own in zip(stored, manifest.agents, strict=True):
        read = load_agent(part / entry.name, entry, its)
        source = own.source or manifest.source
        scale = entry.scale if read.metric == entry.metric else "arbitrary"
        agents.append(replaced(own, source=source, scale=scale))
        sequences.append(replace(read, name=own.name))
        folders.append(part / entry.name)
    known = tuple(read_saved(folder / entry.name / SAVED) for entry in agents)
    whole = replaced(manifest, agents=tuple(agents))
    return EarlierRun(folder, whole, tuple(sequences), tuple(folders), known)


def _made(entry: AgentEntry) -> tuple[object, ...]:
    """What an agent's sequence is known by, whatever its number."""
    return (entry.sequence, entry.first_frame, entry.frames, entry.keyframes, entry.tracks, entry.start_ns)


def joined_manifest(earlier: EarlierRun, manifest: Manifest) -> Manifest:
    """The earlier agents, then those of ``manifest``, which get other names; ``MasError`` where the two do not go
    together."""
    before, now = earlier.manifest.descriptor, manifest.descriptor
    if (before.sha256, before.dim) != (now.sha256, now.dim):
        raise MasError(
            f"{earlier.folder}: made with place descriptor {before.name} ({before.sha256[:12]}), "
            f"not {now.name} ({now.sha256[:12]})"
        )
    origins = [m.settings.get("gps", {}).get("origin") for m in (earlier.manifest, manifest)]
    if None not in origins and origins[0] != origins[1]:
        raise MasError(f"{earlier.folder}: its positions count from {origins[0]}, those of this run from {origins[1]}")
    first, metric = len(earlier.manifest.agents), [m.scale == "metric" for m in (earlier.manifest, manifest)]
    own = [
        replaced(
            entry,
            name=f"agent_{first + k:02d}",
            scale=entry.scale if metric[1] or not entry.metric else "arbitrary",
        )
        for k, entry in enumerate(manifest.agents)
    ]
    settings = {**manifest.settings, "onto": str(earlier.folder.resolve())}
    if origins[1] is None and origins[0] is not None:
        settings["gps"] = earlier.manifest.settings["gps"]
    return replaced(
        manifest,
        agents=(*earlier.manifest.agents, *own),
        scale="metric" if any(metric) else "arbitrary",
        settings=settings,
    )


def joined_sequences(earlier: EarlierRun, manifest: Manifest, own: Sequence[AgentSequence]) -> list[AgentSequence]:
    """The sequences of a joined ``manifest``. Two recordings of one name in other folders are not one: a frame is known
    by its recording."""
    first = len(earlier.sequences)
    before = [
        replace(sequence, source=_recording(sequence.source, entry, manifest))
        for sequence, entry in zip(earlier.sequences, manifest.agents[:first], strict=True)
    ]
    return before + [replace(s, name=e.name) for s, e in zip(own, manifest.agents[first:], strict=True)]


def _recording(name: str, entry: AgentEntry, manifest: Manifest) -> str:
    return name if entry.source in (None, manifest.source) else f"{name} of {entry.source}"


def keep_earlier(earlier: EarlierRun, out: Path) -> None:
    """Copy the earlier agents' sequences beside the run ``out``, whole or not at all."""
    out.mkdir(parents=True, exist_ok=True)
    with replacing(out / EARLIER) as part:
        part.mkdir()
        for entry, folder in zip(earlier.manifest.agents, earlier.folders, strict=True):
            shutil.copytree(folder, part / entry.name)
        write_manifest(part, earlier.manifest)
