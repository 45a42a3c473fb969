"""One other agent as seen over the link: who it is, what is on its way to it, how far it is."""

from __future__ import annotations

from .framing import (
    PIECE_BYTES,
    DrivePhase,
    Frame,
    MessageBundle,
    MessagePiece,
    PhaseNotice,
    PhaseReceived,
    PiecesReceived,
    RevokedNotice,
    RevokedReceived,
    bundled,
)
from .pieces import PieceReceiver, PieceSender
from .seals import Seals

# A phase that is not acknowledged is sent again after this.
_REPEAT_NS = 500_000_000


class Session:
    """What two processes of agents have between them, from their greetings on. Times are of the machine's clock, which
    goes on whatever the logical time does."""

    def __init__(self, seals: Seals, max_message_bytes: int) -> None:
        self.seals = seals
        self.phase: DrivePhase | None = None
        self._phase_number = -1
        self._sender = PieceSender()
        self._receiver = PieceReceiver(max_message_bytes)
        self._short: list[bytes] = []
        self._answers: list[Frame] = []
        self._notice: PhaseNotice | None = None
        self._notice_ns: int | None = None
        self._notices = 0
        self._list: tuple[int, bytes] | None = None
        self._list_ns: int | None = None

    def put(self, message: bytes) -> None:
        """Take a message on its way."""
        if len(message) > PIECE_BYTES:
            self._sender.put(message)
        else:
            self._short.append(message)

    def announce(self, phase: DrivePhase) -> None:
        """Say how far I am, until the other side has it."""
        self._notice, self._notice_ns = PhaseNotice(self._notices % 2**16, phase), None
        self._notices += 1

    def pass_on(self, number: int, der: bytes) -> None:
        """Send a list of revoked certificates, until the other side has it."""
        self._list, self._list_ns = (number, der), None

    def answer(self, frame: Frame) -> None:
        """Send a frame with the next ones."""
        self._answers.append(frame)

    @property
    def sending(self) -> bool:
        """Whether a long message is on its way."""
        return self._sender.busy

    @property
    def busy(self) -> bool:
        """Whether a long message is on its way, or a phase not acknowledged."""
        return self.sending or self._notice is not None

    @property
    def awaits_answer(self) -> bool:
        """Whether the last announcement is not acknowledged."""
        return self._notice is not None

    def outgoing(self, now_ns: int) -> list[Frame]:
        """Frames to send now."""
        frames: list[Frame] = [*self._answers, *bundled(self._short)]
        self._answers, self._short = [], []
        if self._notice is not None and (self._notice_ns is None or now_ns - self._notice_ns >= _REPEAT_NS):
            self._notice_ns = now_ns
            frames.append(self._notice)
        if self._list is not None and (self._list_ns is None or now_ns - self._list_ns >= _REPEAT_NS):
            self._list_ns = now_ns
            frames.append(RevokedNotice(self._list[1]))
        frames += self._sender.due(now_ns)
        return frames

    def incoming(self, frame: Frame, now_ns: int) -> list[bytes]:
        """Take a frame; returns the messages that it brings or completes."""
        match frame:
            case MessageBundle(messages):
                return list(messages)
            case MessagePiece():
                taken = self._receiver.take(frame)
                self._answers += [] if taken.answer is None else [taken.answer]
                return [] if taken.message is None else [taken.message]
            case PiecesReceived():
                self._sender.acknowledge(frame, now_ns)
            case PhaseNotice(number, phase):
                self._answers.append(PhaseReceived(number))
                # Numbers go round after 65 535.
                if self._phase_number < 0 or 0 < (number - self._phase_number) % 2**16 < 2**15:
                    self.phase, self._phase_number = phase, number
            case PhaseReceived(number):
                if self._notice is not None and self._notice.number == number:
                    self._notice = None
            case RevokedReceived(number):
                if self._list is not None and number >= self._list[0]:
                    self._list = None
            case RevokedNotice():
                pass  # for all neighbours, not for this one alone
        return []
