"""Messages: what goes in comes out, and nothing else comes in."""

from __future__ import annotations

from contextlib import suppress

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from sample_messages import examples, optimise_task, parcel, submap, verify_answer, verify_task

from maslam.backend.distributed.messages import Deltas, Report, Values
from maslam.backend.distributed.solver_stage import Round, SolverStage
from maslam.backend.geometry import Sim3, se3_exp
from maslam.mas.protocol.ids import ContractId, FrameId, MatchId
from maslam.mas.protocol.map_messages import MapOrder
from maslam.mas.protocol.messages import VERSION, Award, Bid, Links, Message, PieceTerms, Result, decode, encode
from maslam.mas.protocol.solver_messages import SolverBody
from maslam.mas.protocol.tasks import PlaceAnswer, PlaceQuery, PlaceRedirect
from maslam.mas.protocol.tensors import MessageError, Tensor, pack_poses, pack_sim3s, unpack_poses, unpack_sim3s

LIMIT = 2**20


@pytest.mark.parametrize("message", examples(), ids=lambda m: type(m.body).__name__)
def test_round_trip(message: Message) -> None:
    assert decode(encode(message), LIMIT) == message


def test_poses_and_similarities_survive_the_wire() -> None:
    rng = np.random.default_rng(0)
    poses = se3_exp(rng.normal(size=(5, 6)))
    np.testing.assert_allclose(unpack_poses(pack_poses(poses).array()), poses, atol=1e-12)
    transform = Sim3(poses[0, :3, :3], poses[0, :3, 3], 1.7)
    back = unpack_sim3s(pack_sim3s([transform]))[0]
    np.testing.assert_allclose(back.matrix(), transform.matrix(), atol=1e-12)


def test_too_long_is_refused_before_it_is_read() -> None:
    with pytest.raises(MessageError, match="at most 10"):
        decode(encode(examples()[0]), 10)


@given(st.sampled_from(examples()), st.data())
@settings(max_examples=300, deadline=None)
def test_damaged_bytes_are_an_error_and_never_a_crash(message: Message, data: st.DataObject) -> None:
    raw = bytearray(encode(message))
    for _ in range(data.draw(st.integers(1, 4))):
        raw[data.draw(st.integers(0, len(raw) - 1))] = data.draw(st.integers(0, 255))
    cut = data.draw(st.integers(0, len(raw)))
    for damaged in (bytes(raw), bytes(raw[:cut])):
        with suppress(MessageError):
            decode(damaged, LIMIT)


@given(st.binary(max_size=200))
@settings(max_examples=200, deadline=None)
def test_noise_is_no_message(noise: bytes) -> None:
    with pytest.raises(MessageError):
        decode(noise, LIMIT)


