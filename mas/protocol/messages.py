"""Every message between agents: typed, versioned, bounded, checked when it comes in. Nothing else travels.

A :class:`Message` is a header and one body. Bodies are the contract net's (Smith 1980, thesis sections 2.1.6 and 3.8;
with confirmation: 2.2.5) and, while an optimisation runs, those of the solver in
:mod:`maslam.mas.protocol.solver_messages`. What an operation needs travels inside award (the task) and result (the
outcome): no work exists without its contract.
"""

from __future__ import annotations

from typing import Annotated, ClassVar

import msgspec

from .accounting import Counted, Traffic
from .ids import MAX_AGENTS, AgentId, ContractId, FrameId, Index, MatchId, Members, OperationKind, Reason, Stamp
from .solver_messages import SolverBody
from .tasks import Outcome, Task
from .tensors import MessageError, Tensor, check_sim3s, pack_sim3s

VERSION = 6
LINK_DTYPE = "<f4"
_NO_ROWS = pack_sim3s([], LINK_DTYPE)

# -- terms: what a bid offers -----------------------------------------------------------------------------------------


class Links(msgspec.Struct, frozen=True, array_like=True):
    """Accepted matches as one of their owners holds them, one row for each own end.

    ``poses`` ``(n, 8)``: the owner's key-frames in ``frames`` as it believes now, Sim(3) with the key-frame's unit as
    scale; ``query``: which rows are the query's end, and for those, in order, ``transforms`` ``(q, 8)``: ``T_M_Q``.
    Single precision: they tell how members stand to each other when an optimisation starts, and what contradicts what.
    """

    matches: Annotated[tuple[MatchId, ...], msgspec.Meta(max_length=100_000)] = ()
    tracks: Annotated[tuple[Index, ...], msgspec.Meta(max_length=100_000)] = ()
    frames: Annotated[tuple[FrameId, ...], msgspec.Meta(max_length=100_000)] = ()
    query: Annotated[tuple[bool, ...], msgspec.Meta(max_length=100_000)] = ()
    poses: Tensor = _NO_ROWS
    transforms: Tensor = _NO_ROWS

    def __post_init__(self) -> None:
        n = len(self.matches)
        if not n == len(self.tracks) == len(self.frames) == len(self.query):
            raise MessageError(f"links: {n} matches with other numbers of tracks, frames and ends")
        check_sim3s("poses", self.poses, n, LINK_DTYPE)
        check_sim3s("transforms", self.transforms, sum(self.query), LINK_DTYPE)


class PieceTerms(msgspec.Struct, frozen=True, array_like=True):
    """A track that its agent would bring into an optimisation, and the coordinates it is in. ``metric``: the agent's
    unit is the metre; ``frame_metric``: that of the coordinates is, even if the agent's is not; ``positions``: its
    solver has positions measured from outside (GPS) of it."""

    track: Index
    frame: FrameId
    metric: bool
    frame_metric: bool
    positions: bool = False

    def __post_init__(self) -> None:
        if self.metric and not self.frame_metric:
            raise MessageError("pieces: a metric track in coordinates that are not")


class Offer(msgspec.Struct, frozen=True, array_like=True):
    """A map for sale: whose, which version, how many key-frames."""

    owner: AgentId
    version: Index
    keyframes: Index


# -- bodies -----------------------------------------------------------------------------------------------------------


class Call(Counted, frozen=True, array_like=True, tag=1):
    """Call for proposals: manager to possible contractors. ``members``: who is asked, where that matters."""

    operation: OperationKind
    deadline_ns: Stamp
    members: Members = ()


