"""Retransmission of the last message of each contract: nothing travels reliably.

Only a manager repeats itself unasked, after ``repeat_s``, then after twice that, and so on up to ``repeat_max_s``, and
always with its call, the shortest message there is. A contractor answers a message that it knows with its own last one:
the bid, by which the manager learns that the award was lost and sends it again; the confirmation; the result. So each
exchange needs one timer, and no award or result travels twice that came the first time. Who has not sent anything for
``silence_s`` (longer where answers take long) is taken to be gone.
"""

from __future__ import annotations

import heapq
from dataclasses import dataclass

from ..config import LinkConfig
from ..protocol.ids import ContractId, OperationKind
from ..protocol.messages import Award, Bid, Call, Confirmation, Failure, Message, Refusal, Result
from .contract import Contract, ContractState
from .rtt import RttEstimator

Key = tuple[ContractId, int]
_FROM_CONTRACTOR = Bid | Refusal | Confirmation | Result | Failure
# In these states the other side owes the manager an answer.
_OWED = (ContractState.CALLED, ContractState.AWARDED, ContractState.WORKING)
# A last message worth repeating after the end: the other side may not know that it ended.
_CONTRACTOR_ENDS = (ContractState.DONE, ContractState.FAILED, ContractState.REFUSED)
_MANAGER_ENDS = (ContractState.REJECTED, ContractState.CANCELLED)
# Contracts whose bids are awarded each for itself.
_FOR_ITSELF = (OperationKind.DVPR, OperationKind.RELPOSE)
# Contracts of which award and confirmation are small, and a result follows at once only if it is.
_SMALL = (OperationKind.DVPR, OperationKind.DOPT)
# So many waits in vain until a contractor is given up, where answers are slow.
_TRIES = 20
# Times of repeats that are kept.
_TIMES = 15


@dataclass
class _Last:
    """``call``: the manager's call; ``message``: what I sent last, last at ``message_ns``; ``since_ns``: since when the
    other side is silent; ``times_ns``: when I sent it, or the call instead, the last few times; ``tries``: repeats
    since the other side sent something."""

    contract: Contract
    message: Message
    call: Message | None
    since_ns: int
    message_ns: int
    times_ns: list[int]
    tries: int = 0


class Retransmitter:
    """Last messages of one agent's contracts, kept until their deadlines. ``repeated``: how many were sent again."""

    def __init__(self, me: int, config: LinkConfig) -> None:
        self.me = me
        self.config = config
        self.repeated = 0
        self.rtt = RttEstimator(config)
        self._last: dict[Key, _Last] = {}
        self._owed: set[Key] = set()
        self._deadlines: list[tuple[int, Key]] = []

    def sent(self, contract: Contract, message: Message, now_ns: int) -> None:
        """Remember what I sent in a contract, as it is after that."""
        key = (contract.id, contract.contractor)
        known = self._last.get(key)
        call = message if isinstance(message.body, Call) else known.call if known else None
        self._last[key] = _Last(contract, message, call, now_ns, now_ns, [now_ns])
        if known is None:
            heapq.heappush(self._deadlines, (contract.deadline_ns, key))
        self._note_owed(key, contract)

    def received(self, contract: Contract, now_ns: int) -> None:
        """The other side has sent something, new or not: it is there."""
        last = self._last.get((contract.id, contract.contractor))
        if last is not None:
            before = last.contract.state
            if contract.state is not before and before in _answered_at_once(contract, self.me):
                self.rtt.answered(self._other(contract), now_ns, last.times_ns)
            # Who only repeats itself is there, and no nearer to an answer.
            last.tries = last.tries if contract.state is before else 0
            last.contract, last.since_ns = contract, now_ns
            self._note_owed((contract.id, contract.contractor), contract)

    def due(self, now_ns: int) -> list[Message]:
        """The manager's calls that it is time to send again; contracts past their deadline are forgotten."""
        while self._deadlines and self._deadlines[0][0] < now_ns:
            _, key = heapq.heappop(self._deadlines)
            self._last.pop(key, None)
            self._owed.discard(key)
        out = []
        for last in self._open():
            if last.call is not None and now_ns - last.times_ns[-1] >= self._wait_ns(last):
                out.append(self._again(last, last.call, now_ns))
        return out

    def silent(self, now_ns: int) -> list[Contract]:
        """Contracts whose contractor has owed an answer for too long, although it was asked again."""
        late = [x for x in self._open() if x.tries and now_ns - x.since_ns >= self._patience_ns(x.contract)]
        return [x.contract for x in late if x.contract.deadline_ns >= now_ns]

    def patience_ns(self, other: int) -> int:
        """How long the other may be silent that owes an answer."""
        return max(round(self.config.silence_s * 1e9), _TRIES * self.rtt.wait_ns(other))

    def _patience_ns(self, contract: Contract) -> int:
        # Who works was there a moment ago, and giving it up costs all other members of an optimisation their work.
        times = 2 if contract.state is ContractState.WORKING else 1
        return times * self.patience_ns(self._other(contract))

    def answer(self, contract: Contract, body: object, now_ns: int) -> Message | None:
        """Answer to a repeated message, or to one that came after the end; None: nothing. ``contract``: my
        copy."""
        last = self._last.get((contract.id, contract.contractor))
        if last is None or now_ns - last.message_ns < self.rtt.wait_ns(self._other(contract)) // 2:
            return None
        if contract.manager == self.me:
            missed = contract.state in _MANAGER_ENDS and isinstance(body, Bid | Confirmation)
            missed |= contract.state is ContractState.AWARDED and isinstance(body, Bid)
        else:
            missed = isinstance(body, Call | Award) and (not contract.ended or contract.state in _CONTRACTOR_ENDS)
            missed &= isinstance(last.message.body, _FROM_CONTRACTOR)
        if not missed:
            return None
        last.message_ns = now_ns
        return self._again(last, last.message, now_ns)

    @property
    def owed(self) -> bool:
        """Whether an answer is due to me."""
        return bool(self._owed)

    def _open(self) -> list[_Last]:
        return [self._last[key] for key in sorted(self._owed)]

    def _note_owed(self, key: Key, contract: Contract) -> None:
        if contract.manager == self.me and contract.state in _OWED:
            self._owed.add(key)
        else:
            self._owed.discard(key)

    def _again(self, last: _Last, message: Message, now_ns: int) -> Message:
        last.times_ns = [*last.times_ns[-_TIMES:], now_ns]
        last.tries += 1
        self.repeated += 1
        return message

    def _wait_ns(self, last: _Last) -> int:
        """Who works on something large may be sending it."""
        contract, other = last.contract, self._other(last.contract)
        small = contract.state is ContractState.CALLED or (
            contract.state is ContractState.AWARDED and contract.operation in _SMALL
        )
        return self.rtt.ask_ns(other, last.tries) if small else self.rtt.wait_ns(other, last.tries)

    def _other(self, contract: Contract) -> int:
        return contract.contractor if contract.manager == self.me else contract.manager


def _answered_at_once(contract: Contract, me: int) -> tuple[ContractState, ...]:
    """States in which the other side answers what I sent without waiting for anything: a call to an optimisation may
    wait until its contractor is idle, and a bid for the bids of others."""
    if contract.manager != me:
        return (ContractState.BID,) if contract.operation in _FOR_ITSELF else ()
    return (ContractState.AWARDED,) if contract.operation is OperationKind.DOPT else _OWED[:2]
