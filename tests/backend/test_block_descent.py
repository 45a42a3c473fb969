"""Block-coordinate descent: to the optimum, in few bytes, warm, and with wrong matches about."""

from dataclasses import replace

import numpy as np
import pytest
from graphs import grid, loops, town, with_wrong_edges

from maslam.backend.central.costs import cost, edge_cost
from maslam.backend.central.optimise import optimise
from maslam.backend.config import CentralConfig, SolverConfig
from maslam.backend.distributed.exchange import optimise_distributed
from maslam.backend.distributed.mixing import Mixer, MixingRule
from maslam.backend.distributed.places import Places, move, moved
from maslam.backend.geometry import se3_exp
from maslam.backend.pose_graph.graph import EdgeKind
from maslam.backend.robust.schedule import first_mu, next_mu, settled, tls_weight, truncation

DESCENT = SolverConfig(method="rbcd")


def test_it_goes_on_to_the_optimum_where_two_stages_stop():
    graph, _ = grid(np.random.default_rng(2), sigma=0.15)
    optimum = optimise(graph, CentralConfig()).cost_after
    assert optimise_distributed(graph, SolverConfig()).outcomes[0].cost_after > 1.005 * optimum
    assert optimise_distributed(graph, DESCENT).outcomes[0].cost_after == pytest.approx(optimum, rel=2e-5)


def test_every_member_learns_the_cost_of_every_sweep():
    graph, _ = grid(np.random.default_rng(2))
    result = optimise_distributed(graph, DESCENT)
    sent, costs = zip(*result.traffic.trace, strict=True)
    assert list(sent) == sorted(sent) and sent[-1] <= result.traffic.payload_bytes
    assert costs[0] == result.outcomes[0].cost_before and costs[-1] == result.outcomes[0].cost_after == min(costs)


def test_mixing_saves_sweeps_and_bytes():
    graph, _ = loops(np.random.default_rng(3), robots=3, length=12, separators=3)
    optimum = optimise(graph, CentralConfig()).cost_after
    mixed = optimise_distributed(graph, DESCENT)
    plain = optimise_distributed(graph, DESCENT.model_copy(update={"mixed_sweeps": 0}))
    assert mixed.outcomes[0].cost_after == pytest.approx(optimum, rel=1e-4)
    # In its more bytes the plain one does not even come as far.
    assert plain.outcomes[0].cost_after > mixed.outcomes[0].cost_after
    assert mixed.traffic.payload_bytes < plain.traffic.payload_bytes


def test_a_new_match_costs_a_fraction_of_a_cold_solve():
    graph, _ = loops(np.random.default_rng(6), robots=4, length=30, separators=6)
    *fewer, last = graph.edges
    assert last.is_separator
    before = optimise_distributed(replace(graph, edges=tuple(fewer)), DESCENT).graph
    again = replace(before, edges=graph.edges)
    cold = optimise_distributed(again, DESCENT)
    warm = optimise_distributed(again, DESCENT.model_copy(update={"start": "warm"}))
    assert warm.outcomes[0].cost_after == pytest.approx(cold.outcomes[0].cost_after, rel=1e-4)
    assert warm.outcomes[0].pose_sweeps < 0.5 * cold.outcomes[0].pose_sweeps
    assert warm.traffic.payload_bytes < 0.75 * cold.traffic.payload_bytes


