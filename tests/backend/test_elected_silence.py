"""The elected solver where messages are lost, come twice or late, and where robots fall silent."""

from dataclasses import replace

import numpy as np
import pytest
from graphs import loops
from hypothesis import given, settings
from hypothesis import strategies as st
from transports import until_ended

from maslam.backend.central.costs import cost
from maslam.backend.central.optimise import optimise
from maslam.backend.config import CentralConfig, SolverConfig
from maslam.backend.distributed.elected import ElectedNode
from maslam.backend.distributed.elected_messages import Kind
from maslam.backend.distributed.exchange import optimise_distributed
from maslam.backend.distributed.share import shares

CONFIG = SolverConfig(method="elected")


@settings(max_examples=10, deadline=None)
@given(st.integers(0, 2**31), st.floats(0.0, 0.4))
def test_lost_repeated_and_disordered_messages_change_nothing(seed, loss):
    graph, _ = loops(np.random.default_rng(5), robots=4, length=12, separators=3)
    expected = optimise_distributed(graph, CONFIG).graph
    patient = CONFIG.model_copy(update={"elected_patience": 1000})
    nodes = {r: ElectedNode(s, patient) for r, s in shares(graph).items()}
    until_ended(nodes, rng=np.random.default_rng(seed), loss=loss, repeat=0.2)
    for node in nodes.values():
        for n, T in node.outcome.poses.items():
            assert np.array_equal(T, expected.poses[n])


@pytest.mark.parametrize("silent", ["elected", "other"])
def test_silent_robots_are_done_without(silent):
    graph, _ = loops(np.random.default_rng(7), robots=4, length=20, separators=4)
    probe = {r: ElectedNode(s, CONFIG) for r, s in shares(graph).items()}
    until_ended(probe)
    leader = probe[0].leader
    lost = leader if silent == "elected" else (leader + 1) % 4
    nodes = {r: ElectedNode(s, CONFIG) for r, s in shares(graph).items()}
    until_ended(nodes, dead={lost})
    rest = {r: n for r, n in nodes.items() if r != lost}
    assert all(n.outcome.accepted for n in rest.values())
    assert len({n.leader for n in rest.values()}) == 1
    without = replace(
        graph,
        poses={n: T for n, T in graph.poses.items() if n.robot != lost},
        edges=tuple(e for e in graph.edges if lost not in (e.i.robot, e.j.robot)),
    )
    best = optimise(without, CentralConfig()).cost_after
    found = without.with_poses({k: T for n in rest.values() for k, T in n.outcome.poses.items()})
    assert cost(found, "F") == pytest.approx(best, rel=1e-4)


def test_who_waits_asks_and_only_what_was_lost_is_sent_again():
    graph, _ = loops(np.random.default_rng(7), robots=4, length=20, separators=4)
    patient = CONFIG.model_copy(update={"elected_patience": 1000})
    nodes = {r: ElectedNode(s, patient) for r, s in shares(graph).items()}
    queue, lost, sent = [m for n in nodes.values() for m in n.start()], set(), []
    for _ in range(30):
        while queue:
            message = queue.pop(0)
            sent.append(message)
            # The first of each kind that a robot sends to another is lost.
            key = (message.kind, message.sender, message.receiver)
            if key not in lost and message.kind is not Kind.WAIT:
                lost.add(key)
                continue
            queue += nodes[message.receiver].handle(message)
        queue = [m for n in nodes.values() for m in n.tick()]
    assert all(n.outcome is not None and n.outcome.accepted for n in nodes.values())
    for kind in (Kind.CONTRIBUTION, Kind.SOLUTION):
        assert sum(m.kind is kind for m in sent) == 2 * 3, "lost once, sent twice"
    assert all(m.payload_bytes == 1 for m in sent if m.kind is Kind.WAIT)


class Fading(ElectedNode):
    """Contributes, and then neither hears nor says anything."""

    def handle(self, message):
        return super().handle(message) if message.kind is Kind.SIZE else []

    def tick(self):
        return []


def test_when_a_member_falls_silent_after_its_contribution_nobody_takes_the_result():
    graph, _ = loops(np.random.default_rng(7), robots=4, length=20, separators=4)
    probe = {r: ElectedNode(s, CONFIG) for r, s in shares(graph).items()}
    until_ended(probe)
    lost = (probe[0].leader + 1) % 4
    nodes = {r: (Fading if r == lost else ElectedNode)(s, CONFIG) for r, s in shares(graph).items()}
    queue = [m for n in nodes.values() for m in n.start()]
    for _ in range(100):
        while queue:
            message = queue.pop(0)
            queue += nodes[message.receiver].handle(message)
        queue = [m for n in nodes.values() for m in n.tick()]
    for robot in set(nodes) - {lost}:
        outcome = nodes[robot].outcome
        assert not outcome.accepted and outcome.reason == "a member fell silent"
        assert all(np.array_equal(T, graph.poses[n]) for n, T in outcome.poses.items())


def test_an_elected_robot_that_comes_back_late_keeps_its_poses():
    graph, _ = loops(np.random.default_rng(8), robots=3, length=12, separators=3)
    nodes = {r: ElectedNode(s, CONFIG) for r, s in shares(graph).items()}
    queue = [m for n in nodes.values() for m in n.start()]
    late = None
    for _ in range(200):
        while queue:
            message = queue.pop(0)
            queue += nodes[message.receiver].handle(message) if message.receiver != late else []
            late = nodes[0].leader if late is None else late
        awake = {r: n for r, n in nodes.items() if r != late}
        queue = [m for n in awake.values() for m in n.tick()]
        if all(n.outcome for n in awake.values()):
            break
    assert late is not None
    for message in nodes[late].tick():
        for answer in nodes[message.receiver].handle(message):
            nodes[late].handle(answer)
    outcome = nodes[late].outcome
    assert outcome is not None and not outcome.accepted and outcome.reason.startswith("left out")
    assert all(np.array_equal(T, graph.poses[n]) for n, T in outcome.poses.items())
