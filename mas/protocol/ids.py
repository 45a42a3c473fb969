"""Names and bounded numbers that messages are made of."""

from __future__ import annotations

from enum import IntEnum
from typing import Annotated

import msgspec

# Bounds of single fields: generous for any real run, small enough that a hostile message cannot fill the memory.
MAX_AGENTS = 4096
MAX_POINTS = 1_000_000
MAX_VIEW_POINTS = 20_000
MAX_VECTOR_BYTES = 65_536
AgentId = Annotated[int, msgspec.Meta(ge=0, lt=MAX_AGENTS)]
Index = Annotated[int, msgspec.Meta(ge=0, le=2**31)]
Language = Annotated[int, msgspec.Meta(ge=0, lt=2**32)]
Recording = Annotated[int, msgspec.Meta(ge=0, lt=2**32)]
Stamp = Annotated[int, msgspec.Meta(ge=-(2**62), le=2**62)]
REASON_LENGTH = 200
Reason = Annotated[str, msgspec.Meta(max_length=REASON_LENGTH)]
Members = Annotated[tuple[AgentId, ...], msgspec.Meta(max_length=MAX_AGENTS)]


class OperationKind(IntEnum):
    """Subject of a contract: the thesis's three operations, place recognition in its two halves."""

    DVPR = 0
    RELPOSE = 1
    DOPT = 2
    MAPMERGE = 3


class ContractId(msgspec.Struct, frozen=True, array_like=True, order=True):
    """The manager's number for one call for proposals."""

    manager: AgentId
    number: Index


class MatchId(msgspec.Struct, frozen=True, array_like=True, order=True):
    """A place match: key-frame ``query`` of ``query_agent`` was recognised in ``match`` of ``match_agent``."""

    query_agent: AgentId
    query: Index
    match_agent: AgentId
    match: Index

    def __str__(self) -> str:
        """``query agent:key-frame - match agent:key-frame`` for people."""
        return f"{self.query_agent}:{self.query} - {self.match_agent}:{self.match}"

    @property
    def agents(self) -> tuple[int, int]:
        """The agent that asked and the one that recognised it: the same for an own loop."""
        return self.query_agent, self.match_agent

    def end_of(self, agent: int) -> tuple[int, int]:
        """This agent's key-frame (of a loop of its own: the query's), and the other agent."""
        return (self.query, self.match_agent) if self.query_agent == agent else (self.match, self.query_agent)


class FrameId(msgspec.Struct, frozen=True, array_like=True, order=True):
    """A coordinate frame O: the camera of the first key-frame of one agent's track; its unit is that track's own."""

    agent: AgentId
    track: Index
