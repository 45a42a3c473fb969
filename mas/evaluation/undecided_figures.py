"""What robust selection by elected agents left open."""

from __future__ import annotations

from collections.abc import Sequence

from pydantic import BaseModel, ConfigDict

from ..agent import Agent


class UndecidedFigures(BaseModel):
    """The ``rejected`` matches hold where ``agents`` are moved against the rest of their group, and the ``kept`` ones
    break then: nothing tells which are wrong."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    agents: list[int]
    kept: list[str]
    rejected: list[str]


def undecided_of(agents: Sequence[Agent]) -> list[UndecidedFigures]:
    """By the last optimisation of each agent."""
    left = (u for agent in agents for u in agent.optimisation.running.undecided)
    return [
        UndecidedFigures(agents=list(u.agents), kept=[str(m) for m in u.kept], rejected=[str(m) for m in u.rejected])
        for u in left
    ]
