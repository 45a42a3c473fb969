"""Owners of place vectors (thesis sections 2.2.3 and 3.5): the nearest of as many k-means centres as there are
agents, given to all beforehand."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from maslam.descriptors.clusters import k_means
from maslam.descriptors.codes import Coder
from maslam.descriptors.container import PlaceVectors
from maslam.descriptors.errors import DescriptorError

from ..config import MasConfig
from ..errors import MasError
from ..manifest import Manifest
from ..sequence import AgentSequence

_ITERATIONS = 30


def centres_of(vectors: NDArray[np.float32], agents: int, rng: np.random.Generator) -> NDArray[np.float32]:
    """Centres ``(agents, d)`` of place vectors ``(n, d)``: cluster k belongs to agent k."""
    if len(vectors) < agents:
        raise MasError(f"clusters of place vectors: {agents} agents need as many vectors at least, got {len(vectors)}")
    return k_means(np.ascontiguousarray(vectors, dtype=np.float32), agents, _ITERATIONS, rng)


def owner_of(vector: NDArray[np.float32], centres: NDArray[np.float32]) -> int:
    """The agent that owns the cluster of a vector ``(d,)``; the lower number of equals."""
    return int(np.linalg.norm(centres - vector, axis=1).argmin())


def centres_before(
    manifest: Manifest, sequences: Sequence[AgentSequence], config: MasConfig, coder: Coder
) -> NDArray[np.float32]:
    """Centres of clusters of place vectors, one an agent, known before the run: from other images if the settings name
    some, else from the run's own, the best that the predecessor's clusters could be."""
    places = [s.places for s in sequences]
    if config.places.centres_from is not None:
        try:
            places = [PlaceVectors.load(Path(config.places.centres_from))]
        except (DescriptorError, OSError) as error:
            raise MasError(f"places.centres_from: {error}") from error
        if (places[0].sha256, places[0].dim) != (manifest.descriptor.sha256, manifest.descriptor.dim):
            raise MasError(
                f"places.centres_from: {config.places.centres_from} is of model {places[0].name}, the agents' vectors "
                f"are of {manifest.descriptor.name}"
            )
    known = np.concatenate([p.vectors[p.textured] for p in places]).astype(np.float32)
    return centres_of(coder.cut(known), len(sequences), np.random.default_rng([config.seed, len(sequences)]))
