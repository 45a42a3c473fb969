"""Decide for the agents: whom to ask, when to optimise and with whom, from whom to buy maps, what a bid is worth.

python examples/02_own_policy.py SEQUENCES OUT
"""

from __future__ import annotations

import sys

import maslam


class AskTheLikeliest(maslam.Policy):
    """Asks one agent about each key-frame: one that it has not asked yet, else the one whose last answer came nearest.

    Each agent has a policy of its own, so what it remembers is this agent's.
    """

    def __init__(self) -> None:
        self._asked: set[int] = set()

    def ask(self, state: maslam.AgentState, outlook: maslam.Outlook, keyframe: int) -> list[int]:
        if not outlook.reachable:
            return []
        likeliest = min(outlook.reachable, key=lambda a: (a in self._asked, outlook.distances.get(a, 2.0), a))
        self._asked.add(likeliest)
        return [likeliest]

    def optimise(self, state: maslam.AgentState, outlook: maslam.Outlook) -> list[int]:
        due = outlook.pending_matches >= 3 or (outlook.pending_matches > 0 and outlook.closing)
        return sorted(state.group) if due else []

    def buy(self, state: maslam.AgentState, outlook: maslam.Outlook) -> list[int]:
        return state.partners() if outlook.closing else []

    def worth(self, reputation: float, benefit: float, bid: maslam.Bid, deadline_ns: int) -> float:
        """Who does not deliver is hardly worth a cheap price."""
        return reputation**2 * benefit / max(bid.cost_bytes, 1) if bid.ready_ns <= deadline_ns else 0.0


def main(sequences: str, out: str) -> None:
    ours = maslam.run(sequences, f"{out}/ours", preset="maslam")
    own = maslam.run(sequences, f"{out}/own", preset="maslam", policy=AskTheLikeliest())
    for name, run in (("ours", ours), ("own", own)):
        figures = run.summary
        print(
            f"{name}: policy {run.config.policy}, {figures.traffic['total'].wire_bytes} bytes, "
            f"{figures.matches.accepted} matches, groups {figures.groups}"
        )


if __name__ == "__main__":
    main(*sys.argv[1:])
