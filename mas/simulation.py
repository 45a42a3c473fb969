"""The environment (thesis section 3.8.1): it sets agents up, carries their messages, and ends the run. Nothing else:
it takes no decision for an agent and shows none of them the truth.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import degrees
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from maslam._kernels import watch_compiling
from maslam._replaced import replaced
from maslam.descriptors.card import model_path
from maslam.descriptors.codes import PRODUCT_CODES, Coder
from maslam.descriptors.errors import DescriptorError
from maslam.extensions import name_of

from .agent import Agent
from .config import AUTO_CODE, MasConfig
from .contracts.effects import Effects, Event
from .errors import MasError
from .evaluation.earlier_map import EarlierMap
from .evaluation.ground_truth import GroundTruthEvaluator
from .evaluation.summarise import FinishedRun
from .evaluation.summary import Summary, Timing
from .manifest import AgentEntry, DescriptorEntry, Manifest
from .output.earlier_run import EarlierRun, joined_manifest, joined_sequences, keep_earlier
from .output.run_folder import Recorder
from .output.saved_agent import SAVED, restore
from .output.whole_run import record_run, timeline_row
from .policies.cluster_owners import centres_before
from .policies.foreign import PolicyLike
from .policies.presets import policy_of
from .sequence import AgentSequence
from .state.agent_state import Ownership, Profile
from .state.keyframe import KeyFrame, keyframes_of
from .state.positions import not_used
from .transport.choice import TransportLike, transport_of
from .transport.faults import FaultyTransport, gone, present
from .transport.transport import RefusedMessage, Sent, Transport

# Steps after the last key-frame, beside the rounds of purchases: for optimisations still wanted and contracts to
# expire.
_CLOSING_STEPS = 20
# Where optimisations take time: as many of their deadlines more, and where radios are slow.
_CLOSING_OPTIMISATIONS, _ON_SLOW_RADIOS = 6, 30

log = logging.getLogger(__name__)
RunProgress = Callable[[int, int], None]


class Environment:
    """Agents side by side in logical time: each gets its next key-frames when its own time has come. ``events``: what
    happened to all of them so far."""

    def __init__(
        self, agents: Sequence[Agent], keyframes: Sequence[list[KeyFrame]], transport: Transport, config: MasConfig
    ) -> None:
        self.agents = list(agents)
        self.keyframes = [list(k) for k in keyframes]
        self.transport = transport
        self.config = config
        self.now_ns = 0
        self.events: list[Event] = []
        self._next = [0] * len(self.agents)

    @property
    def steps(self) -> int:
        """Steps until the last key-frame, not counting the closing ones."""
        last = max((self._due_ns(a, k[-1]) for a, k in enumerate(self.keyframes) if k), default=0)
        return -(-max(last, 0) // self._step_ns) + 1

    @property
    def _step_ns(self) -> int:
        return round(self.config.step_s * 1e9)

    def step(self, number: int) -> None:
        """One step: key-frames whose time has come, a tick for each agent, then all messages until none is on the
        way. Where messages get lost or late, agents are reminded in between, as often as they may have to repeat
        themselves."""
        self._advance(number * self._step_ns)
        for agent, keyframes in zip(self.agents, self.keyframes, strict=True):
            self._feed(agent, keyframes)
        if self._all_seen():
            for agent in self.agents:
                agent.finish()
        for agent in self._there():
            self._act_on(agent.tick(self.now_ns), agent)
        self._deliver()
        if self.config.faults.any:
            self._live_until((number + 1) * self._step_ns)

    def _live_until(self, end_ns: int) -> None:
        """The time between two steps, as long as an answer is owed or a message is on the way."""
        between = round(self.config.link.repeat_s * 1e9)
        while self.now_ns + between < end_ns and (self.transport.waiting or any(a.waiting for a in self._there())):
            self._advance(self.now_ns + between)
            self._deliver()
            for agent in self._there():
                self._act_on(agent.remind(self.now_ns), agent)
            self._deliver()

    def _advance(self, now_ns: int) -> None:
        self.now_ns = now_ns
        self.transport.advance(now_ns)

    def _there(self) -> list[Agent]:
        """Agents that have come and not left."""
        return [a for a in self.agents if present(self.config.faults, a.state.me, self.now_ns)]

    def _due_ns(self, agent: int, keyframe: KeyFrame) -> int:
        return keyframe.time_ns + round(self.config.faults.late_s.get(agent, 0.0) * 1e9)

    def _all_seen(self) -> bool:
        pairs = enumerate(zip(self._next, self.keyframes, strict=True))
        return all(n == len(k) or gone(self.config.faults, a, self.now_ns) for a, (n, k) in pairs)

    def _feed(self, agent: Agent, keyframes: list[KeyFrame]) -> None:
        me = agent.state.me
        while self._next[me] < len(keyframes) and self._due_ns(me, keyframes[self._next[me]]) <= self.now_ns:
            if gone(self.config.faults, me, self.now_ns):
                return
            agent.observe(keyframes[self._next[me]])
            self._next[me] += 1

    def _act_on(self, effects: Effects, agent: Agent) -> None:
        """Send an agent's messages, and log its events. Who hands a message over is known here, whatever it says."""
        self.events += effects.events
        for message in effects.messages:
            self.transport.send(message, self.now_ns, agent.state.me)

    def _deliver(self) -> None:
        delivered = 0
        while (arrived := self.transport.receive()) is not None:
            agent = self.agents[arrived.recipient]
            if isinstance(arrived, RefusedMessage):
                self._act_on(agent.refuse(arrived.sender, arrived.reason), agent)
            else:
                self._act_on(agent.handle(arrived), agent)
            delivered += 1
            if delivered > self.config.max_messages_a_step:
                raise MasError(
                    f"more than {delivered - 1} messages at {self.now_ns / 1e9:.1f} s: the exchange does not end"
                )

    @property
    def over(self) -> bool:
        """Whether all agents have seen their sequence and have nothing left to do."""
        return not self.transport.waiting and all(agent.quiet for agent in self._there())


