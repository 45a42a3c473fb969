"""Going on where an agent's process ended: its journal makes the agent what it was."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from .journal import EntryKind, JournalError, read_journal
from .one_agent import digest_of
from .recorded_agent import AgentInputs, replay


@dataclass(frozen=True)
class Resumed:
    """``now_ns``: logical time of the last entry, 0 where there is none; ``begun``: how often a process has begun."""

    now_ns: int
    begun: int


def resume(inputs: AgentInputs, journal: Path) -> Resumed:
    """Give an agent all that its journal holds; :class:`~.journal.JournalError` where that is another agent's, or of
    other settings."""
    if not journal.exists():
        return Resumed(0, 0)
    now_ns, begun = 0, 0
    digest = digest_of(inputs)
    for one in replay(inputs, read_journal(journal), str(journal)):
        now_ns = one.entry.now_ns
        if one.entry.kind is EntryKind.BEGIN:
            begun += 1
            if one.entry.data != digest:
                raise JournalError(f"{journal}: of another sequence, or written with other settings")
    return Resumed(now_ns, begun)
