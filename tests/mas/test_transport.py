"""Transports: every message once, in order, counted to the byte."""

from __future__ import annotations

import numpy as np
from sample_messages import examples, submap, verify_task

from maslam.backend.distributed.messages import Values
from maslam.backend.distributed.solver_stage import Round, SolverStage
from maslam.mas.protocol.accounting import Traffic
from maslam.mas.protocol.messages import Award, Bid, Result, encode
from maslam.mas.protocol.solver_messages import SolverBody
from maslam.mas.protocol.tasks import EarlierAnswer, MapDelivery, OwnerQuery, PlaceAnswer, PlaceQuery, PlaceRedirect
from maslam.mas.protocol.tensors import Tensor
from maslam.mas.transport.transport import InProcessTransport, RefusedMessage


class TestInProcess:
    """What is its own; ``tests/extensions`` holds it to the contract of all transports."""

    def test_what_cannot_be_read_is_dropped_and_counted(self) -> None:
        transport = InProcessTransport(2**20)
        transport.carry(0, 1, b"nonsense")
        transport.carry(0, 2, encode(examples()[0]))
        transport.carry(3, 1, encode(examples()[0]))
        transport.send(examples()[1], 0)
        refused = [transport.receive() for _ in range(3)]
        assert transport.receive() == examples()[1] and transport.receive() is None
        assert all(isinstance(r, RefusedMessage) for r in refused)
        assert [(r.sender, r.recipient) for r in refused] == [(0, 1), (0, 2), (3, 1)]
        assert "came to agent 2" in refused[1].reason and "in the name of agent 0" in refused[2].reason
        assert transport.refused == 3


def test_payload_is_counted_as_the_published_tables_do() -> None:
    """Expected figures worked out by hand from the table of byte accounting."""
    vector = bytes(4 * 128)
    words = verify_task(descriptors=None, words=Tensor.of(np.zeros(4), "<u2"))
    cases = [
        (Award(PlaceQuery(0, 7, vector)), Traffic.DVPR, 4 * 128),
        (Award(PlaceQuery(0, 7, vector[:32])), Traffic.DVPR, 32),
        (Result(PlaceAnswer(1, 0.1)), Traffic.DVPR, 8 + 4),
        (Result(EarlierAnswer(0, 1, 0.1)), Traffic.DVPR, 8 + 4 + 4),
        (Award(OwnerQuery(0, 7, vector)), Traffic.DVPR, 4 * 128 + 1 + 4),
        (Result(PlaceRedirect(2, 1, 0.1)), Traffic.DVPR, 8 + 4 + 1),
        (Award(verify_task()), Traffic.RELPOSE, 1 + 4 + 4 + 4 * (32 + 12)),
        (Award(words), Traffic.RELPOSE, 1 + 4 + 4 + 4 * (2 + 12)),
        (SolverBody.of(Values(0, 1, Round(SolverStage.ROTATION), np.zeros((3, 9)))), Traffic.DOPT, 3 * 9 * 8),
        (Bid(0, 0), Traffic.NEGOTIATION, 0),
    ]
    for body, operation, payload in cases:
        assert (body.traffic, body.payload_bytes) == (operation, payload)


def test_a_map_counts_its_numbers() -> None:
    from maslam.mas.protocol.ids import FrameId

    delivery = MapDelivery(FrameId(0, 0), (), submap().transforms, (submap(),))
    poses, points = 2 * (7 * 8 + 8 + 4), 3 * (12 + 32 + 4)
    assert Result(delivery).payload_bytes == poses + points
