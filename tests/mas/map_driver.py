"""An agent driving alone, for tests of how its map is sold."""

from __future__ import annotations

from functools import cache

import numpy as np
from factory import circuit, make_sequence, make_world, manifest_of

from maslam.mas.map_exchange.coding.quantised_map import QuantisedMap
from maslam.mas.policies.presets import preset
from maslam.mas.sequence import AgentSequence
from maslam.mas.simulation import make_agents
from maslam.mas.state.agent_state import AgentState
from maslam.mas.state.keyframe import KeyFrame, keyframes_of

WORLD = make_world(7, points=90_000)
SMALL_WORLD = make_world(12, points=12_000)
SEEN = 12


def driver(keyframes: int = 40, **merge: object) -> tuple[AgentState, list[KeyFrame]]:
    """An agent that has seen nothing yet, and the key-frames that it will see."""
    sequence, frames = _drive(keyframes)
    config = preset("maslam")
    config = config.model_copy(update={"merge": config.merge.model_copy(update={"version_keyframes": 1, **merge})})
    agent = make_agents(manifest_of([sequence]), [sequence], config)[0]
    return agent.state, frames


@cache
def _drive(keyframes: int) -> tuple[AgentSequence, list[KeyFrame]]:
    sequence = make_sequence(WORLD, circuit(0.0, keyframes * 1.5), 7)
    return sequence, keyframes_of(sequence)


def see(state: AgentState, keyframes: list[KeyFrame], count: int) -> None:
    for keyframe in keyframes[len(state.keyframes) : len(state.keyframes) + count]:
        state.observe(keyframe)


def same_map(a: QuantisedMap, b: QuantisedMap) -> bool:
    """Whether two copies hold the same numbers."""
    pairs = zip(vars(a).values(), vars(b).values(), strict=True)
    return all(np.array_equal(x, y) if isinstance(x, np.ndarray) else x == y for x, y in pairs)


# -- one camera --------------------------------------------------------------------------------------------------------


def seen(
    count: int = SEEN, scale: float = 0.5, cuts: tuple[int, ...] = (), **merge: object
) -> tuple[AgentState, list[KeyFrame]]:
    """An agent that has seen its first key-frames; 1: it is metric."""
    sequence = make_sequence(SMALL_WORLD, circuit(0.0, SEEN * 1.5), 12, scale=scale, cuts=cuts)
    config = preset("maslam")
    config = config.model_copy(update={"merge": config.merge.model_copy(update={"version_keyframes": 1, **merge})})
    state = make_agents(manifest_of([sequence]), [sequence], config)[0].state
    keyframes = keyframes_of(sequence)
    for keyframe in keyframes[:count]:
        state.observe(keyframe)
    return state, keyframes


def drift_apart(state: AgentState, per_keyframe: float = 0.03) -> None:
    """What an optimisation does to a track whose unit drifts."""
    for k in range(len(state.keyframes)):
        state.units[k] = 2.0 * float(np.exp(per_keyframe * k))
        state.poses[k] = state.poses[k].copy()
        state.poses[k][:3, 3] *= 2.0 * np.exp(0.5 * per_keyframe * k)
    state.version += 1
