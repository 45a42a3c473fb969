"""Scores of place recognition: any descriptor on any benchmark, as the table that ``maslam netvlad eval`` prints."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from maslam.descriptors.calibration import judge, precision_recall

from ..common.text_table import aligned
from ..place_benchmarks.public_sets import PlaceBenchmark, corridor, gardenspoint
from .methods import Code, Method

PUBLIC_SETS: dict[str, Callable[..., PlaceBenchmark]] = {
    "places_corridor": corridor,
    "places_gardenspoint": gardenspoint,
}
_NEAREST = 5


@dataclass(frozen=True)
class Score:
    """One row of the table. ``queries``: that have a place to find; ``bytes``: of one description as it is sent;
    ``ap``: average precision of "nearest neighbour, if near enough"; ``ms``: of one thread to describe one image."""

    dataset: str
    method: str
    code: str
    bytes: int
    queries: int
    recall_at_1: float
    recall_at_5: float
    ap: float
    ms: float


@dataclass(frozen=True)
class Evaluation:
    """A score, and the distances ``(Q, R)`` it comes from: infinite for pairs that are never compared."""

    score: Score
    distances: NDArray[np.float32]


def public_benchmarks(root: Path, colour: bool = False) -> list[PlaceBenchmark]:
    """The real sets that are present under the data folder."""
    return [read(root, colour=colour) for name, read in sorted(PUBLIC_SETS.items()) if (root / name).is_dir()]


def evaluate(method: Method, benchmark: PlaceBenchmark) -> list[Evaluation]:
    """One for each of the method's codes."""
    start = time.process_time()
    queries, references = (
        [method.describe(image) for image in side] for side in (benchmark.queries, benchmark.references)
    )
    ms = 1e3 * (time.process_time() - start) / (len(queries) + len(references))
    return [_evaluate_code(method, code, benchmark, queries, references, ms) for code in method.codes]


def _evaluate_code(
    method: Method, code: Code, benchmark: PlaceBenchmark, queries: list[Any], references: list[Any], ms: float
) -> Evaluation:
    distances = code.distances(queries, references)
    if benchmark.barred is not None:
        distances = np.where(benchmark.barred, np.float32(np.inf), distances)
    found = judge(distances, benchmark.truth, _NEAREST)
    ap = precision_recall(found).average_precision()
    figures = (round(float(x), 4) for x in (found.recall_at(1), found.recall_at(_NEAREST), ap, ms))
    size, findable = code.bytes_each(references), int(found.findable.sum())
    return Evaluation(Score(benchmark.name, method.name, code.name, size, findable, *figures), distances)


def table(scores: Sequence[Score]) -> str:
    """The scores as text, a block for each set."""
    heads = ["method", "code", "bytes", "R@1", "R@5", "AP", "ms"]
    blocks = []
    for name in dict.fromkeys(score.dataset for score in scores):
        chosen = [score for score in scores if score.dataset == name]
        rows = [
            [s.method, s.code, str(s.bytes), *(f"{x:.3f}" for x in (s.recall_at_1, s.recall_at_5, s.ap)), f"{s.ms:.1f}"]
            for s in chosen
        ]
        blocks.append("\n".join([f"{name}: {chosen[0].queries} queries", *aligned([heads, *rows])]))
    return "\n\n".join(blocks)


def as_records(scores: Sequence[Score]) -> list[dict[str, object]]:
    """For ``--json``."""
    return [asdict(score) for score in scores]
