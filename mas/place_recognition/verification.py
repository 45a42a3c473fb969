"""RelPose between agents: the query sends its points, the match agent verifies (thesis section 3.5)."""

from __future__ import annotations

from collections import deque

import numpy as np

from maslam.backend.errors import BackendError
from maslam.backend.relpose.verification import PlaceView, Verdict, joined

from ..contracts.context import AgentContext
from ..contracts.contract import Contract
from ..contracts.effects import NOTHING, Effects, total
from ..contracts.operation import Answer, Operation, WorkError
from ..contracts.retries import RetryBudget
from ..policies.utility import VERIFY_ANSWER_BYTES
from ..protocol.ids import ContractId, MatchId, OperationKind
from ..protocol.messages import Award, Bid, Call, Confirmation, GroupNotice, Rejection, Result
from ..protocol.tasks import VerifyAnswer, VerifyTask
from ..protocol.tensors import MessageError, unpack_information, unpack_poses, unpack_sim3
from ..state.match_audit import judged
from ..state.place_match import Match, MatchEnd, SkipReason
from .candidates import Candidate, Candidates, MatchCheck
from .comparison import answer_to, descriptor_width, kind_of, match_end, task_of, verify, view_of_task

# Views of which only the first points have come, at most, and points of all of them.
_KEPT, _KEPT_POINTS = 256, 200_000
# Matches with one other agent, at most: who replays one view for ever fills no memory.
_MATCHES = 5000
# How many times as deep as the own view of a place the other's may be, or how much less.
_DEPTHS = 10.0
# Why an agent cannot verify a match of a key-frame that it does not have: whoever named it is to blame.
_NO_KEYFRAME = "no such key-frame"
# How many times as far as this agent another one may have come, as far as tolerances go.
_WAYS = 4.0
# Only who has both images can tell that they are one: the match agent, before it looks at the geometry.
_NO_EVIDENCE = Verdict(False, SkipReason.SAME_IMAGE.value, None, 0, 0, np.nan, None)


