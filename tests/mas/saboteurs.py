"""Agents that misbehave, each in one way, and runs with them in memory."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import msgspec
import numpy as np

from maslam.backend.geometry import Sim3, se3, so3_exp
from maslam.mas.agent import Agent
from maslam.mas.config import MasConfig
from maslam.mas.contracts.effects import NOTHING, Effects
from maslam.mas.evaluation.ground_truth import GroundTruthEvaluator
from maslam.mas.manifest import Manifest
from maslam.mas.policies.base import Outlook, Policy
from maslam.mas.policies.presets import policy_of
from maslam.mas.policies.query_all import QueryAll
from maslam.mas.protocol.messages import Message, Result, encode
from maslam.mas.protocol.solver_messages import SolverBody
from maslam.mas.protocol.tasks import VerifyAnswer
from maslam.mas.protocol.tensors import pack_information, pack_sim3, unpack_poses
from maslam.mas.sequence import AgentSequence
from maslam.mas.simulation import Environment, make_agents, make_transport
from maslam.mas.state.agent_state import AgentState, Profile
from maslam.mas.state.keyframe import keyframes_of
from maslam.mas.transport.transport import Transport


class Saboteur(Agent):
    """An agent whose every outgoing message passes :meth:`spoil`."""

    def handle(self, message: Message) -> Effects:
        return self._spoilt(super().handle(message))

    def tick(self, now_ns: int) -> Effects:
        return self._spoilt(super().tick(now_ns))

    def remind(self, now_ns: int) -> Effects:
        return self._spoilt(super().remind(now_ns))

    def _spoilt(self, effects: Effects) -> Effects:
        return replace(effects, messages=tuple(self.spoil(list(effects.messages))))

    def spoil(self, messages: list[Message]) -> list[Message]:
        raise NotImplementedError


class Idler(Saboteur):
    """Bids, confirms, and never delivers."""

    def spoil(self, messages: list[Message]) -> list[Message]:
        return [m for m in messages if not isinstance(m.body, Result | SolverBody)]


class Liar(Saboteur):
    """Finds every place that it is asked to verify, with many inliers, elsewhere. ``lies``: how many."""

    lies = 0

    def spoil(self, messages: list[Message]) -> list[Message]:
        return [self._lie(m, m.body.outcome) if isinstance(m.body, Result) else m for m in messages]

    def _lie(self, message: Message, outcome: object) -> Message:
        if not isinstance(outcome, VerifyAnswer):
            return message
        self.lies += 1
        changed = {
            "accepted": True,
            "reason": "accepted",
            "inliers": 300,
            "matches": 300,
            "rmse": 0.01,
            "wants_more": False,
            "T_M_Q": pack_sim3(self.invented(outcome)),
            "information": pack_information(1e5 * np.eye(6)),
        }
        return msgspec.structs.replace(message, body=Result(msgspec.structs.replace(outcome, **changed)))

    def invented(self, outcome: VerifyAnswer) -> Sim3:
        """Another nonsense each time."""
        rng = np.random.default_rng(self.lies)
        return Sim3.from_se3(se3(so3_exp([0.0, rng.uniform(-3, 3), 0.0]), rng.uniform(-20, 20, 3)))


class _CallsForNone(QueryAll):
    def optimise(self, state: AgentState, outlook: Outlook) -> list[int]:
        return []


class Swindler(Liar):
    """Its lies agree with each other: all of its map is claimed to be 15 m beside where it is. It leaves it to others
    to call for optimisations."""

    def __init__(self, profile: Profile, config: MasConfig, policy: Policy) -> None:
        super().__init__(profile, config, policy)
        self.policy = _CallsForNone()

    @property
    def quiet(self) -> bool:
        return self.context.closing and not self.context.ledger.running()

    def invented(self, outcome: VerifyAnswer) -> Sim3:
        T_T_M = Sim3.from_se3(unpack_poses(outcome.T_T_M.array()))
        beside = Sim3.from_se3(se3(np.eye(3), [15.0, 0.0, 0.0]))
        true = Sim3.identity() if outcome.T_M_Q is None else _sim3(outcome)
        return T_T_M.inverse() @ beside @ T_T_M @ true


def _sim3(outcome: VerifyAnswer) -> Sim3:
    from maslam.mas.protocol.tensors import unpack_sim3

    assert outcome.T_M_Q is not None
    return unpack_sim3(outcome.T_M_Q)


class Sleeper(Saboteur):
    """Neither hears nor says anything between the two times of ``ASLEEP_S``."""

    ASLEEP_S = (0.0, 0.0)

    @property
    def asleep(self) -> bool:
        return self.ASLEEP_S[0] <= self.context.now_ns / 1e9 < self.ASLEEP_S[1]

    def handle(self, message: Message) -> Effects:
        return NOTHING if self.asleep else super().handle(message)

    def spoil(self, messages: list[Message]) -> list[Message]:
        return [] if self.asleep else messages


def _overheard(transport: Transport, listen: Callable[[Message, int], None]) -> None:
    """Have ``listen`` hear every message that is sent, whether it arrives or not, with its wire bytes."""
    send = transport.send

    def heard(message: Message, now_ns: int, handed_by: int | None = None) -> None:
        send(message, now_ns, handed_by)
        listen(message, len(encode(message)))

    transport.send = heard  # type: ignore[method-assign]


def live(
    manifest: Manifest,
    sequences: Sequence[AgentSequence],
    config: MasConfig,
    saboteurs: Mapping[int, type[Agent]] | None = None,
    limit: int = 600,
    watch: Callable[[list[Agent], list[Any]], None] | None = None,
    listen: Callable[[Message, int], None] | None = None,
) -> tuple[Environment, GroundTruthEvaluator]:
    """A run in memory, until all agents are quiet; an error if they never are. ``watch``: called after each step with
    the agents and their true poses. ``listen``: hears every message, with its wire bytes."""
    agents = make_agents(manifest, sequences, config)
    for number, kind in (saboteurs or {}).items():
        agents[number] = kind(agents[number].state.profile, config, policy_of(config, number))
    transport = make_transport(config, lambda sent: None)
    if listen is not None:
        _overheard(transport, listen)
    environment = Environment(agents, [keyframes_of(s) for s in sequences], transport, config)
    for step in range(limit):
        environment.step(step)
        if watch is not None:
            watch(environment.agents, [s.groundtruth.poses for s in sequences if s.groundtruth is not None])
        if step + 1 >= environment.steps and environment.over:
            return environment, GroundTruthEvaluator(sequences)
    raise AssertionError(f"not over after {limit} steps")
