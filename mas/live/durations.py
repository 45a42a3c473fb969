"""Times in messages between agents without a common clock: while a message travels, each is a time from now."""

from __future__ import annotations

import msgspec

from ..protocol.messages import Bid, Call, Message

LONGEST_NS = 3_600_000_000_000
"""No contract takes longer than an hour, whatever a message says."""


def departing(message: Message, now_ns: int) -> Message:
    """The message as it travels: its times, which are of the sender's clock, as durations from now."""
    return _shifted(message, -now_ns)


def arrived(message: Message, now_ns: int) -> Message:
    """The message as the recipient reads it: its durations as times of the recipient's clock."""
    return _shifted(message, now_ns)


def _shifted(message: Message, by_ns: int) -> Message:
    body = message.body
    if isinstance(body, Call):
        deadline_ns = _bounded(body.deadline_ns + by_ns, by_ns)
        return msgspec.structs.replace(message, body=msgspec.structs.replace(body, deadline_ns=deadline_ns))
    if isinstance(body, Bid):
        ready_ns = _bounded(body.ready_ns + by_ns, by_ns)
        return msgspec.structs.replace(message, body=msgspec.structs.replace(body, ready_ns=ready_ns))
    return message


def _bounded(time_ns: int, by_ns: int) -> int:
    """A time at most :data:`LONGEST_NS` from now: from 0 while it travels, from the recipient's now after that."""
    now_ns = max(by_ns, 0)
    return min(max(time_ns, now_ns - LONGEST_NS), now_ns + LONGEST_NS)
