"""The elected solver: one robot gathers its group's condensed graph, solves it centrally, and sends poses back.

Every robot sends how much it would have to transmit; the one with the most is elected, as its own part need not travel.
Members give it their condensed graphs once, get their poses once, place what was condensed away by themselves, and
report what their own edges cost then; the result counts only if the group's cost has not risen. Where rounding would
cost too much, the elected robot asks for what was rounded off before it sends poses. Far fewer bytes than any
iteration, but the elected robot sees the group's whole (condensed) graph. Where it falls silent the next one takes
over.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping

import numpy as np

from ..config import SolverConfig
from ..errors import BackendError
from ..geometry import Array
from . import contribution as parcel
from .condense import Known, OwnGraph
from .contribution import Contribution
from .elected_messages import ElectedMessage, Kind
from .elected_terms import ElectedTerms, unpack
from .gathered import Gathered, cost_between, cost_of_priors, expected_gain, solve
from .rounding import encode_remainder, finer, rounding_cost
from .settled import Settled
from .share import Share, SolverOutcome, anchor_of
from .solution import decode_solution, encode_solution

_COST = struct.Struct("<d")
_DECISION = struct.Struct("<?ddHB")
_POSITIONS, _LENGTHS, _HEADINGS = 1, 2, 4
"""In the last byte of a decision: what had a say, or was found."""
NO_SURE_GAIN = "no gain beyond the rounding of what is sent"
"""Begins the reason of a result that is not taken although its cost seems lower: poses stay as good as they were."""
# A gain that rounding hides: up to this share of the cost the poses are as good as the result.
_SMALL_GAIN = 1e-3
# A fall of the cost by less than this share is none.
_NO_GAIN = 1e-5
# How many times finer a solution is sent that gains little: as F rises with the square of what is rounded off.
_NEAR = 4.0
# How often what was rounded off is asked for: each time it is 128 times less.
_MOST_REMAINDERS = 3


class ElectedNode(ElectedTerms):
    """What travels once it is known who is elected, and what both sides do with it; used as :class:`ElectedTerms`."""

    def __init__(self, share: Share, config: SolverConfig) -> None:
        super().__init__(share, config)
        self._own = OwnGraph(share)
        self._fineness = config.elected_fineness * self._own.exactness()
        self._sizes[share.robot] = len(parcel.encode(self._mine(None)))
        self._contributions: dict[int, Contribution] = {}
        self._costs: dict[int, float] = {}
        self._gathered: Gathered | None = None
        self._body = b""
        self._sent: Contribution | None = None
        self._remainders = 0
        self._coarse: set[int] = set()
        self._known = Known()
        self._completed: tuple[Array, Array] | None = None
        self._reached = np.zeros(len(self._own.nodes), dtype=bool)

    @property
    def settled(self) -> Settled:
        """What updates go on from, once it has ended."""
        given = {r: self._contributions[r] for r in self._members()} if self.leader == self.share.robot else {}
        return Settled(-1 if self.leader is None else self.leader, self._known, given)

    def _awaited_in_term(self) -> list[tuple[Kind, list[int]]]:
        if self.leader != self.share.robot:
            assert self.leader is not None
            return [(Kind.SOLUTION if self._completed is None else Kind.DECISION, [self.leader])]
        members = self._members()
        if self._coarse:
            return [(Kind.REMAINDER, sorted(self._coarse))]
        if self._gathered is None:
            return [(Kind.CONTRIBUTION, [r for r in members if r not in self._contributions])]
        return [(Kind.COST, [r for r in members if r not in self._costs])]

    def _begin(self) -> list[ElectedMessage]:
        self._costs, self._gathered, self._completed = {}, None, None
        self._remainders, self._coarse = 0, set()
        me = self.share.robot
        if self.leader != me:
            assert self.leader is not None
            self._body = parcel.encode(self._mine(self.leader))
            self._sent = None
            return self._say(self._to([self.leader], Kind.CONTRIBUTION, self._body))
        self._contributions = {me: self._mine(me)}
        return self._try_solve()

    def _begin_without(self, silent: set[int]) -> list[ElectedMessage]:
        if self._gathered is not None:
            return []
        self._left_out |= silent - set(self._contributions)
        return self._try_solve()

    def _is_for(self, said: ElectedMessage, wanted: int) -> bool:
        return super()._is_for(said, wanted) or (said.kind is Kind.FINER and said.receiver in self._coarse)

    def _mine(self, leader: int | None) -> Contribution:
        return parcel.contribution(self.share, self._own, leader, self._config.elected_longest, self._fineness)

    def _take(self, message: ElectedMessage) -> list[ElectedMessage]:
        leads = self.leader == self.share.robot
        if message.kind is Kind.SIZE:
            return []
        if message.kind in (Kind.CONTRIBUTION, Kind.REMAINDER, Kind.COST) and leads:
            if message.sender in self._left_out:
                return []
            if message.kind is Kind.REMAINDER:
                return self._take_remainder(message)
            if message.kind is Kind.COST:
                self._silent = 0 if message.sender not in self._costs else self._silent
                self._costs[message.sender] = unpack(_COST, message.body)[0]
                return self._try_decide()
            if message.sender not in self._contributions:
                given = parcel.decode(message.body, message.sender, self.share.scaled)
                self._check_own_edges(given)
                self._silent = 0
                self._contributions[message.sender] = given
            return self._try_solve()
        if message.sender != self.leader or leads:
            return []
        self._silent = 0
        if message.kind is Kind.FINER and self._completed is None:
            return self._give_remainder(message.body)
        if message.kind is Kind.SOLUTION and self._completed is None:
            return self._finish_own(message.body)
        if message.kind is Kind.DECISION:
            self._end(*unpack(_DECISION, message.body))
        return []

    def _check_own_edges(self, given: Contribution) -> None:
        """Edges with the elected robot are its own to state; those of two others the lower one's."""
        for i, j in given.between.nodes:
            other = j.robot if i.robot == given.robot else i.robot
            if other == self.share.robot or other < given.robot or other not in self.share.members:
                raise BackendError(f"robot {given.robot} states an edge that is not its own to state: {i} - {j}")

    def _try_solve(self) -> list[ElectedMessage]:
        """As the elected robot: once everyone has contributed."""
        missing = self._coarse | (set(self._members()) - set(self._contributions))
        if self._gathered is not None or missing:
            return []
        me, own_units = self.share.robot, self.share.arbitrary_scale
        given = {r: self._contributions[r] for r in self._members()}
        found = solve(self._believed(given), own_units, self.share.length_sigma, self.share.heading_sigma)
        rounded = sum(rounding_cost(c) for r, c in given.items() if r != me)
        gain, doubt = expected_gain(list(given.values()), found, set(given) <= own_units)
        # Whether there is a gain, which rounding may hide when it is weighed.
        hidden = _NO_GAIN * found.total < gain < 2.0 * doubt + rounded
        coarse = rounded > self._config.elected_rounding * found.cost
        if self._remainders < _MOST_REMAINDERS and (coarse or hidden):
            return self._ask_for_remainders()
        self._gathered = found
        near = 0.0 <= gain < _SMALL_GAIN * found.total
        fineness = self._config.elected_fineness * self._gathered.exactness * (_NEAR if near else 1.0)
        self._known = Known()
        out = []
        for robot, c in given.items():
            places = self._gathered.of(c.graph.nodes)
            if robot == me:
                self._known = self._known.also(places)
                self._costs[me] = self._complete(places)
                continue
            finer = fineness * self._gathered.stiffer(c)
            body, known = encode_solution(c.graph, places, finer, self.share.scaled)
            self._known = self._known.also(known)
            out += self._to([robot], Kind.SOLUTION, self._to_say(robot, body))
        self._say(out)
        return [*out, *self._try_decide()]

    def _believed(self, given: Mapping[int, Contribution]) -> Mapping[int, Contribution]:
        """What of the contributions is solved with; this and the next two: see elected_selection.py."""
        return given

    def _to_say(self, robot: int, solution: bytes) -> bytes:
        """The solution for a member with what else it is sent."""
        return solution

    def _take_verdicts(self, body: bytes) -> bytes:
        """Inverse of :meth:`_to_say`: the solution alone."""
        return body

    def _own_cost(self, poses: Array, log_units: Array) -> float:
        return self._own.cost(poses, log_units)

    def _ask_for_remainders(self) -> list[ElectedMessage]:
        self._remainders += 1
        self._coarse = set(self._members()) - {self.share.robot}
        return self._say(self._to(sorted(self._coarse), Kind.FINER, bytes([self._remainders])))

    def _as_sent(self) -> Contribution:
        """What the elected robot has of this one: read when it is needed, as nothing else in a member is as large."""
        return self._sent or parcel.decode(self._body, self.share.robot, self.share.scaled)

    def _give_remainder(self, body: bytes) -> list[ElectedMessage]:
        """As a member: what was rounded off, if it was not given before."""
        if body != bytes([self._remainders + 1]):
            return []
        self._remainders += 1
        sent = self._as_sent()
        remainder = encode_remainder(self._mine(self.leader), sent)
        self._sent = finer(sent, remainder)
        assert self.leader is not None
        return self._say(self._to([self.leader], Kind.REMAINDER, body + remainder))

    def _take_remainder(self, message: ElectedMessage) -> list[ElectedMessage]:
        if message.sender in self._coarse and message.body[:1] == bytes([self._remainders]):
            self._silent = 0
            self._contributions[message.sender] = finer(self._contributions[message.sender], message.body[1:])
            self._coarse.discard(message.sender)
        return self._try_solve()

    def _complete(self, known: Known) -> float:
        """Own poses with the ``known`` ones held; returns F over the own edges."""
        own, first = self._own, self._own.nodes[:1]
        if self.share.robot == anchor_of(self._members(), self.share.arbitrary_scale) and first[0] in known.poses:
            known = known.also(own.known(first))
        poses, log_units, self._reached = own.completed(known)
        self._completed = poses, log_units
        return self._own_cost(poses, log_units)

    def _finish_own(self, body: bytes) -> list[ElectedMessage]:
        self._known = decode_solution(self._take_verdicts(body), self._as_sent().graph, self.share.scaled)
        cost = self._complete(self._known)
        assert self.leader is not None
        return self._say(self._to([self.leader], Kind.COST, _COST.pack(cost)))

    def _try_decide(self) -> list[ElectedMessage]:
        """As the elected robot: once every member has sent the present cost of its own edges."""
        found = self._gathered
        if found is None or any(r not in self._costs for r in self._members()):
            return []
        given = [self._contributions[r] for r in self._members()]
        start = Known()
        for c in given:
            start = start.also(c.start)
        free_unit = set(self._members()) <= self.share.arbitrary_scale
        outside, doubt = cost_between(found.between, start)
        before = sum(c.cost for c in given) + outside + cost_of_priors(found.priors, start, free_unit)
        outside, more_doubt = cost_between(found.between, start.also(self._known))
        after = sum(self._costs[r] for r in self._members()) + outside
        after += cost_of_priors(found.priors, start.also(self._known), free_unit)
        accepted = after + doubt + more_doubt <= before
        flags = _POSITIONS * bool(len(found.priors)) | _LENGTHS * found.lengths | _HEADINGS * found.headings
        body = _DECISION.pack(accepted, before, after, min(found.iterations, 0xFFFF), flags)
        out = self._say(self._to(self._others(), Kind.DECISION, body))
        self._end(accepted, before, after, found.iterations, flags)
        return out

    def _go_on_without(self) -> list[ElectedMessage]:
        """As the elected robot, out of patience: leave out who has not contributed; give up without all costs."""
        self._silent = 0
        missing = self._coarse | (set(self._members()) - set(self._contributions))
        if missing:
            self._left_out |= missing
            self._coarse = set()
            return self._try_solve()
        if self._gathered is None or self.outcome is not None:
            return []
        before = sum(self._contributions[r].cost for r in self._members())
        out = self._say(self._to(self._others(), Kind.DECISION, _DECISION.pack(False, before, float("nan"), 0, 0)))
        self._end(False, before, float("nan"), 0, 0)
        return out

    def _end(self, accepted: bool, before: float, after: float, iterations: int, flags: int) -> None:
        own, reason = self._own, "accepted"
        mine = accepted and self._completed is not None
        if not accepted:
            what = "the cost would rise"
            if after <= before:
                small = before - after <= _SMALL_GAIN * before
                what = NO_SURE_GAIN if small else "the gain is less than what rounding may have changed"
            reason = f"{what}: {before:.6g} to {after:.6g}" if after == after else "a member fell silent"
        elif not mine:
            reason = "left out: others received nothing from this robot"
        poses, log_units = own.poses, own.log_units
        if mine and self._completed is not None:
            poses, log_units = self._completed
        self.outcome = SolverOutcome(
            robot=self.share.robot,
            accepted=mine,
            reason=reason,
            poses={n: poses[k].copy() for k, n in enumerate(own.nodes)},
            units=dict(zip(own.nodes, np.exp(log_units).tolist(), strict=True)),
            cost_before=before,
            cost_after=after if accepted else before,
            rotation_sweeps=0,
            pose_sweeps=iterations,
            unreached=tuple(n for k, n in enumerate(own.nodes) if not self._reached[k]),
            positions=bool(flags & _POSITIONS),
            length=own.length(poses, log_units) if mine and flags & _LENGTHS else 1.0,
            turn=tuple(own.turn(poses).tolist()) if mine and flags & _HEADINGS else (0.0, 0.0, 0.0),
        )