def test_wrong_matches_are_rejected_by_both_owners_alike():
    graph, _ = loops(np.random.default_rng(0), robots=3, length=24)
    right = sum(e.is_separator for e in graph.edges)
    spoiled, wrong = with_wrong_edges(graph, np.random.default_rng(1), right // 2)
    config = DESCENT.model_copy(update={"robust": "gnc", "gnc_confidence": 0.9999})
    result = optimise_distributed(spoiled, config)
    assert [v is None for v in result.judged] == [e.kind is EdgeKind.ODOMETRY for e in spoiled.edges]
    assert {(v.i, v.j) for v in result.judged if v and v.rejected} == wrong
    verdicts = {}
    for outcome in result.outcomes.values():
        for judged in outcome.judged:
            # Weight and residual, to the last bit.
            assert verdicts.setdefault((judged.i, judged.j), judged) == judged
    assert {pair for pair, judged in verdicts.items() if judged.rejected} == wrong
    assert all(judged.weight in (0.0, 1.0) for judged in verdicts.values())
    clean = optimise(graph, CentralConfig()).graph
    assert max(np.linalg.norm((clean.poses[n] - result.graph.poses[n])[:3, 3]) for n in graph.nodes) < 0.05
    residuals = dict(zip([(e.i, e.j) for e in spoiled.edges], edge_cost(result.graph, "F"), strict=True))
    for pair, judged in verdicts.items():
        assert judged.residual**2 == pytest.approx(residuals[pair], rel=1e-6)


def test_a_rejected_edge_comes_back_when_the_graph_agrees_with_it():
    """A lone right match against three wrong ones that agree with each other is out; among its like it is in."""
    graph, _ = loops(np.random.default_rng(7), robots=2, length=20, separators=6)
    ties = [e for e in graph.edges if e.is_separator]
    shift = se3_exp([4.0, 0.0, 3.0, 0.0, 1.0, 0.0])
    rest = tuple(e for e in graph.edges if not e.is_separator)
    # The same wrong motion of one robot against the other: consistent among themselves.
    truth = optimise(graph, CentralConfig()).graph.poses
    wrong = tuple(replace(e, T_i_j=np.linalg.inv(truth[e.i]) @ shift @ truth[e.j]) for e in ties[1:4])
    config = DESCENT.model_copy(update={"robust": "gnc", "gnc_confidence": 0.9999})

    def rejected(edges):
        outcome = optimise_distributed(replace(graph, edges=rest + edges), config).outcomes[0]
        return {(j.i, j.j) for j in outcome.judged if j.rejected}

    assert rejected((ties[0], *wrong)) == {(ties[0].i, ties[0].j)}
    assert (ties[0].i, ties[0].j) not in rejected((ties[0], *ties[4:6]))


def test_the_schedule_is_that_of_truncated_least_squares():
    bound = truncation(0.99)
    assert bound == pytest.approx(16.811894, rel=1e-6)  # chi-square tables
    assert first_mu(bound / 3, bound) is None
    mu = first_mu(10 * bound, bound)
    assert mu == pytest.approx(1 / 19)
    # Continuous at both ends of the middle piece, and what the closed form says inside.
    low, high = bound * mu / (mu + 1), bound * (mu + 1) / mu
    np.testing.assert_allclose(tls_weight([0.5 * low, low, high, 2 * high], bound, mu), [1, 1, 0, 0], atol=1e-12)
    assert tls_weight(bound, bound, mu) == pytest.approx(np.sqrt(mu * (mu + 1)) - mu)
    for _ in range(60):
        mu = next_mu(mu)
    weights = tls_weight([0.9 * bound, 1.1 * bound], bound, mu)
    assert settled(weights) and not settled([0.5, 1.0])
    np.testing.assert_allclose(weights, [1, 0])


def test_mixing_solves_a_linear_problem_in_as_many_sweeps_as_it_has_unknowns():
    """On a linear map, Anderson acceleration with full memory is GMRES: exact after n steps."""
    rng = np.random.default_rng(8)
    A = 0.9 * np.linalg.qr(rng.normal(size=(3, 3)))[0]
    target = rng.normal(size=3)
    origin = Places(np.eye(4)[None], np.zeros(1))
    places = origin
    mixer, rule = Mixer(6, np.ones((1, 6))), MixingRule()

    def shifted(x):
        return move(origin, np.concatenate([x, np.zeros(3)])[None])

    for _ in range(5):
        mixer.begin(places)
        x = moved(origin, places, 6)[0, :3]
        places = shifted(target + A @ (x - target))
        weights = rule.weights(mixer.end(places))
        if weights:
            places = mixer.mix(weights)
    np.testing.assert_allclose(places.poses[0, :3, 3], target, atol=1e-4)


def test_many_robots_run_through():
    graph, _ = town(np.random.default_rng(0), robots=16, length=24)
    result = optimise_distributed(graph, DESCENT.model_copy(update={"cost_tolerance": 1e-4}))
    assert result.outcomes[0].accepted and not any(o.unreached for o in result.outcomes.values())
    optimum = optimise(graph, CentralConfig()).cost_after
    assert cost(result.graph, "F") < 1.05 * optimum


@pytest.mark.parametrize("square", [0.0, 1e-45, 1e-39])
def test_a_step_that_vanished_in_single_precision_has_no_weight(square: float) -> None:
    """Its product with a residual may still be there, and their quotient is beyond every number."""
    assert MixingRule().weights((square, 1e-20)) == (0.0,)
