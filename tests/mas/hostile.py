"""Agents that attack their team by what they send, one kind each; the lines are those of the documents' table."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, ClassVar

import msgspec
import numpy as np
from saboteurs import Liar, Saboteur

from maslam.backend.distributed.elected import ElectedNode
from maslam.backend.distributed.elected_messages import ElectedMessage, Kind
from maslam.backend.distributed.messages import Decision, Report, Values
from maslam.backend.distributed.solution import encode_solution
from maslam.backend.distributed.solver_stage import SolverStage
from maslam.backend.geometry import Sim3, se3_exp
from maslam.mas.config import MasConfig
from maslam.mas.contracts.effects import Effects
from maslam.mas.policies.base import Policy
from maslam.mas.protocol.ids import ContractId, FrameId, MatchId, OperationKind
from maslam.mas.protocol.map_messages import MapDelivery, SubMap
from maslam.mas.protocol.messages import (
    LINK_DTYPE,
    Award,
    Begin,
    Bid,
    Call,
    Cancel,
    Confirmation,
    Failure,
    GroupNotice,
    Links,
    MapNotice,
    Message,
    Offer,
    Result,
    encode,
)
from maslam.mas.protocol.solver_messages import SolverBody
from maslam.mas.protocol.tasks import (
    EarlierAnswer,
    OptimiseTask,
    PlaceAnswer,
    PlaceRedirect,
    VerifyAnswer,
    VerifyTask,
)
from maslam.mas.protocol.tensors import (
    Tensor,
    pack_information,
    pack_poses,
    pack_sim3,
    pack_sim3s,
    unpack_poses,
    unpack_sim3,
)
from maslam.mas.state.agent_state import Profile

FAR = 100_000
FAR_NS = 2**62


class Hostile(Saboteur):
    """Honest but for :meth:`attack`, what it sends unasked with each tick; :meth:`raw`, bytes that no encoder makes;
    and :meth:`other`, what it sends instead of a message."""

    sent = 0

    def tick(self, now_ns: int) -> Effects:
        own = super().tick(now_ns)
        return own + Effects(messages=tuple(self.attack()))

    def attack(self) -> list[Message]:
        return []

    def raw(self) -> list[bytes]:
        """To be brought to each of the others after each step."""
        return []

    def spoil(self, messages: list[Message]) -> list[Message]:
        return [changed for m in messages for changed in self.other(m)]

    def other(self, message: Message) -> list[Message]:
        return [message]

    @property
    def others(self) -> tuple[int, ...]:
        return self.state.profile.others

    def called(self, other: int, body: Any) -> Message:
        """A new contract of its own."""
        self.sent += 1
        return Message(self.state.me, other, ContractId(self.state.me, 50_000 + self.sent), body)

    @property
    def quiet(self) -> bool:
        return self.context.closing


def changed(message: Message, **fields: Any) -> Message:
    """A message whose result, award or bid has other fields."""
    body: Any = message.body
    if isinstance(body, Result):
        return msgspec.structs.replace(message, body=Result(msgspec.structs.replace(body.outcome, **fields)))
    if isinstance(body, Award):
        return msgspec.structs.replace(message, body=Award(msgspec.structs.replace(body.task, **fields)))
    return msgspec.structs.replace(message, body=msgspec.structs.replace(body, **fields))


def outcome_of(message: Message) -> Any:
    return message.body.outcome if isinstance(message.body, Result) else None


def task_of(message: Message) -> Any:
    return message.body.task if isinstance(message.body, Award) else None


class NamesStrangers(Hostile):
    """1: notices and calls that name an agent that does not exist."""

    def attack(self) -> list[Message]:
        members = (*sorted((self.state.me, *self.others)), 77)
        notices = [Message(self.state.me, a, None, GroupNotice(members)) for a in self.others]
        call = Call(OperationKind.DOPT, self.context.now_ns + 10**9, members)
        return notices + [self.called(a, call) for a in self.others]


class SendsNested(Hostile):
    """2: deeply nested bytes in a field that nobody knows, and in one that is."""

    def raw(self) -> list[bytes]:
        good = encode(Message(self.state.me, self.others[0], None, GroupNotice((0,))))
        nested = b"\x91" * 2000 + b"\xc0"
        header = msgspec.msgpack.decode(good)
        unknown = b"\x96" + b"".join(msgspec.msgpack.encode(v) for v in header) + nested
        inside = b"\x95" + b"".join(msgspec.msgpack.encode(v) for v in header[:3]) + nested + b"\x05"
        return [unknown, inside]


class FarKeyframes(Hostile):
    """3: recognises every place in its key-frame 100 000, and verifies that; sends others to such ones."""

    def other(self, message: Message) -> list[Message]:
        outcome = outcome_of(message)
        if isinstance(outcome, PlaceAnswer | EarlierAnswer):
            self.sent += 1
            return [msgspec.structs.replace(message, body=Result(PlaceAnswer(FAR + self.sent, 0.01)))]
        if isinstance(outcome, PlaceRedirect):
            self.sent += 1
            other = next(a for a in self.others if a != message.recipient)
            named = self.state.me if self.sent % 2 else other
            return [msgspec.structs.replace(message, body=Result(PlaceRedirect(named, FAR + self.sent, 0.01)))]
        if isinstance(message.body, Failure) and self._asked is not None:
            answer = false_answer(self._asked, self.sent)
            return [
                msgspec.structs.replace(message, body=Confirmation()),
                msgspec.structs.replace(message, body=Result(answer)),
            ]
        return [message]

    _asked: VerifyTask | None = None

    def handle(self, message: Message) -> Effects:
        task = task_of(message)
        self._asked = task if isinstance(task, VerifyTask) else None
        return super().handle(message)


def false_answer(task: VerifyTask, number: int, **fields: Any) -> VerifyAnswer:
    """A verified match that is none."""
    return msgspec.structs.replace(
        VerifyAnswer(
            match=task.match,
            accepted=True,
            reason="accepted",
            matches=300,
            inliers=300,
            rmse=0.01,
            T_M_Q=pack_sim3(Sim3.identity()),
            information=pack_information(1e5 * np.eye(6)),
            track=0,
            stamp_ns=number * 10**9,
            T_T_M=pack_poses(np.eye(4)),
            way=1.0,
            depth=8.0,
            keyframes=FAR * 2,
        ),
        **fields,
    )


class WildDepth(Liar):
    """4: lies about matches whose depth allows any difference."""

    DEPTH = 1e9

    def _lie(self, message: Message, outcome: object) -> Message:
        return (
            changed(super()._lie(message, outcome), depth=self.DEPTH) if isinstance(outcome, VerifyAnswer) else message
        )


class TinyDepth(WildDepth):
    DEPTH = 1e-9


class WildWay(Liar):
    """4: lies about matches between which it claims to have come far, so that odometry may have drifted."""

    def _lie(self, message: Message, outcome: object) -> Message:
        way = float(min(1e8 * (self.lies + 1), 1e9))
        return changed(super()._lie(message, outcome), way=way) if isinstance(outcome, VerifyAnswer) else message


class WildQuery(Hostile):
    """4: likewise as the one that asks."""

    def other(self, message: Message) -> list[Message]:
        if isinstance(task_of(message), VerifyTask):
            self.sent += 1
            wild = pack_poses(se3_exp(np.array([1e6 * self.sent, 0, 0, 0, 0, 0])))
            return [changed(message, way=1e9 / self.sent, T_T_Q=wild)]
        return [message]


class WildInformation(Hostile):
    """4: answers truly, with information, residual and counts that make a solver overflow."""

    def other(self, message: Message) -> list[Message]:
        outcome = outcome_of(message)
        if isinstance(outcome, VerifyAnswer) and outcome.accepted:
            self.sent += 1
            values = [9e17, -9e17, 1e-38][self.sent % 3] * np.ones((7, 7))
            return [changed(message, information=pack_information(values), rmse=179.0, inliers=2**31)]
        return [message]


class FarDeadline(Hostile):
    """5: calls for optimisations with a deadline in 146 years, and awards nothing."""

    def attack(self) -> list[Message]:
        members = tuple(sorted((self.state.me, *self.others)))
        return [self.called(a, Call(OperationKind.DOPT, FAR_NS, members)) for a in self.others]


class NeverBegins(Hostile):
    """5: awards optimisations and never begins."""

    def other(self, message: Message) -> list[Message]:
        return [] if isinstance(message.body, Begin | SolverBody) else [message]


class FalseSolver(Hostile):
    """6: has itself elected, sends each member poses in a heap, and says that the cost fell."""

    SPREAD_M: ClassVar[float] = 100.0

    def other(self, message: Message) -> list[Message]:
        if not isinstance(message.body, SolverBody):
            return [message]
        inner = message.body.read(message.sender, message.recipient)
        if not isinstance(inner, ElectedMessage):
            return [message]
        if inner.kind is Kind.SIZE:
            inner = replace(inner, body=b"\xff\xff\xff\xff")
        elif inner.kind is Kind.SOLUTION:
            inner = replace(inner, body=self._false(inner))
        elif inner.kind is Kind.DECISION:
            inner = replace(inner, body=b"\x01" + np.array([1e6, 1.0], dtype="<f8").tobytes() + b"\x03\x00\x00")
        return [msgspec.structs.replace(message, body=SolverBody.of(inner))]

    def _false(self, inner: ElectedMessage) -> bytes:
        session = self.optimisation.running.session
        assert session is not None and isinstance(session.node, ElectedNode)
        node, given = session.node, session.node._contributions[inner.receiver]
        assert node._gathered is not None
        true = node._gathered.of(given.graph.nodes)
        rng = np.random.default_rng(self.sent)
        self.sent += 1
        moved = dict(true.poses)
        for count, n in enumerate(sorted(moved)):
            moved[n] = moved[n].copy()
            moved[n][:3, 3] += self.shift(count, rng)
        return encode_solution(given.graph, replace(true, poses=moved), given.fineness, given.scaled)[0]

    def shift(self, count: int, rng: np.random.Generator) -> Any:
        return rng.normal(0.0, self.SPREAD_M, 3)


class BendingSolver(FalseSolver):
    """6: likewise, but bends each member's trajectory by a metre for each node."""

    def shift(self, count: int, rng: np.random.Generator) -> Any:
        return np.array([1.0 * count, 0.0, 0.0])


