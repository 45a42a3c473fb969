"""Single rules against hostile messages: who may say what, how much of it is kept, and who answers for what follows."""

from __future__ import annotations

import numpy as np
import pytest
from factory import town
from sample_messages import submap, verify_answer

from maslam.backend.distributed.compact import CompactReader, CompactWriter
from maslam.backend.distributed.contribution import decode
from maslam.backend.distributed.share import SolverOutcome
from maslam.backend.errors import BackendError
from maslam.backend.geometry import Sim3, se3_exp
from maslam.backend.pose_graph.graph import NodeId
from maslam.mas.agent import Agent
from maslam.mas.contracts.ledger import _REMEMBERED, Ledger
from maslam.mas.contracts.reputation import Trust
from maslam.mas.optimisation.own_judgement import CLEARLY_WORSE, judged
from maslam.mas.optimisation.suspicion import Suspicion
from maslam.mas.policies.presets import preset
from maslam.mas.protocol.claims import false_claim
from maslam.mas.protocol.ids import ContractId, FrameId, MatchId, OperationKind
from maslam.mas.protocol.map_messages import MapDelivery, MapOrder
from maslam.mas.protocol.messages import (
    LINK_DTYPE,
    Award,
    Bid,
    Body,
    Call,
    Cancel,
    Confirmation,
    GroupNotice,
    Links,
    MapNotice,
    Message,
    Offer,
    PieceTerms,
    Result,
)
from maslam.mas.protocol.tasks import OptimiseTask
from maslam.mas.protocol.tensors import MessageError, Tensor, pack_sim3s
from maslam.mas.simulation import make_agents
from maslam.mas.state.keyframe import keyframes_of
from maslam.mas.state.pose_graph import UnknownPart, share_of

EVERYONE = frozenset(range(4))
SECOND = 10**9
ROW = pack_sim3s([Sim3.identity()], LINK_DTYPE)


def bid(match: MatchId, query: bool) -> Bid:
    links = Links((match,), (0,), (FrameId(1, 0),), (query,), ROW, ROW if query else pack_sim3s([], LINK_DTYPE))
    return Bid(1, 0, links, (PieceTerms(0, FrameId(1, 0), True, True),))


def delivery(**changes: object) -> Result:
    return Result(MapDelivery(FrameId(1, 0), (), pack_sim3s([]), (submap(**changes),)))


@pytest.mark.parametrize(
    ("body", "reason"),
    [
        (GroupNotice((0, 1, 77)), "no agent 77"),
        (Call(OperationKind.DOPT, 1, (1, 9)), "no agent 9"),
        (MapNotice((Offer(4000, 1, 1),)), "no agent 4000"),
        (Bid(1, 0, offers=(Offer(4000, 1, 1),)), "no agent 4000"),
        (Award(MapOrder((8,))), "no agent 8"),
        (delivery(owner=4000), "no agent 4000"),
        (delivery(route=(1, 5)), "no agent 5"),
        (bid(MatchId(0, 1, 2, 1), True), "not its own"),
        (bid(MatchId(0, 1, 1, 1), True), "not its own"),
        (bid(MatchId(1, 1, 0, 1), False), "not its own"),
        (delivery(matches=(MatchId(0, 1, 2, 1),), transforms=pack_sim3s([Sim3.identity()])), "a match of others"),
    ],
)
def test_what_a_sender_may_not_say(body: Body, reason: str) -> None:
    assert reason in false_claim(1, body, EVERYONE)


@pytest.mark.parametrize("body", [GroupNotice((0, 1)), bid(MatchId(1, 1, 0, 1), True), bid(MatchId(0, 1, 1, 1), False)])
def test_what_it_may(body: Body) -> None:
    assert false_claim(1, body, EVERYONE) == ""


@pytest.mark.parametrize(
    "changes",
    [
        {"keyframes": Tensor.of([-1, 1], "<i4")},
        {"stamps_ns": Tensor.of([5, 0], "<i8")},
        {"stamps_ns": Tensor.of([5, 5], "<i8")},
    ],
)
def test_a_map_that_no_owner_has(changes: dict[str, object]) -> None:
    with pytest.raises(MessageError, match="not ascending"):
        submap(**changes)


