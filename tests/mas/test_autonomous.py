"""The optimised system's decisions, from states and outlooks made by hand."""

from __future__ import annotations

import numpy as np
import pytest
from factory import town

from maslam.mas.agent import Agent
from maslam.mas.policies.autonomous import Autonomous
from maslam.mas.policies.base import Outlook
from maslam.mas.policies.presets import policy_of, preset
from maslam.mas.protocol.ids import MatchId
from maslam.mas.simulation import make_agents
from maslam.mas.state.agent_state import AgentState


def outlook(**changes: object) -> Outlook:
    fields: dict[str, object] = {
        "pending_matches": 0,
        "since_optimised": 100,
        "since_bought": {},
        "since_matched": {},
        "stale": frozenset(),
        "distances": {},
        "reachable": frozenset(),
        "closing": False,
    }
    return Outlook(**{**fields, **changes})  # type: ignore[arg-type]


def state_of(agents: int) -> AgentState:
    manifest, sequences = town(agents, 2)
    return make_agents(manifest, sequences, preset("optimised"))[0].state


def match(state: AgentState, other: int, keyframe: int = 0) -> None:
    """As if a match with another agent had been accepted."""
    state.accepted.add(MatchId(state.me, keyframe, other, keyframe))
    state.group.add(other)


def test_who_learned_a_place_asks_nobody_and_then_all_but_one_again() -> None:
    state, policy = state_of(10), Autonomous()
    assert len(policy.ask(state, outlook(), 0)) == 8
    match(state, 3)
    assert policy.ask(state, outlook(), 1) == []
    assert len(policy.ask(state, outlook(), 2)) == 8


def test_nobody_is_left_out_for_good() -> None:
    state, policy = state_of(10), Autonomous()
    asked = [policy.ask(state, outlook(), k) for k in range(9)]
    times = np.bincount([a for agents in asked for a in agents], minlength=10)[1:]
    assert times.tolist() == [8] * 9


def test_all_of_the_group_optimise_what_is_new() -> None:
    state, policy = state_of(6), Autonomous()
    match(state, 2)
    match(state, 5)
    policy.ask(state, outlook(), 0)
    assert policy.optimise(state, outlook(pending_matches=2)) == [0, 2, 5]
    assert policy.optimise(state, outlook()) == []
    assert policy.optimise(state, outlook(pending_matches=2, since_optimised=0)) == []
    assert policy.optimise(state, outlook(pending_matches=2, since_optimised=0, closing=True)) == [0, 2, 5]


def test_the_number_of_agents_limits_who_optimises_partners_first() -> None:
    state, policy = state_of(6), Autonomous()
    match(state, 5)
    policy.ask(state, outlook(), 0)  # a group of one other: two optimise
    state.group.update({1, 2})
    assert policy.optimise(state, outlook(pending_matches=1)) == [0, 5]


def test_maps_are_bought_once_after_places_were_gained() -> None:
    state, policy = state_of(6), Autonomous()
    stale = outlook(stale=frozenset({2, 5}))
    policy.ask(state, outlook(), 0)
    assert policy.buy(state, stale) == []
    match(state, 2)
    match(state, 5)
    policy.ask(state, outlook(), 1)
    policy.ask(state, outlook(), 2)  # the optimisation in between took so long
    assert policy.buy(state, stale) == [2, 5]
    assert policy.buy(state, stale) == []
    assert policy.buy(state, outlook(closing=True)) == [2, 5]


def test_the_oldest_copies_are_renewed_first() -> None:
    state, policy = state_of(6), Autonomous()
    match(state, 2)
    policy.ask(state, outlook(), 0)
    match(state, 4)
    match(state, 5)
    stale = frozenset({2, 4, 5})
    assert policy.buy(state, outlook(stale=stale, since_bought={2: 90, 4: 100, 5: 95})) == [4]


def test_selection_draws_by_weight_with_a_generator_of_its_own() -> None:
    state = state_of(10)
    config = preset("selection")

    def asked(me: int, seed: int = 0) -> list[list[int]]:
        policy = policy_of(config.model_copy(update={"seed": seed}), me)
        return [policy.ask(state, outlook(), k) for k in range(30)]

    assert asked(0) == asked(0)
    assert asked(0) != asked(1) and asked(0) != asked(0, seed=1)
    assert all(len(set(a)) == len(a) and 0 not in a for a in asked(0))
    assert 0.4 * 9 < np.mean([len(a) for a in asked(0)]) < 0.7 * 9


@pytest.mark.parametrize(("agents", "share"), [(10, 0.65), (20, 0.55)])
def test_selection_asks_about_half_of_whom_the_logic_allows(agents: int, share: float) -> None:
    state, rng = state_of(agents), np.random.default_rng(0)
    policy, counts = Autonomous(np.random.default_rng(1)), []
    for k in range(200):
        far = dict(zip(range(1, agents), rng.uniform(0.6, 1.3, agents - 1), strict=True))
        counts.append(len(policy.ask(state, outlook(distances=far), k)))
    assert np.mean(counts) <= share * (agents - 2)


def test_selection_prefers_near_members_of_the_group_and_those_not_asked_last_time() -> None:
    state = state_of(10)
    match(state, 3)
    policy = Autonomous(np.random.default_rng(0))
    policy.ask(state, outlook(), 0)
    counts = np.zeros(10)
    for k in range(1, 400):
        before = policy._previous
        for agent in policy.ask(state, outlook(distances={a: 0.1 if a == 3 else 1.0 for a in range(1, 10)}), k):
            counts[agent] += 1
            counts[0] += agent not in before
    assert counts[3] > 1.4 * np.delete(counts, [0, 3]).max()
    assert counts[0] > 0.6 * counts[1:].sum()


def test_an_agent_without_others_decides_nothing() -> None:
    manifest, sequences = town(1, 2)
    agent: Agent = make_agents(manifest, sequences, preset("selection"))[0]
    assert agent.policy.ask(agent.state, outlook(), 0) == []
    assert agent.policy.optimise(agent.state, outlook(pending_matches=1)) == [0]
