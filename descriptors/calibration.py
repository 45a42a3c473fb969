"""Distance thresholds from data: how precise and how complete place recognition is at each distance. numpy only.

What is measured is what agents do: each query takes its nearest neighbour, and the match stands if the distance is
small enough. Precision counts the matches that stand; recall counts, of the queries that have a place to find,
those that found it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .card import Calibration, OperatingPoint, SetCurve
from .errors import DescriptorError

_CHUNK = 1024
_CURVE_POINTS = 40
_SET_POINTS = 24


@dataclass(frozen=True)
class Retrieval:
    """Nearest neighbours of Q queries, nearest first: ``distances`` ``(Q, k)``, ``right`` ``(Q, k)`` whether each
    shows the query's place; ``findable`` ``(Q,)`` whether anything does."""

    distances: NDArray[np.float32]
    right: NDArray[np.bool_]
    findable: NDArray[np.bool_]

    def recall_at(self, k: int) -> float:
        """Share of the findable queries with a right answer among their first ``k``; 0 where nothing can be found."""
        hits = np.asarray(self.right[self.findable, :k].any(axis=1))
        return float(hits.mean()) if len(hits) else 0.0


@dataclass(frozen=True)
class PrecisionRecall:
    """One row for each distance at which a match appears, growing, all ``(n,)``; ``matches`` counts those that
    stand there."""

    distance: NDArray[np.float64]
    matches: NDArray[np.int64]
    precision: NDArray[np.float64]
    recall: NDArray[np.float64]

    def average_precision(self) -> float:
        """Area under precision over recall, as a sum of steps."""
        return float((np.diff(self.recall, prepend=0.0) * self.precision).sum())


def retrieve(
    queries: NDArray[np.float32],
    references: NDArray[np.float32],
    truth: NDArray[np.bool_],
    k: int = 5,
    ignore: NDArray[np.bool_] | None = None,
) -> Retrieval:
    """The ``k`` nearest of ``references`` ``(R, d)`` to each of ``queries`` ``(Q, d)``, unit rows, judged by
    ``truth`` ``(Q, R)``.

    ``ignore`` ``(Q, R)``: pairs that may not be answered, neither right nor wrong (the query itself, its neighbours
    in time, pairs so close to the border of "same place" that calling them wrong would be unfair).
    """
    if truth.shape != (len(queries), len(references)):
        raise DescriptorError(f"truth must be ({len(queries)}, {len(references)}), got {truth.shape}")
    parts = []
    for start in range(0, max(len(queries), 1), _CHUNK):
        rows = slice(start, start + _CHUNK)
        distances = np.sqrt(np.maximum(2.0 - 2.0 * (queries[rows] @ references.T), 0.0))
        parts.append(judge(distances, truth[rows], k, None if ignore is None else ignore[rows]))
    return pool(parts)


def judge(
    distances: NDArray[np.float32], truth: NDArray[np.bool_], k: int = 5, ignore: NDArray[np.bool_] | None = None
) -> Retrieval:
    """As :func:`retrieve`, of distances ``(Q, R)`` measured elsewhere; equal distances in the order of the
    references."""
    if distances.shape != truth.shape:
        raise DescriptorError(f"truth must be {distances.shape}, got {truth.shape}")
    allowed = distances if ignore is None else np.where(ignore, np.float32(np.inf), distances)
    order = np.argsort(allowed, axis=1, kind="stable")[:, :k]
    nearest = np.take_along_axis(allowed, order, axis=1).astype(np.float32)
    right = np.take_along_axis(truth, order, axis=1) & np.isfinite(nearest)
    findable = truth if ignore is None else truth & ~ignore
    return Retrieval(nearest, right, np.asarray(findable.any(axis=1)))


def precision_recall(retrieval: Retrieval) -> PrecisionRecall:
    """Precision and recall of "the nearest neighbour, if it is nearer than d", for every d at which something
    changes."""
    answered = np.isfinite(retrieval.distances[:, 0])
    distance = retrieval.distances[answered, 0].astype(np.float64)
    right = np.asarray(retrieval.right[answered, 0])
    order = np.argsort(distance, kind="stable")
    distance, hits = distance[order], np.cumsum(right[order])
    matches = np.arange(1, len(hits) + 1)
    precision = hits / matches
    recall = hits / max(int(retrieval.findable.sum()), 1)
    last = (
        np.append(np.diff(distance) > 0, True) if len(distance) else np.zeros(0, dtype=bool)
    )  # equal distances stand or fall together
    return PrecisionRecall(distance[last], matches[last], precision[last], recall[last])


