"""What robust selection is made of: the schedule, quantiles, cliques, chains of odometry, predictions, pairwise
consistency; against brute force, closed forms and simulated noise.
"""

import itertools
from dataclasses import replace

import numpy as np
import pytest
from graphs import loops, measured, spoiled
from scipy.stats import chi2

from maslam.backend.central.costs import cost, edge_cost
from maslam.backend.central.optimise import optimise
from maslam.backend.config import CentralConfig, RobustConfig
from maslam.backend.geometry import se3, se3_exp, se3_inverse, se3_log, so3_exp
from maslam.backend.pose_graph.graph import Edge, EdgeKind, NodeId, PoseGraph
from maslam.backend.robust import chi_square
from maslam.backend.robust.chains import adjoint, chains
from maslam.backend.robust.clique import largest_clique
from maslam.backend.robust.pcm import consistent_edges
from maslam.backend.robust.prediction import predicted_distances
from maslam.backend.robust.schedule import first_mu, next_mu, tls_weight
from maslam.backend.robust.select import optimise_robustly


def test_the_schedule():
    # At the first mu the largest residual is at the end of the convex part, (mu + 1) / mu = 2 r^2 / c^2.
    mu = first_mu(50.0, 4.0)
    assert (mu + 1) / mu == pytest.approx(2 * 50 / 4)
    assert first_mu(2.0, 4.0) is None and next_mu(0.5) == pytest.approx(0.7)
    c, mu = 4.0, 0.25
    low, high = mu / (mu + 1) * c, (mu + 1) / mu * c
    weights = tls_weight(np.array([0.0, low, 4.0, high, 2 * high]), c, mu)
    np.testing.assert_allclose(weights, [1, 1, np.sqrt(mu * (mu + 1)) - mu, 0, 0], atol=1e-12)
    np.testing.assert_array_equal(tls_weight(np.array([3.9, 4.1]), c, 100.0), [1, 0])
    # In between, the weight is what minimises w r^2 + the penalty mu (1 - w) / (mu + w) c^2 (Black and Rangarajan).
    grid = np.linspace(0, 1, 100_001)
    best = grid[np.argmin(grid * 7.0 + mu * (1 - grid) / (mu + grid) * c)]
    assert tls_weight(np.array([7.0]), c, mu)[0] == pytest.approx(best, abs=1e-4)


@pytest.mark.parametrize("freedom", [1.0, 2.5, 3.0, 6.0, 40.0])
def test_quantiles_of_chi_square_are_those_of_scipy(freedom):
    for probability in (1e-9, 0.01, 0.5, 0.75, 0.999):
        assert chi_square.below(probability, freedom) == pytest.approx(chi2.ppf(probability, freedom), rel=1e-12)
        assert chi_square.exceeded(probability, freedom) == pytest.approx(chi2.isf(probability, freedom), rel=1e-12)


def test_the_largest_clique_is_the_largest():
    rng = np.random.default_rng(0)
    for _ in range(60):
        n = int(rng.integers(1, 11))
        joined = rng.random((n, n)) < rng.random()
        joined |= joined.T
        found = largest_clique(joined)
        assert found.exact and all(joined[p] for p in itertools.combinations(found.members, 2))
        size = len(found.members) + 1
        bigger = itertools.combinations(range(n), size)
        assert not any(all(joined[p] for p in itertools.combinations(c, 2)) for c in bigger)
    assert largest_clique(np.zeros((0, 0), dtype=bool)).members == ()


def test_a_hidden_clique_among_thousands_and_a_bound_on_the_work():
    rng = np.random.default_rng(1)
    joined = np.triu(rng.random((2000, 2000)) < 0.2, 1)
    joined |= joined.T
    inside = np.sort(rng.choice(2000, 300, replace=False))
    joined[np.ix_(inside, inside)] = True
    found = largest_clique(joined)
    assert found.exact and set(inside) <= set(found.members)
    dense = np.triu(rng.random((300, 300)) < 0.9, 1)
    dense |= dense.T
    found = largest_clique(dense, work=20_000)
    assert not found.exact and all(dense[p] for p in itertools.combinations(found.members, 2))
    assert len(found.members) > 15


