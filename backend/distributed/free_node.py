"""Block-coordinate descent without rounds: every robot works when it is ticked, with the values received so far.

States carry versions and replace each other, so late, lost, repeated and disordered messages only delay. A robot is
quiet when its block step, given the newest versions it has of its neighbours, moves no separator by more than a
threshold; it then stands still until a neighbour's newer version arrives. Standings go up the tree of members. When
the latest standings of all are quiet and name each other's versions, nobody can move any more: a first one to move
would have needed a version that nobody has made. So the root's decision finds all in the state that they reported.
"""

from __future__ import annotations

import numpy as np

from ..config import SolverConfig
from ..errors import BackendError
from ..geometry import Array
from .descent_node import DescentNode
from .messages import Decision, NodeMessage, RoundWait, SeparatorState, Standing, Status, Wanted
from .places import Places, moved, places_of
from .share import Share
from .solver_stage import Round, SolverStage, number_type

# Ticks between sending again what nobody has confirmed.
_PATIENCE = 3
# Neighbours that step at the same time overshoot together.
_RELAXATION = 0.85
# Without new values, a step that is only what the last one left out is not worth a message.
_LEFTOVER = 0.3
# Steps at most in which only poses move that no neighbour sees.
_MOST_IDLE = 20
_HERE = Round(SolverStage.FREE)


