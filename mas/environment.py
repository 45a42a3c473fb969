"""The environment (thesis section 3.8.1): it sets agents up, carries their messages, and ends the run. Nothing else:
it takes no decision for an agent and shows none of them the truth.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from pathlib import Path

from descriptors.card import model_path
from descriptors.codes import Coder
from descriptors.errors import DescriptorError
from mas.agent import Agent
from mas.config import MasConfig
from mas.errors import MasError
from mas.keyframe import KeyFrame, keyframes_of
from mas.messages import Message
from mas.metrics import Onlooker, groups_of
from mas.policy.clusters import centres_before
from mas.policy.presets import policy_of
from mas.recorder import Recorder, match_errors
from mas.report import summarise
from mas.sequence import AgentSequence, Manifest
from mas.state import Profile
from mas.summary import Summary
from mas.transport import InProcessTransport, Traffic, Transport

# Steps after the last key-frame, beside the rounds of purchases: for optimisations still wanted and contracts to
# expire.
_CLOSING_STEPS = 20

Progress = Callable[[int, int], None]


class Environment:
    """Agents side by side in logical time: each gets its next key-frames when its own time has come."""

    def __init__(
        self, agents: Sequence[Agent], keyframes: Sequence[list[KeyFrame]], transport: Transport, config: MasConfig
    ) -> None:
        self.agents = list(agents)
        self.keyframes = [list(k) for k in keyframes]
        self.transport = transport
        self.config = config
        self.now_ns = 0
        self._next = [0] * len(self.agents)

    @property
    def steps(self) -> int:
        """Steps until the last key-frame, not counting the closing ones."""
        last = max((k[-1].time_ns for k in self.keyframes if k), default=0)
        return -(-max(last, 0) // self._step_ns) + 1

    @property
    def _step_ns(self) -> int:
        return round(self.config.step_s * 1e9)

    def step(self, number: int) -> None:
        """One step: key-frames whose time has come, a tick for each agent, then all messages until none is on the
        way."""
        self.now_ns = number * self._step_ns
        for agent, keyframes in zip(self.agents, self.keyframes, strict=True):
            self._feed(agent, keyframes)
        if self._next == [len(k) for k in self.keyframes]:
            for agent in self.agents:
                agent.finish()
        for agent in self.agents:
            self._send(agent.tick(self.now_ns))
        self._deliver()

    def _feed(self, agent: Agent, keyframes: list[KeyFrame]) -> None:
        me = agent.state.me
        while self._next[me] < len(keyframes) and keyframes[self._next[me]].time_ns <= self.now_ns:
            agent.observe(keyframes[self._next[me]])
            self._next[me] += 1

    def _send(self, messages: Sequence[Message]) -> None:
        for message in messages:
            self.transport.send(message, self.now_ns)

    def _deliver(self) -> None:
        delivered = 0
        while (message := self.transport.receive()) is not None:
            self._send(self.agents[message.recipient].handle(message))
            delivered += 1
            if delivered > self.config.max_messages_a_step:
                raise MasError(
                    f"more than {delivered - 1} messages at {self.now_ns / 1e9:.1f} s: agents talk without end"
                )

    @property
    def over(self) -> bool:
        """Whether all agents have seen their sequence and have nothing left to do."""
        return all(agent.quiet for agent in self.agents)


def run(
    manifest: Manifest,
    sequences: Sequence[AgentSequence],
    config: MasConfig,
    out: Path,
    progress: Progress | None = None,
) -> Summary:
    """Run the multi-agent system on agent sequences and write the RUN folder ``out``, whole or not at all.

    ``progress(done, total)`` counts steps. Same sequences, config and seed: same bytes in every file, wall times apart.
    """
    started = time.perf_counter()
    keyframes = [keyframes_of(sequence) for sequence in sequences]
    agents = make_agents(manifest, sequences, config)
    onlooker = Onlooker(sequences)
    with Recorder(out) as recorder:
        transport = InProcessTransport(round(config.max_message_mb * 2**20), recorder.sent)
        environment = Environment(agents, keyframes, transport, config)
        recorder.begin_timeline(len(agents))
        steps = _play(environment, onlooker, recorder, progress)
        errors = match_errors(agents, onlooker)
        recorder.settings(config, manifest)
        recorder.events(event for agent in agents for event in agent.diary)
        recorder.matches(agents, errors)
        for agent, sequence in zip(agents, sequences, strict=True):
            recorder.agent(agent, sequence)
        summary = summarise(agents, sequences, config, onlooker, transport, errors, steps)
        duration = max((k[-1].time_ns for k in keyframes if k), default=0) / 1e9
        wall = time.perf_counter() - started
        timed = {"duration_s": duration, "wall_s": wall, "realtime_factor": duration / wall}
        summary = summary.model_copy(update=timed)
        recorder.summary(summary)
    return summary


def make_agents(manifest: Manifest, sequences: Sequence[AgentSequence], config: MasConfig) -> list[Agent]:
    """One agent a sequence; sequences of different descriptor models or scales do not go together."""
    if not sequences:
        raise MasError("no agents to run")
    wanted = manifest.descriptor
    coder = coder_of(manifest, config.places.code)
    centres = centres_before(manifest, sequences, config, coder) if config.policy == "clustered" else None
    agents = []
    for me, sequence in enumerate(sequences):
        if (sequence.places.sha256, sequence.places.dim) != (wanted.sha256, wanted.dim):
            raise MasError(
                f"{sequence.name}: place vectors of model {sequence.places.name} ({sequence.places.sha256[:12]}, "
                f"{sequence.places.dim} numbers), the others have {wanted.name} ({wanted.sha256[:12]}, {wanted.dim})"
            )
        if sequence.metric != (manifest.scale == "metric"):
            raise MasError(f"{sequence.name}: its scale is not {manifest.scale} like that of the others")
        others = tuple(a for a in range(len(sequences)) if a != me)
        profile = Profile(me, others, sequence.metric, wanted.sha256, wanted.threshold, coder, centres)
        agents.append(Agent(profile, config, policy_of(config, me)))
    return agents


def coder_of(manifest: Manifest, code: str) -> Coder:
    """How place vectors travel. Product codes look for their codebooks beside the model that preprocessing used; an
    error where they are not there or belong to other weights."""
    wanted = manifest.descriptor
    model = str(manifest.settings.get("model", "default"))
    try:
        return Coder.make(code, wanted.dim, wanted.sha256, model_path(model))
    except DescriptorError as error:
        raise MasError(f"{error}, or choose another code (places.code)") from error


def _play(environment: Environment, onlooker: Onlooker, recorder: Recorder, progress: Progress | None) -> int:
    """Step until all agents are done; returns how many steps that took."""
    total = environment.steps
    limit = total + environment.config.merge.closing_rounds + _CLOSING_STEPS
    for number in range(limit):
        environment.step(number)
        recorder.step(timeline_row(number, environment, onlooker))
        if progress is not None:
            progress(min(number + 1, total), total)
        if number + 1 >= total and environment.over:
            return number + 1
    return limit


def timeline_row(number: int, environment: Environment, onlooker: Onlooker) -> list[object]:
    """What ``timeline.csv`` says about a step; errors are empty without truth."""
    from mas.trajectories import keyframe_trajectory

    agents = environment.agents
    own = [onlooker.error_of(a.state.me, keyframe_trajectory(a.state)) for a in agents]
    maps = [onlooker.map_error(a)[0] for a in agents]
    accepted = len({m for a in agents for m in a.state.accepted})
    counts = [environment.transport.by_operation[t] for t in Traffic]
    return [
        number,
        environment.now_ns / 1e9,
        sum(len(a.state.keyframes) for a in agents),
        len(groups_of(agents)),
        accepted,
        *(None if e is None else e.rmse_m for e in own),
        *(None if e is None else e.rmse_m for e in maps),
        *(value for c in counts for value in (c.payload_bytes, c.wire_bytes)),
    ]