def run(
    manifest: Manifest,
    sequences: Sequence[AgentSequence],
    config: MasConfig,
    out: Path,
    progress: RunProgress | None = None,
    policy: PolicyLike | None = None,
    transport: TransportLike | None = None,
    onto: EarlierRun | None = None,
) -> Summary:
    """Run the multi-agent system on agent sequences and write the RUN folder ``out``, whole or not at all. ``onto``: a
    finished run whose agents are there from the start, and answer; ``manifest`` and ``sequences`` are the later ones'.

    ``progress(done, total)`` counts steps. ``policy``, ``transport``: a user's own instead of those that ``config``
    names. Same sequences, config and seed: same bytes in every file but ``timing.json``.
    """
    given = {"policy": policy, "transport": transport}
    config = replaced(config, **{key: name_of(own) for key, own in given.items() if own is not None})
    count = 0 if onto is None else len(onto.sequences)
    if onto is not None:
        manifest = joined_manifest(onto, manifest)
        sequences = joined_sequences(onto, manifest, sequences)
    faults = config.faults
    strangers = sorted({*faults.late_s, *faults.leave_s, *faults.blackout_s} - set(range(len(sequences))))
    if strangers:
        raise MasError(f"faults: there is no agent {strangers[0]}, only 0 to {len(sequences) - 1}")
    started = time.perf_counter()
    keyframes = [keyframes_of(sequence) for sequence in sequences]
    agents = make_agents(manifest, sequences, config, policy)
    earlier = None if onto is None else _restored(onto, agents[:count], keyframes, sequences)
    keyframes[:count] = [[] for _ in range(count)]  # they have been driven
    evaluator = GroundTruthEvaluator(sequences, sum(entry.frames for entry in manifest.left_out))
    log.info("%d agents, preset %s, policy %s, seed %d", len(agents), config.preset, config.policy, config.seed)
    with Recorder(out) as recorder, watch_compiling() as compilations:
        if onto is not None:
            keep_earlier(onto, out)
        carrier = make_transport(config, recorder.sent, transport)
        environment = Environment(agents, keyframes, carrier, config)
        recorder.begin_timeline(len(agents))
        steps = _play(environment, evaluator, recorder, progress)
        finished = FinishedRun(
            agents, sequences, config, carrier, environment.events, steps, manifest.left_out, earlier
        )
        summary = record_run(recorder, manifest, finished, evaluator)
        wall = time.perf_counter() - started - compilations.seconds
        recorder.timing(Timing(wall_s=wall, realtime_factor=summary.duration_s / wall))
    log.info("done in %d steps, %.1f s", steps, wall)
    return summary


def _restored(
    onto: EarlierRun,
    agents: Sequence[Agent],
    keyframes: Sequence[list[KeyFrame]],
    sequences: Sequence[AgentSequence],
) -> EarlierMap:
    """Make the agents of an earlier run what they were at its end; returns its map."""
    for agent, own, known in zip(agents, keyframes, onto.known, strict=False):
        restore(agent, own, known, str(onto.folder / sequences[agent.state.me].name / SAVED))
    return EarlierMap(agents, sequences, onto.manifest.scale == "metric")


