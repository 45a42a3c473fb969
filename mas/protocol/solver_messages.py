"""Messages of the distributed solver's nodes, as they are transmitted between agents: in the back end's own bytes
(:mod:`maslam.backend.distributed.wire`)."""

from __future__ import annotations

from typing import Annotated, ClassVar

import msgspec

from maslam.backend.distributed.wire import GroupMessage, pack, unpack
from maslam.backend.errors import BackendError

from .accounting import Counted
from .ids import OperationKind
from .tensors import MessageError


class SolverBody(Counted, frozen=True, array_like=True, tag=20):
    """A node's message of any method, or of an update, without sender and receiver: those stand in the message's
    header."""

    belongs_to: ClassVar[OperationKind | None] = OperationKind.DOPT

    data: Annotated[bytes, msgspec.Meta(max_length=2**26)]

    def __post_init__(self) -> None:
        try:
            self.read(0, 0)
        except BackendError as error:
            raise MessageError(f"data: {error}") from error

    @classmethod
    def of(cls, message: GroupMessage) -> SolverBody:
        """The body that carries a node's message; :class:`MessageError` where a number is not finite."""
        return cls(pack(message))

    def read(self, sender: int, receiver: int) -> GroupMessage:
        """The node's message between these two agents."""
        return unpack(sender, receiver, self.data)

    @property
    def kind(self) -> str:
        return f"Solver{self.read(0, 0).name}"

    @property
    def payload_bytes(self) -> int:
        """The numbers of separator poses as they travel; the rest as the back end counts it."""
        return self.read(0, 0).payload_bytes
