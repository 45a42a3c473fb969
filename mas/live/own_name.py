"""One certificate, one process: an agent notices another process with its own certificate, and the later one ends.

Both show their greeting to their own number. What each then seals proves that the other runs now, and is no recording
of an earlier process: it needs the secret of a key that is made anew in each process.
"""

from __future__ import annotations

import logging
import struct
import time

from ..errors import MasError
from ..transport.link import Link
from .acquaintance import process_code
from .credentials import Credentials, CredentialsError
from .seals import SealError, Seals, SessionKey

GREETING, SAME_NAME = b"\0", b"\2"
_AGAIN_NS = 1_000_000_000
# How long the sender has run, ns; whether it takes itself for the earlier one.
_CLAIM = struct.Struct("<Q?")
_MOST_TWINS = 8
log = logging.getLogger(__name__)


class NameTakenError(MasError):
    """Another process has this agent's certificate, and began before."""


class OwnName:
    """``take`` what comes from the agent's own number; :class:`NameTakenError` where this process is the later one."""

    def __init__(self, credentials: Credentials, key: SessionKey, link: Link, greeting: bytes) -> None:
        self._credentials = credentials
        self._key = key
        self._link = link
        self._greeting = greeting
        self._began_ns = time.monotonic_ns()
        self._others: set[str] = set()
        self._seals: dict[bytes, Seals] = {}
        self._proven: set[bytes] = set()
        self._shown_ns: int | None = None

    def changed(self, process: str, here: bool) -> None:
        """The link sees a process of this agent, or does not any more."""
        if not here:
            self._others.discard(process)
        elif process != process_code(self._key.public) and len(self._others) < _MOST_TWINS:
            self._others.add(process)

    def flush(self) -> None:
        """Show to other processes of this agent who I am, and how long I have run."""
        now_ns = time.monotonic_ns()
        if not self._others or (self._shown_ns is not None and now_ns - self._shown_ns < _AGAIN_NS):
            return
        self._shown_ns = now_ns
        me = self._credentials.number
        self._link.send(me, GREETING + self._greeting)
        for public, seals in self._seals.items():
            claim = _CLAIM.pack(now_ns - self._began_ns, public in self._proven)
            self._link.send(me, SAME_NAME + seals.seal(claim))

    def take(self, data: bytes) -> None:
        """What came from this agent's own number: my own greeting, another process's, or nothing that is known."""
        try:
            if data[:1] == GREETING:
                self._greeted(data[1:])
            elif data[:1] == SAME_NAME:
                self._claimed(data[1:])
        except (CredentialsError, SealError) as error:
            log.info("in this agent's own name: %s", error)

    def _greeted(self, greeting: bytes) -> None:
        public = self._credentials.check(greeting).public
        if public == self._key.public or public in self._seals or len(self._seals) >= _MOST_TWINS:
            return
        self._seals[public] = self._key.seals_of_twin(public)
        self._shown_ns = None

    def _claimed(self, data: bytes) -> None:
        for public, seals in self._seals.items():
            opened = seals.open(data)
            if opened is None or len(opened) != _CLAIM.size:
                continue
            ran_ns, earlier = _CLAIM.unpack(opened)
            mine_ns = time.monotonic_ns() - self._began_ns
            # Both take themselves for the earlier one where they began at almost the same time: their keys decide.
            if ran_ns > mine_ns or (earlier and public < self._key.public):
                raise NameTakenError(
                    f"{self._credentials.folder}: name taken: another process with this certificate of agent "
                    f"{self._credentials.number} runs already, for {ran_ns / 1e9:.0f} s"
                )
            if public not in self._proven:
                self._proven.add(public)
                self._shown_ns = None
                log.warning(
                    "another process with the certificate of agent %d, this one, runs, in a copied folder? The later "
                    "of the two ends",
                    self._credentials.number,
                )
