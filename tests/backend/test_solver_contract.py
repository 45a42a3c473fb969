"""What every distributed method keeps to, whatever it does in between."""

from dataclasses import replace

import numpy as np
import pytest
from graphs import constant_units, drifting, grid, loops
from scipy.stats import chi2
from transports import faulty

from maslam.backend.central.costs import cost, edge_cost
from maslam.backend.central.optimise import optimise
from maslam.backend.config import CentralConfig, SolverConfig
from maslam.backend.distributed.exchange import optimise_distributed, solve_group
from maslam.backend.distributed.messages import Decision, Report, Values
from maslam.backend.distributed.methods import node_for
from maslam.backend.distributed.share import shares
from maslam.backend.distributed.solver_stage import Round, SolverStage
from maslam.backend.errors import BackendError
from maslam.backend.geometry import se3_exp, se3_inverse
from maslam.backend.pose_graph.graph import EdgeKind, NodeId, PoseGraph


def in_two_groups(graph):
    """Four robots' graph without the edges between 0, 1 and 2, 3."""
    return replace(graph, edges=tuple(e for e in graph.edges if (e.i.robot < 2) == (e.j.robot < 2)))


class SolverContract:
    """Subclasses name a configuration, and how near it comes to the truth of exact measurements (metres)."""

    config = SolverConfig()
    exact = SolverConfig()
    nearness = 1e-6
    bit_for_bit = True

    def group_cost(self, graph):
        """What the outcome must say, computed from the whole graph."""
        return cost(graph, "F")

    def solve(self, graph, **settings):
        return optimise_distributed(graph, self.config.model_copy(update=settings))

    def test_exact_measurements_give_the_truth_and_the_anchor_stays(self):
        graph, truth = loops(np.random.default_rng(0), robots=3, length=24, sigma_t=0.0, sigma_deg=0.0)
        result = optimise_distributed(graph, self.exact)
        anchor = NodeId(0, 0)
        assert np.array_equal(result.graph.poses[anchor], graph.poses[anchor])
        for node, T in truth.items():
            expected = graph.poses[anchor] @ se3_inverse(truth[anchor]) @ T
            np.testing.assert_allclose(result.graph.poses[node], expected, atol=self.nearness)
        assert all(o.accepted and not o.unreached for o in result.outcomes.values())

    def test_outcomes_agree_with_each_other_and_with_the_whole_graph(self):
        graph, _ = grid(np.random.default_rng(1))
        result = self.solve(graph)
        first = result.outcomes[0]
        for outcome in result.outcomes.values():
            assert (outcome.accepted, outcome.reason) == (first.accepted, first.reason)
            assert (outcome.cost_before, outcome.cost_after) == (first.cost_before, first.cost_after)
        assert first.cost_after == pytest.approx(self.group_cost(result.graph), rel=1e-6)
        assert first.cost_after < first.cost_before
        assert optimise(graph, CentralConfig()).cost_after < cost(result.graph, "F") * (1 + 1e-9)
        assert 0 < result.traffic.payload_bytes < result.traffic.wire_bytes

    @pytest.mark.parametrize("start", ["flagged", "warm"])
    def test_the_cost_never_ends_higher(self, start):
        graph, _ = grid(np.random.default_rng(5), sigma=0.2)
        best = optimise(graph, CentralConfig()).graph
        result = self.solve(best, start=start)
        outcome = result.outcomes[0]
        assert outcome.cost_after <= outcome.cost_before == pytest.approx(self.group_cost(best))
        if not outcome.accepted:
            assert outcome.reason.startswith("the cost would rise:")
        assert self.group_cost(result.graph) <= self.group_cost(best) * (1 + 1e-12)
        for node in best.nodes:
            np.testing.assert_allclose(result.graph.poses[node], best.poses[node], atol=0.02)

    @pytest.mark.parametrize("seed", [1, 2])
    def test_lost_repeated_late_and_disordered_messages_do_no_harm(self, seed):
        graph, _ = loops(np.random.default_rng(4), robots=4, length=12, separators=3)
        expected, _ = solve_group(shares(graph), self.config)
        got = faulty(shares(graph), self.config, np.random.default_rng(seed))
        assert len({o.cost_after for o in got.values()}) == 1
        assert got[0].cost_after == pytest.approx(expected[0].cost_after, rel=1e-3)
        if self.bit_for_bit:
            for robot, outcome in expected.items():
                assert all(np.array_equal(got[robot].poses[n], T) for n, T in outcome.poses.items())

    def test_shares_that_contradict_each_other_are_an_error(self):
        graph, _ = loops(np.random.default_rng(11), robots=2, length=10, separators=3)
        group = shares(graph)
        own = tuple(e for e in group[1].edges if not e.is_separator)
        short = replace(group[1], edges=(*own[:-1], group[1].edges[-1]))
        with pytest.raises(BackendError, match=r"different edges|wait for messages"):
            solve_group({0: group[0], 1: short}, self.config)
        node = node_for(group[0], self.config)
        with pytest.raises(BackendError, match="handed a message for robot 1"):
            node.handle(Report(1, 1, Round(SolverStage.START), 0.0, 0.0))
        with pytest.raises(BackendError, match="tree of members"):
            node.handle(Decision(1, 0, Round(SolverStage.START), False, 0.0))
        with pytest.raises(BackendError, match="shares no edge"):
            node.handle(Values(7, 0, Round(SolverStage.START), np.zeros((1, 6))))

    def test_what_no_edge_reaches_stays_and_is_named(self):
        graph, _ = loops(np.random.default_rng(9), robots=4, length=10)
        apart = in_two_groups(graph)
        outcomes, _ = solve_group(shares(apart), self.config)  # robots that believe to be one group
        solved = apart.with_poses({n: T for o in outcomes.values() for n, T in o.poses.items()})
        assert outcomes[0].accepted and not outcomes[1].unreached
        for robot in (2, 3):
            assert outcomes[robot].unreached == tuple(n for n in graph.nodes if n.robot == robot)
            for node in outcomes[robot].unreached:
                assert np.array_equal(solved.poses[node], graph.poses[node])
        assert outcomes[0].cost_after == pytest.approx(self.group_cost(solved), rel=1e-6)
        empty = PoseGraph({NodeId(0, 0): np.eye(4), NodeId(1, 0): np.eye(4)}, ())
        assert solve_group(shares(empty), self.config)[0][1].unreached == (NodeId(1, 0),)

    def test_robots_that_no_edge_joins_solve_their_own_group(self):
        graph, _ = loops(np.random.default_rng(9), robots=4, length=10)
        apart = in_two_groups(graph)
        together = self.solve(apart)
        for robots in ((0, 1), (2, 3)):
            of_them = {n: T for n, T in apart.poses.items() if n.robot in robots}
            alone = self.solve(replace(apart, poses=of_them, edges=tuple(e for e in apart.edges if e.i in of_them)))
            for n in of_them:
                assert np.array_equal(together.graph.poses[n], alone.graph.poses[n])
            for robot in robots:
                assert together.outcomes[robot].accepted and not together.outcomes[robot].unreached
                assert together.outcomes[robot].cost_after < together.outcomes[robot].cost_before

    def test_a_robot_in_pieces_is_reached_through_others(self):
        graph, _ = loops(np.random.default_rng(13), robots=3, length=24, sigma_t=0.0, sigma_deg=0.0)
        # Robot 1 lost track half way: its second half has a frame of its own.
        cut = next(e for e in graph.edges if e.i == NodeId(1, 12) and e.kind is EdgeKind.ODOMETRY)
        ties = [e for e in graph.edges if e.is_separator and any(n.robot == 1 and n.index > 12 for n in (e.i, e.j))]
        assert ties
        moved = {NodeId(1, k): se3_exp([9.0, 0, 0, 0, 1, 0]) @ graph.poses[NodeId(1, k)] for k in range(13, 24)}
        parted = replace(graph, edges=tuple(e for e in graph.edges if e is not cut)).with_poses(moved)
        result = optimise_distributed(parted, self.exact)
        assert all(not o.unreached for o in result.outcomes.values())
        assert result.outcomes[0].cost_after < 1e-6 < result.outcomes[0].cost_before

    def test_a_robot_alone_closes_its_own_loops(self):
        graph, _ = loops(np.random.default_rng(10), robots=1, length=30)
        loop = replace(graph.edges[0], i=NodeId(0, 0), j=NodeId(0, 29), kind=EdgeKind.LOOP)
        loop = replace(loop, T_i_j=graph.poses[NodeId(0, 29)] @ se3_exp([0.3, 0, 0, 0, 0, 0]))
        result = self.solve(replace(graph, edges=(*graph.edges, loop)))
        assert result.outcomes[0].accepted and result.traffic.payload_bytes == 0
        assert result.outcomes[0].cost_after < 0.5 * result.outcomes[0].cost_before

    def test_robots_with_units_of_their_own_find_them(self):
        graph, _ = loops(np.random.default_rng(8), robots=3, length=30, sigma_t=0.005, sigma_deg=0.05)
        units = {0: 1.0, 1: 2.5, 2: 0.4}
        own = constant_units(graph.rescaled({r: 1.0 / u for r, u in units.items()}))
        result = optimise_distributed(own, self.config, arbitrary_scale=frozenset({0, 1, 2}))
        for robot, outcome in result.outcomes.items():
            assert outcome.units[NodeId(robot, 3)] == pytest.approx(units[robot], rel=1e-3)

    def test_units_that_drift_are_found_where_edges_measure_them(self):
        graph, truth = loops(np.random.default_rng(14), robots=3, length=30, sigma_t=0.0, sigma_deg=0.0)
        rng = np.random.default_rng(15)
        units = {n: np.exp(0.3 * n.robot + 0.2 * np.sin(n.index / 5) + 0.01 * rng.normal()) for n in graph.nodes}
        units |= {n: 1.0 for n in graph.nodes if n.robot == 1}
        own = drifting(graph, truth, units)
        result = optimise_distributed(own, self.exact, frozenset({0, 2}))
        # The metric robot is the anchor, whatever its number; its unit is everybody's.
        anchor = NodeId(1, 0)
        assert np.array_equal(result.graph.poses[anchor], own.poses[anchor])
        for node, T in truth.items():
            expected = own.poses[anchor] @ se3_inverse(truth[anchor]) @ T
            np.testing.assert_allclose(result.graph.poses[node], expected, atol=20 * self.nearness)
            assert result.units[node] == pytest.approx(units[node], rel=20 * self.nearness)
        assert all(result.units[n] == 1.0 for n in graph.nodes if n.robot == 1)
        assert all(o.accepted and not o.unreached for o in result.outcomes.values())

    def test_the_same_graph_gives_the_same_bytes(self):
        graph, _ = loops(np.random.default_rng(12), robots=4, length=16)
        a, b = self.solve(graph), self.solve(graph)
        assert a.traffic == b.traffic
        assert all(np.array_equal(a.graph.poses[n], b.graph.poses[n]) for n in graph.nodes)