class WrongUnit(Hostile):
    """6: awards optimisations in which others' coordinates are a thousand times as large."""

    def other(self, message: Message) -> list[Message]:
        task = task_of(message)
        if isinstance(task, OptimiseTask) and len(task.present):
            rows = task.placements.array().copy()
            rows[:, 7] = 1000.0
            return [changed(message, placements=Tensor.of(rows, "<f8"))]
        return [message]


class NoisySolver(Hostile):
    """6: sends separators that are noise, and says that the cost was high and is 0."""

    def other(self, message: Message) -> list[Message]:
        if not isinstance(message.body, SolverBody):
            return [message]
        inner: Any = message.body.read(message.sender, message.recipient)
        rng = np.random.default_rng(self.sent)
        self.sent += 1
        start = getattr(inner, "round", None) is not None and inner.round.stage is SolverStage.START
        if isinstance(inner, Values) and not start:
            inner = replace(inner, values=inner.values + rng.normal(0.0, 100.0, inner.values.shape))
        elif isinstance(inner, Report) or (
            isinstance(inner, Decision) and inner.round.stage in (SolverStage.START, SolverStage.COST)
        ):
            inner = replace(inner, cost=1e12 if start else 0.0)
        return [msgspec.structs.replace(message, body=SolverBody.of(inner))]


