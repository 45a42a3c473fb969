"""Algorithm 4: its weights by hand, its degenerate cases, and that agents are drawn as often as the weights say."""

from __future__ import annotations

import numpy as np
import pytest

from maslam.mas.policies.peer_sampling import FLOOR, draw, weights

OTHERS = [1, 2, 3, 4, 5]


def test_nobody_known_yet_is_uniform() -> None:
    np.testing.assert_allclose(weights(OTHERS, set(), set(), {}), [0.2] * 5)


def test_the_weights_are_those_of_the_algorithm() -> None:
    found = weights(OTHERS, {2, 4}, {1, 2, 3}, {1: 0.9, 2: 0.3, 3: 1.2})
    by_hand = np.array(
        [
            4 * (2 / 3) * (0.3 / 1.2),  # second nearest of three, not grouped
            6 * 4 * (3 / 3) * (0.9 / 1.2),  # nearest, grouped
            4 * FLOOR,  # the farthest
            6 * 6,  # not asked last time, grouped
            6,  # not asked last time
        ]
    )
    np.testing.assert_allclose(found, by_hand / by_hand.sum())


def test_answers_of_agents_not_asked_last_time_do_not_count() -> None:
    found = weights(OTHERS, set(), {1, 2}, {1: 0.5, 2: 1.0, 3: 0.1, 4: 2.0})
    by_hand = np.array([4 * 0.5, 4 * FLOOR, 6, 6, 6])
    np.testing.assert_allclose(found, by_hand / by_hand.sum())


@pytest.mark.parametrize(
    ("previous", "distances"),
    [
        ({1}, {1: 0.7}),
        ({1, 2, 3, 4, 5}, dict.fromkeys(OTHERS, 0.7)),
        ({1, 2, 3, 4, 5}, dict.fromkeys(OTHERS, 0.0)),
        ({1, 2, 3, 4, 5}, {}),
        ({1, 2}, {2: 0.4}),
        ({7}, {7: 0.4}),
    ],
    ids=["one asked", "all equally far", "no distance at all", "nobody answered", "one silent", "gone"],
)
def test_whatever_happened_everyone_can_be_drawn(previous: set[int], distances: dict[int, float]) -> None:
    found = weights(OTHERS, {3, 9}, previous, distances)
    assert np.isfinite(found).all() and (found > 0).all()
    assert found.sum() == pytest.approx(1.0)


def test_equally_far_agents_are_equally_likely() -> None:
    np.testing.assert_allclose(weights(OTHERS, set(), set(OTHERS), dict.fromkeys(OTHERS, 0.7)), [0.2] * 5)


def test_the_silent_count_as_the_farthest() -> None:
    assert weights([1, 2], set(), {1, 2}, {1: 0.4})[0] == pytest.approx(0.5)
    found = weights([1, 2, 3], set(), {1, 2, 3}, {1: 0.4, 2: 0.8})
    assert found[0] > found[1] == found[2]


def test_agents_are_drawn_as_often_as_the_weights_say() -> None:
    found = weights(OTHERS, {2, 4}, {1, 2, 3}, {1: 0.9, 2: 0.3, 3: 1.2})
    rng = np.random.default_rng(0)
    rounds, draws = 20_000, 3
    counts = np.zeros(5)
    for _ in range(rounds):
        for agent in draw(OTHERS, found, draws, rng):
            counts[agent - 1] += 1
    expected = 1.0 - (1.0 - found) ** draws
    sigma = np.sqrt(expected * (1 - expected) / rounds)
    assert (np.abs(counts / rounds - expected) < 4.5 * sigma).all()


def test_a_draw_is_a_set_of_at_most_as_many_agents() -> None:
    rng = np.random.default_rng(1)
    drawn = [draw(OTHERS, np.full(5, 0.2), 4, rng) for _ in range(200)]
    assert all(d == sorted(set(d)) and 1 <= len(d) <= 4 for d in drawn)
    assert {len(d) for d in drawn} >= {2, 3, 4}


def test_nobody_to_draw() -> None:
    rng = np.random.default_rng(2)
    assert draw(OTHERS, np.full(5, 0.2), 0, rng) == []
    assert weights([], set(), set(), {}).size == 0
    assert draw([], np.zeros(0), 3, rng) == []