@pytest.mark.parametrize("changes", [{"way": np.nan}, {"depth": np.nan}, {"rmse": np.inf}])
def test_numbers_that_bounds_let_through(changes: dict[str, object]) -> None:
    with pytest.raises(MessageError, match="NaN or infinity"):
        verify_answer(**changes)


def test_a_map_is_ordered_once() -> None:
    with pytest.raises(MessageError, match="twice"):
        MapOrder((1, 1))


# -- bytes of solvers -------------------------------------------------------------------------------------------------


def test_a_number_without_end_is_refused_at_once() -> None:
    reader = CompactReader(b"\xff" * 2**20)
    with pytest.raises(BackendError, match="too large"):
        reader.count()
    assert reader._at < 16, "a longer one takes no longer"


@pytest.mark.parametrize("number", [np.nan, np.inf])
def test_numbers_of_solvers_are_finite(number: float) -> None:
    out = CompactWriter()
    out.number(number)
    with pytest.raises(BackendError, match="not finite"):
        CompactReader(out.bytes()).number()


@pytest.mark.parametrize(("ends", "other"), [((0, 5), None), ((0, 0), None), (None, (2, 3)), (None, (1, 1))])
def test_contributions_of_nonsense_are_the_senders_fault(
    ends: tuple[int, int] | None, other: tuple[int, int] | None
) -> None:
    """Two nodes of robot 1 with an edge of nodes that are not there, or an edge between two others."""
    out = CompactWriter()
    out.rough(1.0)
    for count in (2, 0, 1):  # nodes, and their indices
        out.count(count)
    out.pose(np.eye(4))
    out.number(0.0)
    out.count(1)
    out.weights(1.0, 1.0)
    out.count(int(ends is not None))
    if ends is not None:
        out.signed(ends[0])
        out.signed(ends[1] - ends[0])
        out.count(0)
        out.steps([0] * 6)
    out.count(int(other is not None))
    if other is not None:
        for robot in other:
            out.count(robot)
            out.count(0)
        out.count(0)
        out.steps([0] * 6)
    out.count(0)  # no priors
    with pytest.raises(BackendError, match="contribution"):
        decode(out.bytes(), 1)


# -- one agent --------------------------------------------------------------------------------------------------------


def lone(count: int = 3, keyframes: int = 10) -> Agent:
    """Agent 0 of a few, which has seen its sequence."""
    manifest, sequences = town(count, keyframes, spacing_m=3.0)
    agent = make_agents(manifest, sequences, preset("maslam"))[0]
    for keyframe in keyframes_of(sequences[0]):
        agent.observe(keyframe)
    return agent


def test_a_deadline_is_one_that_it_could_have_set_itself() -> None:
    agent = lone()
    config = agent.state.config
    for number, (operation, most_s) in enumerate(
        [(OperationKind.DVPR, config.deadline_s), (OperationKind.DOPT, 4 * config.optimisation.deadline_s)]
    ):
        agent.handle(Message(1, 0, ContractId(1, number), Call(operation, 2**62, (0, 1))))
        assert agent.context.ledger.running(operation)[0].deadline_ns == most_s * SECOND


def test_refused_messages_cost_their_sender_and_fill_no_log() -> None:
    agent = lone()
    events = [e for _ in range(1000) for e in agent.handle(Message(1, 0, None, GroupNotice((0, 77)))).events]
    assert 100 < sum(e.kind == "refused" for e in events) < 110
    assert agent.context.reputation.of(1).refused == 1000
    assert agent.context.reputation.trust(1) is Trust.UNDELIVERING
    assert agent.context.reputation.trust(2) is Trust.GOOD and agent.state.group == {0}


