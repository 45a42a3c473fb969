"""RelPose between agents: the query sends its points, the match agent verifies (thesis section 3.5)."""

from __future__ import annotations

from collections import deque

import numpy as np
from numpy.typing import NDArray

from backend.verification import PlaceView, Verdict, relative_pose
from mas.contract import Contract
from mas.desk import Desk, Trade, WorkError
from mas.honesty import judged
from mas.identities import ContractId, MatchId, Operation
from mas.keyframe import KeyFrame
from mas.matches import Match
from mas.messages import Award, Bid, Call, Confirmation, GroupNotice, Refusal, Rejection, Result
from mas.placebook import Candidate, PlaceBook
from mas.policy.utility import VERIFY_ANSWER_BYTES
from mas.retender import Retender
from mas.state import AgentState, thinned
from mas.tasks import Outcome, Task, VerifyAnswer, VerifyTask
from mas.tensors import Tensor, pack_poses, pack_sim3, unpack_poses, unpack_sim3

_REASON_LENGTH = 200


class Verification(Trade):
    """Manager: the agent that asked; contractor: the agent that knew the place."""

    def __init__(self, desk: Desk, book: PlaceBook) -> None:
        super().__init__(desk)
        self.book = book
        self._waiting: dict[int, deque[MatchId]] = {}
        self._running: dict[ContractId, MatchId] = {}
        self._again = Retender(desk.state.config.link.retries)

    def request(self, candidate: Candidate) -> None:
        """Have a candidate verified by the other agent, after those already waiting for it."""
        if self.book.propose(candidate):
            self._waiting.setdefault(candidate.id.match_agent, deque()).append(candidate.id)
            self._next(candidate.id.match_agent)

    def bid(self, contract: Contract, call: Call) -> Bid | Refusal:
        return Bid(cost_bytes=VERIFY_ANSWER_BYTES, ready_ns=self.desk.now_ns)

    def on_bid(self, contract: Contract, bid: Bid) -> None:
        match = self._running.get(contract.id)
        if match is None:
            self.desk.say(contract, Rejection("no longer wanted"))
            return
        self.desk.say(contract, Award(_task(self.state, match)))

    def work(self, contract: Contract, task: Task) -> None:
        if not isinstance(task, VerifyTask) or task.match.query_agent != contract.manager:
            raise WorkError("not a verification of the manager's own key-frame")
        if task.match.match_agent != self.state.me or task.match.match >= len(self.state.keyframes):
            raise WorkError("no such key-frame")
        if task.metric != self.state.profile.metric:
            raise WorkError("one scale is metric, the other arbitrary")
        self.desk.say(contract, Confirmation())
        mine = self.state.keyframes[task.match.match]
        verdict = verify(self.state, task.match, _view_of_task(task), mine)
        self.desk.say(contract, Result(_answer(self.state, task, mine, verdict)))
        if verdict.accepted:
            assert verdict.T_M_Q is not None and verdict.information is not None
            match = Match(
                task.match, task.track, mine.track, verdict.T_M_Q, verdict.information, verdict.inliers,
                unpack_poses(task.T_T_Q.array()), mine.T_T_C, task.way, self.state.travelled[mine.index], mine.depth,
            )  # fmt: skip
            self.learn(match)

    def on_result(self, contract: Contract, outcome: Outcome) -> None:
        match_id = self._running.get(contract.id)
        if not isinstance(outcome, VerifyAnswer) or match_id is None or outcome.match != match_id:
            raise WorkError("not the answer to this verification")
        transform = None if outcome.T_M_Q is None else unpack_sim3(outcome.T_M_Q)
        self.book.update(
            match_id, verified=outcome.accepted, reason=kind_of(outcome.reason), detail=outcome.reason, T_M_Q=transform,
            matches=outcome.matches, inliers=outcome.inliers, rmse=outcome.rmse,
        )  # fmt: skip
        if outcome.accepted and transform is not None and outcome.information is not None:
            mine = self.state.keyframes[match_id.query]
            match = Match(
                match_id, mine.track, outcome.track, transform, np.array(outcome.information.array()), outcome.inliers,
                mine.T_T_C, unpack_poses(outcome.T_T_M.array()), self.state.travelled[mine.index], outcome.way,
                outcome.depth,
            )  # fmt: skip
            self.learn(match)

    def on_end(self, contract: Contract) -> None:
        match = self._running.pop(contract.id, None) if contract.manager == self.state.me else None
        if match is None:
            return
        if self._again.wanted(contract, match):
            self._waiting.setdefault(contract.contractor, deque()).append(match)
        elif not self.book.candidates[match].detail:
            self.book.update(match, reason="not verified", detail=f"contract {contract.state}: {contract.reason}")
        self._next(contract.contractor)

    def learn(self, match: Match) -> None:
        """Take in a verified match; accepted ones join their agents in a group, and the group hears of it."""
        accepted_now = self.state.add_match(match)
        for other in set(match.id.agents) - {self.state.me}:
            self.desk.standing.judged(other, *judged(self.state, other))
        for accepted in accepted_now:
            self.book.matched(accepted)
            self.desk.note("match", match=str_match(accepted), inliers=self.state.verified[accepted].inliers)
            if self.state.join(accepted.agents):
                tell_group(self.desk)

    def resume(self) -> None:
        """Go on with agents that could not be called for a while."""
        for other in sorted(self._waiting):
            self._next(other)

    def _next(self, other: int) -> None:
        waiting = self._waiting.get(other)
        if not waiting or not self.desk.may_call(other):
            return
        identity, called = self.desk.call(Operation.RELPOSE, [other])
        if called:
            self._running[identity] = waiting.popleft()


