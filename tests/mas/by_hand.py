"""Agents driven without an environment: what they send, and the events that they logged so far."""

from __future__ import annotations

from typing import Any
from weakref import WeakKeyDictionary

from maslam.mas.agent import Agent
from maslam.mas.contracts.effects import Effects, Event
from maslam.mas.protocol.messages import Message
from maslam.mas.simulation import Environment

_LOGS: WeakKeyDictionary[Agent, list[Event]] = WeakKeyDictionary()


def sent(agent: Agent, effects: Effects) -> list[Message]:
    """The messages among the effects; the events are kept. Nothing else may leave an agent."""
    assert not effects.ended and not effects.changes
    _LOGS.setdefault(agent, []).extend(effects.events)
    return list(effects.messages)


def handled(agents: list[Agent], message: Message) -> list[Message]:
    """What the recipient answers."""
    agent = agents[message.recipient]
    return sent(agent, agent.handle(message))


def ticked(agent: Agent, now_ns: int) -> list[Message]:
    return sent(agent, agent.tick(now_ns))


def begun(agent: Agent, effects: Effects) -> list[Message]:
    """The messages of an operation that was started from outside."""
    return sent(agent, agent._settled(effects))


def logged(agent: Agent, kind: str) -> list[dict[str, Any]]:
    """Fields of an agent's events of one kind, oldest first."""
    return [e.fields for e in _LOGS.get(agent, []) if e.kind == kind]


def happened(environment: Environment, kind: str, agent: int | None = None) -> list[dict[str, Any]]:
    """The same of all agents of an environment, or of one."""
    return [e.fields for e in environment.events if e.kind == kind and agent in (None, e.agent)]
