"""An agent whose every input is written down first, and the same agent made anew from what was written."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from ..agent import Agent
from ..contracts.effects import NOTHING, Effects
from ..protocol.messages import Message, decode, encode
from ..state.keyframe import KeyFrame
from .journal import EntryKind, Journal, JournalEntry, JournalError, read_journal
from .observed import Observed, decode_observed, encode_observed

_NUMBER = struct.Struct("<I")
_REASON = 300


@dataclass
class AgentInputs:
    """An agent and what its inputs refer to. ``keyframes``: of its sequence, none of a live camera. ``sent``: checksum
    of all messages that it has sent; ``seen``: how many key-frames it has observed. ``made_of``: what else its journal
    is bound to, a live agent's camera."""

    agent: Agent
    keyframes: Sequence[KeyFrame]
    max_message_bytes: int
    sent: int = 0
    seen: int = 0
    made_of: str = ""

    def act_on(self, entry: JournalEntry) -> Effects:
        """Give the agent what an entry says, and return what follows."""
        effects = self._effects_of(entry)
        for message in effects.messages:
            self.sent = zlib.crc32(encode(message), self.sent)
        return effects

    def _effects_of(self, entry: JournalEntry) -> Effects:
        agent = self.agent
        match entry.kind:
            case EntryKind.TICK:
                return agent.tick(entry.now_ns)
            case EntryKind.REMIND:
                return agent.remind(entry.now_ns)
            case EntryKind.MESSAGE:
                return agent.handle(decode(entry.data, self.max_message_bytes))
            case EntryKind.REFUSE:
                (sender,) = _NUMBER.unpack_from(entry.data)
                return agent.refuse(sender, entry.data[_NUMBER.size :].decode("utf-8", "replace"))
            case EntryKind.MEET:
                agent.meet(_NUMBER.unpack(entry.data)[0])
            case EntryKind.OBSERVE:
                agent.observe(self.keyframes[_NUMBER.unpack(entry.data)[0]])
                self.seen += 1
            case EntryKind.SEE:
                agent.observe(decode_observed(entry.data).keyframe)
                self.seen += 1
            case EntryKind.FINISH:
                agent.finish()
            case EntryKind.BEGIN | EntryKind.SIGNED:
                pass
        return NOTHING


class RecordedAgent:
    """An agent, and the journal in which each of its inputs stands before it acts on it."""

    def __init__(self, inputs: AgentInputs, journal: Journal) -> None:
        self.inputs = inputs
        self.journal = journal

    @property
    def agent(self) -> Agent:
        """The agent itself; its inputs come through this class only."""
        return self.inputs.agent

    def begin(self, digest: bytes, now_ns: int) -> None:
        """A process begins, with settings and a sequence of this digest."""
        self._enter(EntryKind.BEGIN, now_ns, digest)

    def meet(self, other: int, now_ns: int) -> None:
        """Another agent is there."""
        self._enter(EntryKind.MEET, now_ns, _NUMBER.pack(other))

    def observe(self, now_ns: int) -> None:
        """The sensors' next key-frame."""
        self._enter(EntryKind.OBSERVE, now_ns, _NUMBER.pack(self.inputs.seen))

    def see(self, observed: Observed, now_ns: int) -> None:
        """A live camera's next key-frame."""
        self._enter(EntryKind.SEE, now_ns, encode_observed(observed))

    def handle(self, message: Message, now_ns: int) -> Effects:
        """A message that the link has delivered."""
        return self._enter(EntryKind.MESSAGE, now_ns, encode(message))

    def keep_signatures(self, data: bytes, now_ns: int) -> None:
        """Signatures of maps in the message that is handled next."""
        self._enter(EntryKind.SIGNED, now_ns, data)

    def refuse(self, sender: int, reason: str, now_ns: int) -> Effects:
        """The link brought bytes of an agent that are no message, or one in another's name."""
        return self._enter(EntryKind.REFUSE, now_ns, _NUMBER.pack(sender) + reason[:_REASON].encode())

    def tick(self, now_ns: int) -> Effects:
        """Logical time goes on by a step."""
        self.journal.flush()
        return self._enter(EntryKind.TICK, now_ns)

    def remind(self, now_ns: int) -> Effects:
        """Logical time goes on, between two ticks."""
        return self._enter(EntryKind.REMIND, now_ns)

    def finish(self, now_ns: int) -> None:
        """Nobody present has anything new to see."""
        self._enter(EntryKind.FINISH, now_ns)

    def _enter(self, kind: EntryKind, now_ns: int, data: bytes = b"") -> Effects:
        entry = JournalEntry(kind, now_ns, data, self.inputs.sent)
        self.journal.append(entry)
        return self.inputs.act_on(entry)


@dataclass(frozen=True)
class Replayed:
    """An entry of a journal and what followed from it."""

    entry: JournalEntry
    effects: Effects


def replay(inputs: AgentInputs, entries: Iterable[JournalEntry], name: str) -> Iterator[Replayed]:
    """Make an agent what it was, entry by entry. ``name``: of its journal, for errors; :class:`JournalError` where the
    agent does not do again what it did: another version, other settings, another sequence or another processor."""
    for number, entry in enumerate(entries):
        if entry.sent != inputs.sent:
            raise JournalError(
                f"{name}: entry {number}: the agent made from it sends other messages than the agent that wrote it: "
                "it was written by another version, with other settings or on another kind of processor"
            )
        try:
            effects = inputs.act_on(entry)
        except (IndexError, struct.error) as error:
            raise JournalError(f"{name}: entry {number}: {entry.kind.name.lower()} of what is not there") from error
        yield Replayed(entry, effects)


def signatures_in(journal: Path) -> list[bytes]:
    """Signatures of maps that the agent of a journal has bought."""
    return [e.data for e in read_journal(journal) if e.kind is EntryKind.SIGNED] if journal.exists() else []


def met_in(journal: Path) -> set[int]:
    """Agents that the agent of a journal has met."""
    return {_NUMBER.unpack(e.data)[0] for e in read_journal(journal) if e.kind is EntryKind.MEET}
