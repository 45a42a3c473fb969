"""Retransmission among the members of an optimisation (``tick`` and ``again`` of the solver's nodes).

A node that gets no further for as long as answers take asks for what it lacks, or sends its last messages again; who
receives a message for the second time knows by that what the sender waits for, and sends its own to it again. Nothing
of this happens as long as messages arrive.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

from maslam.backend.distributed.methods import SolverNode
from maslam.backend.distributed.wire import SolverMessage

from ..contracts.rtt import RttEstimator

# Messages that are known again, at most.
_SEEN = 50_000


@dataclass
class SolverLink:
    """One agent's side of one optimisation. ``goes_on``: it got further; ``tries``: repeats since then."""

    sent_ns: int = 0
    tries: int = 0
    _answered_ns: dict[int, int] = field(default_factory=dict)
    _seen: set[tuple[object, ...]] = field(default_factory=set)

    def goes_on(self, now_ns: int) -> None:
        """The node got further and sent something: the wait begins anew."""
        self.sent_ns, self.tries = now_ns, 0

    def seen(self, message: SolverMessage) -> bool:
        """Whether this very message came before; remembers it."""
        key = (message.sender, message.name, *message.place)
        known = key in self._seen
        if len(self._seen) >= _SEEN:
            self._seen.clear()  # what comes again is then taken for new, and only not answered
        self._seen.add(key)
        return known

    def due(self, node: SolverNode, now_ns: int, rtt: RttEstimator) -> list[SolverMessage]:
        """The last message to each other member, once the node has waited long enough: whoever has it already answers
        with what this node may have missed, and learns by the next that it missed something itself."""
        others = set(node.share.members) - {node.share.robot}
        wait = max((rtt.wait_ns(member, min(self.tries, 2)) for member in others), default=0)
        if now_ns - self.sent_ns < wait:
            return []
        self.sent_ns, self.tries = now_ns, self.tries + 1
        return list({m.receiver: m for m in node.tick()}.values())

    def again(self, node: SolverNode, message: SolverMessage, now_ns: int, rtt: RttEstimator) -> list[SolverMessage]:
        """To a member that has sent ``message`` again: what it may have missed. Not twice at once."""
        return self.answered(message.sender, node.again(message), now_ns, rtt)

    def answered(
        self, member: int, answer: Sequence[SolverMessage], now_ns: int, rtt: RttEstimator
    ) -> list[SolverMessage]:
        """The ``answer`` to a member, or nothing where it got one just now."""
        before = self._answered_ns.get(member)
        if not answer or (before is not None and now_ns - before < rtt.wait_ns(member) // 2):
            return []
        self._answered_ns[member] = now_ns
        return list(answer)
