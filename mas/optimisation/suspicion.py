"""Who spoilt an optimisation, where nobody can see it: members are done without in turn.

A solution that one's own odometry speaks against was spoilt by a member. Where one robot solved, it was that one; of
two members it was the other. Where all work on their own parts each one's numbers may have been spoilt by another's:
then the agent takes part in none that its first suspect takes part in, the manager, and where that one's absence
changes nothing, the next one. All who were there suspect in the same order.
"""

from __future__ import annotations

from collections.abc import Sequence


class Suspicion:
    """One agent's search for the member that lies. ``left_out``: whom it does without now."""

    def __init__(self, me: int) -> None:
        self.me = me
        self.left_out: int | None = None
        self._next: list[int] = []

    def spoilt(self, members: Sequence[int], manager: int, leader: int | None = None) -> int | None:
        """An optimisation was spoilt, or never came to its end. Returns who did it, where that is certain."""
        others = [m for m in members if m != self.me]
        if leader is not None:
            return leader if leader != self.me else None
        if len(others) == 1:
            return others[0]
        if self.left_out is None or self.left_out not in members:
            if not self._next:
                self._next = sorted(others, key=lambda m: (m != manager, m))
            self.left_out = self._next.pop(0)
        return None

    def ended_well(self, members: Sequence[int]) -> int | None:
        """An optimisation ended well. Returns who spoilt the earlier ones: the one that took no part in this."""
        if self.left_out is None or self.left_out in members:
            return None
        found, self.left_out, self._next = self.left_out, None, []
        return found