class Verification(Operation[VerifyTask, VerifyAnswer]):
    """Manager: the agent that asked; contractor: the agent that knew the place. ``wider``: contracts about candidates
    of the wider search."""

    kind = OperationKind.RELPOSE

    def __init__(self, context: AgentContext, candidates: Candidates) -> None:
        super().__init__(context)
        self.candidates = candidates
        self._waiting: dict[int, deque[MatchId]] = {}
        self._running: dict[ContractId, MatchId] = {}
        self.wider: set[ContractId] = set()
        self._again = RetryBudget(context.state.config.link.retries)
        self._promising: set[MatchId] = set()
        self._insisted: set[MatchId] = set()
        self._first: dict[MatchId, PlaceView] = {}

    # -- manager ------------------------------------------------------------------------------------------------------

    def request(self, candidate: Candidate) -> Effects:
        """Have a candidate verified by the other agent, after those already waiting for it."""
        if not self.candidates.propose(candidate):
            return NOTHING
        self._waiting.setdefault(candidate.id.match_agent, deque()).append(candidate.id)
        return self._next(candidate.id.match_agent)

    def insist(self, candidate: Candidate) -> Effects:
        """Have a candidate verified that was skipped, whatever lies near it."""
        self.candidates.insist(candidate)
        self._insisted.add(candidate.id)
        self._waiting.setdefault(candidate.id.match_agent, deque()).append(candidate.id)
        return self._next(candidate.id.match_agent)

    def busy_with(self, other: int) -> bool:
        """Whether a candidate waits for its verification by the other, or for the answer."""
        return bool(self._waiting.get(other)) or any(m.match_agent == other for m in self._running.values())

    def on_bid(self, contract: Contract, bid: Bid) -> Effects:
        match = self._running.get(contract.id)
        if match is None:
            return self.context.send(contract, Rejection("no longer wanted"))
        return self.context.send(contract, Award(task_of(self.state, match, rest=match in self._promising)))

    def objection(self, contract: Contract, outcome: VerifyAnswer) -> str:
        match = self._running.get(contract.id)
        if match is None or outcome.match != match:
            return "not the answer to this verification"
        if not outcome.accepted or outcome.T_M_Q is None:
            return ""
        if outcome.keyframes <= match.match:
            return f"key-frame {match.match} of {outcome.keyframes}"
        # Both see the same place: how deep it is they can only say alike, or tolerances would be what a peer likes.
        depth = self.state.keyframes[match.query].depth * unpack_sim3(outcome.T_M_Q).scale
        if not depth / _DEPTHS <= outcome.depth <= depth * _DEPTHS:
            return f"a place {outcome.depth:.3g} deep that is {depth:.3g} deep here"
        return ""

    def on_result(self, contract: Contract, outcome: VerifyAnswer) -> Effects:
        match_id = outcome.match
        self.candidates.noted_length(match_id.match_agent, outcome.keyframes)
        if outcome.wants_more and match_id not in self._promising:
            self._promising.add(match_id)
            self._waiting.setdefault(match_id.match_agent, deque()).appendleft(match_id)
            return NOTHING
        transform = None if outcome.T_M_Q is None else unpack_sim3(outcome.T_M_Q)
        self.candidates.checked(
            match_id,
            MatchCheck(
                verified=outcome.accepted,
                reason=kind_of(outcome.reason),
                detail=outcome.reason,
                matches=outcome.matches,
                inliers=outcome.inliers,
                rmse=outcome.rmse,
                T_M_Q=transform,
            ),
        )
        if not outcome.accepted or transform is None or outcome.information is None:
            return NOTHING
        query = match_end(self.state, self.state.keyframes[match_id.query])
        way = self._believed_way(outcome.way, match_id.query, transform.scale)
        match = MatchEnd(outcome.track, unpack_poses(outcome.T_T_M.array()), way)
        information = unpack_information(outcome.information)
        return self.learn(Match.of(match_id, query, match, transform, information, outcome.inliers, outcome.depth))

    def answers_for(self, contract: Contract) -> int:
        match = self._running.get(contract.id) if contract.manager == self.state.me else None
        named_by = None if match is None else self.candidates.by_id[match].named_by
        return contract.contractor if named_by is None or contract.reason != _NO_KEYFRAME else named_by

    def on_end(self, contract: Contract) -> Effects:
        match = self._running.pop(contract.id, None) if contract.manager == self.state.me else None
        if match is None:
            return NOTHING
        again = match in self._waiting.get(match.match_agent, ())
        if self._again.wanted(contract, match) and not again:
            self._waiting.setdefault(contract.contractor, deque()).append(match)
        elif not again and not self.candidates.by_id[match].check.detail:
            why = f"contract {contract.state}: {contract.reason}"
            self.candidates.checked(match, MatchCheck(reason=SkipReason.NOT_VERIFIED.value, detail=why))
        return self._next(contract.contractor)

    def resume(self) -> Effects:
        """Go on with agents that could not be called for a while."""
        return total(self._next(other) for other in sorted(self._waiting))

    def _next(self, other: int) -> Effects:
        waiting = self._waiting.get(other)
        if not waiting or not self.context.may_call(other):
            return NOTHING
        # What was learned meanwhile may have answered it.
        sure = self._promising | self._insisted
        while waiting and waiting[0] not in sure and not self.candidates.still_wanted(waiting[0]):
            waiting.popleft()
        if not waiting:
            return NOTHING
        call = self.context.call(OperationKind.RELPOSE, [other])
        if call.contractors:
            match = waiting.popleft()
            self._running[call.identity] = match
            if self.candidates.by_id[match].wider:
                self.wider.add(call.identity)
        return call.effects

    # -- contractor ---------------------------------------------------------------------------------------------------

    def bid(self, contract: Contract, call: Call) -> Answer:
        return Answer(Bid(cost_bytes=VERIFY_ANSWER_BYTES, ready_ns=self.context.now_ns))

    def work(self, contract: Contract, task: VerifyTask) -> Effects:
        if task.match.query_agent != contract.manager:
            raise WorkError("not a verification of the manager's own key-frame")
        if task.match.match_agent != self.state.me or task.match.match >= len(self.state.keyframes):
            raise WorkError(_NO_KEYFRAME)
        if sum(contract.manager in m.agents for m in self.state.verified) >= _MATCHES:
            raise WorkError("enough matches with this agent")
        mine = self.state.keyframes[task.match.match]
        try:
            query = self._view_of(task)
            if mine.is_image(task.recording, task.stamp_ns):
                verdict = _NO_EVIDENCE
            else:
                verdict = verify(self.state, task.match, query, mine, bool(task.more))
            answer = answer_to(self.state, task, mine, verdict)
        except (BackendError, MessageError) as error:  # e.g. points as far off as messages may have them
            raise WorkError(f"views that cannot be compared: {error}") from error
        self._keep(task, query if answer.wants_more else None)
        effects = self.context.send(contract, Confirmation()) + self.context.send(contract, Result(answer))
        if not verdict.accepted or verdict.T_M_Q is None or answer.information is None:
            return effects
        way = self._believed_way(task.way, mine.index, 1.0 / verdict.T_M_Q.scale)
        asked = MatchEnd(task.track, unpack_poses(task.T_T_Q.array()), way)
        known = match_end(self.state, mine)
        # The information as it travels, so that both owners weigh the match alike.
        information = unpack_information(answer.information)
        match = Match.of(task.match, asked, known, verdict.T_M_Q, information, verdict.inliers, mine.depth)
        return effects + self.learn(match)

    def _view_of(self, task: VerifyTask) -> PlaceView:
        """The query's view as received by now."""
        view = view_of_task(task)
        if not task.rest:
            return view
        first = self._first.get(task.match)
        if first is None:
            raise WorkError("the first points of this view are not here")
        if descriptor_width(first) != descriptor_width(view):
            raise WorkError("the first points of this view were described otherwise")
        return joined(first, view)

    def _keep(self, task: VerifyTask, first: PlaceView | None) -> None:
        """First points that no rest followed are forgotten in the end."""
        if task.rest:
            self._first.pop(task.match, None)
        else:
            while len(self._first) >= _KEPT or sum(len(v.points_C) for v in self._first.values()) > _KEPT_POINTS:
                del self._first[next(iter(self._first))]
        if first is not None:
            self._first[task.match] = first

    def _believed_way(self, claimed: float, mine: int, unit: float) -> float:
        """How far another agent says it has come, in its unit, of which an own one is ``unit``: no farther than a few
        times what this one has come, as odometry's drift is allowed for on the way."""
        keyframe = self.state.keyframes[mine]
        own = self.state.travelled[-1] + _DEPTHS * keyframe.depth
        return min(claimed, _WAYS * own * unit)

    # -- both ---------------------------------------------------------------------------------------------------------

    def learn(self, match: Match) -> Effects:
        """Take in a verified match; accepted ones join their agents in a group, and the group gets a notice."""
        accepted_now = self.state.add_match(match)
        others = sorted(set(match.id.agents) - {self.state.me})
        effects = total(self.context.judged(other, *judged(self.state, other)) for other in others)
        for accepted in accepted_now:
            self.candidates.matched(accepted)
            effects += self.context.event("match", match=str(accepted), inliers=self.state.verified[accepted].inliers)
            if self.state.join(accepted.agents):
                effects += tell_group(self.context)
        return effects


def tell_group(context: AgentContext) -> Effects:
    """Tell the group's other members who is in it, after it grew; they pass it on as far as it is new to them."""
    members = tuple(sorted(context.state.group))
    others = [member for member in members if member != context.me]
    return context.event("group", members=list(members)) + total(
        context.tell(member, None, GroupNotice(members)) for member in others
    )
