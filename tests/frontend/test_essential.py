"""The essential graph against counts made one pair at a time, and as a file that another program can optimise."""

from __future__ import annotations

import numpy as np
import pytest

from maslam.backend.geometry import se3_exp
from maslam.frontend.files.essential_graph import essential_graph, shared_points
from maslam.frontend.files.vo_files import VoTrack


def make_track(seen: list[set[int]], points: int) -> VoTrack:
    """Key-frame k sees the points ``seen[k]``."""
    rng = np.random.default_rng(0)
    observations = np.array([[k, p] for k, ids in enumerate(seen) for p in sorted(ids)], np.int32).reshape(-1, 2)
    n = len(observations)
    return VoTrack(
        np.arange(len(seen)) * 0.5,
        se3_exp(rng.normal(0, 0.3, (len(seen), 6))),
        rng.normal(size=(points, 3)),
        observations,
        np.zeros((n, 32), np.uint8),
        np.zeros((n, 2), np.int32),
    )


def a_loop() -> list[set[int]]:
    """Six views sliding over 1000 points by 60 each, 200 at a time; a seventh that is back at the second, an eighth
    that sees nothing known."""
    return [*(set(range(60 * k, 60 * k + 200)) for k in range(6)), set(range(65, 265)), set(range(990, 1000))]


def test_edges_are_the_tree_the_neighbours_and_the_strong_ones() -> None:
    seen = a_loop()
    track = make_track(seen, 1000)
    graph = essential_graph(track)
    counts = np.array([[len(a & b) for b in seen] for a in seen])
    np.testing.assert_array_equal(shared_points(track), counts)
    expected = {(i, j) for i in range(8) for j in range(i + 1, 8) if counts[i, j] >= 100 or j == i + 1}
    # Key-frame 6 is back at key-frame 1; nobody shares with 7: it hangs on the one before.
    parents = {1: 0, 2: 1, 3: 2, 4: 3, 5: 4, 6: 1, 7: 6}
    expected |= {(p, c) for c, p in parents.items()}
    assert [tuple(e) for e in graph.ends.tolist()] == sorted(expected)
    assert {(i, j) for (i, j), t in zip(graph.ends.tolist(), graph.tree, strict=True) if t} == {
        (p, c) for c, p in parents.items()
    }
    np.testing.assert_array_equal(graph.shared, counts[tuple(graph.ends.T)])
    for (i, j), T_i_j in zip(graph.ends.tolist(), graph.T_i_j, strict=True):
        np.testing.assert_allclose(track.poses[i] @ T_i_j, track.poses[j], atol=1e-12)


@pytest.mark.parametrize("count", [0, 1, 2])
def test_short_tracks(count: int) -> None:
    graph = essential_graph(make_track([{0, 1}] * count, 2))
    assert len(graph) == max(count - 1, 0) and graph.T_i_j.shape == (len(graph), 4, 4)


def test_the_tree_joins_all_without_a_circle() -> None:
    rng = np.random.default_rng(4)
    seen = [set(rng.integers(0, 400, 150).tolist()) for _ in range(30)]
    graph = essential_graph(make_track(seen, 400), strong=60)
    assert graph.tree.sum() == 29
    joined = {0}
    for i, j in graph.ends[graph.tree].tolist():  # sorted by the earlier key-frame: a parent comes before its children
        assert i in joined
        joined.add(j)
    assert len(joined) == 30
