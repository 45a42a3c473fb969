"""Optimisations of two: who bids so, what it offers, what becomes of the others, and how it goes on from there."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from by_hand import begun, handled, happened, logged
from factory import circuit, make_sequence, make_world, town
from hypothesis import given, settings
from hypothesis import strategies as st
from saboteurs import live
from test_autonomous import match, outlook, state_of
from test_map_exchange import agents_in_a_row
from test_matches import random_sim3

from maslam.backend.geometry import se3_inverse
from maslam.mas.agent import Agent
from maslam.mas.optimisation.pending_matches import PendingMatches
from maslam.mas.optimisation.planning import plan
from maslam.mas.policies.autonomous import Autonomous
from maslam.mas.policies.base import Outlook
from maslam.mas.policies.presets import PRESETS, policy_of, preset
from maslam.mas.policies.query_all import QueryAll
from maslam.mas.protocol.ids import FrameId, MatchId
from maslam.mas.protocol.messages import LINK_DTYPE, Bid, Links, PieceTerms
from maslam.mas.protocol.tensors import pack_sim3s, unpack_sim3s
from maslam.mas.state.agent_state import AgentState
from maslam.mas.state.keyframe import keyframes_of
from maslam.mas.state.pose_graph import terms
from maslam.mas.transport.transport import InProcessTransport

# -- who decides so ---------------------------------------------------------------------------------------------------


def test_an_agent_allowed_two_bids_peer_to_peer_until_it_decides_anew() -> None:
    state, policy = state_of(6), Autonomous()
    match(state, 5)
    policy.ask(state, outlook(), 0)
    state.group.update({1, 2})
    assert policy.peer_to_peer(state, outlook())
    assert not policy.peer_to_peer(state, outlook(closing=True)), "at the end everything that is known is used"
    policy.ask(state, outlook(), 1)
    assert not policy.peer_to_peer(state, outlook())


def test_a_manager_allowed_two_calls_whom_it_was_matched_with_last() -> None:
    state, policy = state_of(6), Autonomous()
    match(state, 5)
    policy.ask(state, outlook(), 0)
    match(state, 2)
    assert policy.optimise(state, outlook(pending_matches=2, since_matched={5: 9, 2: 0})) == [0, 2]
    assert policy.optimise(state, outlook(pending_matches=2, since_matched={5: 0, 2: 9})) == [0, 5]


def test_who_met_the_first_other_since_it_decided_optimises_with_it_and_not_alone() -> None:
    state, policy = state_of(6), Autonomous()
    policy.ask(state, outlook(), 0)
    match(state, 3)
    assert policy.optimise(state, outlook(pending_matches=1, since_matched={3: 0})) == [0, 3]


@pytest.mark.parametrize("name", PRESETS)
def test_only_agents_with_logic_ever_bid_peer_to_peer(name: str) -> None:
    state = state_of(6)
    policy = policy_of(preset(name), 0)
    match(state, 5)
    if isinstance(policy, Autonomous):
        policy.ask(state, outlook(), 0)
    assert policy.peer_to_peer(state, outlook()) == (name in ("optimised", "selection"))


def test_matches_with_agents_that_were_not_called_stay_news() -> None:
    state = state_of(6)
    match(state, 5)
    match(state, 2)
    pending = PendingMatches(state)
    pending.offered([0, 2])
    pending.used(frozenset())
    assert pending.matches == {m for m in state.accepted if 5 in m.agents}


# -- what is offered --------------------------------------------------------------------------------------------------


def test_a_bid_peer_to_peer_offers_the_matches_with_the_manager_and_own_loops() -> None:
    agents = agents_in_a_row(3)
    state = agents[1].state
    loop = replace(next(iter(state.verified.values())), id=MatchId(1, 5, 1, 0))
    state.verified[loop.id] = loop
    state.accepted.add(loop.id)
    whole, pair = terms(state, 0), terms(state, 0, peer=0)
    assert {m.agents for m in offered(whole)} == {(1, 0), (2, 1), (1, 1)} and not whole.peer_to_peer
    assert {m.agents for m in offered(pair)} == {(1, 0), (1, 1)} and pair.peer_to_peer
    assert pair.pieces == whole.pieces
    made = agents[1].optimisation.running.estimator
    assert offered(made.bid(0)) == offered(pair) and offered(made.bid()) == offered(whole)
    assert made.bid(0).cost_bytes < made.bid().cost_bytes


def offered(bid: Bid) -> tuple[MatchId, ...]:
    return () if bid.links is None else bid.links.matches


Rows = dict[int, list[tuple[MatchId, bool]]]


def bids_of(
    rows: Rows, pairs: set[int], manager: int, frames: dict[int, FrameId], rng: np.random.Generator
) -> dict[int, Bid]:
    made = {}
    for agent, held in rows.items():
        peer = agent in pairs and agent != manager
        mine = [(m, q) for m, q in held if not peer or set(m.agents) <= {agent, manager}]
        links = Links(
            tuple(m for m, _ in mine),
            tuple(0 for _ in mine),
            tuple(frames[agent] for _ in mine),
            tuple(q for _, q in mine),
            pack_sim3s([random_sim3(rng, 1.0) for _ in mine], LINK_DTYPE),
            pack_sim3s([random_sim3(rng, 1.0) for _, q in mine if q], LINK_DTYPE),
        )
        made[agent] = Bid(0, 0, links, (PieceTerms(0, frames[agent], True, True),), peer_to_peer=peer)
    return made


@given(
    st.integers(2, 7),
    st.sets(st.tuples(st.integers(0, 6), st.integers(0, 6)), max_size=15),
    st.sets(st.integers(0, 6)),
    st.integers(0, 6),
    st.integers(0, 10**6),
)
@settings(max_examples=200, deadline=None)
def test_no_match_is_used_that_one_of_its_owners_did_not_offer(
    agents: int, edges: set[tuple[int, int]], pairs: set[int], manager: int, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    manager %= agents
    rows: Rows = {a: [] for a in range(agents)}
    for q, m in sorted((q % agents, m % agents) for q, m in edges):
        if q != m:
            match_id = MatchId(q, int(rng.integers(1000)), m, int(rng.integers(1000)))
            rows[q].append((match_id, True))
            rows[m].append((match_id, False))
    frames = {a: FrameId(int(rng.integers(a + 1)), 0) for a in range(agents)}
    bids = bids_of(rows, pairs, manager, frames, rng)
    found = plan(manager, bids)
    assert manager in found.members and set(found.tasks) == set(found.members)
    for agent, task in found.tasks.items():
        for used in task.matches:
            assert all(used in offered(bids[a]) and used in found.tasks[a].matches for a in used.agents)
            assert agent == manager or agent not in pairs or set(used.agents) == {agent, manager}
        assert task.frame == min(frames[a] for a in found.members)
    for agent in pairs & set(found.members) - {manager}:
        assert any(set(m.agents) == {agent, manager} for m in found.tasks[agent].matches)


def test_who_leaves_others_behind_for_an_optimisation_of_two_keeps_their_coordinates() -> None:
    """Agent 2 shares agent 0's coordinates, agent 1 has its own: the two meet in agent 0's."""
    rng = np.random.default_rng(3)
    T_0_1 = random_sim3(rng, 2.0)
    at = {1: random_sim3(rng, 1.0), 2: random_sim3(rng, 0.5)}
    T_M_Q = (T_0_1 @ at[1]).inverse() @ at[2]
    met = MatchId(2, 4, 1, 6)
    frames = {1: FrameId(1, 0), 2: FrameId(0, 0)}
    bids = {
        a: Bid(
            0,
            0,
            Links(
                (met,),
                (0,),
                (frames[a],),
                (a == 2,),
                pack_sim3s([at[a]], LINK_DTYPE),
                pack_sim3s([T_M_Q] if a == 2 else [], LINK_DTYPE),
            ),
            (PieceTerms(0, frames[a], False, False),),
        )
        for a in (1, 2)
    }
    found = plan(2, bids)
    assert found.members == (1, 2)
    assert {t.frame for t in found.tasks.values()} == {FrameId(0, 0)}
    np.testing.assert_allclose(unpack_sim3s(found.tasks[1].placements)[0].matrix(), T_0_1.matrix(), atol=1e-5)
    np.testing.assert_allclose(unpack_sim3s(found.tasks[2].placements)[0].matrix(), np.eye(4), atol=1e-5)


# -- a chain of three -------------------------------------------------------------------------------------------------


class Pairing(QueryAll):
    """Bids peer-to-peer whatever the state."""

    def peer_to_peer(self, state: AgentState, outlook: Outlook) -> bool:
        return True


def chain(pairing: set[int]) -> list[Agent]:
    """0 - 1 - 2, matched in a row; who of them bids peer-to-peer."""
    agents = agents_in_a_row(3)
    for agent in agents:
        agent.state.group.update({0, 1, 2})
        if agent.state.me in pairing:
            policy = Pairing()
            agent.optimisation._peer_to_peer = lambda p=policy, a=agent: p.peer_to_peer(a.state, a.outlook())  # type: ignore[misc]
    return agents


def optimised(agents: list[Agent], manager: int) -> tuple[int, ...]:
    """Members of an optimisation that the manager calls all three for."""
    transport = InProcessTransport(2**24)
    agents[manager].pending.offered([0, 1, 2])
    for first in begun(agents[manager], agents[manager].optimisation.start([0, 1, 2])):
        transport.send(first, 0)
    while (message := transport.receive()) is not None:
        for answer in handled(agents, message):
            transport.send(answer, 0)
    assert not any(a.context.ledger.running() for a in agents)
    notes = [e["members"] for e in logged(agents[manager], "optimised")]
    return tuple(notes[-1])


@pytest.mark.parametrize(
    ("pairing", "manager", "members"),
    [
        (set(), 0, (0, 1, 2)),
        ({1}, 0, (0, 1)),  # the one in the middle: only what it shares with the manager
        ({1}, 2, (1, 2)),
        ({2}, 0, (0, 1)),  # an outer one has nothing in common with the manager
        ({0, 2}, 1, (0, 1, 2)),  # both outer ones have
        ({0, 1, 2}, 1, (0, 1, 2)),  # a manager's own number is who it calls
    ],
)
def test_who_bids_peer_to_peer_is_joined_to_the_manager_alone(
    pairing: set[int], manager: int, members: tuple[int, ...]
) -> None:
    agents = chain(pairing)
    assert optimised(agents, manager) == members
    frame = FrameId(min(members), 0)
    for agent in agents:
        inside = agent.state.me in members
        assert agent.state.frame == (frame if inside else FrameId(agent.state.me, 0))
        theirs = {m for m in agent.state.accepted if set(m.agents) <= set(members)}
        assert not inside or agent.pending.matches & theirs == set()
        unused = agent.state.accepted - theirs
        assert agent.state.me == manager or agent.pending.matches >= unused, "what was not used is pending still"


def test_frames_that_come_later_are_carried_over_and_the_group_comes_together_in_the_end() -> None:
    agents = chain({1})
    world, ways = make_world(7, points=20_000), [circuit(6.0 * a, 15.0) for a in range(3)]
    sequences = [make_sequence(world, way, 7, a, drifting=0.0) for a, way in enumerate(ways)]
    assert optimised(agents, 2) == (1, 2)
    for agent, sequence in zip(agents, sequences, strict=True):
        for keyframe in keyframes_of(sequence)[6:]:
            agent.state.observe(keyframe)
    stands(agents, {0: 0, 1: 1, 2: 1})
    assert optimised(agents, 0) == (0, 1)
    stands(agents, {0: 0, 1: 0, 2: 1})
    assert optimised(agents, 2) == (1, 2)
    stands(agents, {0: 0, 1: 0, 2: 0})
    for agent in agents:
        agent.optimisation._peer_to_peer = lambda: False
    assert optimised(agents, 2) == (0, 1, 2)
    stands(agents, {0: 0, 1: 0, 2: 0})


def stands(agents: list[Agent], frames: dict[int, int]) -> None:
    """All key-frames, early and late, are where they truly are in the coordinates of these agents."""
    for agent in agents:
        me, origin = agent.state.me, frames[agent.state.me]
        assert {p.frame for p in agent.state.pieces} == {FrameId(origin, 0)}
        truth = se3_inverse(circuit(6.0 * origin, 1.0)[0]) @ circuit(6.0 * me, 15.0)[::3]
        np.testing.assert_allclose(agent.state.poses, truth[: len(agent.state.poses)], atol=1e-5)


def test_a_town_of_agents_with_logic_comes_together_although_some_bid_peer_to_peer() -> None:
    manifest, sequences = town(5, 16, spacing_m=9.0, drifting=0.03)
    config = preset("optimised")
    config = config.model_copy(update={"merge": config.merge.model_copy(update={"enabled": False})})
    environment, _ = live(manifest, sequences, config)
    assert happened(environment, "peer_to_peer")
    assert {a.state.frame for a in environment.agents} == {FrameId(0, 0)}
