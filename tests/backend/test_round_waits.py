"""Rounds whose messages get lost: who lacks something asks for it in a byte, and only that is sent again."""

from __future__ import annotations

from collections import Counter

import numpy as np
import pytest
from graphs import loops

from maslam.backend.config import SolverConfig
from maslam.backend.distributed.exchange import solve_group
from maslam.backend.distributed.messages import Decision, Report, RoundWait, Values, Wanted
from maslam.backend.distributed.methods import node_for
from maslam.backend.distributed.share import shares
from maslam.backend.distributed.solver_stage import Round, SolverStage
from maslam.backend.distributed.wire import pack, unpack
from maslam.backend.errors import BackendError

METHODS = ["dgs", "jor", "rbcd", "two-level"]


def lossy(graph, config, rng, loss):
    """All tick whenever nothing is on its way. Returns the nodes, how often each message was sent, how often lost."""
    nodes = {robot: node_for(share, config) for robot, share in shares(graph).items()}
    queue = [m for node in nodes.values() for m in node.start()]
    sent, lost = Counter(), Counter()
    for _ in range(3000):
        while queue:
            message = queue.pop(0)
            key = (message.name, message.place, message.sender, message.receiver)
            sent[key] += 1
            if rng.random() < loss:
                lost[key] += 1
                continue
            queue += nodes[message.receiver].handle(unpack(message.sender, message.receiver, pack(message)))
        if all(node.outcome is not None for node in nodes.values()):
            return nodes, sent, lost
        queue = [m for node in nodes.values() for m in node.tick()]
    raise AssertionError("not all ended")


@pytest.mark.parametrize("method", METHODS)
def test_nothing_is_sent_again_that_arrived(method):
    graph, _ = loops(np.random.default_rng(7), robots=4, length=12)
    config = SolverConfig(method=method)
    expected, _ = solve_group(shares(graph), config)
    nodes, sent, lost = lossy(graph, config, np.random.default_rng(3), 0.3)
    for robot, outcome in expected.items():
        assert all(np.array_equal(nodes[robot].outcome.poses[n], T) for n, T in outcome.poses.items())
    asked = {key for key in sent if key[0] == RoundWait.__name__}
    assert asked
    for key in set(sent) - asked:
        assert sent[key] == 1 + lost[key]


@pytest.mark.parametrize("method", METHODS)
def test_where_nothing_is_lost_nobody_asks(method):
    graph, _ = loops(np.random.default_rng(7), robots=4, length=12)
    _, sent, _ = lossy(graph, SolverConfig(method=method), np.random.default_rng(3), 0.0)
    assert set(sent.values()) == {1}
    assert RoundWait.__name__ not in {key[0] for key in sent}


def test_who_has_ended_still_gives_what_another_lacks_and_asks_for_nothing():
    graph, _ = loops(np.random.default_rng(7), robots=2, length=12)
    nodes = {robot: node_for(share, SolverConfig()) for robot, share in shares(graph).items()}
    queue = [m for node in nodes.values() for m in node.start()]
    while queue:
        message = queue.pop(0)
        if not (isinstance(message, Decision) and message.round.stage is SolverStage.COST):
            queue += nodes[message.receiver].handle(message)
    assert nodes[0].outcome is not None and nodes[1].outcome is None
    assert nodes[0].tick() == [] and nodes[1].tick() == [], "a decision is not missed at once"
    (question,) = nodes[1].tick()
    assert question == RoundWait(1, 0, Round(SolverStage.COST, 0, 0), Wanted.DECISION)
    (answer,) = nodes[0].again(question)
    nodes[1].handle(answer)
    assert nodes[1].outcome is not None


def test_who_cannot_give_what_is_asked_for_sends_nothing():
    graph, _ = loops(np.random.default_rng(7), robots=3, length=12)
    nodes = {robot: node_for(share, SolverConfig(method="jor")) for robot, share in shares(graph).items()}
    first = next(m for node in nodes.values() for m in node.start() if isinstance(m, Values))
    me, asker = first.sender, first.receiver
    assert nodes[me].handle(RoundWait(asker, me, first.round, Wanted.DECISION)) == []
    assert nodes[me].handle(RoundWait(asker, me, Round(SolverStage.COST), ~Wanted(0))) == []
    assert nodes[me].handle(RoundWait(asker, me, first.round, Wanted.SEPARATORS)) == [first]
    assert nodes[me].again(Report(asker, me, first.round, 0.0, 0.0)) == [], "what came twice asks for nothing"


@pytest.mark.parametrize("wanted", [0, 8, 255])
def test_a_question_for_nothing_known_is_refused(wanted):
    message = RoundWait(1, 0, Round(SolverStage.ROTATION, 0, 3), Wanted.SEPARATORS | Wanted.REPORT)
    data = pack(message)
    assert unpack(1, 0, data) == message and len(data) == 7
    with pytest.raises(BackendError):
        unpack(1, 0, data[:-1] + bytes([wanted]))
    with pytest.raises(BackendError):
        unpack(1, 0, data + b"\0")
