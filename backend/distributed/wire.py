"""One byte form for the messages of all solvers, without sender and receiver: those stand in their carrier's header."""

from __future__ import annotations

import struct

from ..errors import BackendError
from .compact import CompactReader
from .elected_messages import FIRST_KIND, ElectedMessage
from .message_bytes import decode, decode_coded, encode, encode_coded, is_coded
from .messages import Coded, NodeMessage
from .multifrontal.frontal_messages import FIRST_FRONTAL_KIND, FrontalMessage
from .update_messages import FIRST_UPDATE_KIND, UpdateMessage
from .with_priors.in_run import InRun
from .with_priors.prior_messages import FIRST_PRIOR_KIND, IN_A_RUN, PriorMessage

SolverMessage = NodeMessage | ElectedMessage | FrontalMessage | PriorMessage | InRun
"""What nodes send to each other, whatever their method."""
GroupMessage = SolverMessage | UpdateMessage
"""These, and what is sent afterwards for updates of what they have solved."""

_ENDS = struct.Struct("<HH")
# Where sender and receiver stand in each form.
_ENDS_AT, _ENDS_AT_FRONTAL, _ENDS_AT_ELECTED, _ENDS_AT_UPDATE = 6, 3, 2, 5


def pack(message: GroupMessage) -> bytes:
    """The message without its two ends."""
    match message:
        case InRun():
            return bytes([IN_A_RUN, message.run]) + pack(message.message)
        case ElectedMessage():
            at = _ENDS_AT_ELECTED
        case FrontalMessage() | PriorMessage():
            at = _ENDS_AT_FRONTAL
        case UpdateMessage():
            at = _ENDS_AT_UPDATE
        case Coded():
            return encode_coded(message, ())
        case _:
            at = _ENDS_AT
    data = whole(message)
    return data[:at] + data[at + _ENDS.size :]


def unpack(sender: int, receiver: int, data: bytes) -> GroupMessage:
    """Inverse of :func:`pack`; bytes that are no such message, or whose numbers cannot be, raise
    :class:`~maslam.backend.errors.BackendError`."""
    message: GroupMessage
    ends = _ENDS.pack(sender, receiver)
    if data[:1] == bytes([IN_A_RUN]):
        _check_run(data)
        message = InRun(data[1], unpack(sender, receiver, data[2:]))
    elif data[:1] >= bytes([FIRST_UPDATE_KIND]):
        message = UpdateMessage.decode(data[:_ENDS_AT_UPDATE] + ends + data[_ENDS_AT_UPDATE:])
    elif data[:1] >= bytes([FIRST_KIND]):
        message = ElectedMessage.decode(data[:_ENDS_AT_ELECTED] + ends + data[_ENDS_AT_ELECTED:])
    elif data[:1] >= bytes([FIRST_PRIOR_KIND]):
        message = from_whole(data[:_ENDS_AT_FRONTAL] + ends + data[_ENDS_AT_FRONTAL:])
    elif is_coded(data):
        message = decode_coded(data[0], (sender, receiver), CompactReader(data[1:]))
    else:
        message = decode(data[:_ENDS_AT] + ends + data[_ENDS_AT:])
    message.check()
    return message


def whole(message: GroupMessage) -> bytes:
    """The message with its two ends."""
    match message:
        case InRun():
            return bytes([IN_A_RUN, message.run]) + whole(message.message)
        case ElectedMessage() | FrontalMessage() | PriorMessage() | UpdateMessage():
            return message.encode()
        case _:
            return encode(message)


def from_whole(data: bytes) -> SolverMessage:
    """Inverse of :func:`whole`; numbers are not checked."""
    first = data[:1]
    if first == bytes([IN_A_RUN]):
        _check_run(data)
        return InRun(data[1], from_whole(data[2:]))
    if first >= bytes([FIRST_KIND]):
        return ElectedMessage.decode(data)
    if first >= bytes([FIRST_FRONTAL_KIND]):
        return FrontalMessage.decode(data)
    return PriorMessage.decode(data) if first >= bytes([FIRST_PRIOR_KIND]) else decode(data)


def _check_run(data: bytes) -> None:
    if len(data) < 3 or data[2] in (IN_A_RUN, FIRST_PRIOR_KIND, FIRST_PRIOR_KIND + 1):
        raise BackendError(f"not a message of a run: {len(data)} bytes")
