"""Retransmission among the members of an optimisation (``tick`` and ``again`` of the solver's nodes).

A node that gets no further for as long as answers take asks for what it lacks, in a byte, and its sender sends that
again, if it is not on its way: sent less than half a timeout ago. Nothing of this happens as long as messages arrive.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

from maslam.backend.distributed.methods import SolverNode
from maslam.backend.distributed.wire import SolverMessage

from ..contracts.rtt import RttEstimator


@dataclass
class SolverLink:
    """One agent's side of one optimisation. ``went_on_ns``: when it got further last; ``tries``: repeats since then."""

    went_on_ns: int = 0
    sent_ns: int = 0
    tries: int = 0
    _sent_ns: dict[tuple[object, ...], int] = field(default_factory=dict)

    def goes_on(self, sent: Sequence[SolverMessage], now_ns: int) -> None:
        """The node got further and sent something: the wait begins anew."""
        self.went_on_ns = self.sent_ns = now_ns
        self.tries = 0
        self._note(sent, now_ns)

    def due(self, node: SolverNode, now_ns: int, rtt: RttEstimator) -> list[SolverMessage]:
        """What the node sends once it has waited long enough: it asks for what it lacks."""
        others = set(node.share.members) - {node.share.robot}
        wait = max((rtt.ask_ns(member, min(self.tries, 2)) for member in others), default=0)
        if now_ns - self.sent_ns < wait:
            return []
        self.sent_ns, self.tries = now_ns, self.tries + 1
        return list(node.tick())

    def again(self, node: SolverNode, message: SolverMessage, now_ns: int, rtt: RttEstimator) -> list[SolverMessage]:
        """To a member that has sent ``message`` again: what it may have missed. Not twice at once."""
        return self.answered(message.sender, node.again(message), now_ns, rtt)

    def answered(
        self, member: int, answer: Sequence[SolverMessage], now_ns: int, rtt: RttEstimator
    ) -> list[SolverMessage]:
        """The ``answer`` to a member without what it was sent just now."""
        since = now_ns - rtt.wait_ns(member) // 2
        out = [m for m in answer if m.asks or self._sent_ns.get(_key(m), since) <= since]
        self._note(out, now_ns)
        return out

    def _note(self, messages: Sequence[SolverMessage], now_ns: int) -> None:
        self._sent_ns.update({_key(m): now_ns for m in messages})


def _key(message: SolverMessage) -> tuple[object, ...]:
    return message.receiver, message.name, *message.place