BAD_VALUES = {
    "redirect without a key-frame": lambda: PlaceRedirect(1, None, 0.5),
    "redirect to nobody": lambda: PlaceRedirect(None, 4, 0.5),
    "fewer descriptors than points": lambda: verify_task(descriptors=Tensor.of(np.zeros((3, 32)), "|u1")),
    "neither descriptors nor words": lambda: verify_task(descriptors=None),
    "descriptors of odd length": lambda: verify_task(descriptors=Tensor.of(np.zeros((4, 20)), "|u1")),
    "codes without their ranges": lambda: verify_task(points=Tensor.of(np.ones(4), "<u4")),
    "ranges upside down": lambda: verify_task(
        points=Tensor.of(np.ones(4), "<u4"), ranges=Tensor.of([1, 0, 0, 0, 1, 1], "<f4")
    ),
    "endless ranges": lambda: verify_task(
        points=Tensor.of(np.ones(4), "<u4"), ranges=Tensor.of([0, 0, 0, 1, 1, np.inf], "<f4")
    ),
    "infinite points": lambda: verify_task(points=Tensor.of(np.full((4, 3), np.inf), "<f4")),
    "pose without rotation": lambda: verify_task(T_T_Q=Tensor.of(np.zeros(7), "<f8")),
    "shape larger than its bytes": lambda: verify_task(points=Tensor("<f4", (10**9, 3), b"")),
    "negative shape": lambda: verify_task(points=Tensor("<f4", (-1, 3), b"")),
    "point of a key-frame that is not there": lambda: submap(references=Tensor.of([0, 1, 2], "<i4")),
    "key-frames not ascending": lambda: submap(keyframes=Tensor.of([1, 1], "<i4")),
    "more stamps than key-frames": lambda: submap(stamps_ns=Tensor.of([0, 1, 2], "<i8")),
    "version made of a later one": lambda: parcel(base=3),
    "descriptors of another length": lambda: parcel(descriptors=Tensor.of(np.zeros((2, 31)), "|u1")),
    "versions of other owners": lambda: MapOrder((1, 2), (0,)),
    "scale of zero": lambda: Links(
        (MatchId(0, 1, 1, 2),), (0,), (FrameId(0, 0),), (False,), Tensor.of([[0, 0, 0, 1, 0, 0, 0, 0]], "<f4")
    ),
    "links without poses": lambda: Links((MatchId(0, 1, 1, 2),), (0,), (FrameId(0, 0),), (False,)),
    "infinite cost": lambda: SolverBody.of(Report(0, 1, Round(SolverStage.POSE), 0.0, float("inf"))),
    "an infinite pose": lambda: SolverBody.of(Values(0, 1, Round(SolverStage.POSE), np.full((1, 6), np.inf))),
    "steps where there are none": lambda: SolverBody.of(
        Deltas(0, 1, Round(SolverStage.POSE), (0.5, 0.5), np.zeros((1, 6), dtype=np.int8))
    ),
    "no solver's bytes": lambda: SolverBody(b"\x07" * 12),
    "links of another track": lambda: Bid(
        1, 0, Links((MatchId(0, 1, 1, 2),), (0,), (FrameId(0, 0),), (False,), pack_sim3s([Sim3.identity()], "<f4"))
    ),
    "a track twice": lambda: Bid(
        1, 0, pieces=(PieceTerms(0, FrameId(0, 0), True, True), PieceTerms(0, FrameId(1, 0), True, True))
    ),
    "a metric track in another unit": lambda: PieceTerms(0, FrameId(0, 0), True, False),
    "a metric member in another unit": lambda: optimise_task(metric=False),
    "one camera of a stranger": lambda: optimise_task(arbitrary=(2,)),
    "information of no size": lambda: verify_answer(information=Tensor.of(np.ones(22), "<f4")),
}


@pytest.mark.parametrize("name", BAD_VALUES)
def test_values_that_make_no_sense_are_refused(name: str) -> None:
    with pytest.raises(MessageError, match=r".+"):
        BAD_VALUES[name]()


@pytest.mark.parametrize(("language", "vector"), [(7, b""), (7, bytes(100_000)), (2**32, b"x"), (-1, b"x")])
def test_a_place_query_is_bounded(language: int, vector: bytes) -> None:
    query = PlaceQuery(0, language, vector)
    with pytest.raises(MessageError):
        decode(encode(Message(0, 1, ContractId(0, 7), Award(query))), LIMIT)


def test_what_a_sender_cannot_build_is_refused_when_it_arrives() -> None:
    """Checks run at decoding, whoever made the bytes."""
    good = encode(Message(0, 1, ContractId(0, 7), Result(PlaceAnswer(4, 0.25))))
    fields = msgspec.msgpack.decode(good)
    for path, value in (([1], 10**6), ([3, 1, 2], 9.0), ([3, 1, 1], -4), ([4], VERSION + 1), ([3, 0], 77)):
        changed = msgspec.msgpack.decode(good)
        target = changed
        for key in path[:-1]:
            target = target[key]
        target[path[-1]] = value
        assert changed != fields
        with pytest.raises(MessageError):
            decode(msgspec.msgpack.encode(changed), LIMIT)
