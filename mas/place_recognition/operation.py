"""Place recognition between agents and with oneself (thesis section 3.5): whose key-frame looks most like this one?"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Mapping

import numpy as np
from numpy.typing import NDArray

from maslam.descriptors.errors import DescriptorError

from ..contracts.context import AgentContext
from ..contracts.contract import Contract
from ..contracts.operation import Operation, WorkError
from ..contracts.retries import RetryBudget
from ..policies.utility import PLACE_ANSWER_BYTES
from ..protocol.ids import ContractId, MatchId, OperationKind
from ..protocol.messages import Award, Bid, Call, Confirmation, Refusal, Rejection, Result
from ..protocol.tasks import EarlierAnswer, Outcome, OwnerQuery, PlaceAnswer, PlaceQuery, PlaceRedirect, Task
from ..state.agent_state import Ownership
from ..state.keyframe import KeyFrame
from ..state.place_match import Match
from .candidates import Candidate, Candidates
from .peer_queries import ClusterIndex, RecentQueries
from .sent_queries import SentQueries
from .verification import Verification, kind_of, verify, view_of

_FARTHEST = 2.0


class PlaceRecognition(Operation):
    """Manager: sends the vector of one of its key-frames; contractor: answers with its own nearest key-frame and the
    distance. Where clusters of vectors have owners, the owner answers with the nearest key-frame it was asked about,
    whoever's it is.

    ``distances``: how near each agent's last answer came, 0 to 2.
    """

    def __init__(self, context: AgentContext, book: Candidates, verification: Verification) -> None:
        super().__init__(context)
        self.book = book
        self.verification = verification
        self._waiting: dict[int, deque[int]] = {}
        self._asked: dict[ContractId, int] = {}
        self._cluster = ClusterIndex()
        self._latest = RecentQueries(book, context.state.config.places.latest_frames)
        self.told = SentQueries()
        self.distances: dict[int, float] = {}
        self._again = RetryBudget(context.state.config.link.retries)

    @property
    def threshold(self) -> float:
        """Distance below which two key-frames are candidates for the same place."""
        config, profile = self.state.config.places, self.state.profile
        if config.threshold is not None:
            return config.threshold
        strict = profile.strict_threshold if config.certainty == "strict" else None
        return profile.threshold if strict is None else strict

    def ask(self, keyframe: int, others: Iterable[int]) -> None:
        """Ask these agents about a key-frame, after those already waiting for them; the agent itself: where it owns
        the cluster."""
        if not self.state.keyframes[keyframe].textured:
            return
        asked = set(others)
        self.told.remember(keyframe)
        for other in asked:
            self.told.tell(other, keyframe)
        if self.state.me in asked:
            self._ask_own_log(keyframe)
        for other in sorted(asked - {self.state.me}):
            self._waiting.setdefault(other, deque()).append(keyframe)
        self._next(sorted(self._waiting))

    def recall(self, wanted: Mapping[int, int]) -> None:
        """Tell these agents of so many earlier key-frames each that they do not know, the oldest first, and only when
        no others wait for them: new ones go first."""
        for other, count in sorted(wanted.items()):
            for keyframe in [] if self._waiting.get(other) else self.told.untold(other)[:count]:
                self.book.recalled.add(keyframe)
                self.ask(keyframe, [other])

    def bid(self, contract: Contract, call: Call) -> Bid | Refusal:
        return Bid(cost_bytes=PLACE_ANSWER_BYTES, ready_ns=self.context.now_ns)

    def on_bid(self, contract: Contract, bid: Bid) -> None:
        keyframe = self._asked.get(contract.id)
        if keyframe is None:
            self.context.say(contract, Rejection("no longer wanted"))
            return
        profile = self.state.profile
        kind = PlaceQuery if profile.ownership is Ownership.NONE else OwnerQuery
        query = kind(keyframe, profile.language, self._coded(keyframe).tobytes())
        self.context.say(contract, Award(query))

    def work(self, contract: Contract, task: Task) -> None:
        if not isinstance(task, PlaceQuery):
            raise WorkError("not a place query")
        vector = self._decoded(task)
        if self.state.profile.ownership is Ownership.DIRECTORY:
            # Others take this agent for the directory: its own key-frames belong there too, and need no message.
            self.recall({self.state.me: len(self.state.keyframes)})
        respond = self._answer_as_owner if isinstance(task, OwnerQuery) else self._answer
        answer: Outcome = respond(contract.manager, task.keyframe, vector)
        self.context.say(contract, Confirmation())
        self.context.say(contract, Result(answer))

    def _answer(self, asker: int, keyframe: int, vector: NDArray[np.float32]) -> PlaceAnswer | EarlierAnswer:
        found = self._latest.nearest(asker, keyframe, vector)
        if found is None:
            return PlaceAnswer(None, _FARTHEST)
        return PlaceAnswer(*found[1:]) if found[0] == keyframe else EarlierAnswer(*found)

    def _answer_as_owner(self, asker: int, keyframe: int, vector: NDArray[np.float32]) -> PlaceRedirect:
        found = self._cluster.nearest(vector, asker)
        self._cluster.remember(asker, keyframe, vector)
        if found is None:
            return PlaceRedirect(None, None, _FARTHEST)
        return PlaceRedirect(found[0], found[1], self.book.restored(found[2]))

    def _coded(self, keyframe: int) -> NDArray[np.uint8]:
        return self.state.profile.coder.encode(self.state.keyframes[keyframe].vector[None])[0]

    def _decoded(self, query: PlaceQuery) -> NDArray[np.float32]:
        profile = self.state.profile
        if query.language != profile.language:
            mine = f"{profile.coder.key} of {profile.model[:16]} ({profile.language:08x})"
            raise WorkError(f"place vector of another model or in another code ({query.language:08x}), mine is {mine}")
        try:
            return profile.coder.decode(np.frombuffer(query.vector, dtype=np.uint8)[None])[0]
        except DescriptorError as error:
            raise WorkError(str(error)) from error

    def on_result(self, contract: Contract, outcome: Outcome) -> None:
        keyframe = self._asked.get(contract.id)
        if not isinstance(outcome, PlaceAnswer | EarlierAnswer | PlaceRedirect) or keyframe is None:
            raise WorkError("not the answer to this query")
        other = contract.contractor
        self._consider(keyframe, other, outcome)
        self.distances[other] = outcome.distance
        sure = min(self.threshold, self.state.profile.strict_threshold or self.threshold)
        if outcome.distance < sure and self.state.profile.ownership is Ownership.NONE:
            self._catch_up(other)

    def _catch_up(self, other: int) -> None:
        """Where one key-frame was recognised for certain, ask about those of the latest that this agent was not asked
        about: one match may fail its verification or find no support (thesis section 4.3)."""
        newest, latest = len(self.state.keyframes) - 1, self.state.config.places.latest_frames
        if latest > 1:
            for keyframe in sorted(set(range(max(newest - latest + 1, 0), newest + 1)) - self.told.to(other)):
                self.ask(keyframe, [other])

    def _consider(self, keyframe: int, other: int, answer: PlaceAnswer | EarlierAnswer | PlaceRedirect) -> None:
        """Have the match that an answer names verified, if it is near enough."""
        if isinstance(answer, EarlierAnswer):
            if answer.query not in self.told.to(other):
                raise WorkError(f"agent {other} was not asked about key-frame {answer.query}")
            keyframe = answer.query
        elif isinstance(answer, PlaceRedirect) and answer.agent is not None:
            other = answer.agent
            if other not in self.state.profile.others:
                raise WorkError(f"redirected to agent {other}, which cannot be asked")
        if answer.keyframe is not None and answer.distance < self.threshold:
            match = MatchId(self.state.me, keyframe, other, answer.keyframe)
            self.verification.request(Candidate(match, self.context.now_ns, answer.distance))

    def _ask_own_log(self, keyframe: int) -> None:
        """The agent owns the cluster of its own key-frame: no message needed. It compares what would have travelled."""
        vector = self.state.profile.coder.decode(self._coded(keyframe)[None])[0]
        self._consider(keyframe, self.state.me, self._answer_as_owner(self.state.me, keyframe, vector))

    def on_end(self, contract: Contract) -> None:
        if contract.manager != self.state.me:
            return
        keyframe = self._asked.get(contract.id)
        if keyframe is not None:
            again = self._again.wanted(contract, keyframe)
            self.told.ended(contract, keyframe, again)
            if again:
                self._waiting.setdefault(contract.contractor, deque()).append(keyframe)
        if not self.context.ledger.managed(contract.id):
            self._asked.pop(contract.id, None)
        self._next([contract.contractor])

    def resume(self) -> None:
        """Go on with agents that could not be called for a while."""
        others = [a for a in sorted(self._waiting) if self._waiting[a]]
        if others:
            self._next(others)

    def _next(self, others: Iterable[int]) -> None:
        """Call those who are free: one call for all who are asked about the same key-frame."""
        busy = {c.contractor for c in self.context.ledger.running(OperationKind.DVPR) if c.manager == self.state.me}
        wanted: dict[int, list[int]] = {}
        for other in others:
            if self._waiting.get(other) and other not in busy and self.context.may_call(other):
                wanted.setdefault(self._waiting[other].popleft(), []).append(other)
        for keyframe, agents in sorted(wanted.items()):
            identity, _ = self.context.call(OperationKind.DVPR, agents)
            self._asked[identity] = keyframe

    # -- own loop closures --------------------------------------------------------------------------------------------

    def close_own_loop(self, keyframe: KeyFrame) -> None:
        """Compare a key-frame with the agent's own much earlier ones, and verify the nearest: no message needed."""
        newest = self._newest_candidate(keyframe)
        if not keyframe.textured or not newest:
            return
        found = self.book.nearest(keyframe.vector, below=newest)
        if found is None or found[1] >= self.threshold:
            return
        me = self.state.me
        candidate = Candidate(MatchId(me, keyframe.index, me, found[0]), self.context.now_ns, found[1])
        if self.book.propose(candidate):
            self._verify_own(candidate, keyframe, self.state.keyframes[found[0]])

    def _newest_candidate(self, keyframe: KeyFrame) -> int:
        """How many of the first key-frames are loop candidates: those old enough, and all of earlier tracks, which
        no odometry links to this one."""
        config = self.state.config.places
        times = [k.time_ns for k in self.state.keyframes]
        by_age = int(np.searchsorted(times, keyframe.time_ns - round(config.own_age_s * 1e9), side="right"))
        by_count = 0 if config.own_age_keyframes is None else keyframe.index - config.own_age_keyframes + 1
        earlier_tracks = self.state.piece_of(keyframe.index).first
        return min(max(by_age, by_count, earlier_tracks), keyframe.index)

    def _verify_own(self, candidate: Candidate, query: KeyFrame, match: KeyFrame) -> None:
        verdict = verify(self.state, candidate.id, view_of(self.state, query), match)
        reason = verdict.reason
        good = verdict.accepted and verdict.T_M_Q is not None and verdict.information is not None
        learned = None
        if good and verdict.T_M_Q is not None and verdict.information is not None:
            learned = Match(
                candidate.id,
                query.track,
                match.track,
                verdict.T_M_Q,
                verdict.information,
                verdict.inliers,
                query.T_T_C,
                match.T_T_C,
                self.state.travelled[query.index],
                self.state.travelled[match.index],
                match.depth,
            )
            if not self._plausible(learned):
                learned, reason = None, "beyond odometry's drift"
        self.book.update(
            candidate.id,
            verified=learned is not None,
            reason=kind_of(reason),
            detail=reason,
            T_M_Q=verdict.T_M_Q,
            matches=verdict.matches,
            inliers=verdict.inliers,
            rmse=float(verdict.rmse) if np.isfinite(verdict.rmse) else None,
        )
        if learned is not None:
            self.verification.learn(learned)

    def _plausible(self, match: Match) -> bool:
        """Within one track the loop may not move the query farther than odometry can have drifted on the way."""
        if match.query_track != match.match_track:
            return True
        config = self.state.config.consistency
        way = self.state.travelled[match.id.query] - self.state.travelled[match.id.match]
        moved = match.joins() @ match.T_T_Q[:3, 3] - match.T_T_Q[:3, 3]
        return float(np.linalg.norm(moved)) <= config.depth_share * match.depth + config.loop_drift * way