def make_transport(config: MasConfig, record: Callable[[Sent], None], given: TransportLike | None = None) -> Transport:
    """The transport that is given or set, with the faults that are set."""
    transport = transport_of(config.transport if given is None else given)
    faulty = config.faults.any
    transport.begin(round(config.max_message_mb * 2**20), None if faulty else record)
    return FaultyTransport(transport, config.faults, config.seed, record) if faulty else transport


def make_agents(
    manifest: Manifest, sequences: Sequence[AgentSequence], config: MasConfig, policy: PolicyLike | None = None
) -> list[Agent]:
    """One agent a sequence; sequences of different descriptor models do not go together."""
    if not sequences:
        raise MasError("no agents to run")
    coder = coder_of(manifest, config.places.code)
    policies = [policy_of(config, me, policy) for me in range(len(sequences))]
    ownership = policies[0].ownership
    clustered = ownership is Ownership.CLUSTERS
    for warning in not_used(config.optimisation, any(sequence.positions is not None for sequence in sequences)):
        log.warning(warning)
    centres = centres_before(manifest, sequences, config, coder) if clustered else None
    common = CommonProfile(manifest.descriptor, coder, ownership, centres)
    agents = []
    for me, (entry, sequence) in enumerate(zip(manifest.agents, sequences, strict=True)):
        others = tuple(a for a in range(len(sequences)) if a != me)
        agents.append(Agent(profile_of(me, others, entry, sequence, common), config, policies[me]))
    return agents


@dataclass(frozen=True)
class CommonProfile:
    """What all agents' profiles share: see :class:`~.state.agent_state.Profile`."""

    descriptor: DescriptorEntry
    coder: Coder
    ownership: Ownership
    centres: NDArray[np.float32] | None = None


def profile_of(
    me: int, others: tuple[int, ...], entry: AgentEntry, sequence: AgentSequence, common: CommonProfile
) -> Profile:
    """Who agent ``me`` is, which knows of the ``others``; a sequence of another descriptor model is refused."""
    wanted = common.descriptor
    if (sequence.places.sha256, sequence.places.dim) != (wanted.sha256, wanted.dim):
        raise MasError(
            f"{sequence.name}: place vectors of model {sequence.places.name} ({sequence.places.sha256[:12]}, "
            f"{sequence.places.dim} numbers), the others have {wanted.name} ({wanted.sha256[:12]}, {wanted.dim})"
        )
    pixel_deg = degrees(1.0 / entry.camera.fx)
    limits = (wanted.threshold, common.coder, common.ownership, common.centres, wanted.strict_threshold, pixel_deg)
    return Profile(me, others, sequence.metric, wanted.sha256, *limits)


def coder_of(manifest: Manifest, code: str) -> Coder:
    """The code in which place vectors are sent. Product codes look for their codebooks beside the model that
    preprocessing used; ``MasError`` where they are not there or belong to other weights."""
    wanted = manifest.descriptor
    model = model_path(str(manifest.settings.get("model", "default")))
    if code == AUTO_CODE:
        try:
            return Coder.make(PRODUCT_CODES[0], wanted.dim, wanted.sha256, model)
        except DescriptorError:  # no codebooks, or of other weights: what every model's vectors can be sent as
            code = "int8"
    try:
        return Coder.make(code, wanted.dim, wanted.sha256, model)
    except DescriptorError as error:
        raise MasError(f"{error}, or choose another code (places.code)") from error


def _play(
    environment: Environment, evaluator: GroundTruthEvaluator, recorder: Recorder, progress: RunProgress | None
) -> int:
    """Step until all agents are done; returns how many steps that took."""
    total = environment.steps
    config = environment.config
    limit = total + config.merge.closing_rounds + _CLOSING_STEPS
    if config.faults.any:
        slow = config.faults.rate_kbit is not None
        deadlines = _ON_SLOW_RADIOS if slow else _CLOSING_OPTIMISATIONS
        limit += round(deadlines * config.optimisation.deadline_s / config.step_s)
    for number in range(limit):
        environment.step(number)
        recorder.step(timeline_row(number, environment.now_ns, environment.agents, environment.transport, evaluator))
        if progress is not None:
            progress(min(number + 1, total), total)
        if number + 1 >= total and environment.over:
            return number + 1
    log.info("ended after %d steps with work left", limit)
    return limit
