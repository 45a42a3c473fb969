"""One message of each kind, for tests of the wire."""

from __future__ import annotations

import numpy as np

from maslam.backend.distributed.elected_messages import ElectedMessage, Kind
from maslam.backend.distributed.messages import Decision, Deltas, Report, SeparatorState, Standing, Status, Values
from maslam.backend.distributed.solver_stage import Round, SolverStage
from maslam.backend.distributed.update_messages import UpdateKind, UpdateMessage
from maslam.backend.distributed.wire import GroupMessage
from maslam.backend.geometry import Sim3
from maslam.mas.protocol.ids import ContractId, FrameId, MatchId, OperationKind
from maslam.mas.protocol.map_messages import MapDelivery, MapOrder, MapPatch, Parcel, SubMap
from maslam.mas.protocol.messages import (
    LINK_DTYPE,
    Award,
    Bid,
    Call,
    Confirmation,
    GroupNotice,
    Links,
    MapNotice,
    Message,
    Offer,
    PieceTerms,
    Refusal,
    Result,
)
from maslam.mas.protocol.solver_messages import SolverBody
from maslam.mas.protocol.tasks import (
    EarlierAnswer,
    OptimiseAnswer,
    OptimiseTask,
    OwnerQuery,
    PlaceAnswer,
    PlaceQuery,
    PlaceRedirect,
    VerifyAnswer,
    VerifyTask,
)
from maslam.mas.protocol.tensors import Tensor, pack_information, pack_poses, pack_sim3, pack_sim3s


def submap(**changes: object) -> SubMap:
    fields: dict[str, object] = {
        "owner": 1,
        "version": 4,
        "unit": 1.0,
        "keyframes": Tensor.of([0, 1], "<i4"),
        "stamps_ns": Tensor.of([0, 5], "<i8"),
        "poses": pack_poses(np.stack([np.eye(4)] * 2)),
        "references": Tensor.of([0, 1, 1], "<i4"),
        "points": Tensor.of(np.ones((3, 3)), "<f4"),
        "descriptors": Tensor.of(np.zeros((3, 32)), "|u1"),
        "matches": (),
        "transforms": pack_sim3s([]),
    }
    return SubMap(**{**fields, **changes})  # type: ignore[arg-type]


def verify_task(**changes: object) -> VerifyTask:
    fields: dict[str, object] = {
        "match": MatchId(0, 3, 1, 2),
        "track": 0,
        "stamp_ns": 5,
        "recording": 7,
        "metric": True,
        "T_T_Q": pack_poses(np.eye(4)),
        "way": 12.5,
        "points": Tensor.of(np.ones((4, 3)), "<f4"),
        "descriptors": Tensor.of(np.zeros((4, 32)), "|u1"),
        "words": None,
    }
    return VerifyTask(**{**fields, **changes})  # type: ignore[arg-type]


def optimise_task(**changes: object) -> OptimiseTask:
    fields: dict[str, object] = {
        "members": (0, 1),
        "frame": FrameId(0, 0),
        "metric": True,
        "tracks": (0,),
        "matches": (MatchId(0, 3, 1, 2),),
        "present": (FrameId(1, 0),),
        "placements": pack_sim3s([Sim3.identity()]),
        "arbitrary": (1,),
    }
    return OptimiseTask(**{**fields, **changes})  # type: ignore[arg-type]


def verify_answer(**changes: object) -> VerifyAnswer:
    fields: dict[str, object] = {
        "match": MatchId(0, 3, 1, 2),
        "accepted": True,
        "reason": "accepted",
        "matches": 40,
        "inliers": 30,
        "rmse": 0.1,
        "T_M_Q": pack_sim3(Sim3.identity()),
        "information": pack_information(np.eye(7)),
        "track": 0,
        "stamp_ns": 5,
        "T_T_M": pack_poses(np.eye(4)),
        "way": 12.5,
        "depth": 8.0,
        "keyframes": 7,
    }
    return VerifyAnswer(**{**fields, **changes})  # type: ignore[arg-type]


