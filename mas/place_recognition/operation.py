"""Place recognition between agents and with oneself (thesis section 3.5): whose key-frame looks most like this one?"""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from maslam.descriptors.errors import DescriptorError

from ..contracts.context import AgentContext
from ..contracts.contract import Contract
from ..contracts.effects import NOTHING, Effects, total
from ..contracts.ledger import at_once
from ..contracts.operation import Answer, Operation, WorkError
from ..contracts.retries import RetryBudget
from ..policies.utility import PLACE_ANSWER_BYTES
from ..protocol.ids import ContractId, MatchId, OperationKind
from ..protocol.messages import Award, Bid, Call, Confirmation, Rejection, Result
from ..protocol.tasks import EarlierAnswer, OwnerQuery, PlaceAnswer, PlaceQuery, PlaceRedirect
from ..state.agent_state import Ownership
from ..state.keyframe import KeyFrame
from .candidates import Candidate, Candidates
from .overlap_ends import OverlapEnds
from .own_loops import FARTHEST, OwnLoops
from .peer_queries import ClusterIndex, LoggedPlaces, RecentQueries
from .sent_queries import SentQueries
from .verification import Verification
from .wider_search import WiderSearch

# Ticks after all sequences are over until answers to the last queries are in.
_SETTLED = 4

Found = PlaceAnswer | EarlierAnswer | PlaceRedirect


