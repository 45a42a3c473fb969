"""A method that knows edges only, with priors: runs of it, and rounds of sums in between.

A prior is an edge from the frame that it is measured in, the origin, which no robot has. Where the origin lies among
the group's poses is found from sums over all priors, which go up the tree of members. In the next run of the method
each robot holds its own poses to where its priors then are: nothing of them is sent, no node is given, and the group
moves as a whole, too. In the end all goes back rigidly to where the anchor's first node stood.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import Any, Protocol

from maslam._replaced import replaced

from ...config import SolverConfig
from ...errors import BackendError
from ..share import Share, SolverOutcome
from .course import Course, Next, PriorSums, WhatNext
from .in_run import InRun
from .prior_messages import PriorKind, PriorMessage, body_of, numbers_in
from .prior_part import PriorPart

# Tolerance of the costs, and most sweeps of block descent, where priors are to be laid on a solution.
_ROUGH, _ROUGH_SWEEPS = 0.01, 30


class _Method(Protocol):
    """A node of the method."""

    outcome: SolverOutcome | None

    def start(self) -> Sequence[Any]: ...
    def handle(self, message: Any) -> Sequence[Any]: ...
    def tick(self) -> Sequence[Any]: ...
    def again(self, message: Any) -> Sequence[Any]: ...


class PriorNode:
    """Call ``start()`` once, then ``handle`` with every message addressed to it, in any order; send what they return.

    ``outcome`` is None while it works. Repeated messages do no harm. ``tick()`` returns again what others may have
    missed, also after the end.
    """

    def __init__(self, share: Share, config: SolverConfig, method: Callable[[Share, SolverConfig], _Method]) -> None:
        """``method`` makes a node of it, which knows no priors but held ones."""
        self.share = share
        self.outcome: SolverOutcome | None = None
        self._config, self._method = config, method
        self._part = PriorPart(share)
        rank = share.members.index(share.robot)
        self._parent = share.members[(rank - 1) // 2] if rank else None
        self._children = [share.members[c] for c in (2 * rank + 1, 2 * rank + 2) if c < len(share.members)]
        self._course = Course(share, config.start == "warm", config.robust != "none") if self._parent is None else None
        self._number = self._run = 0
        self._last: Next | None = None
        self._running: _Method | None = None
        self._before: SolverOutcome | None = None
        self._tallies: dict[int, dict[int, PriorSums]] = {}
        self._decisions: dict[int, Next] = {}
        self._early: dict[int, list[InRun]] = {}
        self._reported = False
        self._kept: dict[int, list[PriorMessage]] = {}

    # -- what happens to it ------------------------------------------------------------------------------------------

    def start(self) -> list[PriorMessage | InRun]:
        """Return the first messages."""
        return self._advance()

    def handle(self, message: PriorMessage | InRun) -> list[PriorMessage | InRun]:
        """Receive a message; returns the messages to send because of it."""
        me = self.share.robot
        if not isinstance(message, PriorMessage | InRun):
            raise BackendError(f"robot {me} was handed a message of another method")
        if message.receiver != me or message.sender not in self.share.members:
            raise BackendError(f"robot {me} was handed a message from {message.sender} for {message.receiver}")
        if isinstance(message, InRun):
            return self._take_in_run(message)
        known = self._children if message.kind is PriorKind.SUMS else [self._parent]
        if message.sender not in known:
            raise BackendError(f"robot {message.sender} is not next to robot {me} in the tree of members")
        if self.outcome is not None or message.number < self._number:
            return []
        numbers = numbers_in(message.body)
        if message.kind is PriorKind.SUMS:
            self._tallies.setdefault(message.number, {})[message.sender] = PriorSums.of(numbers)
        else:
            self._decisions[message.number] = Next.of(numbers)
        return self._advance()

    def tick(self) -> list[PriorMessage | InRun]:
        """Return again what others may have missed."""
        out: list[PriorMessage | InRun] = [m for n in sorted(self._kept) for m in self._kept[n]]
        if self._running is not None and self.outcome is None:
            out += self._wrapped(self._running.tick())
        return out

    def again(self, message: PriorMessage | InRun) -> list[PriorMessage | InRun]:
        """What the sender of a message that came before may have missed."""
        if isinstance(message, InRun):
            here = self._running is not None and message.run == self._run
            return self._wrapped(self._running.again(message.message)) if here and self._running else []
        if message.kind is PriorKind.NEXT:
            return []
        return [
            m for n, kept in self._kept.items() if n >= message.number for m in kept if m.receiver == message.sender
        ]

    # -- runs of the method ------------------------------------------------------------------------------------------

    def _take_in_run(self, message: InRun) -> list[PriorMessage | InRun]:
        if self.outcome is not None or message.run < self._run:
            return []
        if message.run > self._run or self._running is None:
            if message.run > self._run + 1:
                raise BackendError(f"robot {message.sender} is {message.run - self._run} runs ahead")
            self._early.setdefault(message.run, []).append(message)
            return []
        out = self._wrapped(self._running.handle(message.message))
        return [*out, *self._advance()]

    def _wrapped(self, messages: Iterable[Any]) -> list[PriorMessage | InRun]:
        return [InRun(self._run, m) for m in messages]

    def _begin(self, step: Next) -> list[PriorMessage | InRun]:
        config = self._config_for(step.then)
        self._running, self._before = self._method(self._part.share_of(step), config), None
        self._run += 1
        out = self._wrapped(self._running.start())
        for message in self._early.pop(self._run, []):
            out += self._wrapped(self._running.handle(message.message))
        return out

    def _config_for(self, then: WhatNext) -> SolverConfig:
        """Where priors are to be laid on a solution, that need not be exact."""
        config = self._config
        if then is WhatNext.RUN:
            return replaced(config, start="warm")
        if then is WhatNext.ALONE:
            return config
        return replaced(
            config,
            cost_tolerance=max(config.cost_tolerance, _ROUGH),
            two_level_tolerance=max(config.two_level_tolerance, _ROUGH),
            descent_sweeps=min(config.descent_sweeps, _ROUGH_SWEEPS),
        )

    # -- rounds of sums ----------------------------------------------------------------------------------------------

    def _advance(self) -> list[PriorMessage | InRun]:
        """Do everything that can be done with what was received."""
        out: list[PriorMessage | InRun] = []
        while self.outcome is None:
            if self._running is not None and self._before is None:
                if self._running.outcome is None:
                    break
                self._before = self._running.outcome
                self._part.take(self._before)
            below = self._tallies.get(self._number, {})
            if not self._reported:
                if any(c not in below for c in self._children):
                    break
                out += self._report(below)
            step = self._decisions.get(self._number)
            if step is None:
                break
            out += self._follow(step)
        return out

    def _report(self, below: dict[int, PriorSums]) -> list[PriorMessage | InRun]:
        tally = self._part.tally(self._last)
        for child in self._children:
            tally = tally.also(below[child])
        self._reported = True
        if self._course is not None:
            self._decisions[self._number] = self._course.after(tally, self._before)
            return []
        assert self._parent is not None
        return self._emit([(self._parent, PriorKind.SUMS, tally.numbers())])

    def _follow(self, step: Next) -> list[PriorMessage | InRun]:
        out = self._emit([(c, PriorKind.NEXT, step.numbers()) for c in self._children])
        if self._parent is None:
            # As the others read it.
            step = Next.of(step.numbers())
        self._tallies.pop(self._number, None)
        self._decisions.pop(self._number, None)
        self._number, self._reported, self._last = self._number + 1, False, step
        if step.then.without or step.then is WhatNext.RUN:
            return [*out, *self._begin(step)]
        if step.then is not WhatNext.ALIGN:
            assert self._before is not None
            whole = step.then is WhatNext.END
            self.outcome = self._part.ended(step, self._before) if whole else self._before
        return out

    def _emit(self, bodies: Sequence[tuple[int, PriorKind, Any]]) -> list[PriorMessage | InRun]:
        me, number = self.share.robot, self._number
        messages = [PriorMessage(kind, number, me, r, body_of(numbers)) for r, kind, numbers in bodies]
        self._kept.setdefault(number, []).extend(messages)
        for old in [n for n in self._kept if n < number - 1]:
            del self._kept[old]
        return list(messages)