def test_who_begins_nothing_is_left_alone_for_a_while() -> None:
    agent = lone()
    calls = [Message(1, 0, ContractId(1, n), Call(OperationKind.DOPT, 20 * SECOND, (0, 1))) for n in range(3)]
    bodies = [type(m.body).__name__ for call in calls for m in agent.handle(call).messages]
    kinds = [body for body in bodies if body in ("Bid", "Refusal")]
    assert kinds == ["Bid", "Refusal", "Refusal"], "one call in vain, then the next is refused"
    agent.tick(11 * SECOND)
    again = Message(1, 0, ContractId(1, 9), Call(OperationKind.DOPT, 40 * SECOND, (0, 1)))
    assert [type(m.body).__name__ for m in agent.handle(again).messages] == ["Bid"]


def test_nobody_makes_it_forget_contracts_with_others() -> None:
    ledger = Ledger(0)
    kept, _ = ledger.call(OperationKind.DVPR, [2], SECOND)
    ledger.expired(2 * SECOND)
    for number in range(_REMEMBERED + 100):
        with pytest.raises(Exception, match="withdrawn"):
            ledger.receive(ContractId(1, number), 1, Cancel("flood"))
    assert len(ledger._ended) == _REMEMBERED + 1
    with pytest.raises(Exception, match="has ended"):
        ledger.receive(kept, 2, Confirmation())


def task_of(agent: Agent, **changes: object) -> OptimiseTask:
    placements = pack_sim3s([Sim3.identity()])
    fields: dict[str, object] = {
        "members": (0, 1),
        "frame": FrameId(0, 0),
        "metric": True,
        "tracks": (0,),
        "matches": (),
        "present": (FrameId(0, 0),),
        "placements": placements,
    }
    return OptimiseTask(**{**fields, **changes})  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"placements": pack_sim3s([Sim3(np.eye(3), np.zeros(3), 1000.0)])}, "unit"),
        ({"tracks": (0, 0)}, "twice"),
    ],
)
def test_an_award_that_is_nonsense(changes: dict[str, object], reason: str) -> None:
    agent = lone()
    with pytest.raises(UnknownPart, match=reason):
        share_of(agent.state, task_of(agent, **changes))


@pytest.mark.parametrize(
    ("step_m", "turn_deg", "kept"), [(0.0, 0.0, False), (0.05, 0.5, False), (1.0, 0.0, True), (0.0, 30.0, True)]
)
def test_a_solution_that_bends_the_trajectory_is_not_adopted(step_m: float, turn_deg: float, kept: bool) -> None:
    """Key-frames are 1.5 m apart: each is moved by ``step_m`` more than the one before, or turned."""
    agent = lone(keyframes=12)
    task = task_of(agent)
    share = share_of(agent.state, task)
    bend = [se3_exp(np.array([0, step_m * k, 0, 0, np.radians(turn_deg) * k, 0])) for k in range(12)]
    poses = {NodeId(0, k): agent.state.poses[k] @ bend[k] for k in range(12)}
    outcome = SolverOutcome(0, True, "accepted", poses, dict.fromkeys(poses, 1.0), 9.0, 1.0, 0, 1, ())
    found = judged(agent.state, task, share, outcome)
    assert (found.reason == CLEARLY_WORSE) is kept and found.accepted is not kept
    if kept:
        np.testing.assert_allclose(found.poses[NodeId(0, 7)], agent.state.poses[7])


def test_a_suspect_is_found_by_doing_without_it() -> None:
    """Agent 3 lies; all others were in the same optimisations."""
    found = []
    for me in (1, 2):
        suspicion = Suspicion(me)
        assert suspicion.spoilt((0, 1, 2, 3), manager=0) is None and suspicion.left_out == 0
        while suspicion.left_out != 3:
            members = tuple(m for m in range(4) if m != suspicion.left_out)
            assert suspicion.spoilt(members, manager=me) is None
        found.append(suspicion.ended_well((0, 1, 2)))
    assert found == [3, 3]
    assert Suspicion(1).spoilt((0, 1, 2), 2, leader=0) == 0 and Suspicion(1).spoilt((1, 2), 1) == 2
