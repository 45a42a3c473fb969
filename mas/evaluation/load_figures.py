"""What each agent carries of the team's work: bytes in and out, and how often it did for others what one does for
all."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

from pydantic import BaseModel, ConfigDict

from ..contracts.effects import Event
from ..transport.transport import Transport


class LoadFigures(BaseModel):
    """Of one agent. ``bytes_out``, ``bytes_in``: of encoded messages that it sent, and that were sent to it;
    ``solver_turns``: optimisations that it solved as the elected solver, and their updates; ``directory_turns``: place
    vectors of others that it was sent as the directory, or as the owner of a cluster."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    bytes_out: int
    bytes_in: int
    solver_turns: int
    directory_turns: int


def load_of(agents: int, transport: Transport, events: Sequence[Event]) -> list[LoadFigures]:
    """Of each agent."""
    out, into, turns = Counter[int](), Counter[int](), Counter[int]()
    for (sender, recipient), count in transport.by_pair.items():
        out[sender] += count.wire_bytes
        into[recipient] += count.wire_bytes
    for event in events:
        if event.kind == "optimised" and event.fields["solver"] is not None:
            turns[event.fields["solver"]] += 1
        if event.kind == "updated":
            turns[event.agent] += 1
    return [
        LoadFigures(
            bytes_out=out[me],
            bytes_in=into[me],
            solver_turns=turns[me],
            directory_turns=transport.owner_queries.get(me, 0),
        )
        for me in range(agents)
    ]