class FreeNode(DescentNode):
    """Riemannian block-coordinate descent, asynchronous; its owner calls :meth:`tick` periodically. At rest, a few
    accelerated rounds finish the slow end of plain descent."""

    def __init__(self, share: Share, config: SolverConfig) -> None:
        super().__init__(share, config)
        self._latest: dict[int, SeparatorState] = {}
        self._used = dict.fromkeys(share.neighbours, 0)
        self._confirmed = dict.fromkeys(share.neighbours, 0)
        self._sent_at = dict.fromkeys(share.neighbours, -_PATIENCE)
        self._owed: set[int] = set()
        self._version = self._ticks = 0
        self._quiet = False
        self._shift, self._idle = 0.0, 0
        self._standings: dict[int, Standing] = {}
        self._status_at = -_PATIENCE
        self._reported_up: tuple[Standing, ...] = ()

    def _after_start(self) -> Round:
        super()._after_start()
        self._metric = self._descent.metric()
        return _HERE

    # -- messages ----------------------------------------------------------------------------------------------------

    def handle(self, message: NodeMessage) -> list[NodeMessage]:
        """Receive a message; returns the messages to send because of it."""
        if not isinstance(message, NodeMessage):
            raise BackendError(f"robot {self.share.robot} was handed a message of another method")
        if not isinstance(message, SeparatorState | Status):
            return super().handle(message)
        if message.receiver != self.share.robot:
            raise BackendError(f"robot {self.share.robot} was handed a message for robot {message.receiver}")
        if isinstance(message, Status):
            self._check_tree(message.sender, self._children)
            for standing in message.standings:
                self._note(standing)
        else:
            self._take(message)
        return [] if self.outcome is not None else self._advance()

    def _take(self, state: SeparatorState) -> None:
        expected = self._expected.get(state.sender)
        if expected is None:
            raise BackendError(
                f"robot {self.share.robot} shares no edge with robot {state.sender}, which sent it poses"
            )
        if len(state.values) not in (0, expected):
            raise BackendError(
                f"robot {state.sender} sent {len(state.values)} poses to robot {self.share.robot}, "
                f"which expected {expected}: the two hold different edges between them"
            )
        self._confirmed[state.sender] = max(self._confirmed[state.sender], state.used)
        if len(state.values):
            self._owed.add(state.sender)
            known = self._latest.get(state.sender)
            if known is None or state.version > known.version:
                self._latest[state.sender] = state

    def _note(self, standing: Standing) -> None:
        known = self._standings.get(standing.robot)
        if known is None or standing.serial > known.serial:
            self._standings[standing.robot] = standing

    def tick(self) -> list[NodeMessage]:
        """Work with the values received; returns the messages that neighbours have not confirmed."""
        if self.outcome is not None or self._round != _HERE:
            return super().tick()
        self._ticks += 1
        self._step()
        return [*self._advance(), *self._states(), *self._status()]

    # -- work --------------------------------------------------------------------------------------------------------

    def _step(self) -> None:
        newer = [n for n in sorted(self._latest) if self._latest[n].version > self._used[n]]
        for neighbour in newer:
            self._adopt(neighbour, self._latest[neighbour])
        if self._quiet and not newer:
            return
        descent, places = self._descent, self._problem.places
        public = places.at(descent.shared)
        new = descent.place() or (self._version == 0 and bool(descent.placed[: self._problem.own_count].any()))
        own = slice(self._problem.own_count)
        inner = places.at(own)
        descent.sweep(_RELAXATION if newer else 1.0)
        shift = self._largest(public, places.at(descent.shared), self._metric[descent.shared])
        limit = self._config.free_threshold
        may_move = self._version < self._config.descent_sweeps
        if new or (shift > (limit if newer else max(limit, _LEFTOVER * self._shift)) and may_move):
            self._values = descent.round_to_numbers(number_type(SolverStage.FREE))
            self._version += 1
            self._shift = shift
            self._sent_at = dict.fromkeys(self._sent_at, self._ticks - _PATIENCE)
            self._quiet, self._idle = False, 0
        else:
            # Its inside may go on settling where nobody sees it.
            places.put(descent.shared, public)
            self._idle += 1
            change = self._largest(inner, places.at(own), self._metric)
            self._quiet = change <= limit or self._idle > _MOST_IDLE
        self._stand()

    @staticmethod
    def _largest(before: Places, after: Places, metric: Array) -> float:
        """The largest move, in standard deviations."""
        return float(np.abs(np.nan_to_num(moved(before, after, metric.shape[1])) * metric).max(initial=0.0))

    def _adopt(self, neighbour: int, state: SeparatorState) -> None:
        rows = np.array(self._problem.received_rows[neighbour], dtype=np.intp)
        known = np.isfinite(state.values).all(axis=1)
        self._problem.places.put(rows[known], places_of(state.values[known]))
        self._descent.placed[rows[known]] = True
        self._used[neighbour] = state.version

    def _stand(self) -> None:
        me = self.share.robot
        known = self._standings.get(me)
        serial = known.serial + 1 if known else 1
        self._standings[me] = Standing(me, serial, self._version, self._quiet, tuple(sorted(self._used.items())))

    def _states(self) -> list[NodeMessage]:
        """To each neighbour that lacks the newest version or a confirmation."""
        out: list[NodeMessage] = []
        shared, nothing = self._descent.shared, np.zeros((0, 6))
        for neighbour in self.share.neighbours:
            late = self._ticks - self._sent_at[neighbour] >= _PATIENCE
            whole = self._version > self._confirmed[neighbour] and late
            if not whole and neighbour not in self._owed:
                continue
            rows = np.searchsorted(shared, self._problem.sent_rows[neighbour])
            values = self._values[rows] if whole else nothing
            if whole:
                self._sent_at[neighbour] = self._ticks
            out.append(SeparatorState(self.share.robot, neighbour, _HERE, self._version, self._used[neighbour], values))
        self._owed.clear()
        return out

    # -- the end -----------------------------------------------------------------------------------------------------

    def _status(self) -> list[NodeMessage]:
        """Up the tree, once all below are quiet; again from time to time, as it may be lost."""
        below = tuple(self._standings[r] for r in sorted(self._standings))
        if self._parent is None or not all(s.quiet for s in below):
            return []
        if below == self._reported_up and self._ticks - self._status_at < _PATIENCE:
            return []
        waiting = below == self._reported_up
        self._reported_up, self._status_at = below, self._ticks
        out: list[NodeMessage] = [Status(self.share.robot, self._parent, _HERE, below)]
        return [*out, RoundWait(self.share.robot, self._parent, _HERE, Wanted.DECISION)] if waiting else out

    def _try_report(self) -> list[NodeMessage] | None:
        if self._round != _HERE:
            return super()._try_report()
        if self._reported:
            return None
        if self._parent is None and self._agreed():
            self._decisions[_HERE] = self._decision(False, 0.0)
        self._reported = _HERE in self._decisions
        return [] if self._reported else None

    def _agreed(self) -> bool:
        """Whether the latest standings of all members are quiet and fit together."""
        standings = self._standings
        if any(m not in standings for m in self.share.members):
            return False
        return all(s.quiet and all(standings[n].version == v for n, v in s.used) for s in standings.values())

    def _leave(self, decision: Decision) -> None:
        if self._round != _HERE:
            super()._leave(decision)
            return
        # Everybody has everybody's newest separators: the rounds go on from there.
        self._sweeps[SolverStage.POSE] = self._version
        self._announced = True
        self._round = Round(SolverStage.DESCENT)

    def _receivers(self) -> list[int]:
        return [] if self._round == _HERE else super()._receivers()

    def _awaited(self) -> list[int]:
        return [] if self._round == _HERE else super()._awaited()
