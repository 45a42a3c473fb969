"""What slow and lossy links cost: answers that take long, messages sent in vain."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import pytest
from factory import town
from saboteurs import Saboteur, live

from maslam.backend.distributed.elected_messages import ElectedMessage, Kind
from maslam.mas.config import FaultsConfig, LinkConfig, MasConfig
from maslam.mas.contracts.contract import Contract, ContractState
from maslam.mas.contracts.effects import NOTHING, Effects
from maslam.mas.contracts.retransmission import Retransmitter
from maslam.mas.contracts.rtt import RttEstimator
from maslam.mas.evaluation.summary import Summary
from maslam.mas.optimisation.session import OptimisationSession
from maslam.mas.policies.presets import preset
from maslam.mas.protocol.ids import ContractId, OperationKind
from maslam.mas.protocol.messages import Call, Message
from maslam.mas.protocol.solver_messages import SolverBody
from maslam.mas.simulation import make_agents, run

MS = 10**6


class Asked:
    """A node that was asked and has an answer of many bytes."""

    def handle(self, message: ElectedMessage) -> list[ElectedMessage]:
        return [ElectedMessage(Kind.CONTRIBUTION, 0, 0, message.sender, bytes(1000))]


def through(tmp_path: Path, seed: int = 0, **faults: float) -> Summary:
    config = preset("maslam")
    config = config.model_copy(update={"seed": seed, "faults": FaultsConfig.model_validate(faults)})
    manifest, sequences = town(3, 40, spacing_m=6.0, drifting=0.03)
    return run(manifest, sequences, MasConfig.model_validate(config.model_dump()), tmp_path / f"{seed}{len(faults)}")


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_late_answers_cost_time_on_the_way_and_little_else(tmp_path: Path, seed: int) -> None:
    still, late = through(tmp_path), through(tmp_path, seed, delay_s=0.1, jitter_s=0.2)
    assert late.groups == still.groups == [[0, 1, 2]]
    assert late.steps <= still.steps + 20, "ten seconds for some dozen answers one after the other"
    assert late.traffic["total"].wire_bytes <= 1.8 * still.traffic["total"].wire_bytes
    assert late.ate_rmse_m.mean_agents == pytest.approx(still.ate_rmse_m.mean_agents, rel=0.1)


@pytest.mark.parametrize("seed", [0, 1, 2, 4])
def test_of_ten_messages_three_are_lost_and_not_many_more_are_sent_than_must_be(tmp_path: Path, seed: int) -> None:
    still, lossy = through(tmp_path), through(tmp_path, seed, loss=0.3)
    assert lossy.groups == still.groups == [[0, 1, 2]]
    sent, needed = lossy.traffic["total"].wire_bytes, still.traffic["total"].wire_bytes
    assert sent <= 1.5 * needed / 0.7, "few messages, so losses by chance count"
    assert lossy.faults is not None
    assert sent - lossy.faults.lost_bytes <= 1.3 * needed, "of what arrives little is not needed"
    assert lossy.steps <= still.steps + 12


def answered(rtt: RttEstimator, other: int, took_ms: int, *repeats_ms: int) -> None:
    """An answer that came so long after the message was sent first; ``repeats_ms``: how long after their repeats."""
    rtt.answered(other, 10**12, [10**12 - t * MS for t in (took_ms, *repeats_ms)])


def test_answers_to_what_was_sent_once_say_how_long_to_wait() -> None:
    rtt = RttEstimator(LinkConfig())
    assert rtt.wait_ns(1) == 10 * MS
    answered(rtt, 1, 900, 500)
    assert rtt.wait_ns(1) == 1350 * MS, "nothing better is known"
    for took in (200, 400, 200, 400):
        answered(rtt, 1, took)
    assert rtt.wait_ns(1) == 640 * MS, "mean and four mean deviations, but three of the quickest, or the longest set"
    for took in (2000, 700, 900):
        assert rtt.wait_ns(2) == 300 * MS, "too little is known: the quickest of all"
        answered(rtt, 2, took, took // 2)
    assert rtt.wait_ns(2) == 1050 * MS, "the quickest of its own"


def test_an_answer_that_met_a_queue_makes_nobody_wait_for_minutes() -> None:
    rtt = RttEstimator(LinkConfig())
    for took in (1000, 1100, 1000, 54_000):
        answered(rtt, 1, took)
    assert rtt.wait_ns(1) == 3000 * MS
    assert [rtt.ask_ns(1, tries) for tries in range(4)] == [2000 * MS, 4000 * MS, 4000 * MS, 4000 * MS]


def test_a_repeat_that_is_answered_sooner_than_any_answer_came_was_in_vain() -> None:
    """Else links that become slow would never be known to be: every message is repeated before its answer is there."""
    rtt = RttEstimator(LinkConfig())
    answered(rtt, 1, 400)
    for _ in range(8):
        answered(rtt, 1, 2000, 1200, 100)
    assert rtt.wait_ns(1) == 1200 * MS, "to the first repeat, or later: the answer took at least that long"
    answered(rtt, 1, 2000, 1300)
    assert rtt.wait_ns(1) == 1200 * MS, "to which of the two, nobody knows"


def test_how_long_a_busy_agent_lets_a_call_wait_says_nothing_about_the_link() -> None:
    keeper = Retransmitter(0, LinkConfig())
    for operation, expected in ((OperationKind.DOPT, 10 * MS), (OperationKind.MAPMERGE, 2250 * MS)):
        called = Contract(ContractId(0, int(operation)), 1, operation, 10**12)
        keeper.sent(called, Message(0, 1, called.id, Call(operation, 10**12)), 0)
        keeper.due(100 * MS)
        keeper.received(replace(called, state=ContractState.BID), 1500 * MS)
        assert keeper.rtt.wait_ns(1) == expected


def test_contracts_have_more_time_where_answers_are_slow() -> None:
    context = make_agents(*town(2, 10), preset("maslam"))[0].context
    assert [context.deadline_ns(o, [1]) / 1e9 for o in (OperationKind.RELPOSE, OperationKind.DOPT)] == [5.0, 20.0]
    for _ in range(8):
        answered(context.retransmitter.rtt, 1, 1500)
    assert [context.deadline_ns(o, [1]) / 1e9 for o in (OperationKind.RELPOSE, OperationKind.DOPT)] == [45.0, 80.0]


def test_radios_of_10_kbit_that_lose_messages_still_join_all(tmp_path: Path) -> None:
    still, slow = through(tmp_path), through(tmp_path, 0, rate_kbit=9.6, delay_s=0.5, loss=0.3)
    assert slow.groups == still.groups == [[0, 1, 2]]
    assert slow.ate_rmse_m.mean_agents == pytest.approx(still.ate_rmse_m.mean_agents, rel=0.1)


def test_a_question_that_is_repeated_at_once_is_answered_once() -> None:
    """A byte asked for must not bring a graph each time, whoever asks."""
    session = OptimisationSession(None, None, Asked())  # type: ignore[arg-type]
    rtt, question = RttEstimator(LinkConfig()), ElectedMessage(Kind.WAIT, 0, 1, 0, b"\x01")
    answers = [len(session.receive(question, now * MS, rtt).again) for now in (0, 0, 1, 4, 5, 6, 12)]
    assert answers == [1, 0, 0, 0, 1, 0, 1]


class EndsByWaiting:
    """A node that gives up when it has waited long enough."""

    share = SimpleNamespace(members=(0, 1), robot=0)
    outcome: object = None

    def tick(self) -> list[ElectedMessage]:
        self.outcome = SimpleNamespace(poses={}, units={0: float("nan")})
        return []


def test_an_optimisation_that_ends_by_waiting_is_over_at_once() -> None:
    agent = make_agents(*town(2, 10), preset("maslam"))[0]
    task = SimpleNamespace(members=(0, 1))
    session = OptimisationSession(None, task, EndsByWaiting(), begun=True)  # type: ignore[arg-type]
    agent.optimisation.running.session, agent.context.now_ns = session, 10**9
    agent.optimisation.resend()
    assert agent.optimisation.running.session is None, "its outcome is no number, so it is given up"


def test_who_only_repeats_itself_does_not_shorten_the_wait() -> None:
    keeper = Retransmitter(0, LinkConfig())
    contract = Contract(ContractId(0, 0), 1, OperationKind.DOPT, 10**12, ContractState.WORKING)
    keeper.sent(contract, Message(0, 1, contract.id, Call(OperationKind.DOPT, 10**12)), 0)
    sent = []
    for now in range(0, 300 * MS, 10 * MS):
        keeper.received(contract, now)
        sent += [now // MS] * len(keeper.due(now))
    assert sent == [10, 30, 70, 150]


class GoneInTheMiddle(Saboteur):
    """Sends and receives nothing any more after its twentieth message of an optimisation."""

    sent = 0

    def spoil(self, messages: list[Message]) -> list[Message]:
        self.sent += sum(isinstance(m.body, SolverBody) for m in messages)
        return messages if self.sent <= 20 else []

    def handle(self, message: Message) -> Effects:
        return super().handle(message) if self.sent <= 20 else NOTHING


@pytest.mark.parametrize("method", ["two-level", "sor"])
def test_where_the_root_falls_silent_in_the_middle_the_others_leave_in_time_and_go_on_without_it(method: str) -> None:
    """The lowest member is the root: without it no round ends. Poses stay as the last optimisation that ended had
    them."""
    config = preset("maslam")
    solver = config.optimisation.solver.model_copy(update={"method": method, "length_sigma": 0.0})
    optimisation = config.optimisation.model_copy(update={"solver": solver})
    config = config.model_copy(update={"optimisation": optimisation, "faults": FaultsConfig(delay_s=0.02)})
    sequences = town(3, 24, spacing_m=6.0, drifting=0.03)
    environment, evaluator = live(*sequences, config, {0: GoneInTheMiddle})
    gone, *others = environment.agents
    assert isinstance(gone, GoneInTheMiddle) and gone.sent > 20
    left = [e for e in environment.events if e.kind == "optimisation_left" and e.agent]
    assert left and all(e.fields["members"][0] == 0 for e in left), "it is said"
    assert environment.now_ns < 60e9
    for other in others:
        assert not other.optimisation.busy and other.state.group >= {1, 2}
    after = [e.fields["members"] for e in environment.events if e.kind == "optimised" and e.now_ns > left[-1].now_ns]
    assert [1, 2] in after
    errors = evaluator.connected_errors(environment.agents)
    assert max(errors[a].rmse_m for a in (1, 2)) < 0.5


@pytest.mark.parametrize("preset_name", ["maslam", "default", "optimised"])
def test_who_cannot_be_reached_for_ten_seconds_joins_when_it_can(tmp_path: Path, preset_name: str) -> None:
    """Longer than the sequences last: what was asked in vain is asked again, and who is silent at the end is probed."""
    config = preset(preset_name)
    config = config.model_copy(update={"faults": FaultsConfig(blackout_s={0: 1.0, 1: 1.0, 2: 1.0})})
    manifest, sequences = town(3, 24, spacing_m=6.0, drifting=0.03)
    summary = run(manifest, sequences, config, tmp_path / "run")
    assert summary.duration_s < 11.0, "all have seen everything before they can be reached"
    assert summary.groups == [[0, 1, 2]]


def test_a_silent_agent_is_probed_three_times_after_the_end_and_then_given_up() -> None:
    context = make_agents(*town(2, 10), preset("default"))[0].context
    context.reputation.of(1).unanswered = 2
    context.close()
    probed = []
    for second in range(60):
        context.now_ns = second * 10**9
        if context.may_call(1):
            probed.append(second)
            assert context.may_come_back(1)
            call = context.call(OperationKind.DVPR, [1])
            context.cancel(context.ledger.managed(call.identity), "test")
            context.reputation.of(1).unanswered = 2
    assert probed == [0, 5, 10]
    assert not context.may_come_back(1)