def tell_group(desk: Desk) -> None:
    """Tell the group's other members who is in it, after it grew; they pass it on as far as it is news to them."""
    members = tuple(sorted(desk.state.group))
    desk.note("group", members=list(members))
    for member in members:
        if member != desk.me:
            desk.tell(member, None, GroupNotice(members))


def verify(state: AgentState, match: MatchId, query: PlaceView, mine: KeyFrame) -> Verdict:
    """The geometric check with a generator that belongs to this match: no order of events changes the verdict."""
    seed = [state.config.seed, match.query_agent, match.query, match.match_agent, match.match]
    return relative_pose(query, view_of(state, mine), state.config.relpose, np.random.default_rng(seed))


def view_of(state: AgentState, keyframe: KeyFrame) -> PlaceView:
    """A key-frame as verification sees it: all its points, with what this system compares."""
    rows = _rows_sent(state, keyframe)
    points = keyframe.points_C[rows].astype(np.float64)
    if state.config.places.features == "words":
        return PlaceView(points, words=keyframe.words[rows], metric=state.profile.metric)
    return PlaceView(points, descriptors=keyframe.descriptors[rows], metric=state.profile.metric)


def kind_of(reason: str) -> str:
    """A reason without its figures, to count by."""
    return reason.partition(":")[0]


def str_match(match: MatchId) -> str:
    """``query agent:key-frame - match agent:key-frame`` for people."""
    return f"{match.query_agent}:{match.query} - {match.match_agent}:{match.match}"


def _rows_sent(state: AgentState, keyframe: KeyFrame) -> NDArray[np.int64]:
    """At most ``max_points`` rows, spread evenly over the key-frame's points."""
    return thinned(np.arange(len(keyframe.points_C)), state.config.places.max_points)


def _task(state: AgentState, match: MatchId) -> VerifyTask:
    keyframe = state.keyframes[match.query]
    rows = _rows_sent(state, keyframe)
    words = state.config.places.features == "words"
    return VerifyTask(
        match=match,
        track=keyframe.track,
        stamp_ns=keyframe.stamp_ns,
        metric=state.profile.metric,
        T_T_Q=pack_poses(keyframe.T_T_C),
        way=state.travelled[keyframe.index],
        points=Tensor.of(keyframe.points_C[rows], "<f4"),
        descriptors=None if words else Tensor.of(keyframe.descriptors[rows], "|u1"),
        words=Tensor.of(keyframe.words[rows], "<u2") if words else None,
    )


def _view_of_task(task: VerifyTask) -> PlaceView:
    points = task.points.array().astype(np.float64)
    if task.words is not None:
        return PlaceView(points, words=task.words.array().astype(np.int32), metric=task.metric)
    assert task.descriptors is not None
    return PlaceView(points, descriptors=task.descriptors.array(), metric=task.metric)


def _answer(state: AgentState, task: VerifyTask, mine: KeyFrame, verdict: Verdict) -> VerifyAnswer:
    good = verdict.accepted
    return VerifyAnswer(
        match=task.match,
        accepted=good,
        reason=verdict.reason[:_REASON_LENGTH],
        matches=verdict.matches,
        inliers=verdict.inliers,
        rmse=float(verdict.rmse) if np.isfinite(verdict.rmse) else None,
        T_M_Q=pack_sim3(verdict.T_M_Q) if verdict.T_M_Q is not None else None,
        information=Tensor.of(verdict.information, "<f8") if good and verdict.information is not None else None,
        track=mine.track,
        stamp_ns=mine.stamp_ns,
        T_T_M=pack_poses(mine.T_T_C),
        way=state.travelled[mine.index],
        depth=mine.depth,
    )
