"""The directory leaves, comes late, comes back: what was seen before is recognised all the same, and nobody is told
anything twice."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pytest
from by_hand import happened
from factory import town
from saboteurs import Sleeper, live
from test_autonomous import outlook

from maslam.mas.agent import Agent
from maslam.mas.config import FaultsConfig, LinkConfig, MasConfig
from maslam.mas.evaluation.ground_truth import GroundTruthEvaluator, groups_of
from maslam.mas.output.run_folder import match_errors
from maslam.mas.place_recognition.candidates import Candidate
from maslam.mas.policies.directory import Directory
from maslam.mas.policies.presets import preset
from maslam.mas.protocol.accounting import Traffic
from maslam.mas.protocol.ids import ContractId, MatchId, OperationKind
from maslam.mas.protocol.messages import Award, Message
from maslam.mas.protocol.tasks import OwnerQuery
from maslam.mas.simulation import Environment, make_agents
from maslam.mas.state.keyframe import keyframes_of

Told = dict[tuple[int, int, int], set[ContractId]]
KEYFRAME_S = 0.3


def faulty(link: LinkConfig | None = None, **faults: object) -> MasConfig:
    update: dict[str, object] = {"faults": FaultsConfig.model_validate(faults)}
    return preset("maslam").model_copy(update=update | ({} if link is None else {"link": link}))


def play(
    config: MasConfig, keyframes: int, spacing_m: float, odd: Mapping[int, type[Agent]] | None = None
) -> tuple[Environment, GroundTruthEvaluator, Told]:
    """A town of four in a row, and in which contracts who told whom of which key-frame, whether it arrived or not."""
    told: Told = {}

    def listen(message: Message, wire: int) -> None:
        if isinstance(message.body, Award) and isinstance(message.body.task, OwnerQuery):
            assert message.contract is not None
            key = (message.sender, message.recipient, message.body.task.keyframe)
            told.setdefault(key, set()).add(message.contract)

    manifest, sequences = town(4, keyframes, spacing_m=spacing_m, drifting=0.03)
    environment, evaluator = live(manifest, sequences, config, odd, listen=listen)
    assert not [e for e in match_errors(environment.agents, evaluator).values() if e.false]
    assert not happened(environment, "refused")
    return environment, evaluator, told


def times(told: Told) -> set[int]:
    """How often anybody was told of a key-frame."""
    return {len(contracts) for contracts in told.values()}


def known_to(told: Told, recipient: int, sender: int) -> set[int]:
    return {k for s, r, k in told if (s, r) == (sender, recipient)}


@pytest.mark.parametrize(("keyframes", "spacing_m"), [(40, 32.0), (60, 47.0)])
def test_a_place_seen_before_the_directory_left_is_recognised_afterwards(keyframes: int, spacing_m: float) -> None:
    """Each agent comes to where the next one started after the directory has gone, with what it was told of there. Its
    successor finds out while all drive, or at the end: then a silence of 2 x 3 s ends after the last key-frame."""
    left_s = 6.0
    assert spacing_m / 5.0 > left_s, "nobody is where another one was before that"
    environment, evaluator, told = play(faulty(leave_s={0: left_s}), keyframes, spacing_m)
    assert [1, 2, 3] in groups_of(environment.agents)
    partners = {a: environment.agents[a].state.partners() for a in (1, 2, 3)}
    assert partners[1] == [2] and partners[2] == [1, 3] and partners[3] == [2]
    for agent in (1, 2, 3):
        for partner in partners[agent]:
            shared = [m for m in environment.agents[agent].state.accepted if partner in m.agents]
            assert min(min(m.query, m.match) for m in shared) * KEYFRAME_S < left_s - 1.0, "told to the one that left"
        assert set(environment.agents[agent].maps.copies) == {1, 2, 3} - {agent}
        assert not environment.agents[agent].context.ledger.running()
    assert max(evaluator.connected_errors(environment.agents)[a].rmse_m for a in (1, 2, 3)) < 1.5
    assert times(told) == {1}, "once"
    assert known_to(told, 1, 2) == known_to(told, 1, 3) == set(range(keyframes))


def test_one_that_comes_late_and_is_the_directory_then_is_told_what_it_missed() -> None:
    environment, evaluator, told = play(faulty(late_s={0: 6.0}), 40, 32.0)
    assert groups_of(environment.agents) == [[0, 1, 2, 3]]
    assert max(e.rmse_m for e in evaluator.connected_errors(environment.agents).values()) < 1.0
    assert times(told) == {1}
    for sender in (1, 2, 3):
        assert known_to(told, 0, sender) == set(range(40))
    for sender in (2, 3):
        assert 0 < len(known_to(told, 1, sender)) < 40, "told as long as it was the directory"


class Dozer(Sleeper):
    ASLEEP_S = (3.0, 10.0)


def test_a_directory_that_comes_back_is_told_only_what_it_missed_and_the_other_one_little() -> None:
    """Two silences of 3 s make it silent after 9 s; probed 2 s later it is back. Meanwhile each new key-frame that its
    successor took in earned it one earlier one."""
    config = faulty(delay_s=0.001)
    config = config.model_copy(update={"reputation": config.reputation.model_copy(update={"probe_s": 2.0})})
    environment, evaluator, told = play(config, 60, 40.0, {0: Dozer})
    assert groups_of(environment.agents) == [[0, 1, 2, 3]]
    assert max(e.rmse_m for e in evaluator.connected_errors(environment.agents).values()) < 1.0
    assert times(told) == {1}
    meanwhile = (2.0 + 2 * config.step_s) / KEYFRAME_S
    for sender in (2, 3):
        assert known_to(told, 0, sender) == set(range(60))
        assert 0 < len(known_to(told, 1, sender)) <= 2 * meanwhile


def dvpr_bytes(environment: Environment) -> int:
    return environment.transport.by_operation[Traffic.DVPR].wire_bytes


def test_loss_alone_moves_no_directory() -> None:
    """A word of place recognition is said again until it arrives: 1 / (1 - p) times on average, with variance
    p / (1 - p)^2. So is the answer; nothing else of this kind may travel."""
    loss, contracts = 0.3, 3 * 40
    whole, _, _ = play(preset("maslam"), 40, 32.0)
    environment, _, told = play(faulty(loss=loss), 40, 32.0)
    assert groups_of(environment.agents) == [[0, 1, 2, 3]]
    assert set(told) == {(a, 0, k) for a in (1, 2, 3) for k in range(40)}
    deviation = np.sqrt(loss / contracts) / (1 - loss)
    assert dvpr_bytes(environment) < (1 / (1 - loss) + 4 * deviation) * dvpr_bytes(whole)


def test_on_a_link_that_fails_often_there_is_no_storm() -> None:
    """Half of all words are lost and patience is short: others are taken for gone that are not. Each key-frame goes to
    whom its agent takes for the directory, at most one earlier one goes with it, and at the end the last directory is
    told the rest: three times as many tellings as without loss at most, each 1 / (1 - p) times until it arrives."""
    loss, keyframes = 0.5, 40
    whole, _, _ = play(preset("maslam"), keyframes, 32.0)
    link = LinkConfig(silence_s=0.05, retries=1)
    environment, _, told = play(faulty(link, loss=loss), keyframes, 32.0)
    moved = {r for _, r, _ in told} - {0}
    assert moved, "otherwise this test shows nothing"
    assert len(told) <= 3 * 3 * keyframes
    assert dvpr_bytes(environment) <= 3 / (1 - loss) * dvpr_bytes(whole)
    assert not any(a.context.ledger.running(OperationKind.DVPR) for a in environment.agents)


def agent_of(number: int, keyframes: int) -> Agent:
    manifest, sequences = town(4, keyframes)
    agent = make_agents(manifest, sequences, preset("maslam"))[number]
    for keyframe in keyframes_of(sequences[number]):
        agent.observe(keyframe)
    return agent


def test_earlier_key_frames_wait_until_the_directory_has_proved_itself() -> None:
    state, policy = agent_of(2, 9).state, Directory()
    here = frozenset({0, 1, 3})
    assert policy.recall(state, outlook(reachable=here), 2) == {}
    assert policy.recall(state, outlook(reachable=here, delivered={0: 1, 1: 9}), 2) == {}
    assert policy.recall(state, outlook(reachable=here, delivered={0: 2}), 2) == {0: 2}
    assert policy.recall(state, outlook(reachable=here, closing=True), 0) == {0: 1}, "a trial, nothing else will come"
    assert policy.recall(state, outlook(reachable=here, closing=True, delivered={0: 2}), 0) == {0: 9}
    assert policy.recall(state, outlook(reachable=frozenset({3})), 1) == {2: 9}, "its own log costs nothing"


def test_an_earlier_key_frame_is_not_verified_again_around_an_accepted_match() -> None:
    agent = agent_of(2, 30)
    agent.state.accepted |= {MatchId(2, 10, 1, 3), MatchId(3, 5, 2, 24)}
    agent.candidates.last_matched = {1: 10, 3: 24}
    gap = preset("maslam").places.gap_keyframes
    agent.candidates.recalled = {10 - gap - 1, 10 - gap, 10 + gap, 17}
    reasons = {}
    for keyframe, other in ((10 - gap - 1, 1), (10 - gap, 1), (10 + gap, 1), (17, 1), (17, 3)):
        match = MatchId(2, keyframe, other, 3)
        agent.candidates.propose(Candidate(match, 0, 0.1))
        reasons[keyframe, other] = agent.candidates.by_id[match].check.reason
    assert reasons == {
        (10 - gap - 1, 1): "",
        (10 - gap, 1): "close to an accepted match",
        (10 + gap, 1): "close to an accepted match",
        (17, 1): "",
        (17, 3): "",
    }
    # One that was told in its turn, whose answer comes late, lies as near.
    assert not agent.candidates.propose(Candidate(MatchId(2, 9, 1, 3), 0, 0.1))


def test_of_two_candidates_that_come_at_once_one_is_not_wanted_any_more_when_the_other_is_accepted() -> None:
    agent = agent_of(2, 30)
    first, second, apart = (MatchId(2, keyframe, 1, 3) for keyframe in (10, 12, 20))
    assert all(agent.candidates.propose(Candidate(match, 0, 0.1)) for match in (first, second, apart))
    assert agent.candidates.still_wanted(second)
    agent.state.accepted |= {first}
    assert not agent.candidates.still_wanted(second)
    assert agent.candidates.by_id[second].check.reason == "close to an accepted match"
    assert agent.candidates.still_wanted(apart)