class RowTooMany(Hostile):
    """6: sends one separator more than there are."""

    def other(self, message: Message) -> list[Message]:
        if not isinstance(message.body, SolverBody):
            return [message]
        inner = message.body.read(message.sender, message.recipient)
        if isinstance(inner, Values) and len(inner.values):
            more = np.concatenate([inner.values, inner.values[:1]])
            return [msgspec.structs.replace(message, body=SolverBody.of(replace(inner, values=more)))]
        return [message]


class BidsForOthers(Hostile):
    """7: bids matches between others, as if it were both of their owners."""

    def other(self, message: Message) -> list[Message]:
        body = message.body
        if not isinstance(body, Bid) or not body.pieces:
            return [message]
        piece = body.pieces[0]
        a, b = [x for x in range(4) if x != self.state.me][:2]
        ids = [MatchId(x, k, y, k) for x, y in ((a, b), (b, a)) for k in range(6)]
        rng = np.random.default_rng(0)
        poses = pack_sim3s([Sim3.from_se3(se3_exp(rng.normal(0, 10, 6))) for _ in range(2 * len(ids))], LINK_DTYPE)
        transforms = pack_sim3s([Sim3.from_se3(se3_exp(rng.normal(0, 10, 6))) for _ in ids], LINK_DTYPE)
        rows = 2 * len(ids)
        links = Links(
            tuple(i for i in ids for _ in range(2)),
            (piece.track,) * rows,
            (piece.frame,) * rows,
            (False, True) * len(ids),
            poses,
            transforms,
        )
        return [changed(message, links=links)]


class FalseDirectory(Hostile):
    """8: sends others to key-frames that an honest agent lacks."""

    def other(self, message: Message) -> list[Message]:
        if isinstance(outcome_of(message), PlaceRedirect):
            self.sent += 1
            other = next(a for a in self.others if a != message.recipient)
            return [msgspec.structs.replace(message, body=Result(PlaceRedirect(other, 500 + self.sent, 0.01)))]
        return [message]


class SellsUnordered(Hostile):
    """9: adds to each sale a map of agent 4000 that nobody ordered; offers such ones; and one of its buyer."""

    def other(self, message: Message) -> list[Message]:
        outcome = outcome_of(message)
        if isinstance(outcome, MapDelivery):
            more = tuple(map_of(owner) for owner in (4000, message.recipient))
            return [changed(message, maps=(*outcome.maps, *more))]
        if isinstance(message.body, Bid) and message.body.offers:
            return [changed(message, offers=(*message.body.offers, Offer(4000, 2**31, 30)))]
        return [message]

    def attack(self) -> list[Message]:
        return [Message(self.state.me, a, None, MapNotice((Offer(4000, 2**31, 30),))) for a in self.others]


