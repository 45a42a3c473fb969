"""Synchronous rounds of a whole group: the part of a solver node that knows messages and nothing of poses.

A round: receive the input of the work (Gauss-Seidel: this round's values of lower robots; Jacobi: none), work, send the
separators, receive those of all neighbours, report up a binary tree over the members, receive the decision down the
same tree. So every member knows at the same round what all of them found, and no member decides for others by looking
into them.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence

from ..errors import BackendError
from .messages import Coded, Decision, Deltas, NodeMessage, Report, RoundWait, Values, Wanted, wanted_as
from .share import Share, SolverOutcome
from .solver_stage import Round, width_of

Separators = Values | Deltas | Coded


class Rounds(ABC):
    """A solver node that works in rounds.

    Call ``start()`` once, then ``handle`` with every message addressed to it, in any order; send the messages that they
    return. ``outcome`` is None while it works. Repeated and early messages do no harm; one that contradicts its graph
    raises :class:`BackendError`. ``tick()`` asks for what has not come, in a byte, and only that is sent again, also
    after the end: for transports that lose messages.
    """

    # Rounds with messages that others may still lack.
    _ROUNDS_KEPT = 2
    # Rounds to come with messages that are kept.
    _ROUNDS_AHEAD = 256

    def __init__(self, share: Share, first: Round) -> None:
        self.share = share
        self.outcome: SolverOutcome | None = None
        self._round = first
        self._solved = self._reported = False
        self._silent = 0
        self._change = 0.0
        self._received: dict[Round, dict[int, Separators]] = {}
        self._reports: dict[Round, dict[int, Report]] = {}
        self._decisions: dict[Round, Decision] = {}
        self._recent: dict[Round, list[NodeMessage]] = {}
        self._expected = {n: len(share.separators_with(n)[1]) for n in share.neighbours}
        rank = share.members.index(share.robot)
        self._parent = share.members[(rank - 1) // 2] if rank else None
        self._children = [share.members[c] for c in (2 * rank + 1, 2 * rank + 2) if c < len(share.members)]

    # -- supplied by a method ----------------------------------------------------------------------------------------

    @abstractmethod
    def _enter(self) -> None:
        """Set up the stage that the current round begins."""

    @abstractmethod
    def _work(self) -> float:
        """This round's work; returns by how much things changed, infinite if a pose got its first estimate."""

    @abstractmethod
    def _say(self, neighbour: int) -> Separators:
        """The separators for this neighbour after the work."""

    @abstractmethod
    def _receive(self, neighbour: int, message: Separators) -> None:
        """Inverse of :meth:`_say` at the other side."""

    @abstractmethod
    def _found(self) -> tuple[float, tuple[float, ...]]:
        """This robot's part of the group's cost and of its sums, once all neighbours' values are received."""

    @abstractmethod
    def _decide(self, change: float, cost: float, numbers: tuple[float, ...]) -> Decision:
        """At the root only: what follows from the group's largest change, its cost and its sums."""

    @abstractmethod
    def _leave(self, decision: Decision) -> None:
        """Act on a decision that ends the stage, and name the next round (or set the outcome)."""

    def _stay(self, decision: Decision) -> None:  # noqa: B027  # most stages have nothing to do
        """Act on a decision that goes on with the stage."""

    def _by_tree(self) -> bool:
        """Whether members agree on what follows; else each knows it by itself."""
        return True

    def _alone(self) -> Decision:
        """What follows a round without agreement."""
        return Decision(self.share.robot, self.share.robot, self._round, True, 0.0)

    def _waits_for_lower(self) -> bool:
        """Whether the work needs this round's values of lower neighbours."""
        return False

    def _receivers(self) -> list[int]:
        """Neighbours that get this round's separators."""
        return self.share.neighbours

    def _awaited(self) -> list[int]:
        """Neighbours whose separators complete the round."""
        return self.share.neighbours

    def _follows(self) -> bool:
        """Whether what this robot waits for is sent once others' messages are received there: a decision."""
        return self._reported

    # -- what happens to it ------------------------------------------------------------------------------------------

    def start(self) -> list[NodeMessage]:
        """Return the first messages."""
        self._enter()
        return self._advance()

    def handle(self, message: NodeMessage) -> list[NodeMessage]:
        """Receive a message; returns the messages to send because of it."""
        if not isinstance(message, NodeMessage):
            raise BackendError(f"robot {self.share.robot} was handed a message of another method")
        if message.receiver != self.share.robot:
            raise BackendError(f"robot {self.share.robot} was handed a message for robot {message.receiver}")
        if isinstance(message, RoundWait):
            return self._answer(message)
        if self.outcome is not None or message.round < self._round:
            return []
        match message:
            case Values() | Deltas() | Coded():
                self._check(message)
                self._check_near(message.round, self._received)
                self._received.setdefault(message.round, {})[message.sender] = message
            case Report():
                self._check_tree(message.sender, self._children)
                self._check_near(message.round, self._reports)
                self._reports.setdefault(message.round, {})[message.sender] = message
            case Decision():
                self._check_tree(message.sender, [self._parent])
                self._decisions[message.round] = message
        return self._advance()

    def _check_near(self, round_: Round, kept: Mapping[Round, object]) -> None:
        """A neighbour is a few rounds ahead at most; what it sends of many more is not kept."""
        if len(kept) >= self._ROUNDS_AHEAD and round_ not in kept and round_ != self._round:
            raise BackendError(f"robot {self.share.robot} was handed messages of too many rounds to come")

    def tick(self) -> list[NodeMessage]:
        """Ask for what has not come; for what follows from others' messages not the first time: it is they who lack
        something as a rule."""
        if self.outcome is not None:
            return []
        self._silent += 1
        missing = {} if self._silent == 1 and self._follows() else self._missing()
        return [RoundWait(self.share.robot, robot, self._round, kinds) for robot, kinds in sorted(missing.items())]

    def again(self, message: NodeMessage) -> list[NodeMessage]:
        """What the sender of a message that came before may have missed: it asks for that, nothing else tells."""
        return self._answer(message) if isinstance(message, RoundWait) else []

    def _missing(self) -> dict[int, Wanted]:
        """What this round waits for, by who sends it."""
        received, below = self._received.get(self._round, {}), self._reports.get(self._round, {})
        if self._reported:
            return {} if self._parent is None else {self._parent: Wanted.DECISION}
        awaited = [n for n in self._awaited() if self._solved or n < self.share.robot]
        out = {n: Wanted.SEPARATORS for n in awaited if n not in received}
        for child in self._children if self._solved and self._by_tree() else []:
            if child not in below:
                out[child] = out.get(child, Wanted(0)) | Wanted.REPORT
        return out

    def _answer(self, message: RoundWait) -> list[NodeMessage]:
        """What its sender lacks, if it was sent before; else this robot asks for what it lacks in its own time."""
        kept = self._recent.get(message.round, [])
        return [m for m in kept if m.receiver == message.sender and wanted_as(m) & message.wanted]

    def _width(self) -> int:
        """Numbers of a separator in this round."""
        return width_of(self._round.stage, self.share.scaled)

    def _check_tree(self, sender: int, allowed: Sequence[int | None]) -> None:
        if sender not in allowed:
            raise BackendError(f"robot {sender} is not next to robot {self.share.robot} in the tree of members")

    def _check(self, message: Separators) -> None:
        if message.sender not in self._expected:
            raise BackendError(
                f"robot {self.share.robot} shares no edge with robot {message.sender}, which sent it poses"
            )
        stage, rows = message.round.stage, self._expected[message.sender]
        if isinstance(message, Coded):
            raise BackendError(f"robot {message.sender} sent coded numbers, which this method has none of")
        values = message.values if isinstance(message, Values) else message.steps
        expected = (rows, width_of(stage, self.share.scaled))
        if values.shape != expected and (len(values) or isinstance(message, Deltas)):
            raise BackendError(
                f"robot {message.sender} sent {values.shape} values to robot {self.share.robot}, "
                f"which expected {expected}: the two hold different edges between them"
            )

    # -- one round ---------------------------------------------------------------------------------------------------

    def _advance(self) -> list[NodeMessage]:
        """Do everything that can be done with the values received."""
        out: list[NodeMessage] = []
        while self.outcome is None:
            progress = self._try_work()
            if progress is None:
                progress = self._try_report()
            if progress is None:
                progress = self._try_decide()
            if progress is None:
                break
            out += progress
        return out

    def _emit(self, messages: Sequence[NodeMessage]) -> list[NodeMessage]:
        self._silent = 0
        for message in messages:
            self._recent.setdefault(message.round, []).append(message)
        for old in sorted(self._recent)[: -self._ROUNDS_KEPT]:
            del self._recent[old]
        return list(messages)

    def _try_work(self) -> list[NodeMessage] | None:
        """The work itself, once what it needs is there; sends the separators."""
        if self._solved:
            return None
        if self._waits_for_lower():
            received = self._received.get(self._round, {})
            lower = [n for n in self.share.neighbours if n < self.share.robot]
            if any(n not in received for n in lower):
                return None
            for neighbour in lower:
                self._receive(neighbour, received[neighbour])
        self._change = self._work()
        self._solved = True
        return self._emit([self._say(n) for n in self._receivers()])

    def _try_report(self) -> list[NodeMessage] | None:
        """Once the work is done here, at every neighbour and below in the tree: pass the sums up."""
        received, below = self._received.get(self._round, {}), self._reports.get(self._round, {})
        if not self._solved or self._reported:
            return None
        children = self._children if self._by_tree() else []
        if any(n not in received for n in self._awaited()) or any(c not in below for c in children):
            return None
        for neighbour in self._awaited():
            if not (self._waits_for_lower() and neighbour < self.share.robot):
                self._receive(neighbour, received[neighbour])
        self._reported = True
        if not self._by_tree():
            self._decisions[self._round] = self._alone()
            return []
        cost, numbers = self._found()
        reports = [below[c] for c in self._children]
        change = max([self._change, *(r.change for r in reports)])
        cost += sum(r.cost for r in reports)
        numbers = self._together(numbers, [r.numbers for r in reports])
        if self._parent is not None:
            return self._emit([Report(self.share.robot, self._parent, self._round, change, cost, numbers)])
        self._decisions[self._round] = self._decide(change, cost, numbers)
        return []

    def _together(self, mine: tuple[float, ...], others: Sequence[tuple[float, ...]]) -> tuple[float, ...]:
        """What goes up the tree of this robot's numbers and those from below: their sums."""
        if any(len(numbers) != len(mine) for numbers in others):
            raise BackendError(f"robot {self.share.robot} was sent other sums than it has itself")
        return tuple(sum(column) for column in zip(mine, *others, strict=True))

    def _try_decide(self) -> list[NodeMessage] | None:
        """Pass the decision down and go to the next round."""
        decision = self._decisions.get(self._round)
        if decision is None or not self._reported:
            return None
        me = self.share.robot
        passed = (decision.round, decision.go_on, decision.cost, decision.numbers)
        children = self._children if self._by_tree() else []
        out = self._emit([Decision(me, c, *passed) for c in children])
        if decision.go_on:
            self._stay(decision)
            self._round = Round(self._round.stage, self._round.step, self._round.sweep + 1)
        else:
            self._leave(decision)
            self._enter()
        self._solved = self._reported = False
        self._change = 0.0
        self._received.pop(decision.round, None)
        self._reports.pop(decision.round, None)
        self._decisions.pop(decision.round, None)
        return out
