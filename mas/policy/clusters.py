"""Who owns which place vectors (thesis sections 2.2.3 and 3.5): the nearest of as many k-means centres as there are
agents, given to all beforehand."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from descriptors.clusters import k_means
from mas.errors import MasError

_ITERATIONS = 30


def centres_of(vectors: NDArray[np.float32], agents: int, rng: np.random.Generator) -> NDArray[np.float32]:
    """Centres ``(agents, d)`` of place vectors ``(n, d)``: cluster k belongs to agent k."""
    if len(vectors) < agents:
        raise MasError(f"clusters of place vectors: {agents} agents need as many vectors at least, got {len(vectors)}")
    return k_means(np.ascontiguousarray(vectors, dtype=np.float32), agents, _ITERATIONS, rng)


def owner_of(vector: NDArray[np.float32], centres: NDArray[np.float32]) -> int:
    """The agent that owns the cluster of a vector ``(d,)``; the lower number of equals."""
    return int(np.linalg.norm(centres - vector, axis=1).argmin())
