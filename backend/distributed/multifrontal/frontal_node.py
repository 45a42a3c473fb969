"""Exact elimination at one robot: no robot is elected, none sees more than its part and what others share.

All robots eliminate their poses in an agreed order, as a sparse factorisation does (multifrontal; Duff and Reid, 1983;
between robots DDF-SAM, Cunningham et al., IROS 2010): a robot passes on what its poses say about those that it shares
with robots to come, to the first of these, and gets back where these are. The anchor is the last; its way back places
everybody. A pass is a linear problem, exact on any shape; what is sent grows with the square of the poses that robots
share.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ...config import SolverConfig
from ...errors import BackendError
from ...geometry import Array
from ...pose_graph.graph import NodeId
from ..compact import CompactReader, CompactWriter, numbers_of
from ..local import LocalProblem
from ..share import Share, SolverOutcome
from .agreement import read_order, read_pairs, write_order, write_pairs
from .equations import Matrices, StepFrom, Unknowns, shape_of
from .front import Front, neighbours_by_edges
from .frontal_messages import FrontalKind, FrontalMessage
from .ordering import elimination_order
from .passes import Passes
from .reports import Boundary, Step, Sums, Update
from .results import cost_aside, finished, refused
from .schedule import Schedule

# Whole steps that are one standard deviation of the residuals: what their rounding costs is 1e-7 of F.
_FINENESS = 2048.0
# Bytes of an update and a step beside their numbers.
_ENVELOPES = 100


class FrontalNode:
    """Call ``start()`` once, then ``handle`` with every message addressed to it, in any order; send what they return.

    ``outcome`` is None while it works. Repeated messages do no harm. ``tick()`` asks for what has not come; who is
    asked for what it cannot give yet asks in turn.
    """

    def __init__(self, share: Share, config: SolverConfig) -> None:
        self.share = share
        self.outcome: SolverOutcome | None = None
        self._warm = config.start == "warm"
        self._depth, self._most = config.mixed_sweeps, config.multifrontal_most_mb
        self._matrix_bytes = 0
        self._schedule = Schedule(config, share.scaled, self._warm)
        self._problem, self._number = self._schedule.first, 0
        self._matrices = Matrices.OLD if self._warm else Matrices.GAUSS_NEWTON
        self._neighbours = neighbours_by_edges(share)
        self._local = LocalProblem(share)
        rank = share.members.index(share.robot)
        self._parent = share.members[(rank - 1) // 2] if rank else None
        self._children = [share.members[c] for c in (2 * rank + 1, 2 * rank + 2) if c < len(share.members)]
        self._order: tuple[int, ...] | None = None
        self._passes: Passes | None = None
        self._below: dict[int, Boundary] = {}
        self._went_up = False
        self._total = Sums()
        self._cost_before = self._aside = 0.0
        self._inbox: dict[tuple[FrontalKind, int], dict[int, bytes]] = {}
        self._said: dict[tuple[FrontalKind, int, int], FrontalMessage] = {}

    # -- what happens to it ------------------------------------------------------------------------------------------

    def start(self) -> list[FrontalMessage]:
        """Return the first messages."""
        out = []
        if not self._warm:
            lower = [n for n in self.share.neighbours if n < self.share.robot]
            out = [self._send(FrontalKind.START, 0, n, self._start_for(n)) for n in lower]
        return [*out, *self._advance()]

    def handle(self, message: FrontalMessage) -> list[FrontalMessage]:
        """Receive a message; returns the messages to send because of it."""
        if not isinstance(message, FrontalMessage):
            raise BackendError(f"robot {self.share.robot} was handed a message of another method")
        if message.receiver != self.share.robot or message.sender not in self.share.members:
            raise BackendError(
                f"robot {self.share.robot} was handed a message from {message.sender} for {message.receiver}"
            )
        if message.kind is FrontalKind.WAIT:
            return self._answer(message)
        if self.outcome is not None or message.number < self._number or message.number > self._number + 1:
            return []
        arrived = self._inbox.setdefault((message.kind, message.number), {})
        arrived[message.sender] = message.body
        try:
            return self._advance()
        except BackendError:
            arrived.pop(message.sender, None)
            raise

    def tick(self) -> list[FrontalMessage]:
        """Ask for what has not come."""
        if self.outcome is not None:
            return []
        me = self.share.robot
        missing = [r for r in self._starting() if r not in self._inbox.get((FrontalKind.START, 0), {})]
        asked = [(FrontalKind.START, 0, r) for r in missing if self._number == 0]
        if self._order is None:
            if (FrontalKind.PAIRS, 0, self._parent) in self._said and self._parent is not None:
                asked.append((FrontalKind.ORDER, 0, self._parent))
        elif self._went_up and self._passes is not None and self._passes.front.next_robot is not None:
            asked.append((FrontalKind.STEP, self._number, self._passes.front.next_robot))
        return [FrontalMessage(FrontalKind.WAIT, number, me, r, bytes([kind])) for kind, number, r in asked]

    def again(self, message: FrontalMessage) -> list[FrontalMessage]:
        """What the sender of a message that came before may have missed: it asks for that, nothing else tells."""
        ours = isinstance(message, FrontalMessage)
        return self._answer(message) if ours and message.kind is FrontalKind.WAIT else []

    def _answer(self, message: FrontalMessage) -> list[FrontalMessage]:
        if len(message.body) != 1 or message.body[0] not in tuple(FrontalKind):
            raise BackendError(f"robot {message.sender} waits for something that no robot sends")
        wanted, asker = FrontalKind(message.body[0]), message.sender
        said = self._said.get((wanted, message.number, asker))
        if said is not None:
            return [said]
        lacks = {FrontalKind.ORDER: FrontalKind.PAIRS, FrontalKind.STEP: FrontalKind.UPDATE}.get(wanted)
        if lacks is None or asker in self._inbox.get((lacks, message.number), {}):
            return []
        if message.number < self._number or self.outcome is not None:
            return []
        return [FrontalMessage(FrontalKind.WAIT, message.number, self.share.robot, asker, bytes([lacks]))]

    def _send(self, kind: FrontalKind, number: int, receiver: int, body: bytes) -> FrontalMessage:
        message = FrontalMessage(kind, number, self.share.robot, receiver, body)
        self._said[kind, number, receiver] = message
        return message

    def _advance(self) -> list[FrontalMessage]:
        """Do everything that can be done with what was received."""
        out: list[FrontalMessage] = []
        while self.outcome is None:
            if self._order is None:
                found = self._try_order()
            else:
                found = self._try_down() if self._went_up else self._try_up()
            if found is None:
                break
            out += found
        return out

    # -- the order ---------------------------------------------------------------------------------------------------

    def _try_order(self) -> list[FrontalMessage] | None:
        """Tell up the tree of members who shares poses with whom, and down it the order that follows."""
        order = self._inbox.get((FrontalKind.ORDER, 0), {}).get(-1 if self._parent is None else self._parent)
        if order is None:
            given = self._inbox.get((FrontalKind.PAIRS, 0), {})
            if any(c not in given for c in self._children) or (FrontalKind.PAIRS, 0, self._parent) in self._said:
                return None
            pairs = {(self.share.robot, r): n for r, n in self._neighbours.items() if r > self.share.robot}
            for child in self._children:
                pairs |= read_pairs(given[child], self.share.members)
            if self._parent is not None:
                return [self._send(FrontalKind.PAIRS, 0, self._parent, write_pairs(pairs))]
            found, squares = elimination_order(self.share.members, pairs, self.share.anchor)
            megabytes = squares * shape_of(Unknowns.POSE, self.share.scaled)[0] ** 2 * 1e-6
            order = write_order(found, megabytes if megabytes > self._most else 0.0)
        self._order, megabytes = read_order(order, self.share)
        if megabytes:
            self.outcome = refused(self.share, megabytes, self._most)
        return [self._send(FrontalKind.ORDER, 0, c, order) for c in self._children]

    # -- up ----------------------------------------------------------------------------------------------------------

    def _starting(self) -> list[int]:
        """Neighbours whose poses are needed to know the cost before."""
        return [] if self._warm else [n for n in self.share.neighbours if n > self.share.robot]

    def _try_up(self) -> list[FrontalMessage] | None:
        assert self._order is not None
        given = self._inbox.get((FrontalKind.UPDATE, self._number), {})
        if self._passes is None:
            if any(r not in self._inbox.get((FrontalKind.START, 0), {}) for r in self._starting()):
                return None
            below = {r: self._decode(r, body) for r, body in sorted(given.items())}
            if not self._complete(below):
                return None
            self._begin(below)
        else:
            if any(r not in given for r in self._below):
                return None
            below = {r: self._decode(r, given[r]) for r in sorted(self._below)}
        return self._go_up(below)

    def _decode(self, robot: int, body: bytes) -> Update:
        carried = None if self._passes is None else self._passes.carried_of(robot, self._problem)
        return Update.decode(body, self._problem, carried, self._matrices is not Matrices.OLD, self.share.scaled)

    def _complete(self, below: dict[int, Update]) -> bool:
        """Whether every robot before this one that shares edges with it is among those that what came is about."""
        assert self._order is not None
        me, rank = self.share.robot, {robot: k for k, robot in enumerate(self._order)}
        boundaries = [u.boundary for u in below.values() if u.boundary is not None]
        if me == self._order[-1]:
            return 1 + sum(b.robots for b in boundaries) == len(self.share.members)
        return sum(b.below.get(me, 0) for b in boundaries) == sum(rank[r] < rank[me] for r in self._neighbours)

    def _begin(self, below: dict[int, Update]) -> None:
        assert self._order is not None
        self._below = {r: u.boundary for r, u in below.items() if u.boundary is not None}
        front = Front(self.share, self._order, self._below)
        self._passes = Passes(self.share, front, self._below, self._warm, self._depth)
        if not self._warm:
            for neighbour in self._starting():
                self._take_start(neighbour, self._inbox[FrontalKind.START, 0][neighbour])

    def _go_up(self, below: dict[int, Update]) -> list[FrontalMessage]:
        assert self._passes is not None
        passes = self._passes
        places: dict[NodeId, Array] = {}
        if self._problem is Unknowns.KNOWN:
            for update in below.values():
                passes.take_places(update.places)
                places |= update.places
            places = passes.sent_places(places)
        hessian, b, sums = passes.up(self._problem, below, self._matrices)
        if self._number == 0 and not self._warm:
            sums = Sums(self._local.cost())
        elif self._problem is Unknowns.POSE:
            sums = replace(sums, cost=sums.cost + self._aside)
        # What comes back is about as much as right-hand sides are.
        sums = replace(sums, matrices=self._matrix_bytes, others=2 * b.size * 4 + _ENVELOPES)
        for update in below.values():
            sums = sums.also(update.sums)
        self._total, self._went_up = sums, True
        if passes.front.next_robot is None:
            return []
        boundary = passes.front.boundary if self._number == 0 else None
        update = Update(sums, hessian, b, passes.carried_of(None, self._problem), boundary, places)
        body = update.encode()
        if hessian is not None:
            self._matrix_bytes = len(body)
        return [self._send(FrontalKind.UPDATE, self._number, passes.front.next_robot, body)]

    # -- down --------------------------------------------------------------------------------------------------------

    def _try_down(self) -> list[FrontalMessage] | None:
        assert self._passes is not None
        passes = self._passes
        if passes.front.next_robot is None:
            return self._go_down(self._decided())
        body = self._inbox.get((FrontalKind.STEP, self._number), {}).get(passes.front.next_robot)
        if body is None:
            return None
        return self._go_down(Step.decode(body, self._problem, len(passes.front.held), self.share.scaled))

    def _decided(self) -> Step:
        """As the anchor."""
        sums, schedule = self._total, self._schedule
        if self._number == 0 and not self._warm:
            self._cost_before = sums.cost
        decided = schedule.after(self._problem, sums)
        grid = (1.0, 1.0)
        if self._problem is Unknowns.POSE:
            grid = schedule.grid(sums, shape_of(Unknowns.POSE, self.share.scaled)[0], _FINENESS)
            self._cost_before = schedule.start if self._warm else self._cost_before
        origin = None
        if decided.problem is None and not self._warm:
            first = sorted(self.share.poses)[:1]
            origin = np.append(numbers_of(self.share.poses[first[0]]), self.share.log_units(first))
        return Step(
            next_problem=decided.problem,
            matrices=decided.matrices,
            place=decided.place,
            cost=schedule.best,
            cost_before=self._cost_before,
            origin=origin,
            grid=grid,
            known=np.ones(0, dtype=bool),
            numbers=np.zeros((0, 0)),
            weights=decided.weights,
            capped=decided.capped,
        )

    def _go_down(self, step: Step) -> list[FrontalMessage]:
        assert self._passes is not None
        passes, problem = self._passes, self._problem
        moves = step.place.moves and step.next_problem is not None
        if step.place is StepFrom.BEST_AND_FURTHER:
            passes.remember()
        if moves:
            numbers = passes.down(problem, step)
        elif step.place is StepFrom.HALFWAY:
            passes.go_halfway()
        else:
            passes.go_to_best()
        if moves and self._number == 0:
            self._aside = cost_aside(self._local, passes.front)
        out = []
        for robot in sorted(self._below):
            passed = step
            if moves:
                known, sent = passes.for_robot(robot, numbers)
                passed = replace(step, known=known, numbers=sent)
            out.append(self._send(FrontalKind.STEP, self._number, robot, passed.encode(problem)))
        for key in [k for k in self._said if k[1] < self._number]:
            del self._said[key]
        for old in [k for k in self._inbox if k[1] <= self._number]:
            del self._inbox[old]
        if step.next_problem is None:
            self.outcome = finished(self.share, passes, step, self._number + 1)
        else:
            self._problem, self._matrices = step.next_problem, step.matrices
            self._number, self._went_up = self._number + 1, False
        return out

    # -- poses as they are -------------------------------------------------------------------------------------------

    def _start_for(self, neighbour: int) -> bytes:
        out = CompactWriter()
        out.array(self._local.separator_places(neighbour), "<f4")
        return out.bytes()

    def _take_start(self, neighbour: int, body: bytes) -> None:
        rows = len(self._local.received_rows[neighbour])
        values = CompactReader(body).array(rows * self._local.width, "<f4")
        self._local.receive_places(neighbour, values.reshape(rows, -1))