_EXACT = {"rotation_threshold": 1e-10, "pose_threshold": 1e-10, "rotation_sweeps": 2000, "pose_sweeps": 2000}


class TestGaussSeidel(SolverContract):
    config = SolverConfig(method="dgs")
    exact = SolverConfig(method="dgs", **_EXACT)


class TestJacobi(SolverContract):
    config = SolverConfig(method="jor")
    exact = SolverConfig(method="jor", **_EXACT)


class TestOverRelaxed(SolverContract):
    config = SolverConfig(method="sor")
    exact = SolverConfig(method="sor", **_EXACT)


class TestQuick(SolverContract):
    config = SolverConfig.quick()
    exact = SolverConfig(method="sor", **_EXACT)


class TestBlockDescent(SolverContract):
    config = SolverConfig(method="rbcd")
    exact = SolverConfig(method="rbcd")
    nearness = 1e-5


class TestRobustBlockDescent(SolverContract):
    config = SolverConfig(method="rbcd", robust="gnc", gnc_confidence=1 - 1e-9)
    exact = SolverConfig(method="rbcd", robust="gnc")
    nearness = 1e-5

    def group_cost(self, graph):
        bound = chi2.ppf(self.config.gnc_confidence, 6)
        squared = edge_cost(graph, "F")
        judged = np.array([e.kind is not EdgeKind.ODOMETRY for e in graph.edges])
        return float(np.where(judged, np.minimum(squared, bound), squared).sum())


class TestMultifrontal(SolverContract):
    config = SolverConfig(method="multifrontal")
    exact = SolverConfig(method="multifrontal", cost_tolerance=1e-12)

    def test_shares_that_contradict_each_other_are_an_error(self):
        graph, _ = loops(np.random.default_rng(11), robots=2, length=10, separators=3)
        group = shares(graph)
        short = replace(group[1], edges=tuple(e for e in group[1].edges if not e.is_separator))
        with pytest.raises(BackendError, match=r"do not fit together|wait for messages"):
            solve_group({0: group[0], 1: short}, self.config)
        node = node_for(group[0], self.config)
        with pytest.raises(BackendError, match="message of another method"):
            node.handle(Report(1, 0, Round(SolverStage.START), 0.0, 0.0))


class TestTwoLevel(SolverContract):
    config = SolverConfig(method="two-level")
    exact = SolverConfig(method="two-level", two_level_tolerance=1e-12)


class TestFreeBlockDescent(SolverContract):
    config = SolverConfig(method="rbcd-async")
    exact = SolverConfig(method="rbcd-async")
    nearness = 1e-5
    bit_for_bit = False