def test_the_uncertainty_of_a_chain_is_that_of_simulated_ones():
    rng = np.random.default_rng(2)
    sigma = np.array([0.05, 0.02, 0.02, 0.01, 0.005, 0.02])
    truth = {NodeId(0, k): se3(so3_exp([0.0, 0.3 * k, 0.1 * k]), [2.0 * k, np.sin(k), 0.0]) for k in range(12)}
    pairs = list(itertools.pairwise(sorted(truth)))
    exact = [measured(truth, a, b, EdgeKind.ODOMETRY, np.zeros(6), np.diag(sigma**-2.0), rng) for a, b in pairs]
    # One edge the other way round means the same.
    exact[4] = measured(truth, pairs[4][1], pairs[4][0], EdgeKind.ODOMETRY, np.zeros(6), np.diag(sigma**-2.0), rng)
    (chain,) = chains(truth, exact)
    noisy = np.eye(4)
    for e in exact[3:10]:
        T = e.T_i_j @ se3_exp(sigma * rng.normal(size=(4000, 6)))
        noisy = noisy @ (T if e.i < e.j else se3_inverse(T))
    # The relative pose of nodes 3 and 10, its error brought into the chain's frame.
    true = se3_inverse(chain.poses[3]) @ chain.poses[10]
    errors = se3_log(noisy @ se3_inverse(true)) @ adjoint(chain.poses[3]).T
    predicted = chain.covariance[10] - chain.covariance[3]
    root = np.linalg.inv(np.linalg.cholesky(predicted))
    np.testing.assert_allclose(root @ np.cov(errors.T) @ root.T, np.eye(6), atol=0.12)


def test_chains_end_where_odometry_is_missing():
    graph, _ = loops(np.random.default_rng(3), robots=2, length=10, separators=2)
    cut = [e for e in graph.edges if (e.i, e.j) != (NodeId(1, 4), NodeId(1, 5))]
    assert [(c.robot, len(c.row)) for c in chains(graph.poses, cut)] == [(0, 10), (1, 5), (1, 5)]


def test_a_right_edge_is_as_far_from_the_prediction_as_chi_square_says():
    distances = []
    for seed in range(40):
        graph, _ = loops(np.random.default_rng(seed), robots=2, length=25, separators=5)
        rows = np.array([k for k, e in enumerate(graph.edges) if e.is_separator][2:4])
        weights = np.ones(len(graph.edges))
        weights[rows] = 0.0
        solution = optimise(graph.with_weights(weights), CentralConfig()).graph
        distances += predicted_distances(solution, rows, CentralConfig()).tolist()
    # Mean of chi-square with 6 degrees is 6, its deviation sqrt(12); 80 samples, in pairs that are not independent.
    assert np.mean(distances) == pytest.approx(6.0, abs=3 * np.sqrt(12 / 40))
    graph, _ = loops(np.random.default_rng(0), robots=2, length=10, separators=2)
    apart = graph.with_weights([0.0 if e.is_separator else 1.0 for e in graph.edges])
    rows = np.array([k for k, e in enumerate(graph.edges) if e.is_separator])
    assert np.isinf(predicted_distances(apart, rows, CentralConfig())).all()


def test_leaving_an_edge_out_needs_no_new_solution():
    graph, _ = loops(np.random.default_rng(13), robots=2, length=25, separators=5, sigma_t=0.02, sigma_deg=0.1)
    rows = np.array([k for k, e in enumerate(graph.edges) if e.is_separator])
    solution = optimise(graph, CentralConfig()).graph
    at_once = predicted_distances(solution, rows, CentralConfig())
    for row, found in zip(rows, at_once, strict=True):
        weights = np.ones(len(graph.edges))
        weights[row] = 0.0
        without = optimise(graph.with_weights(weights), CentralConfig()).graph
        assert found == pytest.approx(predicted_distances(without, np.array([row]), CentralConfig())[0], rel=0.1)
        # And it is what the edge adds to the cost.
        added = cost(solution, "F") - cost(without, "F")
        assert found == pytest.approx(added, rel=0.1)
    # The only edge between two robots cannot be tested: no distance, whatever it says.
    one = replace(graph, edges=tuple(e for k, e in enumerate(graph.edges) if k not in rows[1:]))
    only = predicted_distances(optimise(one, CentralConfig()).graph, rows[:1], CentralConfig())
    assert only[0] < 1e-3


