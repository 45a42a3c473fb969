"""Key-frames already sent to each peer, and which peers answered lately."""

from __future__ import annotations

from ..contracts.contract import Contract, ContractState


class SentQueries:
    """Each key-frame is sent to a peer once, and again only where the contract failed for good.

    ``delivered``: contracts about places that each other agent fulfilled since the last that it did not.
    """

    def __init__(self) -> None:
        self.delivered: dict[int, int] = {}
        self._mine: list[int] = []
        self._to: dict[int, set[int]] = {}
        self._missed: dict[int, set[int]] = {}

    def remember(self, keyframe: int) -> None:
        """A key-frame that can be sent: the newest, or one that is known."""
        if not self._mine or keyframe > self._mine[-1]:
            self._mine.append(keyframe)

    def sent(self, other: int, keyframe: int) -> None:
        """It was sent to the other, or waits to be."""
        self._to.setdefault(other, set()).add(keyframe)
        self._missed.get(other, set()).discard(keyframe)

    def to(self, other: int) -> set[int]:
        """Key-frames sent to the other, those of failed contracts among them."""
        return self._to.get(other, set())

    def known_to(self, other: int) -> tuple[int, ...]:
        """Key-frames that the other was asked about, in order, as far as the agent knows."""
        return tuple(sorted(self.to(other) - self._missed.get(other, set())))

    def unsent(self, other: int) -> list[int]:
        """Key-frames that the other does not know, as far as the agent knows; the oldest first."""
        sent, missed = self.to(other), self._missed.get(other, set())
        if len(sent) == len(self._mine) and not missed:
            return []
        return [k for k in self._mine if k not in sent or k in missed]

    def ended(self, contract: Contract, keyframe: int, again: bool) -> None:
        """A contract about a key-frame has ended; ``again``: it will be called for once more."""
        other = contract.contractor
        done = contract.state is ContractState.DONE
        self.delivered[other] = self.delivered.get(other, 0) + 1 if done else 0
        if not done and not again:
            self._missed.setdefault(other, set()).add(keyframe)