class Bid(Counted, frozen=True, array_like=True, tag=2):
    """I can do it: ``cost_bytes`` that the result will take (estimate), by ``ready_ns``; with the state the operation
    needs: ``links`` and ``pieces`` (optimisation), ``offers`` (maps). ``peer_to_peer``: an optimisation of two, with
    the manager alone; the links are those with it."""

    cost_bytes: Index
    ready_ns: Stamp
    links: Links | None = None
    pieces: Annotated[tuple[PieceTerms, ...], msgspec.Meta(max_length=4096)] = ()
    offers: Annotated[tuple[Offer, ...], msgspec.Meta(max_length=MAX_AGENTS)] = ()
    peer_to_peer: bool = False

    def __post_init__(self) -> None:
        pieces = {p.track: p.frame for p in self.pieces}
        links = self.links or Links()
        if len(pieces) != len(self.pieces):
            raise MessageError("pieces: a track that comes twice")
        if any(pieces.get(t) != f for t, f in zip(links.tracks, links.frames, strict=True)):
            raise MessageError("links: of a track that is no piece, or in other coordinates than it")


class Refusal(Counted, frozen=True, array_like=True, tag=3):
    """I do not bid."""

    reason: Reason


class Award(Counted, frozen=True, array_like=True, tag=4):
    """The bid is taken; here is the task."""

    task: Task

    @property
    def traffic(self) -> Traffic:
        return self.task.traffic

    @property
    def kind(self) -> str:
        return self.task.kind

    @property
    def payload_bytes(self) -> int:
        return self.task.payload_bytes


class Rejection(Counted, frozen=True, array_like=True, tag=5):
    """The bid is not taken."""

    reason: Reason


class Confirmation(Counted, frozen=True, array_like=True, tag=6):
    """The contractor commits itself, only now (contract net with confirmation)."""


class Result(Counted, frozen=True, array_like=True, tag=7):
    """The work is done."""

    outcome: Outcome

    @property
    def traffic(self) -> Traffic:
        return self.outcome.traffic

    @property
    def kind(self) -> str:
        return self.outcome.kind

    @property
    def payload_bytes(self) -> int:
        return self.outcome.payload_bytes


class Failure(Counted, frozen=True, array_like=True, tag=8):
    """The contractor cannot do the work it was awarded."""

    reason: Reason


class Cancel(Counted, frozen=True, array_like=True, tag=9):
    """The manager withdraws the contract."""

    reason: Reason


class Begin(Counted, frozen=True, array_like=True, tag=10):
    """All members have confirmed: the optimisation starts."""

    belongs_to: ClassVar[OperationKind | None] = OperationKind.DOPT


class GroupNotice(Counted, frozen=True, array_like=True, tag=11):
    """These agents are joined by place matches, directly or through others, as far as I know."""

    members: Members


class MapNotice(Counted, frozen=True, array_like=True, tag=12):
    """These maps are new here, and may be bought."""

    offers: Annotated[tuple[Offer, ...], msgspec.Meta(max_length=MAX_AGENTS)]


ContractBody = Call | Bid | Refusal | Award | Rejection | Confirmation | Result | Failure | Cancel
Body = ContractBody | Begin | GroupNotice | MapNotice | SolverBody


class Message(msgspec.Struct, frozen=True, array_like=True):
    """Header and body. ``contract`` is None for notices only."""

    sender: AgentId
    recipient: AgentId
    contract: ContractId | None
    body: Body
    version: int = VERSION

    def __post_init__(self) -> None:
        if self.version != VERSION:
            raise MessageError(f"version {self.version} of the protocol, expected {VERSION}")


_encoder = msgspec.msgpack.Encoder()
_decoder = msgspec.msgpack.Decoder(Message)


def encode(message: Message) -> bytes:
    """The exact bytes that travel: MessagePack."""
    return _encoder.encode(message)


def decode(data: bytes, max_bytes: int) -> Message:
    """The message in ``data``, or :class:`MessageError` saying what is wrong with it."""
    if len(data) > max_bytes:
        raise MessageError(f"message of {len(data)} bytes, at most {max_bytes} are taken")
    try:
        return _decoder.decode(data)
    except RecursionError:
        raise MessageError(f"message of {len(data)} bytes is nested too deeply") from None
    except (msgspec.MsgspecError, MessageError, UnicodeDecodeError) as error:
        # msgspec takes a check's ValueError or TypeError for bad data. Checks raise MessageError: it is our own.
        if isinstance(error.__cause__, ValueError | TypeError):
            raise error.__cause__ from None
        raise MessageError(f"message of {len(data)} bytes cannot be read: {error}") from error
