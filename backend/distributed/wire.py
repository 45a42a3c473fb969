"""One byte form for the messages of all solvers, without sender and receiver: those stand in their carrier's header."""

from __future__ import annotations

import struct

from .compact import CompactReader
from .elected_messages import FIRST_KIND, ElectedMessage
from .incremental.update_messages import FIRST_UPDATE_KIND, UpdateMessage
from .message_bytes import decode, decode_coded, encode, encode_coded, is_coded
from .messages import Coded, NodeMessage
from .multifrontal.frontal_messages import FIRST_FRONTAL_KIND, FrontalMessage

SolverMessage = NodeMessage | ElectedMessage | FrontalMessage
"""What nodes send to each other, whatever their method."""
GroupMessage = SolverMessage | UpdateMessage
"""These, and what is sent afterwards for updates of what they have solved."""

_ENDS = struct.Struct("<HH")
# Where sender and receiver stand in each form.
_ENDS_AT, _ENDS_AT_FRONTAL, _ENDS_AT_ELECTED, _ENDS_AT_UPDATE = 6, 3, 2, 5


def pack(message: GroupMessage) -> bytes:
    """The message without its two ends."""
    match message:
        case ElectedMessage():
            data, at = message.encode(), _ENDS_AT_ELECTED
        case FrontalMessage():
            data, at = message.encode(), _ENDS_AT_FRONTAL
        case UpdateMessage():
            data, at = message.encode(), _ENDS_AT_UPDATE
        case Coded():
            return encode_coded(message, ())
        case _:
            data, at = encode(message), _ENDS_AT
    return data[:at] + data[at + _ENDS.size :]


def unpack(sender: int, receiver: int, data: bytes) -> GroupMessage:
    """Inverse of :func:`pack`; bytes that are no such message, or whose numbers cannot be, raise
    :class:`~maslam.backend.errors.BackendError`."""
    message: GroupMessage
    ends = _ENDS.pack(sender, receiver)
    if data[:1] >= bytes([FIRST_UPDATE_KIND]):
        message = UpdateMessage.decode(data[:_ENDS_AT_UPDATE] + ends + data[_ENDS_AT_UPDATE:])
    elif data[:1] >= bytes([FIRST_KIND]):
        message = ElectedMessage.decode(data[:_ENDS_AT_ELECTED] + ends + data[_ENDS_AT_ELECTED:])
    elif data[:1] >= bytes([FIRST_FRONTAL_KIND]):
        message = FrontalMessage.decode(data[:_ENDS_AT_FRONTAL] + ends + data[_ENDS_AT_FRONTAL:])
    elif is_coded(data):
        message = decode_coded(data[0], (sender, receiver), CompactReader(data[1:]))
    else:
        message = decode(data[:_ENDS_AT] + ends + data[_ENDS_AT:])
    message.check()
    return message
