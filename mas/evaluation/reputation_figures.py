"""Figures of how agents dealt with each other and with faults, for the summary."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..agent import Agent
from ..contracts.reputation import Reputation, Trust
from ..transport.faults import FaultyTransport
from ..transport.transport import Transport
from .summary import FaultFigures, ReputationFigures


def reputations(agents: Sequence[Agent]) -> list[ReputationFigures]:
    """For each agent, what the others think of it."""
    return [_of(agent.state.me, agents) for agent in agents]


def _of(me: int, agents: Sequence[Agent]) -> ReputationFigures:
    views: dict[int, Reputation] = {}
    for other in agents:
        if me in other.context.reputation.records:
            views[other.state.me] = other.context.reputation.records[me]
    values = [r.value for r in views.values()]
    return ReputationFigures(
        agent=me,
        delivered=sum(r.delivered for r in views.values()),
        failed=sum(r.failed for r in views.values()),
        expired=sum(r.expired for r in views.values()),
        contradicted=int(sum(r.f for r in views.values())),
        mean=float(np.mean(values)) if values else None,
        lowest=min(values) if values else None,
        not_called_by=sorted(a for a, r in views.items() if r.trust is not Trust.GOOD),
    )


def fault_figures(agents: Sequence[Agent], transport: Transport) -> FaultFigures | None:
    """Counts of messages lost and doubled on purpose, and of repeats; None without such faults."""
    if not isinstance(transport, FaultyTransport):
        return None
    solvers = sum(a.optimisation.running.repeated + a.optimisation.running.updates.repeated for a in agents)
    repeated = solvers + sum(a.context.retransmitter.repeated for a in agents)
    return FaultFigures(
        lost=transport.lost, lost_bytes=transport.lost_bytes, doubled=transport.doubled, repeated=repeated
    )
