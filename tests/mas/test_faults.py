"""Messages lost, late, doubled and out of order: the transport that does it, and whole agents that live with it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from by_hand import happened
from factory import town
from hypothesis import example, given, settings
from hypothesis import strategies as st
from saboteurs import live
from sample_messages import examples

from maslam.backend.distributed.elected_messages import ElectedMessage, Kind
from maslam.backend.distributed.messages import Decision
from maslam.backend.distributed.solver_stage import SolverStage
from maslam.mas.agent import Agent
from maslam.mas.config import FaultsConfig, MasConfig
from maslam.mas.contracts.contract import ContractState
from maslam.mas.contracts.effects import NOTHING, Effects
from maslam.mas.errors import MasError
from maslam.mas.evaluation.ground_truth import groups_of
from maslam.mas.policies.presets import preset
from maslam.mas.protocol.ids import ContractId
from maslam.mas.protocol.messages import Message, encode
from maslam.mas.protocol.solver_messages import SolverBody
from maslam.mas.simulation import run
from maslam.mas.transport.faults import FaultyTransport
from maslam.mas.transport.transport import InProcessTransport, Transport

CONFIG = preset("maslam")


def transport(seed: int = 0, **faults: object) -> FaultyTransport:
    return FaultyTransport(InProcessTransport(2**20), FaultsConfig.model_validate(faults), seed)


def faulty(seed: int = 0, **faults: object) -> MasConfig:
    return CONFIG.model_copy(update={"seed": seed, "faults": FaultsConfig.model_validate(faults)})


def everything(carrier: Transport) -> list[Message]:
    out = []
    while (message := carrier.receive()) is not None:
        out.append(message)
    return out


def send_many(carrier: Transport, count: int = 4000) -> None:
    for _ in range(count):
        carrier.send(examples()[0], 0)


def test_the_share_that_is_lost_or_doubled_is_the_one_set() -> None:
    carrier = transport(loss=0.3, duplicate=0.2)
    send_many(carrier)
    arrived = len(everything(carrier))
    assert arrived == 4000 - carrier.lost + carrier.doubled
    # Four standard deviations of a binomial.
    assert carrier.lost_bytes == carrier.lost * len(encode(examples()[0])), "all are as long"
    assert carrier.lost == pytest.approx(1200, abs=4 * np.sqrt(4000 * 0.3 * 0.7))
    assert carrier.doubled == pytest.approx(560, abs=4 * np.sqrt(2800 * 0.2 * 0.8))
    assert sum(c.messages for c in carrier.by_operation.values()) == 4000, "sent is sent"


def test_a_message_arrives_when_its_time_has_come() -> None:
    carrier = transport(delay_s=1.0, jitter_s=1.0)
    send_many(carrier, 100)
    assert everything(carrier) == [] and carrier.waiting
    carrier.advance(999_999_999)
    assert everything(carrier) == []
    carrier.advance(1_500_000_000)
    half = len(everything(carrier))
    assert 20 < half < 80
    carrier.advance(2_000_000_000)
    assert half + len(everything(carrier)) == 100 and not carrier.waiting


def test_out_of_order_nothing_is_lost_and_most_stay_in_order() -> None:
    carrier = transport(reorder=0.2)
    numbers = list(range(500))
    for n in numbers:
        carrier.send(Message(0, 1, ContractId(0, n), examples()[0].body), 0)
    came = [m.contract.number for m in everything(carrier) if m.contract is not None]
    assert came != numbers and sorted(came) == numbers
    assert max(abs(n - k) for k, n in enumerate(came)) <= 20


def test_who_is_not_there_gets_and_says_nothing() -> None:
    carrier = transport(late_s={1: 5.0})
    carrier.send(examples()[0], 0)
    assert everything(carrier) == [] and carrier.lost == 1
    carrier.advance(5_000_000_000)
    carrier.send(examples()[0], 5_000_000_000)
    assert len(everything(carrier)) == 1


def test_who_cannot_be_reached_for_a_while_gets_and_says_nothing_then() -> None:
    arrived = []
    for who in (0, 1):
        carrier = transport(blackout_s={who: 5.0}, blackout_for_s=10.0, delay_s=1.0)
        for second in range(20):
            carrier.advance(second * 10**9)
            carrier.send(Message(0, 1, ContractId(0, second), examples()[0].body), second * 10**9)
            arrived += [(who, m.contract.number) for m in everything(carrier) if m.contract is not None]
    # What is on its way to it when that begins is lost too.
    assert arrived == [(0, s) for s in (*range(5), *range(15, 19))] + [(1, s) for s in (*range(4), *range(14, 19))]


def test_a_radio_sends_one_message_after_another_at_its_rate() -> None:
    carrier = transport(rate_kbit=8.0, delay_s=0.25)
    length = len(encode(examples()[0]))
    for _ in range(3):
        carrier.send(examples()[0], 0)
    other = Message(1, 0, examples()[0].contract, examples()[0].body)
    carrier.send(other, 0)
    for sent, senders in ((1, [0, 1]), (2, [0]), (3, [0])):
        carrier.advance(sent * length * 10**6 + 250 * 10**6 - 1)
        assert everything(carrier) == []
        carrier.advance(sent * length * 10**6 + 250 * 10**6)
        assert [m.sender for m in everything(carrier)] == senders, "a byte a millisecond; each has a radio of its own"
    assert not carrier.waiting


@pytest.mark.parametrize("faults", [{"late_s": {7: 1.0}}, {"blackout_s": {7: 1.0}}])
def test_agents_that_there_are_not_cannot_be_late_or_out_of_reach(
    tmp_path: Path, faults: dict[str, dict[int, float]]
) -> None:
    manifest, sequences = town(2, 4)
    with pytest.raises(MasError, match="there is no agent 7"):
        run(manifest, sequences, faulty(0, **faults), tmp_path / "run")


def test_same_seed_same_bytes_under_faults(tmp_path: Path) -> None:
    manifest, sequences = town(3, 16, spacing_m=6.0, drifting=0.03)
    for name, seed in (("a", 0), ("b", 0), ("c", 1)):
        summary = run(manifest, sequences, faulty(seed, loss=0.3, jitter_s=0.05), tmp_path / name)
        assert summary.groups == [[0, 1, 2]] and summary.refused_messages == 0
        assert summary.faults is not None and summary.faults.lost > 0 and summary.faults.repeated > 0
    for file in ("traffic.csv", "events.jsonl", "matches.csv", "timeline.csv", "agent_01/trajectory.tum"):
        a, b, c = ((tmp_path / name / file).read_bytes() for name in "abc")
        assert a == b
        assert a != c, "another seed, other losses"


def shares(most: float) -> st.SearchStrategy[float]:
    """0 to ``most``; not next to nothing, which settings refuse."""
    return st.just(0.0) | st.floats(1e-6, most)


@given(
    st.integers(0, 1000),
    shares(0.4),
    shares(0.3),
    shares(0.3),
    shares(0.06),
)
@example(181, 0.375, 0.296875, 0.0, 0.04653)  # a deadline came of one late answer, and was minutes away
@settings(max_examples=12, deadline=None)
def test_agents_end_in_peace_whatever_the_air_is_like(
    seed: int, loss: float, duplicate: float, reorder: float, jitter: float
) -> None:
    manifest, sequences = town(3, 10, spacing_m=4.0, drifting=0.03)
    config = faulty(seed, loss=loss, duplicate=duplicate, reorder=reorder, jitter_s=jitter)
    environment, _ = live(manifest, sequences, config)
    assert not environment.transport.refused
    assert not happened(environment, "refused"), "a message out of place"
    for agent in environment.agents:
        # Of a bid that nobody took up the contractor hears nothing where that message is lost: nothing is left to do.
        bids = [c.contractor == agent.state.me and c.state is ContractState.BID for c in agent.context.ledger.running()]
        assert all(bids), "a contract without end"


class Deaf(Agent):
    """Misses the end of its first optimisation: the last decision never arrives, however often it is repeated."""

    missed: ContractId | None = None

    def handle(self, message: Message) -> Effects:
        body = message.body
        said = body.read(message.sender, message.recipient) if isinstance(body, SolverBody) else None
        last = isinstance(said, Decision) and said.round.stage is SolverStage.COST
        if last or (isinstance(said, ElectedMessage) and said.kind is Kind.DECISION):
            self.missed = self.missed or message.contract
            if message.contract == self.missed:
                return NOTHING
        return super().handle(message)


@pytest.mark.parametrize("method", ["sor", "elected"])
@pytest.mark.parametrize("deaf", [0, 1, 2])
def test_who_misses_the_end_of_an_optimisation_stays_where_it_was_and_is_called_again(deaf: int, method: str) -> None:
    """Two generals: the others have adopted. What all say about the frame they name must stay true meanwhile."""
    manifest, sequences = town(3, 20, spacing_m=8.0, drifting=0.03)
    solver = CONFIG.optimisation.solver.model_copy(update={"method": method})
    optimisation = CONFIG.optimisation.model_copy(update={"solver": solver})
    config = CONFIG.model_copy(update={"optimisation": optimisation})
    environment, evaluator = live(manifest, sequences, config, {deaf: Deaf}, watch=frames_are_true)
    agent = environment.agents[deaf]
    optimised = happened(environment, "optimised")
    assert isinstance(agent, Deaf)
    if method == "sor":
        assert (agent.missed is None) == (deaf == 0), "the lowest member decides: it hears of no decision"
    if agent.missed is not None:
        assert len(optimised) >= 2, "called again"
    assert groups_of(environment.agents) == [[0, 1, 2]]
    assert max(e.rmse_m for e in evaluator.connected_errors(environment.agents).values()) < 0.5


def frames_are_true(agents: list[Agent], truth: list[np.ndarray]) -> None:  # type: ignore[type-arg]
    """Every key-frame lies where its agent says, in the frame that it names: as far as odometry drifts at most."""
    for agent in agents:
        state = agent.state
        for index in state.placed():
            T_W_F = truth[state.frame.agent][0]
            p = T_W_F[:3, :3] @ state.poses[index][:3, 3] + T_W_F[:3, 3]
            assert np.linalg.norm(p - truth[state.me][3 * index][:3, 3]) < 3.0