class PlaceRecognition(Operation[PlaceQuery, Found]):
    """Manager: sends the vector of one of its key-frames; contractor: answers with its own nearest key-frame and the
    distance. Where clusters of vectors have owners, the owner answers with the nearest key-frame it was asked about,
    whoever's it is.

    ``distances``: how near each agent's last answer came, 0 to 2.
    """

    kind = OperationKind.DVPR

    def __init__(self, context: AgentContext, candidates: Candidates, verification: Verification) -> None:
        super().__init__(context)
        self.candidates = candidates
        self.verification = verification
        self.own_loops = OwnLoops(context, candidates, verification)
        self._waiting: dict[int, deque[int]] = {}
        self._asked: dict[ContractId, int] = {}
        self._asked_ns: dict[int, int] = {}
        self._cluster = ClusterIndex()
        self._latest = RecentQueries(candidates, context.state.config.places.latest_frames)
        self.sent_queries = SentQueries()
        self.wider = WiderSearch(candidates)
        self.ends = OverlapEnds(candidates)
        self._closing_ticks = 0
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

    @property
    def wide_threshold(self) -> float:
        """The same for agents and tracks that are not in one frame yet: never below :attr:`threshold`."""
        widened = self.state.config.places.widen_keyframes is not None
        return max(self.threshold, self.state.profile.threshold) if widened else self.threshold

    def ask(self, keyframe: int, others: Iterable[int]) -> Effects:
        """Ask these agents about a key-frame, after those already waiting for them; the agent itself: where it owns
        the cluster."""
        if not self.state.keyframes[keyframe].textured:
            return NOTHING
        asked = set(others)
        self.sent_queries.remember(keyframe)
        for other in asked:
            self.sent_queries.sent(other, keyframe)
        effects = self._ask_own_log(keyframe) if self.state.me in asked else NOTHING
        for other in sorted(asked - {self.state.me}):
            self._waiting.setdefault(other, deque()).append(keyframe)
        return effects + self._next(sorted(self._waiting))

    def recall(self, wanted: Mapping[int, int]) -> Effects:
        """Tell these agents of so many earlier key-frames each that they do not know, the oldest first, and only when
        no others wait for them: new ones go first."""
        effects = NOTHING
        for other, count in sorted(wanted.items()):
            for keyframe in [] if self._waiting.get(other) else self.sent_queries.unsent(other)[:count]:
                self.candidates.recall(keyframe)
                effects += self.ask(keyframe, [other])
        return effects

    def asked_about(self) -> LoggedPlaces:
        """Key-frames that the agent was asked about as the directory, or as the owner of a cluster."""
        return self._cluster.logged

    def know(
        self, sent: Mapping[int, Iterable[int]], asked: Iterable[Sequence[int]], vectors: NDArray[np.float32]
    ) -> None:
        """Of an earlier run: key-frames ``sent`` to each other agent, and ``asked`` about as the directory."""
        for other, keyframe in [(other, keyframe) for other, all_ in sent.items() for keyframe in all_]:
            self.sent_queries.sent(other, keyframe)
        for (agent, keyframe), vector in zip(asked, vectors, strict=True):
            self._cluster.remember(agent, keyframe, vector)

    def bid(self, contract: Contract, call: Call) -> Answer:
        return Answer(Bid(cost_bytes=PLACE_ANSWER_BYTES, ready_ns=self.context.now_ns))

    def on_bid(self, contract: Contract, bid: Bid) -> Effects:
        keyframe = self._asked.get(contract.id)
        if keyframe is None:
            return self.context.send(contract, Rejection("no longer wanted"))
        profile = self.state.profile
        kind = PlaceQuery if profile.ownership is Ownership.NONE else OwnerQuery
        query = kind(keyframe, profile.language, self._coded(keyframe).tobytes())
        return self.context.send(contract, Award(query))

    def work(self, contract: Contract, task: PlaceQuery) -> Effects:
        vector = self._decoded(task)
        effects = NOTHING
        if self.state.profile.ownership is Ownership.DIRECTORY:
            # Others take this agent for the directory: its own key-frames belong there too, and need no message.
            effects = self.recall({self.state.me: len(self.state.keyframes)})
        respond = self._answer_as_owner if isinstance(task, OwnerQuery) else self._answer
        answer = Result(respond(contract.manager, task.keyframe, vector))
        return effects + self.context.send(contract, Confirmation()) + self.context.send(contract, answer)

    def _answer(self, asker: int, keyframe: int, vector: NDArray[np.float32]) -> PlaceAnswer | EarlierAnswer:
        found = self._latest.nearest(asker, keyframe, vector)
        if found is None:
            return PlaceAnswer(None, FARTHEST)
        if found.query == keyframe:
            return PlaceAnswer(found.keyframe, found.distance)
        return EarlierAnswer(found.query, found.keyframe, found.distance)

    def _answer_as_owner(self, asker: int, keyframe: int, vector: NDArray[np.float32]) -> PlaceRedirect:
        found = self._cluster.nearest(vector, asker)
        self._cluster.remember(asker, keyframe, vector)
        if found is None:
            return PlaceRedirect(None, None, FARTHEST)
        return PlaceRedirect(found.agent, found.keyframe, self.candidates.restored(found.distance))

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

    def objection(self, contract: Contract, outcome: Found) -> str:
        if contract.id not in self._asked:
            return "not the answer to a query"
        other = contract.contractor
        if isinstance(outcome, EarlierAnswer) and outcome.query not in self.sent_queries.to(other):
            return f"agent {other} was not asked about key-frame {outcome.query}"
        if isinstance(outcome, PlaceRedirect) and outcome.agent not in (None, *self.state.profile.others):
            return f"redirected to agent {outcome.agent}, which cannot be asked"
        return ""

    def on_result(self, contract: Contract, outcome: Found) -> Effects:
        other = contract.contractor
        effects = self._consider(self._asked[contract.id], other, outcome)
        self.distances[other] = outcome.distance
        sure = min(self.threshold, self.state.profile.strict_threshold or self.threshold)
        if outcome.distance < sure and self.state.profile.ownership is Ownership.NONE:
            effects += self._catch_up(other)
        return effects

    def _catch_up(self, other: int) -> Effects:
        """Where one key-frame was recognised for certain, ask about those of the latest that this agent was not asked
        about: one match may fail its verification or find no support (thesis section 4.3)."""
        newest, latest = len(self.state.keyframes) - 1, self.state.config.places.latest_frames
        if latest <= 1:
            return NOTHING
        unasked = sorted(set(range(max(newest - latest + 1, 0), newest + 1)) - self.sent_queries.to(other))
        return total(self.ask(keyframe, [other]) for keyframe in unasked)

    def _consider(self, keyframe: int, other: int, answer: Found) -> Effects:
        """Have the match that an answer names verified, if it is near enough."""
        said_by = other
        if isinstance(answer, EarlierAnswer):
            keyframe = answer.query
        elif isinstance(answer, PlaceRedirect) and answer.agent is not None:
            other = answer.agent
        if answer.keyframe is None or answer.distance >= self.wide_threshold:
            return NOTHING
        match = MatchId(self.state.me, keyframe, other, answer.keyframe)
        named_by = said_by if other != said_by else None
        candidate = Candidate(match, self.context.now_ns, answer.distance, named_by=named_by)
        if answer.distance < self.threshold:
            return self.verification.request(candidate)
        self.wider.keep(candidate)
        return NOTHING

    def widen(self) -> Effects:
        """Have candidates beyond the strict distance verified, while agents are not in one frame."""
        effects = NOTHING
        self._closing_ticks += self.context.closing
        # What was asked last may still join them.
        if self.context.closing and self._closing_ticks < _SETTLED:
            return effects
        for candidate in self.wider.due(self.context.closing):
            match, keyframes = candidate.id, self.state.keyframes
            if match.match_agent == self.state.me:
                effects += self.own_loops.consider(keyframes[match.query], keyframes[match.match], None, wider=True)
            elif self.context.may_call(match.match_agent, OperationKind.RELPOSE):
                effects += self.verification.request(replace(candidate, now_ns=self.context.now_ns))
        for candidate in self._ends_due(self._closing_ticks - _SETTLED):
            effects += self.verification.insist(replace(candidate, now_ns=self.context.now_ns))
        return effects

    def _ends_due(self, ticks: int) -> list[Candidate]:
        """Skipped candidates at the ends of shared stretches that are worth a verification so long after the end. One
        after the other: what comes of one says whether the next is worth it."""
        if not self.context.closing or not self.state.config.places.closing_ends:
            return []
        due = [c for c in self.ends.due(ticks) if not self.verification.busy_with(c.id.match_agent)]
        return [c for c in due if self.context.may_call(c.id.match_agent, OperationKind.RELPOSE)]

    @property
    def widening(self) -> bool:
        """Whether there are candidates to be verified before the agent is done."""
        others = (c.id.match_agent for c in self.wider.due(self.context.closing))
        wider = any(other == self.state.me or self.context.may_call(other) for other in others)
        return wider or bool(self._ends_due(_SETTLED))

    def _ask_own_log(self, keyframe: int) -> Effects:
        """The agent owns the cluster of its own key-frame: no message needed. It compares what would have travelled."""
        vector = self.state.profile.coder.decode(self._coded(keyframe)[None])[0]
        return self._consider(keyframe, self.state.me, self._answer_as_owner(self.state.me, keyframe, vector))

    def on_end(self, contract: Contract) -> Effects:
        if contract.manager != self.state.me:
            return NOTHING
        keyframe = self._asked.get(contract.id)
        if keyframe is not None:
            again = self._again.wanted(contract, keyframe, self._out_of_reach(contract.contractor))
            self.sent_queries.ended(contract, keyframe, again)
            if again:
                self._waiting.setdefault(contract.contractor, deque()).append(keyframe)
        if not self.context.ledger.managed(contract.id):
            self._asked.pop(contract.id, None)
        return self._next([contract.contractor])

    def _out_of_reach(self, other: int) -> bool:
        """Whether questions wait until a silent agent answers again: where others can answer them, they do."""
        return self.state.profile.ownership is Ownership.NONE and self.context.may_come_back(other)

    @property
    def unasked(self) -> bool:
        """Whether questions wait for an agent that can be asked, or may come back."""
        waiting = [other for other, keyframes in self._waiting.items() if keyframes]
        return any(self.context.may_call(other) or self._out_of_reach(other) for other in waiting)

    def resume(self) -> Effects:
        """Go on with agents that could not be called for a while."""
        return self._next([a for a in sorted(self._waiting) if self._waiting[a]])

    def _next(self, others: Iterable[int]) -> Effects:
        """Call those who are free: one call for all who are asked about the same key-frame. Another before the answer
        is in only where that takes time."""
        running = Counter(c.contractor for c in self.context.ledger.running(self.kind) if c.manager == self.state.me)
        free = {a for a in others if not running[a] or (running[a] < at_once(self.kind) and self._answers_late(a))}
        wanted: dict[int, list[int]] = {}
        for other in others:
            if self._waiting.get(other) and other in free and self.context.may_call(other):
                wanted.setdefault(self._waiting[other].popleft(), []).append(other)
        effects = NOTHING
        for keyframe, agents in sorted(wanted.items()):
            call = self.context.call(OperationKind.DVPR, agents)
            self._asked[call.identity] = keyframe
            self._asked_ns.update(dict.fromkeys(call.contractors, self.context.now_ns))
            effects += call.effects
        return effects

    def _answers_late(self, other: int) -> bool:
        """Whether the last question to the other is some time ago, and not answered yet."""
        return self._asked_ns.get(other, 0) < self.context.now_ns

    def close_own_loop(self, keyframe: KeyFrame) -> Effects:
        """Compare a key-frame with the agent's own much earlier ones, and verify the nearest: no message needed."""
        return self.own_loops.close(keyframe, self.threshold, self.wide_threshold)
