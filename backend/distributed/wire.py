"""One byte form for the messages of all solvers, without sender and receiver: those stand in their carrier's header."""

from __future__ import annotations

import struct

from .elected_messages import FIRST_KIND, ElectedMessage
from .message_bytes import decode, encode
from .messages import NodeMessage

SolverMessage = NodeMessage | ElectedMessage
"""What nodes send to each other, whatever their method."""

_ENDS = struct.Struct("<HH")
# Where sender and receiver stand in the two forms.
_ENDS_AT, _ENDS_AT_ELECTED = 6, 2


def pack(message: SolverMessage) -> bytes:
    """The message without its two ends."""
    if isinstance(message, ElectedMessage):
        data, at = message.encode(), _ENDS_AT_ELECTED
    else:
        data, at = encode(message), _ENDS_AT
    return data[:at] + data[at + _ENDS.size :]


def unpack(sender: int, receiver: int, data: bytes) -> SolverMessage:
    """Inverse of :func:`pack`; bytes that are no such message, or whose numbers cannot be, raise
    :class:`~maslam.backend.errors.BackendError`."""
    elected = data[:1] >= bytes([FIRST_KIND])
    at = _ENDS_AT_ELECTED if elected else _ENDS_AT
    whole = data[:at] + _ENDS.pack(sender, receiver) + data[at:]
    message = ElectedMessage.decode(whole) if elected else decode(whole)
    message.check()
    return message
