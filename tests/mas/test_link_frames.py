"""Frames between agents: what is packed comes out again, long messages survive loss, nonsense is refused."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from maslam.mas.errors import MasError
from maslam.mas.live.durations import LONGEST_NS, arrived, departing
from maslam.mas.live.framing import (
    FRAME_BYTES,
    PIECE_BYTES,
    DrivePhase,
    Frame,
    FrameError,
    MessageBundle,
    MessagePiece,
    PhaseNotice,
    PhaseReceived,
    PiecesReceived,
    bundled,
    cut,
    pack_frame,
    unpack_frame,
)
from maslam.mas.live.link_bytes import LinkBytes, total_bytes
from maslam.mas.live.pieces import IN_FLIGHT, PieceReceiver, PieceSender
from maslam.mas.protocol.ids import ContractId, OperationKind
from maslam.mas.protocol.messages import Bid, Call, Message

FRAMES: list[Frame] = [
    MessageBundle((b"a", b"b" * 127, b"c" * 128, b"d" * 4000)),
    MessagePiece(7, 0, 2, b"x" * PIECE_BYTES),
    MessagePiece(7, 1, 2, b"x"),
    PiecesReceived(7, 3, 0b101),
    PhaseNotice(65535, DrivePhase.RESTING),
    PhaseReceived(3),
]


@pytest.mark.parametrize("frame", FRAMES, ids=lambda frame: type(frame).__name__)
def test_a_frame_comes_out_as_it_was_packed(frame: Frame) -> None:
    assert unpack_frame(pack_frame(frame)) == frame


@settings(max_examples=300, deadline=None)
@given(st.sampled_from(FRAMES), st.data())
def test_mutated_frames_are_read_or_refused(frame: Frame, data: st.DataObject) -> None:
    packed = bytearray(pack_frame(frame))
    for _ in range(data.draw(st.integers(1, 3))):
        packed[data.draw(st.integers(0, len(packed) - 1))] = data.draw(st.integers(0, 255))
    short = bytes(packed[: data.draw(st.integers(0, len(packed)))])
    for bytes_ in (bytes(packed), short):
        try:
            read = unpack_frame(bytes_)
        except FrameError:
            continue
        if isinstance(read, MessageBundle):
            assert sum(len(m) for m in read.messages) < len(bytes_)


def test_short_messages_share_frames_in_their_order() -> None:
    rng = np.random.default_rng(0)
    messages = [bytes(rng.integers(0, 256, rng.integers(1, 3000), dtype=np.uint8)) for _ in range(60)]
    frames = bundled(messages)
    assert [m for frame in frames for m in frame.messages] == messages
    assert all(len(pack_frame(frame)) <= FRAME_BYTES + 1 for frame in frames)
    assert len(frames) < 10


@pytest.mark.parametrize("size", [PIECE_BYTES + 1, 3 * PIECE_BYTES, 100_001])
@pytest.mark.parametrize("loss", [0.0, 0.4])
def test_a_long_message_arrives_whole_whatever_is_lost(size: int, loss: float) -> None:
    """Both pieces and acknowledgements are lost; never more than a few pieces are on their way."""
    rng = np.random.default_rng(size)
    message = bytes(rng.integers(0, 256, size, dtype=np.uint8))
    sender, receiver, now_ns, got, sent = PieceSender(), PieceReceiver(10**6), 0, [], 0
    sender.put(message)
    sender.put(b"the next one" * 400)
    while sender.busy:
        pieces = sender.due(now_ns)
        assert len(pieces) <= IN_FLIGHT
        sent += len(pieces)
        for piece in pieces:
            if rng.random() < loss:
                continue
            taken = receiver.take(piece)
            got += [] if taken.message is None else [taken.message]
            if taken.answer is not None and rng.random() >= loss:
                sender.acknowledge(taken.answer, now_ns + 5_000_000)
        now_ns += 10_000_000
        assert now_ns < 600e9
    assert got == [message, b"the next one" * 400]
    if loss == 0.0:
        assert sent == len(cut(0, message)) + 2


def test_a_recipient_that_is_gone_is_given_up() -> None:
    sender = PieceSender()
    sender.put(b"x" * 10_000)
    sent = sum(len(sender.due(s * 10**9)) for s in range(60))
    assert not sender.busy and sender.given_up == 1 and sent < 100


def test_memory_for_what_is_begun_is_bounded() -> None:
    receiver = PieceReceiver(max_message_bytes=20_000)
    huge = MessagePiece(1, 0, 60_000, b"x" * PIECE_BYTES)
    assert receiver.take(huge).answer is None
    for number in range(1000):
        receiver.take(MessagePiece(number, 0, 4, b"x" * PIECE_BYTES))
    assert len(receiver._begun) <= 4
    first = cut(5000, b"y" * 9000)
    assert receiver.take(first[0]).message is None
    assert receiver.take(MessagePiece(5000, 1, 2, b"z")).answer is None  # another count: no piece of it
    assert receiver.take(first[1]).message is None and receiver.take(first[2]).message == b"y" * 9000
    assert receiver.take(first[2]).message is None  # once


def test_a_message_of_too_many_pieces_is_not_cut() -> None:
    with pytest.raises(FrameError, match="more than 65535 pieces"):
        cut(0, b"x" * (PIECE_BYTES * 65536))


def test_times_travel_as_durations() -> None:
    """Whatever the clocks show, as long is left at the recipient as was at the sender."""
    call = Message(0, 1, ContractId(0, 3), Call(OperationKind.DVPR, 1_005_000_000))
    on_the_way = departing(call, 1_000_000_000)
    assert on_the_way.body.deadline_ns == 5_000_000
    assert arrived(on_the_way, 77).body.deadline_ns == 5_000_077
    bid = Message(1, 0, ContractId(0, 3), Bid(10, 400))
    assert arrived(departing(bid, 500), 10_000).body.ready_ns == 9_900


def test_a_claimed_duration_is_bounded() -> None:
    call = Message(0, 1, ContractId(0, 3), Call(OperationKind.DVPR, 2**62))
    assert arrived(call, 1000).body.deadline_ns == 1000 + LONGEST_NS
    early = Message(0, 1, ContractId(0, 3), Call(OperationKind.DVPR, -(2**62)))
    assert arrived(early, 1000).body.deadline_ns == 1000 - LONGEST_NS


def test_errors_are_the_agents_own() -> None:
    assert issubclass(FrameError, MasError)


def test_bytes_are_counted_for_what_they_are_for() -> None:
    links = {3: LinkBytes(message_bytes=5), 4: LinkBytes(greeting_bytes=7)}
    for frame in FRAMES:
        links[3].count(frame, 100)
    links[4].count(FRAMES[0], 30)
    assert links[3] == LinkBytes(5, 300, 300, 0, 6) and links[3].frame_bytes == 600
    assert total_bytes(links) == LinkBytes(5, 330, 300, 7, 7)
