"""Lengths of odometry as unknowns: a wrong baseline is found and mended, right odometries stay as they are."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from graphs import loops, measured
from scipy.optimize import minimize

from maslam.backend.central.costs import cost
from maslam.backend.central.lengths import with_lengths
from maslam.backend.central.odometry import corrected, freedom, metric_edges
from maslam.backend.central.odometry_noise import noise_of_odometry
from maslam.backend.central.optimise import optimise
from maslam.backend.central.similarity_edges import Descended
from maslam.backend.central.trust_region import anchors
from maslam.backend.config import CentralConfig, SolverConfig
from maslam.backend.distributed.exchange import optimise_distributed
from maslam.backend.errors import BackendError
from maslam.backend.geometry import Sim3
from maslam.backend.pose_graph.graph import EdgeKind, NodeId
from maslam.backend.robust.select import optimise_robustly
from maslam.backend.trajectory_error import trajectory_error

LENGTHS = {0: 1.02, 1: 0.985, 2: 1.01, 3: 0.99}
"""What odometry is to be multiplied by; their mean is near 1, as loops do not tell it."""
SIGMA = 0.01


def biased(seed=0, lengths=LENGTHS, **kwargs):
    """Four robots on crossing circles; odometry too short by their ``lengths``; the true poses."""
    given = {"sigma_t": 0.01, "sigma_deg": 0.02, "separators": 6, **kwargs}
    graph, truth = loops(np.random.default_rng(seed), **given)
    return corrected(graph, {robot: 1.0 / length for robot, length in lengths.items()}), truth


def error(poses, truth):
    """Mean RMSE of the robots, each under its own rigid alignment, metres."""
    found = []
    for robot in sorted({n.robot for n in truth}):
        nodes = [n for n in sorted(truth) if n.robot == robot]
        est, ref = (np.array([p[n][:3, 3] for n in nodes]) for p in (poses, truth))
        found.append(trajectory_error(est, ref, with_scale=False).rmse_m)
    return float(np.mean(found))


def central(graph):
    return optimise(graph, CentralConfig(length_sigma=SIGMA))


def test_wrong_lengths_are_found_and_mended() -> None:
    graph, truth = biased()
    found = central(graph)
    wrong = np.array([found.lengths[r] - LENGTHS[r] for r in graph.robots])
    assert np.abs(wrong - wrong.mean()).max() < 0.002 and abs(wrong.mean()) < 0.006
    assert error(found.graph.poses, truth) < 0.5 * error(optimise(graph, CentralConfig()).graph.poses, truth)


def test_right_lengths_stay_as_they_are_bit_for_bit() -> None:
    graph, _ = biased(lengths={})
    found, plain = central(graph), optimise(graph, CentralConfig())
    assert found.lengths == {} and found.cost_after == plain.cost_after
    assert all(np.array_equal(found.graph.poses[n], plain.graph.poses[n]) for n in graph.nodes)


@pytest.mark.parametrize("keeps", ["nothing", "one match a pair"])
def test_without_loops_nothing_is_changed(keeps: str) -> None:
    """A tree of matches tells no length, however wrong they are."""
    graph, _ = biased()
    edges = [e for e in graph.edges if e.kind is EdgeKind.ODOMETRY]
    if keeps != "nothing":
        edges += [next(e for e in graph.edges if (e.i.robot, e.j.robot) == (r, r + 1)) for r in range(3)]
    bare = replace(graph, edges=tuple(edges))
    found, plain = central(bare), optimise(bare, CentralConfig())
    assert found.lengths == {}
    assert all(np.array_equal(found.graph.poses[n], plain.graph.poses[n]) for n in graph.nodes)


def test_the_result_is_the_minimum_over_factors_and_poses() -> None:
    """Against a search over factors of mean 1 that knows nothing of derivatives: F of the best poses, and the prior."""
    graph, _ = biased(robots=3, length=40, lengths={0: 1.02, 1: 0.98, 2: 0.99})
    found = central(graph)

    def joint(apart):
        factors = 1.0 + np.array([*apart, -sum(apart)])
        stretched = corrected(graph, dict(enumerate(factors)))
        best = optimise(stretched.with_poses(found.graph.poses), CentralConfig(start="given"))
        return best.cost_after + float((((factors - 1.0) / SIGMA) ** 2).sum())

    ours = np.array([found.lengths[r] for r in graph.robots])
    best = minimize(joint, ours[:2] - 1.0 + 2e-3, method="Nelder-Mead", options={"xatol": 1e-6, "fatol": 1e-9})
    assert joint(ours[:2] - 1.0) <= best.fun + 1e-4 * best.fun
    assert np.allclose(ours[:2] - 1.0, best.x, atol=1e-4)


@pytest.mark.parametrize("separators", [4, 6, 24])
def test_what_is_common_to_all_stays(separators: int) -> None:
    """Loops do not tell it, and what many noisy matches seem to say of it is no reason to make all maps larger."""
    graph, _ = biased(separators=separators, lengths={r: length + 0.01 for r, length in LENGTHS.items()})
    found = central(graph)
    assert found.lengths and np.mean(list(found.lengths.values())) == pytest.approx(1.0, abs=1e-9)


def test_one_robot_alone_has_no_factor() -> None:
    """Its own loops are of its own lengths."""
    graph, truth = biased(robots=1, lengths={0: 1.02})
    information = graph.edges[0].information
    sigma = np.array([0.01] * 3 + [np.radians(0.02)] * 3)
    rng = np.random.default_rng(1)
    ends = [(NodeId(0, k), NodeId(0, k + 50)) for k in range(0, 50, 5)]
    own = [measured(truth, i, j, EdgeKind.LOOP, sigma, information, rng) for i, j in ends]
    assert central(replace(graph, edges=(*graph.edges, *own))).lengths == {}


def test_the_evidence_is_the_marginal_likelihood() -> None:
    """Of two robots, against the integral over how their factors differ by a grid (F is near quadratic in that)."""
    graph, _ = biased(robots=2, length=40, lengths={0: 1.004, 1: 0.996})
    solved = optimise(graph, CentralConfig()).graph
    a = solved.arrays()
    edges, steps = metric_edges(solved, SIGMA)
    start = Descended(a.poses, np.zeros(len(a.poses)), 0)
    kept = np.ones(len(a.poses), dtype=bool)
    _, lengths = with_lengths(edges, start, anchors(a), kept, steps, freedom(solved))
    axis = np.linspace(-0.03, 0.03, 13)
    total = 0.0
    for x in axis:
        stretched = corrected(solved, {0: 1.0 + x / np.sqrt(2.0), 1: 1.0 - x / np.sqrt(2.0)})
        fallen = cost(solved, "F") - optimise(stretched, CentralConfig(start="given")).cost_after
        total += np.exp(0.5 * fallen - 0.5 * x**2 / SIGMA**2)
    integral = total * (axis[1] - axis[0]) / np.sqrt(2.0 * np.pi * SIGMA**2)
    assert lengths.evidence == pytest.approx(np.log(integral), abs=0.3)


@pytest.mark.parametrize("longest", [1, 5])
def test_elected_ends_where_central_does(longest: int) -> None:
    graph, truth = biased(1)
    whole = central(graph)
    config = SolverConfig(method="elected", length_sigma=SIGMA, elected_longest=longest)
    found = optimise_distributed(graph, config)
    assert all(outcome.accepted for outcome in found.outcomes.values())
    assert set(found.lengths) == set(whole.lengths)
    assert found.lengths == pytest.approx(whole.lengths, abs=1e-3 if longest == 1 else 3e-2)
    assert error(found.graph.poses, truth) < 1.02 * error(whole.graph.poses, truth)


def test_elected_takes_hardly_more_bytes_for_it() -> None:
    """No number more is sent; poses are sent more finely where residuals are smaller."""
    graph, _ = biased(1)
    sizes = [
        optimise_distributed(graph, SolverConfig(method="elected", length_sigma=sigma)).traffic.payload_bytes
        for sigma in (0.0, SIGMA)
    ]
    assert sizes[1] <= 1.02 * sizes[0]


def test_robots_with_units_of_their_own_beside_metric_ones() -> None:
    """The monocular robot keeps its units, the metric ones' lengths are found."""
    graph, _ = biased(2)
    config = SolverConfig(method="elected", length_sigma=SIGMA)
    found = optimise_distributed(graph, config, frozenset({3}))
    assert all(outcome.accepted for outcome in found.outcomes.values())
    assert set(found.lengths) == {0, 1, 2}
    apart = found.lengths[0] - found.lengths[1]
    assert apart == pytest.approx(LENGTHS[0] - LENGTHS[1], abs=0.004)


