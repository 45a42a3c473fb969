"""Another agent, process by process: with which of its processes an agent talks, and whether two run at once.

A process is known by the public key that it made when it began. Its session is kept as long as this agent runs: where
only one side of a link noticed that it was broken, both go on with the numbers that they had, and frames recorded by
somebody else do not count a second time.
"""

from __future__ import annotations

from dataclasses import dataclass, field

from .framing import DrivePhase
from .neighbour import Session

_ANSWER_NS = 3_000_000_000
"""A process that does not answer for so long, while another of its agent does, is taken for dead."""
_CHECKS_A_SECOND = 5
_MOST_PROCESSES = 64
"""Processes of one agent: those that have shown a greeting, and those that the link names at once."""
TWICE = "two of its processes run at once, with one certificate (a copied folder?): only the first is talked to"


def process_code(public: bytes) -> str:
    """The name of a process on the link."""
    return public[:8].hex()


@dataclass
class _Process:
    """``proven``: it has sent something sealed, which only the owner of its keys can."""

    session: Session
    serial: int
    proven: bool = False


@dataclass
class Acquaintance:
    """``refused``: what was wrong with it, said once; ``greeted_ns``: when it was last shown who I am; ``looked_at``:
    when its last signatures were checked; ``twice``: two of its processes have proven that they run at once."""

    refused: str = ""
    greeted_ns: int | None = None
    looked_at: list[int] = field(default_factory=list)
    twice: bool = False
    _here: set[str] = field(default_factory=set)
    _processes: dict[bytes, _Process] = field(default_factory=dict)
    _current: bytes = b""
    _newest: bytes = b""
    _asked_ns: int | None = None

    def may_look(self, now_ns: int) -> bool:
        """Whether one more of its signatures may be checked: a few each second, each takes a tenth of a millisecond."""
        self.looked_at = [at for at in self.looked_at if now_ns - at < 1_000_000_000]
        if len(self.looked_at) >= _CHECKS_A_SECOND:
            return False
        self.looked_at.append(now_ns)
        return True

    # -- what the link says -------------------------------------------------------------------------------------------

    @property
    def here(self) -> bool:
        """Whether any of its processes can be reached."""
        return bool(self._here)

    def changed(self, process: str, here: bool) -> None:
        """The link sees a process, or does not any more."""
        self.greeted_ns = None  # whoever comes has not seen my greeting
        if not here:
            self._here.discard(process)
        elif len(self._here) < _MOST_PROCESSES:
            self._here.add(process)
        if len(self._here) < 2:
            self.twice = False
            self._asked_ns = None

    # -- its processes ------------------------------------------------------------------------------------------------

    @property
    def session(self) -> Session | None:
        """With the process that is talked to."""
        return self._processes[self._current].session if self._current else None

    def sessions(self) -> list[Session]:
        """With whom it may be: what is sealed for both reaches whoever it is."""
        publics = dict.fromkeys(p for p in (self._current, self._newest) if p and self._reached(p))
        return [self._processes[public].session for public in publics]

    def knows(self, public: bytes) -> bool:
        """Whether this process has shown a greeting."""
        return public in self._processes

    @property
    def full(self) -> bool:
        """Whether no more processes of it are taken."""
        return len(self._processes) >= _MOST_PROCESSES

    def add(self, public: bytes, session: Session, serial: int) -> None:
        """A process has shown a greeting with the certificate of this serial number."""
        self._processes[public] = _Process(session, serial)
        self._newest = public

    def greets(self, public: bytes) -> None:
        """A known process goes on greeting: it lacks my own greeting, or what I sealed first."""
        self._newest = public

    def open(self, data: bytes, phase: DrivePhase, now_ns: int) -> bytes | None:
        """The frame, where the process that is talked to sealed it; None otherwise. Another process that proves itself
        takes over, unless the one talked to answers: it is asked."""
        order = dict.fromkeys(p for p in (self._current, self._newest, *self._processes) if p)
        for public in order:
            frame = self._processes[public].session.seals.open(data)
            if frame is None:
                continue
            self._processes[public].proven = True
            if self.choose(phase, now_ns, prefer=public) or public == self._current:
                return frame if public == self._current else None
            if self._asked_ns is None and not self.twice and self._reached(public):
                self._asked_ns, self._newest = now_ns, public
                self._processes[self._current].session.announce(phase)
            return None
        return None

    def choose(self, phase: DrivePhase, now_ns: int, prefer: bytes = b"") -> bool:
        """Choose the process that is talked to, among those that are there and have proven themselves; whether there
        is one that was not talked to just before."""
        before = self._current
        if before and not self._reached(before):
            self._current = b""
            self._asked_ns = None
        if self._asked_ns is not None:
            self._judge(now_ns)
        if not self._current:
            proven = [p for p, one in self._processes.items() if one.proven and self._reached(p)]
            self._current = prefer if prefer in proven else next(reversed(proven), b"")
        if self._current in (before, b""):
            return False
        self._processes[self._current].session.announce(phase)
        self.refused = ""
        return True

    def forget(self, serials: frozenset[int]) -> bool:
        """Believe no process with one of these certificates any more; whether there was one."""
        gone = {public for public, one in self._processes.items() if one.serial in serials}
        for public in gone:
            del self._processes[public]
        if gone & {self._current, self._newest}:
            self._asked_ns = None
        self._current = b"" if self._current in gone else self._current
        self._newest = b"" if self._newest in gone else self._newest
        return bool(gone)

    def _judge(self, now_ns: int) -> None:
        """Whether the process talked to has answered since another of its agent proved itself."""
        assert self._asked_ns is not None
        if not self._processes[self._current].session.awaits_answer:
            self.twice, self._asked_ns = True, None
        elif now_ns - self._asked_ns >= _ANSWER_NS:
            self._current, self._asked_ns = self._newest, None

    def _reached(self, public: bytes) -> bool:
        return process_code(public) in self._here
