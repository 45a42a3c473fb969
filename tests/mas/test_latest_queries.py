"""The latest five frames of the asker are compared with what the asked agent has seen since, for the bytes of one."""

from __future__ import annotations

import numpy as np
import pytest
from by_hand import handled, logged, ticked
from factory import town

from maslam.mas.agent import Agent
from maslam.mas.place_recognition.peer_queries import RecentQueries
from maslam.mas.policies.base import Outlook, Policy
from maslam.mas.policies.presets import preset
from maslam.mas.protocol.messages import Award, Message, Result
from maslam.mas.protocol.tasks import EarlierAnswer, PlaceAnswer, PlaceQuery
from maslam.mas.simulation import make_agents
from maslam.mas.state.agent_state import AgentState
from maslam.mas.state.keyframe import KeyFrame, keyframes_of


def pair(seed: int = 0) -> tuple[list[Agent], list[list[KeyFrame]]]:
    """Two agents on the same way, and their key-frames, not yet given to them."""
    manifest, sequences = town(2, 16, seed=seed, spacing_m=0.0)
    return make_agents(manifest, sequences, preset("optimised")), [keyframes_of(s) for s in sequences]


def test_the_answer_is_the_nearest_of_all_pairs_not_compared_before() -> None:
    """The agent that is asked sees key-frames between the queries, by a fixed plan; brute force over all pairs."""
    agents, keyframes = pair()
    log = RecentQueries(agents[1].candidates, 5)
    compared: set[tuple[int, int]] = set()
    earlier = 0
    for query, seen in enumerate([0, 1, 2, 2, 5, 9, 9, 10, 12, 13, 13, 16]):
        for keyframe in keyframes[1][len(agents[1].state.keyframes) : seen]:
            agents[1].observe(keyframe)
        found = log.nearest(0, query, keyframes[0][query].vector)
        pairs = {(q, k) for q in range(max(query - 4, 0), query + 1) for k in range(seen)} - compared
        compared |= pairs
        if not pairs:
            assert found is None
            continue
        apart = {p: float(np.linalg.norm(keyframes[0][p[0]].vector - keyframes[1][p[1]].vector)) for p in pairs}
        assert found is not None
        assert found.distance == pytest.approx(min(apart.values()), abs=1e-6)
        assert apart[found.query, found.keyframe] == pytest.approx(found.distance, abs=1e-6)
        earlier += found.query != query
    assert earlier > 0


def test_askers_are_kept_apart_and_one_frame_only_means_no_memory() -> None:
    agents, keyframes = pair()
    five, one = RecentQueries(agents[1].candidates, 5), RecentQueries(agents[1].candidates, 1)
    place, elsewhere = keyframes[0][12].vector, keyframes[0][0].vector
    assert five.nearest(0, 0, place) is None and one.nearest(0, 0, place) is None
    for keyframe in keyframes[1]:
        agents[1].observe(keyframe)
    for log, asker in ((five, 7), (one, 0)):
        found = log.nearest(asker, 1, elsewhere)
        assert found is not None and (found.query, found.keyframe) == (1, 0)
    again = five.nearest(0, 1, elsewhere)
    assert again is not None and again.distance <= 1e-6


def test_a_query_said_again_is_answered_again_and_kept_once() -> None:
    agents, keyframes = pair()
    log = RecentQueries(agents[1].candidates, 2)
    agents[1].observe(keyframes[1][0])
    first = log.nearest(0, 0, keyframes[0][0].vector)
    log.nearest(0, 1, keyframes[0][14].vector)
    assert log.nearest(0, 1, keyframes[0][14].vector) == log.nearest(0, 1, keyframes[0][14].vector)
    agents[1].observe(keyframes[1][1])
    # Key-frame 0 is still one of the two latest: its new neighbour is found.
    again = log.nearest(0, 1, keyframes[0][14].vector)
    assert first is not None and again is not None and (again.query, again.keyframe) == (0, 1)


def answered(agents: list[Agent], mail: list[Message]) -> list[object]:
    outcomes = []
    while mail:
        message = mail.pop(0)
        if isinstance(message.body, Result):
            outcomes.append(message.body.outcome)
        mail += handled(agents, message)
    return [o for o in outcomes if isinstance(o, PlaceAnswer | EarlierAnswer)]


