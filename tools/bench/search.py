"""``maslam bench search``: time and memory of the exact search among all key-frames received so far."""

from __future__ import annotations

import json
import time
import tracemalloc
from collections.abc import Callable
from dataclasses import asdict, dataclass

import numpy as np
from numpy.typing import NDArray

from maslam.descriptors.search import NearestIndex

from ..common.progress import Progress
from ..common.text_table import aligned

_QUERIES = 50
_NOISE = 0.5  # of a second view, as a share of the vector's length: about what another visit of a place changes


@dataclass(frozen=True)
class SearchResult:
    """``new_ms``, ``seen_ms``: a query that resembles nothing, and one near a vector of the index, median;
    ``fastest_ms``: the quickest of all, on a machine with other work the truest; ``product_ms``: median of one float32
    matrix product with all vectors, what a search without bounds starts with; ``add_us``: to append one, mean."""

    vectors: int
    dim: int
    new_ms: float
    seen_ms: float
    fastest_ms: float
    product_ms: float
    add_us: float
    megabytes: float


def bench_search(sizes: tuple[int, ...], dim: int, seed: int, progress: Progress) -> list[SearchResult]:
    """Made-up unit vectors of any direction: nothing tells them apart early, so no search has it harder."""
    # Compiling is not measured.
    two = _unit(np.random.default_rng(0).standard_normal((2, dim), dtype=np.float32))
    _filled(two).nearest(np.ones(dim, dtype=np.float32))
    task, results = progress.start("searching", len(sizes)), []
    for done, size in enumerate(sizes, 1):
        results.append(_measure(size, dim, np.random.default_rng([seed, size])))
        progress.advance(task, done)
    return results


def as_text(results: list[SearchResult]) -> str:
    """A table for people."""
    heads = ["vectors", "numbers", "new ms", "seen ms", "fastest ms", "float32 product ms", "add us", "MB"]
    rows = [
        [
            f"{r.vectors}",
            f"{r.dim}",
            f"{r.new_ms:.2f}",
            f"{r.seen_ms:.2f}",
            f"{r.fastest_ms:.2f}",
            f"{r.product_ms:.2f}",
            f"{r.add_us:.0f}",
            f"{r.megabytes:.1f}",
        ]
        for r in results
    ]
    return "\n".join(aligned([heads, *rows]))


def as_json(results: list[SearchResult]) -> str:
    """A list of records."""
    return json.dumps([asdict(r) for r in results], indent=1)


def _measure(size: int, dim: int, rng: np.random.Generator) -> SearchResult:
    vectors = _unit(rng.standard_normal((size, dim), dtype=np.float32))
    tracemalloc.start()
    index = _filled(vectors)
    megabytes = tracemalloc.get_traced_memory()[0] / 1e6
    tracemalloc.stop()
    started = time.perf_counter()
    _filled(vectors)
    add_us = (time.perf_counter() - started) / size * 1e6
    new = _unit(rng.standard_normal((_QUERIES, dim), dtype=np.float32))
    noise = _unit(rng.standard_normal((_QUERIES, dim), dtype=np.float32))
    seen = _unit(vectors[rng.integers(0, size, _QUERIES)] + np.float32(_NOISE) * noise)
    unlike, like = _times(index.nearest, new), _times(index.nearest, seen)
    product = _times(lambda query: vectors @ query, new)
    return SearchResult(
        vectors=size,
        dim=dim,
        new_ms=float(np.median(unlike)),
        seen_ms=float(np.median(like)),
        fastest_ms=min(*unlike, *like),
        product_ms=float(np.median(product)),
        add_us=add_us,
        megabytes=megabytes,
    )


def _filled(vectors: NDArray[np.float32]) -> NearestIndex:
    index = NearestIndex()
    for key, vector in enumerate(vectors):
        index.add(key, vector)
    return index


def _times(search: Callable[[NDArray[np.float32]], object], queries: NDArray[np.float32]) -> list[float]:
    """Milliseconds of each query, the first one left out."""
    times = []
    for query in queries:
        started = time.perf_counter()
        search(query)
        times.append(1e3 * (time.perf_counter() - started))
    return times[1:]


def _unit(rows: NDArray[np.float32]) -> NDArray[np.float32]:
    return np.asarray(rows / np.linalg.norm(rows, axis=1, keepdims=True), dtype=np.float32)