def test_odometry_that_is_bent_to_a_wrong_edge_gives_it_away():
    # Two robots are tied to each other by right edges at the beginning; a wrong one ties their loose ends.
    rng = np.random.default_rng(14)
    sigma, information = np.array([0.05] * 3 + [0.01] * 3), np.diag([0.05**-2.0] * 3 + [0.01**-2.0] * 3)
    truth = {NodeId(r, k): se3(so3_exp([0, 0, 0.05 * k]), [k, 2.0 * r, 0]) for r in range(2) for k in range(40)}
    steps = [(NodeId(r, k), NodeId(r, k + 1)) for r in range(2) for k in range(39)]
    edges = [measured(truth, *pair, EdgeKind.ODOMETRY, sigma, information, rng) for pair in steps]
    for k in range(0, 20, 2):
        edges.append(measured(truth, NodeId(0, k), NodeId(1, k), EdgeKind.SEPARATOR, sigma, information, rng))
    wrong = measured(truth, NodeId(0, 39), NodeId(1, 39), EdgeKind.SEPARATOR, sigma, information, rng)
    wrong = replace(wrong, T_i_j=wrong.T_i_j @ se3_exp([4.0, 8.0, 0.0, 0.0, 0.0, 0.7]))
    graph = PoseGraph(truth, (*edges, wrong))
    bent = optimise(graph, CentralConfig()).graph
    assert edge_cost(bent, "F")[-1] < 22.4  # the quantile of 99.9 %: by its residual alone it would pass
    for method in ("gnc", "pcm+gnc"):
        result = optimise_robustly(graph, method)
        assert [r.index for r in result.rejected] == [len(edges)]


@pytest.mark.parametrize("noise", [1.0, 4.0])
def test_pcm_finds_right_edges_and_the_noise(noise):
    rng = np.random.default_rng(5)
    sigma = {"sigma_t": 0.02 * noise, "sigma_deg": 0.1 * noise}
    graph, right, _ = spoiled(rng, wrong=40, robots=3, length=60, separators=12, **sigma)
    stated = np.diag([0.02**-2.0] * 3 + [np.radians(0.1) ** -2.0] * 3)
    graph = replace(graph, edges=tuple(replace(e, information=stated) for e in graph.edges))
    found = consistent_edges(graph, RobustConfig())
    between = np.array([e.kind is not EdgeKind.ODOMETRY for e in graph.edges])
    alone = found.tested == 0
    assert not (found.accepted & ~right & ~alone).any()
    assert (found.accepted & right & between).sum() >= 0.95 * (right & between).sum()
    assert found.accepted[~between].all() and found.exact
    assert found.noise.factor == pytest.approx(noise, rel=0.25)


def test_pcm_judges_loops_of_one_robot_whichever_way_they_point():
    rng = np.random.default_rng(6)
    truth = {
        NodeId(0, k): se3(so3_exp([0, 0.2 * k, 0]), [5 * np.sin(0.2 * k), 0.0, 5 * np.cos(0.2 * k)]) for k in range(70)
    }
    sigma, information = np.array([0.01] * 3 + [0.002] * 3), np.diag([0.01**-2.0] * 3 + [0.002**-2.0] * 3)
    nodes = sorted(truth)
    edges = [measured(truth, a, b, EdgeKind.ODOMETRY, sigma, information, rng) for a, b in itertools.pairwise(nodes)]
    for k in range(0, 30, 5):
        a, b = nodes[k], nodes[k + 31]
        edges.append(measured(truth, *((b, a) if k % 2 else (a, b)), EdgeKind.LOOP, sigma, information, rng))
    right = len(edges)
    for k in range(4):
        T = edges[right - 1 - k].T_i_j @ se3_exp(rng.uniform(-3, 3, 6))
        edges.append(Edge(nodes[3 * k], nodes[40 + 4 * k], T, information, EdgeKind.LOOP))
    found = consistent_edges(PoseGraph(truth, tuple(edges)), RobustConfig())
    assert found.accepted[:right].all() and not found.accepted[right:].any()
    assert (found.agreeing[right - 6 : right] >= 5).all() and (found.tested[-10:] == 9).all()