def test_an_earlier_query_is_matched_when_the_other_agent_gets_there() -> None:
    """Agent 0 is ahead; agent 1 comes by while agent 0 is asking about the next place: the candidate of agent 0's
    earlier key-frame goes to verification."""
    agents, keyframes = pair()
    agents[1].observe(keyframes[1][0])
    ticked(agents[1], 0)
    for k in (8, 9, 10):
        agents[0].observe(_renumbered(keyframes[0][k], len(agents[0].state.keyframes)))
        (answer,) = answered(agents, ticked(agents[0], k))
        assert isinstance(answer, PlaceAnswer)
    # Of those, key-frame 1 (it was the ninth) is where agent 1 is now.
    agents[1].observe(_renumbered(keyframes[1][9], 1))
    agents[0].observe(_renumbered(keyframes[0][14], 3))
    (answer,) = answered(agents, ticked(agents[0], 11))
    assert isinstance(answer, EarlierAnswer) and (answer.query, answer.keyframe) == (1, 1)
    assert [(c.id.query, c.id.match) for c in agents[0].candidates.by_id.values()] == [(1, 1)]


def test_an_answer_for_a_key_frame_never_asked_about_is_refused() -> None:
    agents, keyframes = pair()
    for agent, own in zip(agents, keyframes, strict=True):
        agent.observe(own[0])
    mail = ticked(agents[0], 0)
    while not (isinstance(mail[0].body, Award) and isinstance(mail[0].body.task, PlaceQuery)):
        message = mail.pop(0)
        mail += handled(agents, message)
    award = mail[0]
    confirmed, result = handled(agents, award)
    handled(agents, confirmed)
    false = Result(EarlierAnswer(3, 0, 0.1))
    handled(agents, Message(result.sender, result.recipient, result.contract, false))
    assert [e["reason"] for e in logged(agents[0], "refused")] == ["agent 1 was not asked about key-frame 3"]
    assert not agents[0].candidates.by_id


def _renumbered(keyframe: KeyFrame, index: int) -> KeyFrame:
    from dataclasses import replace

    return replace(keyframe, index=index)


def asked_about(agents: list[Agent], mail: list[Message]) -> list[int]:
    """Deliver everything; the key-frames that were asked about, in order."""
    keyframes = []
    while mail:
        message = mail.pop(0)
        if isinstance(message.body, Award) and isinstance(message.body.task, PlaceQuery):
            keyframes.append(message.body.task.keyframe)
        mail += handled(agents, message)
    return keyframes


class OnlyTheLast(Policy):
    """A policy that asks about one key-frame."""

    def __init__(self, keyframe: int) -> None:
        self.keyframe = keyframe

    def ask(self, state: AgentState, outlook: Outlook, keyframe: int) -> list[int]:
        return [1] if keyframe == self.keyframe else []

    def optimise(self, state: AgentState, outlook: Outlook) -> list[int]:
        return []

    def buy(self, state: AgentState, outlook: Outlook) -> list[int]:
        return []


@pytest.mark.parametrize(("there", "expected"), [(6, [6, 2, 3, 4, 5]), (15, [6])])
def test_where_one_frame_is_recognised_the_latest_five_are_asked_about(there: int, expected: list[int]) -> None:
    """Agent 1 has seen the place of key-frame ``there`` only; agent 0 asks about its seventh, key-frame 6."""
    agents, keyframes = pair()
    agents[0].policy = OnlyTheLast(6)
    agents[1].observe(_renumbered(keyframes[1][there], 0))
    for keyframe in keyframes[0][:7]:
        agents[0].observe(keyframe)
    assert asked_about(agents, ticked(agents[0], 0)) == expected
    # Nothing is asked twice.
    assert asked_about(agents, ticked(agents[0], 1)) == []


def test_with_one_frame_only_nothing_is_asked_beyond_the_policys_wish() -> None:
    manifest, sequences = town(2, 16, spacing_m=0.0)
    agents = make_agents(manifest, sequences, preset("default"))
    agents[0].policy = OnlyTheLast(6)
    agents[1].observe(keyframes_of(sequences[1])[0])
    for keyframe in keyframes_of(sequences[0])[:7]:
        agents[0].observe(keyframe)
    assert asked_about(agents, ticked(agents[0], 0)) == [6]