def parcel(**changes: object) -> Parcel:
    fields: dict[str, object] = {
        "base": 2,
        "version": 3,
        "frame": FrameId(0, 0),
        "unit": None,
        "check": 7,
        "bits": b"123",
        "descriptors": Tensor.of(np.zeros((2, 32)), "|u1"),
    }
    return Parcel(4, pack_sim3(Sim3.identity()), (4, 2), (MapPatch(**{**fields, **changes}),))  # type: ignore[arg-type]


def solver_messages() -> list[GroupMessage]:
    """One of each kind from agent 0 to agent 1."""
    descent, free = Round(SolverStage.DESCENT, 1, 2), Round(SolverStage.FREE)
    steps = np.arange(-6, 6, dtype=np.int8).reshape(2, 6)
    return [
        Values(0, 1, Round(SolverStage.POSE, 0, 2), np.full((2, 6), np.nan)),
        Report(0, 1, Round(SolverStage.ROTATION, 0, 1), float("inf"), 3.0),
        Report(0, 1, descent, 0.5, 3.0, (0.5, 0.25)),
        Decision(0, 1, descent, True, 3.0, (0.5,)),
        Deltas(0, 1, descent, (0.5, 0.25), steps),
        SeparatorState(0, 1, free, 3, 2, np.zeros((2, 6))),
        Status(0, 1, free, (Standing(1, 2, 3, True, ((0, 4),)),)),
        ElectedMessage(Kind.CONTRIBUTION, 0, 0, 1, b"whatever its kind lays out"),
        UpdateMessage(UpdateKind.CORRECTION, 0xABCD, 2, 0, 1, b"likewise"),
        UpdateMessage(UpdateKind.LOST, 0xABCD, 0, 0, 1),
    ]


def examples() -> list[Message]:
    contract = ContractId(0, 7)
    vector = bytes(range(16))
    rows = pack_sim3s([Sim3.identity()], LINK_DTYPE)
    links = Links((MatchId(0, 1, 1, 2),), (0,), (FrameId(0, 0),), (True,), rows, rows)
    bodies = [
        Call(OperationKind.DOPT, 5_000_000_000, (0, 1)),
        Bid(100, 0, links, (PieceTerms(0, FrameId(0, 0), True, True),)),
        Refusal("busy"),
        Award(PlaceQuery(3, 0xAB12CD34, vector)),
        Award(OwnerQuery(3, 0xAB12CD34, vector)),
        Award(verify_task()),
        Award(
            verify_task(
                points=Tensor.of([1, 2, 3, 4], "<u4"),
                ranges=Tensor.of([0, 0, 0, 1, 1, 1], "<f4"),
                descriptors=Tensor.of(np.zeros((4, 16)), "|u1"),
                more=300,
            )
        ),
        Confirmation(),
        Award(optimise_task()),
        Result(verify_answer()),
        Result(verify_answer(information=pack_information(np.eye(6)))),
        Result(PlaceAnswer(4, 0.25)),
        Result(PlaceAnswer(None, 2.0)),
        Result(EarlierAnswer(2, 4, 0.25)),
        Result(PlaceRedirect(5, 4, 0.25)),
        Result(PlaceRedirect(None, None, 2.0)),
        Result(OptimiseAnswer(True, 2.0, 1.0, 30)),
        Award(MapOrder((1, 4), (0, 2), FrameId(0, 0))),
        Result(MapDelivery(FrameId(0, 0), (), pack_sim3s([]), (submap(),), (parcel(),))),
        *(SolverBody.of(message) for message in solver_messages()),
    ]
    notices = [GroupNotice((0, 1, 2)), MapNotice((Offer(0, 7, 40), Offer(2, 3, 20)))]
    return [*(Message(0, 1, contract, b) for b in bodies), *(Message(0, 1, None, b) for b in notices)]
