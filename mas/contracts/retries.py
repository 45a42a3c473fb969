"""Calling again for what was not delivered, a bounded number of times; others who wait for the contractor go first."""

from __future__ import annotations

from collections.abc import Hashable

from .contract import Contract, ContractState
from .reputation import SILENT


class RetryBudget:
    """Counts for each subject (a key-frame, a match, a map) and contractor how often the work was called for again."""

    def __init__(self, limit: int) -> None:
        self.limit = limit
        self._tried: dict[tuple[Hashable, int], int] = {}

    def wanted(self, contract: Contract, subject: Hashable, out_of_reach: bool = False) -> bool:
        """Whether to call again after this end; False once it is done, was not wanted, or was tried often enough.
        ``out_of_reach``: nothing comes from the contractor at all: what was tried meanwhile does not count, as it is
        not called before it answers a probe."""
        key = (subject, contract.contractor)
        lost = (
            contract.state in (ContractState.EXPIRED, ContractState.FAILED, ContractState.REFUSED)
            or contract.reason == SILENT
        )
        if lost and out_of_reach:
            return True
        tried = self._tried.pop(key, 0)
        if not lost or tried >= self.limit:
            return False
        self._tried[key] = tried + 1
        return True
