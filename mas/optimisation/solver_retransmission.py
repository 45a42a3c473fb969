"""What members of an optimisation say again because it may have been lost (``tick`` of the solver's nodes).

A node that gets no further repeats its last messages; who hears a message for the second time knows by that what the
sender waits for, and repeats its own to it. Nothing of this happens as long as messages arrive.
"""

from __future__ import annotations

from dataclasses import dataclass, field

from maslam.backend.distributed.elected_messages import ElectedMessage
from maslam.backend.distributed.methods import SolverNode

from ..contracts.rtt import RttEstimator
from ..protocol.solver_messages import SolverBody, SolverMessage, place_of, round_of


@dataclass
class SolverLink:
    """One agent's side of one optimisation. ``goes_on``: it got further; ``tries``: repeats since then."""

    said_ns: int = 0
    tries: int = 0
    _told_ns: dict[int, int] = field(default_factory=dict)
    _seen: set[tuple[object, ...]] = field(default_factory=set)

    def goes_on(self, now_ns: int) -> None:
        """The node got further and said so: the wait begins anew."""
        self.said_ns, self.tries = now_ns, 0

    def seen(self, sender: int, body: SolverBody) -> bool:
        """Whether this very message came before; remembers it."""
        key = (sender, type(body), *place_of(body))
        known = key in self._seen
        self._seen.add(key)
        return known

    def due(self, node: SolverNode, now_ns: int, rtt: RttEstimator) -> list[SolverMessage]:
        """The last message to each other member, once the node has waited long enough: whoever has it already answers
        with what this node may have missed, and learns by the next that it missed something itself."""
        last = {m.receiver: m for m in node.tick()}
        wait = max((rtt.wait_ns(member, min(self.tries, 2)) for member in last), default=0)
        if now_ns - self.said_ns < wait:
            return []
        self.said_ns, self.tries = now_ns, self.tries + 1
        return list(last.values())

    def again(
        self, node: SolverNode, member: int, body: SolverBody, now_ns: int, rtt: RttEstimator
    ) -> list[SolverMessage]:
        """The last messages to a member that said ``body`` again: those of its round and later, for it has all before.
        Not twice at once."""
        told = self._told_ns.get(member)
        if told is not None and now_ns - told < rtt.wait_ns(member) // 2:
            return []
        self._told_ns[member] = now_ns
        since = round_of(body)
        said = [m for m in node.tick() if m.receiver == member]
        return [m for m in said if since is None or isinstance(m, ElectedMessage) or m.round >= since]
