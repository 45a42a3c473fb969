"""Thresholds against counts made by hand and by brute force."""

from __future__ import annotations

import numpy as np
import pytest

from maslam.descriptors.calibration import (
    Retrieval,
    calibrate,
    candidate_point,
    pool,
    precision_recall,
    retrieve,
    strict_point,
)
from maslam.descriptors.errors import DescriptorError


def _retrieval(distances: list[float], right: list[bool], findable: list[bool] | None = None) -> Retrieval:
    count = len(distances)
    return Retrieval(
        np.array(distances, dtype=np.float32)[:, None],
        np.array(right)[:, None],
        np.ones(count, dtype=bool) if findable is None else np.array(findable),
    )


def test_precision_and_recall_by_hand() -> None:
    # Sorted: 0.1 right, 0.2 right, 0.3 wrong, 0.4 right; a fifth query finds nothing of its own and answers
    # wrongly at 0.5.
    curve = precision_recall(
        _retrieval([0.3, 0.1, 0.4, 0.2, 0.5], [False, True, True, True, False], [True, True, True, True, False])
    )
    np.testing.assert_allclose(curve.distance, [0.1, 0.2, 0.3, 0.4, 0.5], rtol=1e-6)
    np.testing.assert_allclose(curve.precision, [1, 1, 2 / 3, 3 / 4, 3 / 5])
    np.testing.assert_allclose(curve.recall, [1 / 4, 2 / 4, 2 / 4, 3 / 4, 3 / 4])
    assert curve.average_precision() == pytest.approx((1 + 1 + 3 / 4) / 4)


def test_equal_distances_stand_or_fall_together() -> None:
    curve = precision_recall(_retrieval([0.2, 0.2, 0.2], [True, False, True]))
    assert len(curve.distance) == 1
    assert curve.precision[0] == pytest.approx(2 / 3)


def test_strict_threshold_is_as_precise_as_wanted() -> None:
    rng = np.random.default_rng(3)
    right = rng.random(3000) < 0.7
    distances = np.where(right, rng.normal(0.6, 0.12, 3000), rng.normal(1.0, 0.1, 3000)).clip(0.01, 2)
    retrieval = _retrieval(distances.tolist(), right.tolist())
    point = strict_point(precision_recall(retrieval), 0.99)
    assert point is not None
    accepted = retrieval.distances[:, 0] <= point.distance + 1e-6
    assert right[accepted].mean() >= 0.99
    assert right[accepted].sum() / 3000 == pytest.approx(point.recall, abs=1e-3)
    assert 0.4 < point.recall < 0.7


def test_candidate_threshold_keeps_most_right_matches() -> None:
    rng = np.random.default_rng(4)
    right = rng.random(2000) < 0.6
    distances = np.where(right, rng.normal(0.6, 0.1, 2000), rng.normal(0.9, 0.1, 2000)).clip(0.01, 2)
    point = candidate_point(precision_recall(_retrieval(distances.tolist(), right.tolist())), 0.9, 0.5)
    assert point is not None
    kept = (distances <= point.distance + 1e-6) & right
    assert kept.sum() / right.sum() == pytest.approx(0.9, abs=0.01)
    assert point.precision >= 0.5


def test_candidate_threshold_gives_way_to_the_wanted_precision() -> None:
    right = [True] * 5 + [False] * 20 + [True] * 20
    distances = np.linspace(0.1, 1.0, 45).tolist()
    point = candidate_point(precision_recall(_retrieval(distances, right)), 0.9, 0.9)
    assert point is not None
    assert point.distance == pytest.approx(distances[4], abs=1e-6)


def test_data_that_supports_no_threshold_is_an_error() -> None:
    with pytest.raises(DescriptorError, match=r"no distance reaches precision 0\.99 over 300 queries"):
        calibrate({"x": _retrieval(np.linspace(0.1, 1, 300).tolist(), [False] * 300)}, "look-alikes", 0.99, 0.9, 0.5)


def test_easy_sets_do_not_pay_for_a_hard_one() -> None:
    # 20000 right matches of an easy set would hide that half of the hard one's beyond 0.5 are wrong.
    easy, far = _retrieval(np.linspace(0.2, 1.0, 20_000).tolist(), [True] * 20_000), np.linspace(0.3, 0.7, 400)
    hard = _retrieval(far.tolist(), [bool(d < 0.5 or k % 2) for k, d in enumerate(far)])
    pooled = strict_point(precision_recall(pool([easy, hard])), 0.99)
    made = calibrate({"easy": easy, "hard": hard}, "two sets", 0.99, 0.9, 0.5)
    assert pooled is not None and pooled.distance > 0.6
    assert 0.49 < made.strict.distance < 0.51
    stands = hard.distances[:, 0] <= made.strict.distance
    assert hard.right[stands, 0].mean() >= 0.99
    assert [(s.name, s.queries, s.findable) for s in made.sets] == [("easy", 20_000, 20_000), ("hard", 400, 400)]
    assert all(len(one.curve) <= 24 for one in made.sets) and len(made.curve) <= 40


def test_retrieval_equals_brute_force_and_ignores_what_it_is_told_to() -> None:
    rng = np.random.default_rng(5)
    references = rng.normal(size=(60, 8)).astype(np.float32)
    references /= np.linalg.norm(references, axis=1, keepdims=True)
    truth, ignore = rng.random((60, 60)) < 0.1, np.eye(60, dtype=bool)
    found = retrieve(references, references, truth, k=3, ignore=ignore)
    for q in range(60):
        d = np.linalg.norm(references.astype(np.float64) - references[q].astype(np.float64), axis=1)
        d[q] = np.inf
        order = np.argsort(d)[:3]
        np.testing.assert_allclose(found.distances[q], d[order], atol=1e-3)
        assert found.right[q].tolist() == truth[q, order].tolist()
        assert found.findable[q] == np.delete(truth[q], q).any()


def test_pooling_counts_every_query_once() -> None:
    a, b = _retrieval([0.1, 0.2], [True, False]), _retrieval([0.3], [True], [True])
    both = pool([a, b])
    assert len(both.distances) == 3
    assert both.recall_at(1) == pytest.approx(2 / 3)