def strict_point(curve: PrecisionRecall, precision: float) -> OperatingPoint | None:
    """The largest distance at and below which precision never falls under ``precision``; None where even the
    nearest match is wrong.

    "Never", not "at that point": a later lucky run of right matches would hide a worse stretch before it. A stretch
    of fewer matches than it takes to measure the precision is not held against it.
    """
    before = curve.distance < _first_failure(curve, precision)
    good = np.flatnonzero(before & (curve.precision >= precision) & (curve.distance > 0))
    return _point(curve, int(good[-1])) if len(good) else None


def candidate_point(curve: PrecisionRecall, share: float, precision: float) -> OperatingPoint | None:
    """The smallest distance that keeps ``share`` of all the right matches there are; smaller still where precision
    there would be lower than ``precision``. None where there is no right match."""
    if not len(curve.recall) or curve.recall[-1] <= 0:
        return None
    wanted = int(np.argmax(curve.recall >= share * curve.recall[-1]))
    good = np.flatnonzero((curve.precision >= precision) & (curve.distance > 0))
    good = good[good <= wanted]
    if curve.precision[wanted] >= precision and curve.distance[wanted] > 0:
        return _point(curve, wanted)
    return _point(curve, int(good[-1])) if len(good) else None


def calibrate(
    sets: Mapping[str, Retrieval],
    data: str,
    strict_precision: float,
    candidate_share: float,
    candidate_precision: float,
) -> Calibration:
    """Both thresholds of several named sets together, and the curves they were read from; an error where the data
    cannot support them.

    The strict one keeps its precision over all sets pooled, and in each set by itself as far as that has enough
    matches to tell: else easy sets would pay for a hard one, in which agents then go wrong.
    """
    together = pool(list(sets.values()))
    curve, curves = precision_recall(together), {name: precision_recall(one) for name, one in sets.items()}
    limit = min((_first_failure(one, strict_precision) for one in curves.values()), default=np.inf)
    strict = strict_point(_until(curve, limit), strict_precision)
    candidate = candidate_point(curve, candidate_share, candidate_precision)
    if strict is None or candidate is None:
        found = int(together.right[:, 0].sum())
        raise DescriptorError(
            f"calibration on {data}: no distance reaches precision {strict_precision} over {len(together.findable)} "
            f"queries, {found} of which have the right nearest neighbour"
        )
    if candidate.distance < strict.distance:
        candidate = strict
    return Calibration(
        data=data,
        queries=len(together.findable),
        strict=strict,
        candidate=candidate,
        curve=_thin(curve, _CURVE_POINTS),
        sets=tuple(
            SetCurve(
                name=name,
                queries=len(sets[name].findable),
                findable=int(sets[name].findable.sum()),
                strict=strict_point(one, strict_precision),
                curve=_thin(one, _SET_POINTS),
            )
            for name, one in curves.items()
        ),
    )


def accepted(calibration: Calibration) -> int:
    """How many matches the strict threshold's precision was measured on."""
    findable = sum(one.findable for one in calibration.sets)
    return round(calibration.strict.recall * findable / max(calibration.strict.precision, 1e-6))


def pool(retrievals: Sequence[Retrieval]) -> Retrieval:
    """Several sets as one: every query counts once."""
    k = min(r.distances.shape[1] for r in retrievals)
    return Retrieval(
        np.concatenate([r.distances[:, :k] for r in retrievals]),
        np.concatenate([r.right[:, :k] for r in retrievals]),
        np.concatenate([r.findable for r in retrievals]),
    )


def _point(curve: PrecisionRecall, row: int) -> OperatingPoint:
    figures = (curve.distance[row], curve.precision[row], curve.recall[row])
    distance, precision, recall = (round(float(x), 6) for x in figures)
    return OperatingPoint(distance=distance, precision=precision, recall=recall)


def _first_failure(curve: PrecisionRecall, precision: float) -> float:
    """The smallest distance at which the precision is missed by enough matches to tell; infinite where it never is."""
    enough = 1.0 / max(1.0 - precision, 1e-3) - 1e-9
    bad = np.flatnonzero((curve.precision < precision) & (curve.matches >= enough))
    return float(curve.distance[bad[0]]) if len(bad) else np.inf


def _until(curve: PrecisionRecall, distance: float) -> PrecisionRecall:
    n = int(np.searchsorted(curve.distance, distance, side="left"))
    return PrecisionRecall(curve.distance[:n], curve.matches[:n], curve.precision[:n], curve.recall[:n])


def _thin(curve: PrecisionRecall, points: int) -> tuple[OperatingPoint, ...]:
    positive = np.flatnonzero(curve.distance > 1e-6)
    rows = np.unique(np.linspace(0, len(positive) - 1, min(points, len(positive))).round().astype(int))
    return tuple(_point(curve, int(positive[row])) for row in rows)
