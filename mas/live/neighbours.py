"""All other agents that can be reached: greetings, seals, frames. What comes in is a message of a proven sender."""

from __future__ import annotations

import logging
import time
from dataclasses import dataclass

from ..protocol.messages import VERSION
from ..transport.link import Arrived, Link, Presence
from .acquaintance import TWICE, Acquaintance, process_code
from .credentials import Credentials, CredentialsError, RevokedCertificateError, Stranger
from .framing import DrivePhase, Frame, FrameError, RevokedNotice, RevokedReceived, pack_frame, unpack_frame
from .link_bytes import LinkBytes
from .neighbour import Session
from .own_name import GREETING, OwnName
from .revocation import UnsignedListError
from .seals import SealError, SessionKey

SEALED, REVOKED = b"\1", b"\3"
_GREET_AGAIN_NS = 1_000_000_000
log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Received:
    """Bytes of a message, of a proven sender."""

    sender: int
    data: bytes


@dataclass(frozen=True)
class Met:
    """Agent ``other`` is there, and who it says it is."""

    other: int


class Neighbours:
    """The link as an agent uses it. ``out``, ``into``: bytes by the other agent's number."""

    def __init__(self, credentials: Credentials, language: int, link: Link, max_message_bytes: int) -> None:
        self.me = credentials.number
        self.phase = DrivePhase.DRIVING
        self.out: dict[int, LinkBytes] = {}
        self.into: dict[int, LinkBytes] = {}
        self.refused = 0
        self.credentials = credentials
        self._link = link
        self._limit = max_message_bytes
        self._language = language
        self._key = SessionKey()
        self._greeting = credentials.greeting(self._key, language)
        self._known: dict[int, Acquaintance] = {}
        self._own_name = OwnName(credentials, self._key, link, self._greeting)
        link.appear(process_code(self._key.public))

    # -- what an agent does -------------------------------------------------------------------------------------------

    def send(self, other: int, message: bytes) -> None:
        """Take a message on its way; one to an agent that is not there is lost."""
        known = self._known.get(other)
        if known is not None and known.session is not None and known.here:
            known.session.put(message)
            self.out.setdefault(other, LinkBytes()).message_bytes += len(message)

    def announce(self, phase: DrivePhase) -> None:
        """Say to all how far I am."""
        self.phase = phase
        for session in self._sessions():
            session.announce(phase)

    def phases(self) -> dict[int, DrivePhase]:
        """How far the others are that are there, and have said so."""
        there = {a: k.session.phase for a, k in sorted(self._known.items()) if k.here and k.session is not None}
        return {a: phase for a, phase in there.items() if phase is not None}

    @property
    def busy(self) -> bool:
        """Whether something is on its way to an agent that is there, how far I am included."""
        return any(session.busy for session in self._sessions())

    @property
    def sending(self) -> bool:
        """Whether a long message is on its way to an agent that is there."""
        return any(session.sending for session in self._sessions())

    def refusals(self) -> dict[int, str]:
        """Why agents that are there are not talked to."""
        return {a: k.refused for a, k in sorted(self._known.items()) if k.here and k.refused and k.session is None}

    def certificate(self, other: int) -> bytes:
        """That of another agent that is talked to (DER)."""
        return self._known[other].certificate if other in self._known else b""

    def flush(self) -> None:
        """Send what is due."""
        now_ns = time.monotonic_ns()
        self._own_name.flush()
        if self.credentials.revocations.refresh():
            self._revoke()
        for other, known in self._known.items():
            if not known.here:
                continue
            self._choose(other, known, now_ns)
            if known.session is None:
                self._greet(other, known, now_ns)
            for session in known.sessions():
                for frame in session.outgoing(now_ns):
                    self._send_sealed(other, session, frame)

    def receive(self, wait_s: float) -> list[Received | Met] | None:
        """What came in next; None when nothing has after ``wait_s``, seconds."""
        came = self._link.receive(wait_s)
        if came is None:
            return None
        sender = came.other if isinstance(came, Presence) else came.sender
        if sender == self.me:
            self._take_own(came)
            return []
        known = self._known.setdefault(sender, Acquaintance())
        if isinstance(came, Presence):
            known.changed(came.process, came.here)
            return [Met(sender)] if self._choose(sender, known, time.monotonic_ns()) else []
        if came.data[:1] == GREETING:
            self.into.setdefault(sender, LinkBytes()).greeting_bytes += len(came.data)
            self._greeted(came, known)
            return []
        if came.data[:1] == REVOKED:
            self._refused_by(came, known)
            return []
        return list(self._opened(came, known)) if came.data[:1] == SEALED else []

    def _take_own(self, came: Arrived | Presence) -> None:
        """Another process of this agent: one of the two ends."""
        if isinstance(came, Presence):
            self._own_name.changed(came.process, came.here)
        else:
            self._own_name.take(came.data)

    def _revoke(self) -> None:
        """There is a newer list of revoked certificates: pass it on, and talk no more to those it names."""
        newest = self.credentials.revocations.newest
        for other, known in self._known.items():
            for session in known.sessions():
                session.pass_on(newest.number, newest.der)
            if known.forget(newest.serials):
                known.refused = "its certificate was revoked"
                log.warning("agent %d is not talked to any more: %s", other, known.refused)
                self._link.send(other, REVOKED + newest.der)

    def _take_list(self, sender: int, der: bytes) -> None:
        """Another agent passes a list on."""
        revocations = self.credentials.revocations
        session = self._known[sender].session
        newer = revocations.take(der)
        if session is not None:
            session.answer(RevokedReceived(revocations.newest.number))
        if newer:
            self._revoke()

    def _refused_by(self, came: Arrived, known: Acquaintance) -> None:
        """Whoever does not talk to me any more shows why: the authority's word counts, whoever brings it."""
        if not known.may_look(time.monotonic_ns()):
            return
        try:
            if self.credentials.revocations.take(came.data[1:]):
                self._revoke()
        except UnsignedListError as error:
            self.refused += 1
            log.info("agent %d: %s", came.sender, error)

    # -- greetings and seals ------------------------------------------------------------------------------------------

    def _sessions(self) -> list[Session]:
        return [k.session for k in self._known.values() if k.here and k.session is not None]

    def _choose(self, other: int, known: Acquaintance, now_ns: int) -> bool:
        """Choose the process of another agent that is talked to, and say once if two of them run."""
        before = known.twice
        chosen = known.choose(self.phase, now_ns)
        if known.twice and not before:
            log.warning("agent %d: %s", other, TWICE)
        return chosen

    def _greet(self, other: int, known: Acquaintance, now_ns: int) -> None:
        """Show who I am, unless that was done just now."""
        if known.greeted_ns is not None and now_ns - known.greeted_ns < _GREET_AGAIN_NS:
            return
        known.greeted_ns = now_ns
        self.out.setdefault(other, LinkBytes()).greeting_bytes += len(self._greeting) + 1
        self._link.send(other, GREETING + self._greeting)

    def _greeted(self, came: Arrived, known: Acquaintance) -> None:
        """A process says who it is. It is believed once it sends something sealed, which only it can."""
        now_ns = time.monotonic_ns()
        if not known.may_look(now_ns):
            return
        try:
            stranger = self._checked(came)
            if known.knows(stranger.public):
                known.greets(stranger.public)
                self._greet(came.sender, known, now_ns)  # it goes on asking: mine was lost
                return
            if known.full:
                raise CredentialsError("it has begun too often: start this agent anew to meet it")
            seals = self._key.seals(self.me, came.sender, stranger.public)
        except (CredentialsError, SealError) as error:
            self.refused += 1
            if str(error) != known.refused:
                log.warning("agent %d is not talked to: %s", came.sender, error)
            known.refused = str(error)
            if isinstance(error, RevokedCertificateError):
                self._link.send(came.sender, REVOKED + self.credentials.revocations.newest.der)
            return
        self._greet(came.sender, known, now_ns)
        # What is sealed first says how far I am, until it is acknowledged; so it proves who I am.
        session = Session(seals, self._limit)
        session.announce(self.phase)
        newest = self.credentials.revocations.newest
        if newest.number:
            session.pass_on(newest.number, newest.der)
        known.add(stranger, session)

    def _checked(self, came: Arrived) -> Stranger:
        stranger = self.credentials.check(came.data[1:])
        if stranger.number != came.sender:
            raise CredentialsError(f"it shows the certificate of agent {stranger.number}")
        if stranger.version != VERSION:
            raise CredentialsError(f"it speaks version {stranger.version} of the protocol, this one {VERSION}")
        if stranger.language != self._language:
            raise CredentialsError("it has another descriptor model, or another place code (places.code)")
        return stranger

    def _opened(self, came: Arrived, known: Acquaintance) -> list[Received | Met]:
        """The messages in a sealed frame; none where nobody sealed it."""
        before = known.session
        opened = known.open(came.data[1:], self.phase, time.monotonic_ns())
        if opened is None or known.session is None:
            self.refused += 1
            return []
        met: list[Received | Met] = [] if known.session is before else [Met(came.sender)]
        count = self.into.setdefault(came.sender, LinkBytes())
        try:
            frame = unpack_frame(opened)
            count.count(frame, len(came.data))
            messages = known.session.incoming(frame, time.monotonic_ns())
            if isinstance(frame, RevokedNotice):
                self._take_list(came.sender, frame.der)
        except (FrameError, UnsignedListError) as error:
            self.refused += 1
            log.warning("agent %d: %s", came.sender, error)
            return met
        count.message_bytes += sum(len(m) for m in messages)
        return [*met, *(Received(came.sender, m) for m in messages)]

    def _send_sealed(self, other: int, session: Session, frame: Frame) -> None:
        data = SEALED + session.seals.seal(pack_frame(frame))
        self.out.setdefault(other, LinkBytes()).count(frame, len(data))
        self._link.send(other, data)