def test_what_does_not_know_lengths_says_so() -> None:
    graph, _ = biased()
    with pytest.raises(BackendError, match=r"length_sigma.*central and elected, not to rbcd"):
        optimise_distributed(graph, SolverConfig(method="rbcd", length_sigma=SIGMA))
    with pytest.raises(BackendError, match="takes lengths as they are"):
        optimise_robustly(graph, "gnc", CentralConfig(length_sigma=SIGMA))


@pytest.mark.parametrize("times", [1.0, 3.0])
def test_matches_tell_how_exact_odometry_is(times: float) -> None:
    """Odometry whose errors are ``times`` what its edges state, over one step and over many."""
    graph, truth = loops(np.random.default_rng(3), sigma_t=0.02, sigma_deg=0.1, separators=10)
    rng = np.random.default_rng(4)
    sigma = times * np.array([0.02] * 3 + [np.radians(0.1)] * 3)
    information = graph.edges[0].information
    edges = [
        measured(truth, e.i, e.j, e.kind, sigma if e.kind is EdgeKind.ODOMETRY else sigma / times, information, rng)
        for e in graph.edges
    ]
    solved = optimise(replace(graph, edges=tuple(edges)), CentralConfig()).graph
    places = {n: Sim3.from_se3(T) for n, T in solved.poses.items()}
    told = noise_of_odometry(places, solved.edges, frozenset(solved.robots))
    assert set(told) == {1, 10, 50}
    assert all(0.6 * times < value < 1.5 * times for value in told.values())


def test_without_loops_nothing_tells_how_exact_odometry_is() -> None:
    graph, truth = loops(np.random.default_rng(3), separators=0)
    places = {n: Sim3.from_se3(truth[n]) for n in graph.nodes}
    assert noise_of_odometry(places, graph.edges, frozenset(graph.robots)) == {}
    assert noise_of_odometry({NodeId(0, 0): Sim3.identity()}, (), frozenset({0})) == {}
