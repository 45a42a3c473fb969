"""One robot's part in a distributed pose-graph optimisation: a state machine without I/O.

It holds its own poses and edges, and of its neighbours only the separator poses they send. The same code runs in one
process, in tests that lose or repeat messages, and over a network.

A round is: hear what the sweep needs (Gauss-Seidel: this sweep's values of lower robots; Jacobi: none), solve, send
the separators, hear all neighbours, report up a binary tree over the members, get the decision down the same tree. So
every member knows at the same sweep that all of them changed by less than the threshold, and no member decides for
others by looking into them.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from backend.config import SolverConfig
from backend.distributed.gauss_seidel import Relaxation
from backend.distributed.local import LocalProblem, scale_stage
from backend.distributed.messages import WIDTH, Decision, Message, Report, Round, Stage, Values
from backend.distributed.share import Outcome, Share
from backend.errors import BackendError
from backend.geometry import Array


class Node:
    """``start()`` once, then ``handle`` every message addressed to it, in any order; what these return is to be sent.

    ``outcome`` is None while it works. Messages that come twice or too early do no harm; one that contradicts its
    graph raises :class:`BackendError`. ``tick()`` gives again what others may have missed: for transports that lose
    messages, also after the end.
    """

    def __init__(self, share: Share, config: SolverConfig) -> None:
        self.share = share
        self.outcome: Outcome | None = None
        self._config = config
        self._problem = LocalProblem(share)
        self._scales = dict.fromkeys((share.robot, *share.neighbours), 1.0)
        self._stage: Relaxation | None = None
        self._reached = np.zeros(len(self._problem.nodes), dtype=bool)
        self._round = Round(Stage.SCALE if share.arbitrary_scale else Stage.START)
        self._warm = config.start == "warm"
        self._solved = self._reported = False
        self._change = 0.0
        self._cost_before = 0.0
        self._sweeps = {Stage.ROTATION: 0, Stage.POSE: 0}
        self._values: dict[Round, dict[int, Array]] = {}
        self._reports: dict[Round, dict[int, Report]] = {}
        self._decisions: dict[Round, Decision] = {}
        self._recent: dict[Round, list[Message]] = {}
        rank = share.members.index(share.robot)
        self._parent = share.members[(rank - 1) // 2] if rank else None
        self._children = [share.members[c] for c in (2 * rank + 1, 2 * rank + 2) if c < len(share.members)]

    def start(self) -> list[Message]:
        """The first messages."""
        self._enter()
        return self._advance()

    def handle(self, message: Message) -> list[Message]:
        """Take a message in; returns what is to be sent because of it."""
        if message.receiver != self.share.robot:
            raise BackendError(f"robot {self.share.robot} was handed a message for robot {message.receiver}")
        if self.outcome is not None or message.round < self._round:
            return []
        match message:
            case Values():
                self._check(message)
                self._values.setdefault(message.round, {})[message.sender] = message.values
            case Report():
                self._check_tree(message.sender, self._children)
                self._reports.setdefault(message.round, {})[message.sender] = message
            case Decision():
                self._check_tree(message.sender, [self._parent])
                self._decisions[message.round] = message
        return self._advance()

    def tick(self) -> list[Message]:
        """The messages of the last two rounds once more."""
        return [m for r in sorted(self._recent) for m in self._recent[r]]

    def _check_tree(self, sender: int, allowed: Sequence[int | None]) -> None:
        if sender not in allowed:
            raise BackendError(f"robot {sender} is not next to robot {self.share.robot} in the tree of members")

    def _check(self, message: Values) -> None:
        heard = self._problem.heard_rows.get(message.sender)
        if heard is None:
            raise BackendError(
                f"robot {self.share.robot} shares no edge with robot {message.sender}, which sent it poses"
            )
        expected = (1 if message.round.stage is Stage.SCALE else len(heard), WIDTH[message.round.stage])
        if message.values.shape != expected and len(message.values):
            raise BackendError(
                f"robot {message.sender} sent {message.values.shape} values to robot {self.share.robot}, "
                f"which expected {expected}: the two hold different edges between them"
            )

    def _advance(self) -> list[Message]:
        """Do everything that can be done with what has been heard."""
        out: list[Message] = []
        while self.outcome is None:
            progress = self._try_solve() or self._try_report() or self._try_decide()
            if progress is None:
                break
            out += progress
        return out

    def _emit(self, messages: Sequence[Message]) -> list[Message]:
        for message in messages:
            self._recent.setdefault(message.round, []).append(message)
        for old in sorted(self._recent)[:-2]:
            del self._recent[old]
        return list(messages)

    def _enter(self) -> None:
        """Set up the stage that the current round begins."""
        stage, problem = self._round.stage, self._problem
        if stage is Stage.SCALE:
            self._stage = scale_stage(self.share)
        elif stage is Stage.ROTATION:
            self._stage = problem.rotation_stage(self._warm)
        elif stage is Stage.POSE:
            self._stage = problem.pose_stage(self._reached, self._warm or self._round.step > 0)
        else:
            self._stage = None

    def _awaited(self) -> list[int]:
        """Neighbours whose values complete the round."""
        if self._round.stage is Stage.COST:
            return []
        # To count the cost once, the lower of two robots must know the higher one's poses.
        higher_only = self._round.stage is Stage.START and not self._warm
        return [n for n in self.share.neighbours if n > self.share.robot or not higher_only]

    def _try_solve(self) -> list[Message] | None:
        """The sweep itself, once what it needs is there; sends the separators."""
        if self._solved:
            return None
        heard = self._values.get(self._round, {})
        if self._stage is not None:
            if self._config.method != "jor":
                lower = [n for n in self.share.neighbours if n < self.share.robot]
                if any(n not in heard for n in lower):
                    return None
                for neighbour in lower:
                    self._hear(neighbour, heard[neighbour])
            self._change = self._stage.sweep(self._relaxation())
        self._solved = True
        match self._round.stage:
            case Stage.COST:
                receivers = []
            case Stage.START:
                receivers = [n for n in self.share.neighbours if n < self.share.robot or self._warm]
            case _:
                receivers = self.share.neighbours
        return self._emit([Values(self.share.robot, n, self._round, self._say(n)) for n in receivers])

    def _relaxation(self) -> float:
        if self._round.stage is Stage.SCALE or self._config.method == "dgs":
            return 1.0
        return self._config.relaxation if self._config.method == "sor" else min(self._config.relaxation, 1.0)

    def _try_report(self) -> list[Message] | None:
        """Once the sweep is done here, at every neighbour and below in the tree: pass the sum up."""
        heard, below = self._values.get(self._round, {}), self._reports.get(self._round, {})
        if not self._solved or self._reported:
            return None
        if any(n not in heard for n in self._awaited()) or any(c not in below for c in self._children):
            return None
        for neighbour in self._awaited():
            self._hear(neighbour, heard[neighbour])
        self._reported = True
        cost = self._problem.cost() if self._round.stage in (Stage.START, Stage.COST) else 0.0
        change = max([self._change, *(below[c].change for c in self._children)])
        cost += sum(below[c].cost for c in self._children)
        if self._parent is not None:
            return self._emit([Report(self.share.robot, self._parent, self._round, change, cost)])
        go_on = self._another_sweep(change)
        self._decisions[self._round] = Decision(self.share.robot, self.share.robot, self._round, go_on, cost)
        return []

    def _another_sweep(self, change: float) -> bool:
        limits = {
            Stage.SCALE: (self._config.scale_sweeps, self._config.scale_threshold),
            Stage.ROTATION: (self._config.rotation_sweeps, self._config.rotation_threshold),
            Stage.POSE: (self._config.pose_sweeps, self._config.pose_threshold),
        }
        if self._round.stage not in limits:
            return False
        sweeps, threshold = limits[self._round.stage]
        return self._round.sweep + 1 < sweeps and change >= threshold

    def _try_decide(self) -> list[Message] | None:
        """Pass the decision down and go to the next round."""
        decision = self._decisions.get(self._round)
        if decision is None or not self._reported:
            return None
        me = self.share.robot
        out = self._emit([Decision(me, c, self._round, decision.go_on, decision.cost) for c in self._children])
        if self._round.stage in self._sweeps:
            self._sweeps[self._round.stage] += 1
        if decision.go_on:
            self._round = Round(self._round.stage, self._round.step, self._round.sweep + 1)
        else:
            self._leave(decision)
            self._enter()
        self._solved = self._reported = False
        self._change = 0.0
        self._values.pop(decision.round, None)
        self._reports.pop(decision.round, None)
        self._decisions.pop(decision.round, None)
        return out

    def _leave(self, decision: Decision) -> None:
        """Take the finished stage's result over and name the next round."""
        problem, stage = self._problem, self._stage
        match self._round.stage:
            case Stage.SCALE:
                assert stage is not None
                logs = np.nan_to_num(stage.values[:, 0, 0])
                self._scales = dict(zip(self._scales, np.exp(logs).tolist(), strict=True))
                problem.rescale(self._scales)
                self._round = Round(Stage.START)
            case Stage.START:
                self._cost_before = decision.cost
                self._before = problem.poses[: problem.own_count].copy()
                self._round = Round(Stage.ROTATION)
            case Stage.ROTATION:
                assert stage is not None
                self._reached = stage.known()
                problem.take_rotations(stage)
                self._round = Round(Stage.POSE)
            case Stage.POSE:
                assert stage is not None
                problem.take_poses(stage)
                last = self._round.step + 1 == self._config.newton_steps
                self._round = Round(Stage.COST) if last else Round(Stage.POSE, self._round.step + 1)
            case Stage.COST:
                self.outcome = self._finish(decision.cost)

    def _finish(self, cost_after: float) -> Outcome:
        problem = self._problem
        own = problem.nodes[: problem.own_count]
        accepted = cost_after <= self._cost_before
        reason = "accepted" if accepted else f"the cost would rise: {self._cost_before:.6g} to {cost_after:.6g}"
        poses = problem.poses[: problem.own_count] if accepted else self._before
        return Outcome(
            robot=self.share.robot,
            accepted=accepted,
            reason=reason,
            poses={n: poses[k].copy() for k, n in enumerate(own)},
            scales=dict(self._scales),
            cost_before=self._cost_before,
            cost_after=cost_after if accepted else self._cost_before,
            rotation_sweeps=self._sweeps[Stage.ROTATION],
            pose_sweeps=self._sweeps[Stage.POSE],
            unreached=tuple(n for k, n in enumerate(own) if not self._reached[k]),
        )

    def _say(self, neighbour: int) -> Array:
        """The separators' values of this round, as :class:`Values` carries them."""
        if self._round.stage is Stage.START:
            return self._problem.separator_poses(neighbour)
        assert self._stage is not None
        rows = [0] if self._round.stage is Stage.SCALE else self._problem.sent_rows[neighbour]
        values = self._stage.values[rows]
        if self._round.stage is Stage.ROTATION:
            values = np.swapaxes(values, 1, 2)
        flat = values.reshape(len(rows), WIDTH[self._round.stage])
        return flat.copy() if np.isfinite(flat).any() else flat[:0].copy()

    def _hear(self, neighbour: int, values: Array) -> None:
        """Inverse of :meth:`_say`."""
        if not len(values):
            return
        if self._round.stage is Stage.START:
            self._problem.hear_poses(neighbour, values)
            return
        assert self._stage is not None
        if self._round.stage is Stage.SCALE:
            self._stage.values[1 + self.share.neighbours.index(neighbour)] = values.reshape(1, 1)
        elif self._round.stage is Stage.ROTATION:
            self._stage.values[self._problem.heard_rows[neighbour]] = np.swapaxes(values.reshape(-1, 3, 3), 1, 2)
        else:
            self._stage.values[self._problem.heard_rows[neighbour]] = values[:, :, None]
