"""Bodies of messages that were damaged or made up, given to live nodes of the methods that code their own numbers."""

from __future__ import annotations

import resource
from contextlib import suppress
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from graphs import loops
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from maslam.backend.config import SolverConfig
from maslam.backend.distributed.compact import CompactWriter
from maslam.backend.distributed.messages import Coded
from maslam.backend.distributed.methods import node_for
from maslam.backend.distributed.multifrontal.frontal_messages import FrontalMessage
from maslam.backend.distributed.share import shares
from maslam.backend.distributed.solution import decode_solution
from maslam.backend.distributed.wire import pack, unpack
from maslam.backend.errors import BackendError

GRAPH, _ = loops(np.random.default_rng(7), robots=3, length=10)
SCALED = frozenset({1})
# No message of the small group may make a node take more than this beyond what it holds already, kB.
_MOST_KB = 400_000
# Messages that one hostile group may exchange until it has ended or waits.
_MOST_MESSAGES = 5000


def mutated(draw, body: bytes) -> bytes:
    """``body`` with a few bytes changed, cut, repeated, or all of it made up."""
    kind = draw(st.sampled_from(["flip", "cut", "more", "made up", "swap"]))
    if kind == "cut":
        return body[: draw(st.integers(0, max(len(body) - 1, 0)))]
    if kind == "more":
        return body + draw(st.binary(min_size=1, max_size=40))
    if kind == "made up":
        return draw(st.binary(max_size=60))
    out = bytearray(body)
    for _ in range(draw(st.integers(1, 4)) if body else 0):
        at = draw(st.integers(0, len(body) - 1))
        out[at] = draw(st.sampled_from([0, 1, 0x7F, 0x80, 0xFF])) if kind == "flip" else out[-1 - at]
    return bytes(out)


@pytest.mark.parametrize("scaled", [False, True])
@pytest.mark.parametrize("start", ["warm", "flagged"])
@pytest.mark.parametrize("method", ["two-level", "multifrontal"])
@given(places=st.sets(st.integers(0, 80), min_size=1, max_size=4), data=st.data())
@settings(max_examples=10, deadline=None, suppress_health_check=list(HealthCheck))
def test_a_hostile_body_is_refused_or_taken_and_neither_fills_memory_nor_goes_on_for_ever(
    method, start, scaled, places, data
):
    """``places``: which of the messages that carry a body are replaced."""
    group = shares(GRAPH, SCALED if scaled else frozenset())
    nodes = {r: node_for(s, SolverConfig(method=method, start=start)) for r, s in group.items()}
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    queue = [m for node in nodes.values() for m in node.start()]
    carried = count = 0
    with np.errstate(all="ignore"):
        while queue:
            message = queue.pop(0)
            count += 1
            assert count < _MOST_MESSAGES
            if isinstance(message, Coded | FrontalMessage):
                if carried in places:
                    message = replace(message, body=mutated(data.draw, message.body))
                carried += 1
            with suppress(BackendError):
                queue += nodes[message.receiver].handle(unpack(message.sender, message.receiver, pack(message)))
        for node in nodes.values():
            node.tick()
    for node in nodes.values():
        assert node.outcome is None or set(node.outcome.poses) == set(node.share.poses)
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < _MOST_KB


@pytest.mark.parametrize("rows", [[7], [0, 1, 2, 0]], ids=["beyond the last", "more than there are"])
def test_a_solution_of_poses_that_are_not_there_is_refused(rows):
    out, graph = CompactWriter(), SimpleNamespace(nodes=[None] * 3)
    out.rough(1.0)
    for number in (1 + len(rows), *rows):
        out.count(number)
    with pytest.raises(BackendError, match="beyond the 3 of its graph"):
        decode_solution(out.bytes(), graph)
