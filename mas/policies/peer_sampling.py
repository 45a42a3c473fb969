"""Sampling of the agents to ask for a place (thesis section 3.9.2, Algorithm 4): at random, likely ones more often."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from collections.abc import Set as AbstractSet

import numpy as np
from numpy.typing import NDArray

# Algorithm 4's factors.
_GROUPED = 6.0
_SELECTED = 4.0
_NOT_SELECTED = 6.0
FLOOR = 0.01
"""Least product of index and distance factor: without it the farthest of the last answers has weight 0, and so have
all when they were equally far, and nobody could be drawn."""


def weights(
    others: Sequence[int], group: AbstractSet[int], previous: AbstractSet[int], distances: Mapping[int, float]
) -> NDArray[np.float64]:
    """Probabilities ``(N,)`` of asking each of ``others``, sum 1; Algorithm 4.

    ``previous``: whom the last selection named; ``distances``: how near each one's answer came, 0 to 2; who gave none
    counts as the farthest. In print the distance factor is never positive; ``(max - distance) / max`` is meant. The
    nearest has index 0; equal distances go by agent number.
    """
    weight = {a: 1.0 / len(others) for a in others}
    for agent in group & weight.keys():
        weight[agent] *= _GROUPED
    asked = sorted(previous & weight.keys())
    far = max((distances[a] for a in asked if a in distances), default=0.0)
    ranked = sorted(asked, key=lambda a: (distances.get(a, far), a not in distances, a))
    for index, agent in enumerate(ranked):
        index_factor = (len(ranked) - index) / len(ranked)
        distance_factor = (far - distances.get(agent, far)) / far if far > 0 else 0.0
        weight[agent] *= _SELECTED * max(index_factor * distance_factor, FLOOR)
    for agent in weight.keys() - previous:
        weight[agent] *= _NOT_SELECTED
    found = np.array([weight[a] for a in others])
    return found / found.sum() if len(found) else found


def draw(others: Sequence[int], probabilities: NDArray[np.float64], draws: int, rng: np.random.Generator) -> list[int]:
    """The distinct agents among ``draws`` drawn with replacement, sorted: at most ``draws``, often fewer."""
    if not len(others) or draws <= 0:
        return []
    return sorted({int(a) for a in rng.choice(np.asarray(others), size=draws, replace=True, p=probabilities)})
