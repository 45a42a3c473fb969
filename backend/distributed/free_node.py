"""Block-coordinate descent without rounds: every robot works when it is ticked, with whatever it has heard by then.

States carry versions and replace each other, so late, lost, repeated and disordered messages only delay. A robot is
quiet when its block step, given the newest versions it has of its neighbours, moves no separator by more than a
threshold; it then stands still until a neighbour's newer version arrives. Standings go up the tree of members. When
the latest standings of all are quiet and name each other's versions, nobody can move any more: a first one to move
would have needed a version that nobody has made. So the root's decision finds all where they said they were.
"""

from __future__ import annotations

import numpy as np

from backend.config import SolverConfig
from backend.distributed.descent import BlockDescent
from backend.distributed.messages import Decision, Message, Round, Stage, Standing, State, Status, number_type
from backend.distributed.mixing import moved
from backend.distributed.share import Share
from backend.distributed.staged import StagedNode
from backend.errors import BackendError
from backend.geometry import se3, so3_exp

# Ticks between sending again what nobody has confirmed.
_PATIENCE = 3
# Neighbours that step at the same time overshoot together: a little less than the whole step, and some of the last.
_RELAXATION, _MOMENTUM = 0.85, 0.6
_HERE = Round(Stage.FREE)


class FreeNode(StagedNode):
    """Riemannian block-coordinate descent, asynchronous; its owner calls :meth:`tick` again and again (a timer)."""

    _descent: BlockDescent

    def __init__(self, share: Share, config: SolverConfig) -> None:
        super().__init__(share, config)
        self._latest: dict[int, State] = {}
        self._used = dict.fromkeys(share.neighbours, 0)
        self._confirmed = dict.fromkeys(share.neighbours, 0)
        self._sent_at = dict.fromkeys(share.neighbours, -_PATIENCE)
        self._owed: set[int] = set()
        self._arrived: set[int] = set()
        self._version = self._ticks = 0
        self._quiet = False
        self._standings: dict[int, Standing] = {}
        self._status_at = -_PATIENCE
        self._told: tuple[Standing, ...] = ()

    def _after_start(self) -> Round:
        self._elsewhere = self._problem.poses.copy()
        self._descent = BlockDescent(self._problem, self._warm, np.ones(len(self._problem.ends), dtype=bool), None)
        self._metric = self._descent.metric()[self._descent.shared]
        return _HERE

    # -- messages ----------------------------------------------------------------------------------------------------

    def handle(self, message: Message) -> list[Message]:
        if not isinstance(message, State | Status):
            return super().handle(message)
        if message.receiver != self.share.robot:
            raise BackendError(f"robot {self.share.robot} was handed a message for robot {message.receiver}")
        self._arrived.add(message.sender)
        if isinstance(message, Status):
            self._check_tree(message.sender, self._children)
            for standing in message.standings:
                self._note(standing)
        else:
            self._take(message)
        return [] if self.outcome is not None else self._advance()

    def _take(self, state: State) -> None:
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

    def tick(self) -> list[Message]:
        """Work with what has been heard, and say what neighbours have not confirmed."""
        if self.outcome is not None or self._round != _HERE:
            return super().tick()
        self._ticks += 1
        self._step()
        out = [m for m in super().tick() if m.receiver not in self._arrived]
        return [*out, *self._advance(), *self._states(), *self._status()]

    # -- work --------------------------------------------------------------------------------------------------------

    def _step(self) -> None:
        newer = [n for n in sorted(self._latest) if self._latest[n].version > self._used[n]]
        for neighbour in newer:
            self._adopt(neighbour, self._latest[neighbour])
        if self._quiet and not newer:
            return
        descent, poses = self._descent, self._problem.poses
        public = poses[descent.shared].copy()
        new = descent.place() or (self._version == 0 and bool(descent.placed[: self._problem.own_count].any()))
        descent.sweep(_RELAXATION, _MOMENTUM)
        shift = np.abs(np.nan_to_num(moved(public, poses[descent.shared])) * self._metric).max(initial=0.0)
        may_move = self._version < self._config.descent_sweeps
        if new or (shift > self._config.free_threshold and may_move):
            self._values = descent.round_to_numbers(number_type(Stage.FREE))
            self._version += 1
            self._sent_at = dict.fromkeys(self._sent_at, self._ticks - _PATIENCE)
            self._quiet = False
        else:
            poses[descent.shared] = public
            self._quiet = True
        self._stand()

    def _adopt(self, neighbour: int, state: State) -> None:
        rows = np.array(self._problem.heard_rows[neighbour], dtype=np.intp)
        known = np.isfinite(state.values).all(axis=1)
        values = state.values[known]
        self._problem.poses[rows[known]] = se3(so3_exp(values[:, 3:]), values[:, :3])
        self._descent.placed[rows[known]] = True
        self._used[neighbour] = state.version

    def _stand(self) -> None:
        me = self.share.robot
        known = self._standings.get(me)
        serial = known.serial + 1 if known else 1
        self._standings[me] = Standing(me, serial, self._version, self._quiet, tuple(sorted(self._used.items())))

    def _states(self) -> list[Message]:
        """To each neighbour that lacks the newest version or a confirmation."""
        out: list[Message] = []
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
            out.append(State(self.share.robot, neighbour, _HERE, self._version, self._used[neighbour], values))
        self._owed.clear()
        return out

    # -- the end -----------------------------------------------------------------------------------------------------

    def _status(self) -> list[Message]:
        """Up the tree, once all below are quiet; again from time to time, as it may be lost."""
        below = tuple(self._standings[r] for r in sorted(self._standings))
        if self._parent is None or not all(s.quiet for s in below):
            return []
        if below == self._told and self._ticks - self._status_at < _PATIENCE:
            return []
        self._told, self._status_at = below, self._ticks
        return [Status(self.share.robot, self._parent, _HERE, below)]

    def _try_report(self) -> list[Message] | None:
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
        self._sweeps[Stage.POSE] = self._version
        lost = ~self._descent.placed
        self._problem.poses[lost] = self._elsewhere[lost]
        self._reached = self._descent.placed
        self._round = Round(Stage.COST)

    def _receivers(self) -> list[int]:
        return [] if self._round == _HERE else super()._receivers()

    def _awaited(self) -> list[int]:
        return [] if self._round == _HERE else super()._awaited()