def map_of(owner: int, count: int = 2, first: int = FAR) -> SubMap:
    return SubMap(
        owner=owner,
        version=2**31,
        unit=1.0,
        keyframes=Tensor.of(np.arange(first, first + count), "<i4"),
        stamps_ns=Tensor.of(np.arange(count), "<i8"),
        poses=pack_poses(np.stack([np.eye(4)] * count)),
        references=Tensor.of(np.zeros(3), "<i4"),
        points=Tensor.of(np.ones((3, 3)), "<f4"),
        descriptors=Tensor.of(np.zeros((3, 32)), "|u1"),
        matches=(MatchId(owner, FAR, 0, FAR),),
        transforms=pack_sim3s([Sim3.identity()]),
    )


class SellsFarKeyframes(Hostile):
    """3: its own map has key-frames that it does not have."""

    def other(self, message: Message) -> list[Message]:
        outcome = outcome_of(message)
        if isinstance(outcome, MapDelivery):
            named = {m.owner for m in outcome.maps} | {p.owner for p in outcome.parcels}
            return [changed(message, maps=tuple(map_of(o, 200) for o in sorted(named)), parcels=())]
        return [message]


class Spoofer(Hostile):
    """11: cancels all contracts in others' names, and calls in another's name under the highest number."""

    def attack(self) -> list[Message]:
        out = []
        for sender in self.others:
            for recipient in [a for a in self.others if a != sender]:
                out += [
                    Message(sender, recipient, ContractId(m, n), Cancel("spoofed"))
                    for m in (sender, recipient)
                    for n in range(200)
                ]
                call = Call(OperationKind.RELPOSE, self.context.now_ns + 10**9)
                out.append(Message(sender, recipient, ContractId(sender, 2**31), call))
        return out


class SendsHeaps(Hostile):
    """12: a megabyte of one number, contributions of nonsense, and floods."""

    def raw(self) -> list[bytes]:
        kinds = [b"\xe0\x00", b"\xe1\x00", b"\xe2\x00", b"\x20"]
        identity = ContractId(0, 0)
        session = self.optimisation.running.session
        if session is not None and session.identity is not None:
            identity = session.identity
        bodies = [SolverBody(b"\xe1\x00" + b"\xff" * 2**20), SolverBody(b"\x20" + b"\x01" * 2**20)]
        rng = np.random.default_rng(self.sent)
        self.sent += 1
        for kind in kinds:
            bodies.append(SolverBody(kind + rng.bytes(60)))
        return [encode(Message(self.state.me, 0, identity, b)) for b in bodies]


class WrongAnswers(Hostile):
    """13: answers each question with the outcome of another operation."""

    def other(self, message: Message) -> list[Message]:
        outcome = outcome_of(message)
        if isinstance(outcome, PlaceAnswer | EarlierAnswer | PlaceRedirect):
            return [msgspec.structs.replace(message, body=Result(MapDelivery(FrameId(0, 0), (), pack_sim3s([]), ())))]
        if isinstance(outcome, VerifyAnswer):
            return [msgspec.structs.replace(message, body=Result(PlaceAnswer(0, 0.1)))]
        return [message]


class FitsTooWell(Hostile):
    """14: finds each of its places again where the first match and both odometries say that it is: two odometries that
    do not drift at all, by what it says, so that matches seem worth little."""

    def __init__(self, profile: Profile, config: MasConfig, policy: Policy) -> None:
        super().__init__(profile, config, policy)
        self._joins: dict[tuple[int, int, int], Sim3] = {}
        self._queries: dict[MatchId, VerifyTask] = {}

    def handle(self, message: Message) -> Effects:
        task = task_of(message)
        if isinstance(task, VerifyTask):
            self._queries[task.match] = task
        return super().handle(message)

    def other(self, message: Message) -> list[Message]:
        outcome = outcome_of(message)
        if not isinstance(outcome, VerifyAnswer) or not outcome.accepted or outcome.T_M_Q is None:
            return [message]
        task = self._queries[outcome.match]
        T_T_M, T_T_Q = (Sim3.from_se3(unpack_poses(one.array())) for one in (outcome.T_T_M, task.T_T_Q))
        here = T_T_M @ unpack_sim3(outcome.T_M_Q) @ T_T_Q.inverse()
        joins = self._joins.setdefault((message.recipient, task.track, outcome.track), here)
        self.sent += 1
        return [changed(message, T_M_Q=pack_sim3(T_T_M.inverse() @ joins @ T_T_Q))]
