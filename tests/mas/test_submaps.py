"""Map merging: who ends with which map, where it stands, and that it ends."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from factory import circuit, make_sequence, make_world, manifest_of

from backend.geometry import Sim3, se3_exp
from mas.agent import Agent
from mas.environment import make_agents
from mas.identities import MatchId, Operation
from mas.keyframe import keyframes_of
from mas.matches import Match
from mas.policy.presets import preset
from mas.posegraph import Adoption
from mas.transport import InProcessTransport, Traffic


def agents_in_a_row(count: int = 3, keyframes: int = 6) -> list[Agent]:
    """Agents with exact odometry, each matched twice with the next; none of them has optimised or asked for places."""
    world = make_world(7, points=20_000)
    paths = [circuit(6.0 * a, keyframes * 1.5) for a in range(count)]
    sequences = [make_sequence(world, path, 7, a, drifting=0.0) for a, path in enumerate(paths)]
    agents = make_agents(manifest_of(sequences), sequences, preset("default"))
    frames = [keyframes_of(s) for s in sequences]
    for agent, mine in zip(agents, frames, strict=True):
        for keyframe in mine:
            agent.observe(keyframe)
        agent._new.clear()
    for a, b in pairwise(agents):
        for k in (0, 1):
            for side in (a, b):
                side.state.add_match(_true_match(paths, frames, a.state.me, b.state.me, k))
    return agents


def _true_match(paths: list, frames: list, a: int, b: int, k: int) -> Match:  # type: ignore[type-arg]
    match, query = frames[a][k + 4], frames[b][k]
    T_M_Q = Sim3.from_se3(np.linalg.inv(paths[a][3 * (k + 4)]) @ paths[b][3 * k])
    poses = (query.T_T_C, match.T_T_C, 1.5 * k, 1.5 * (k + 4), 10.0)
    return Match(MatchId(b, k, a, k + 4), 0, 0, T_M_Q, 1e4 * np.eye(6), 80, *poses)


def trade(agents: list[Agent], buyer: int, sellers: list[int]) -> InProcessTransport:
    """One purchase, with all messages until none is on the way."""
    transport = InProcessTransport(2**24)
    agents[buyer].maps.buy(sellers)
    for message in agents[buyer]._settle():
        transport.send(message, 0)
    while (message := transport.receive()) is not None:
        for answer in agents[message.recipient].handle(message):
            transport.send(answer, 0)
    assert not any(a.desk.ledger.running() for a in agents)
    return transport


def test_a_map_stands_where_the_match_says() -> None:
    agents = agents_in_a_row()
    trade(agents, 0, [1])
    held = agents[0].maps.held[1]
    start = circuit(0.0, 1.0)[0]
    truth = np.linalg.inv(start) @ circuit(6.0, 9.0)[::3]
    np.testing.assert_allclose(held.poses, truth, atol=1e-6)
    own = {bytes(d): p for d, p in zip(held.descriptors, held.points(), strict=True)}
    assert len(own) > 300


def test_sub_maps_come_along_and_are_placed_through_the_seller() -> None:
    agents = agents_in_a_row()
    trade(agents, 1, [2])
    trade(agents, 0, [1])
    assert sorted(agents[0].maps.held) == [1, 2]
    truth = np.linalg.inv(circuit(0.0, 1.0)[0]) @ circuit(12.0, 9.0)[::3]
    np.testing.assert_allclose(agents[0].maps.held[2].poses, truth, atol=1e-6)


def test_agents_that_hold_each_others_maps_come_to_an_end() -> None:
    """Algorithm 1 as printed would walk from sub-map to sub-map for ever."""
    agents = agents_in_a_row()
    for _ in range(3):
        for buyer, sellers in ((0, [1]), (1, [0, 2]), (2, [1])):
            trade(agents, buyer, sellers)
    assert [sorted(a.maps.held) for a in agents] == [[1, 2], [0, 2], [0, 1]]
    again = trade(agents, 1, [0, 2])
    assert again.by_operation[Traffic.MAPMERGE].messages == 0, "nothing new: nothing ordered, nothing sent"


def test_the_newest_version_wins() -> None:
    agents = agents_in_a_row()
    trade(agents, 1, [2])
    trade(agents, 0, [1])
    old = agents[0].maps.held[2].version
    agents[2].state.version += 1
    trade(agents, 1, [2])
    trade(agents, 0, [1])
    assert agents[0].maps.held[2].version == old + 1
    trade(agents, 2, [1])
    assert 2 not in agents[2].maps.held, "nobody buys back its own map"


def test_a_stranger_without_a_match_is_not_placed() -> None:
    agents = agents_in_a_row()
    trade(agents, 0, [2])
    assert agents[0].maps.held == {}
    assert [e.kind for e in agents[0].diary if e.kind == "map_refused"] == ["map_refused"]


def test_held_maps_move_along_with_the_agents_own_correction() -> None:
    agents = agents_in_a_row()
    trade(agents, 0, [1])
    state, held = agents[0].state, agents[0].maps.held[1]
    before = {i: state.pose(i) for i in range(len(state.keyframes))}
    motion = se3_exp([0.3, -0.1, 0.2, 0.0, 0.1, 0.0])
    state.poses = [motion @ T for T in state.poses]
    agents[0].maps.realign(Adoption(before, frozenset()))
    np.testing.assert_allclose(agents[0].maps.held[1].poses, motion @ held.poses, atol=1e-9)


def test_a_purchase_is_one_contract_that_ends() -> None:
    agents = agents_in_a_row()
    trade(agents, 0, [1])
    ends = [e.fields for e in agents[0].diary if e.kind == "contract"]
    assert [(e["operation"], e["end"]) for e in ends] == [(Operation.MAPMERGE.name.lower(), "done")]
