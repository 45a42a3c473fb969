"""What an agent remembers of an optimisation: the tender before the award, the session after it."""

from __future__ import annotations

from dataclasses import dataclass, field

from backend.distributed.node import Node
from mas.contract import Contract
from mas.identities import ContractId
from mas.messages import Bid
from mas.solver_link import SolverLink
from mas.solver_messages import SolverBody
from mas.tasks import OptimiseTask


@dataclass
class Tender:
    """The manager's side until the award: who still has to answer, what was bid, who did not bid; alone: no
    contract."""

    identity: ContractId | None
    pending: set[int]
    bids: dict[int, Bid]
    missing: set[int] = field(default_factory=set)


@dataclass
class Session:
    """One optimisation this agent takes part in. ``unconfirmed``: members the manager waits for before it begins;
    ``early``: solver messages that came before the start; ``link``: what the others may have missed."""

    identity: ContractId | None
    task: OptimiseTask
    node: Node
    contract: Contract | None = None
    unconfirmed: set[int] = field(default_factory=set)
    begun: bool = False
    early: list[tuple[int, SolverBody]] = field(default_factory=list)
    link: SolverLink = field(default_factory=SolverLink)
