"""The elected solver: against the central optimum, and by what travels."""

import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from graphs import grid, loops
from hypothesis import given
from hypothesis import strategies as st

from maslam.backend.central.costs import cost
from maslam.backend.central.optimise import optimise
from maslam.backend.config import CentralConfig, SolverConfig
from maslam.backend.distributed.compact import CompactReader, CompactWriter, from_steps, step_sizes, to_steps
from maslam.backend.distributed.condense import OwnGraph
from maslam.backend.distributed.elected import ElectedNode
from maslam.backend.distributed.elected_messages import ElectedMessage, Kind
from maslam.backend.distributed.exchange import optimise_distributed, solve_group
from maslam.backend.distributed.share import Share, shares
from maslam.backend.errors import BackendError
from maslam.backend.geometry import se3, se3_exp, se3_inverse, se3_log, so3_exp
from maslam.backend.pose_graph.g2o import read_g2o
from maslam.backend.pose_graph.graph import Edge, NodeId, PoseGraph

DATA = Path(os.environ.get("MASLAM_DATA", Path(__file__).resolve().parents[3] / "shared" / "data")) / "posegraphs"
CONFIG = SolverConfig(method="elected")


def test_a_member_without_edges_of_its_own_is_solved_with_the_others(recwarn):
    """As in the graph of one agent: of another it has single key-frames, joined to its own by matches alone."""
    graph, _ = loops(np.random.default_rng(5), robots=3, length=12, separators=6)
    lone = [e for e in graph.edges if {e.i.robot, e.j.robot} != {2}]
    nodes = {n for e in lone for n in (e.i, e.j)}
    graph = replace(graph, edges=tuple(lone), poses={n: T for n, T in graph.poses.items() if n in nodes})
    assert sum(n.robot == 2 for n in nodes) > 1
    result = optimise_distributed(graph, CONFIG)
    assert not recwarn.list, [str(w.message) for w in recwarn.list]
    optimum = optimise(graph, CentralConfig()).cost_after
    assert cost(result.graph, "F") <= optimum * 1.001 < cost(graph, "F")


@given(st.lists(st.integers(-(2**61), 2**61), max_size=20), st.floats(allow_nan=False, allow_infinity=False))
def test_numbers_come_back(values, number):
    out = CompactWriter()
    for v in values:
        out.signed(v)
        out.count(abs(v))
    out.number(number)
    source = CompactReader(out.bytes())
    for v in values:
        assert source.signed() == v and source.count() == abs(v)
    assert source.number() == number and source.empty
    with pytest.raises(BackendError, match="ends too early"):
        source.count()


def test_poses_come_back_within_half_a_step():
    rng = np.random.default_rng(0)
    for _ in range(50):
        predicted, T = se3_exp(rng.normal(size=6)), se3_exp(3 * rng.normal(size=6))
        sizes = step_sizes(50.0, 100.0, 64.0)
        np.testing.assert_allclose(sizes, np.array([0.1] * 6) / 64)
        back = from_steps(to_steps(T, predicted, sizes), predicted, sizes)
        assert np.abs(se3_log(se3_inverse(T) @ back)).max() < 3 * sizes[0]


@pytest.mark.parametrize("convention", ["F", "U"])
def test_the_group_ends_at_the_central_optimum(convention):
    graph, _ = grid(np.random.default_rng(1), sigma=0.15)
    graph = graph.with_unit_weights() if convention == "U" else graph
    result = optimise_distributed(graph, CONFIG)
    best = optimise(graph, CentralConfig())
    assert cost(result.graph, "F") == pytest.approx(best.cost_after, rel=1e-4)
    anchor = graph.nodes[0]
    np.testing.assert_array_equal(result.graph.poses[anchor], graph.poses[anchor])
    for o in result.outcomes.values():
        assert o.accepted and not o.unreached
        assert o.cost_after == pytest.approx(best.cost_after, rel=3e-4)
        assert o.cost_before == pytest.approx(cost(graph, "F"), rel=3e-4)


def test_exact_measurements_give_the_truth_from_own_frames_whatever_is_condensed():
    graph, truth = loops(np.random.default_rng(2), robots=3, length=40, separators=4, sigma_t=0.0, sigma_deg=0.0)
    shift = graph.poses[NodeId(0, 0)] @ se3_inverse(truth[NodeId(0, 0)])
    bytes_ = []
    for longest in (1, 5, 1000):
        result = optimise_distributed(graph, CONFIG.model_copy(update={"elected_longest": longest}))
        for node, T in truth.items():
            np.testing.assert_allclose(result.graph.poses[node], shift @ T, atol=2e-3)
        bytes_.append(result.traffic.payload_bytes)
    assert bytes_[0] > 1.5 * bytes_[1] > 1.5 * bytes_[2]


def test_a_condensed_stretch_has_the_noise_of_simulated_ones():
    rng = np.random.default_rng(3)
    kappa, tau, n = 2000.0, 400.0, 12
    information = np.diag([tau] * 3 + [2 * kappa] * 3)
    steps = [se3_exp([1.0, 0.1, 0.0, 0.0, 0.15, 0.1]) for _ in range(n)]
    poses = {NodeId(0, 0): np.eye(4)}
    for k, T in enumerate(steps):
        poses[NodeId(0, k + 1)] = poses[NodeId(0, k)] @ T
    # Some edges point backwards; that means the same.
    edges = [
        Edge(NodeId(0, k), NodeId(0, k + 1), T, information)
        if k % 3
        else Edge(NodeId(0, k + 1), NodeId(0, k), se3_inverse(T), information)
        for k, T in enumerate(steps)
    ]
    ends = (Edge(NodeId(0, 0), NodeId(1, 0), np.eye(4), information), Edge(NodeId(0, n), NodeId(1, 1), np.eye(4)))
    share = Share(0, (0, 1), poses, (*edges, *ends))
    condensed = OwnGraph(share).condensed(1000)
    assert condensed.nodes == [NodeId(0, 0), NodeId(0, n)] and condensed.edges.ends.tolist() == [[0, 1]]
    np.testing.assert_allclose(condensed.edges.measured[0], poses[NodeId(0, n)], atol=1e-12)
    sigma = np.array([tau**-0.5] * 3 + [(2 * kappa) ** -0.5] * 3)
    T = np.eye(4)
    for step in steps:
        T = T @ step @ se3_exp(sigma * rng.normal(size=(5000, 6)))
    variance = np.var(se3_log(se3_inverse(poses[NodeId(0, n)]) @ T), axis=0)
    assert variance[:3].sum() == pytest.approx(3 / condensed.edges.tau[0], rel=0.06)
    assert variance[3:].sum() == pytest.approx(3 / (2 * condensed.edges.kappa[0]), rel=0.06)
    # At most five edges in one: 12 are made of 5, 5 and 2.
    assert [n.index for n in OwnGraph(share).condensed(5).nodes] == [0, 5, 10, 12]
    assert len(OwnGraph(share).condensed(1).edges.ends) == n


def test_what_hangs_loose_is_left_out_and_follows():
    rng = np.random.default_rng(4)
    graph, _ = loops(rng, robots=2, length=20, separators=2, sigma_t=0.01)
    result = optimise_distributed(graph, CONFIG.model_copy(update={"elected_longest": 1000}))
    best = optimise(graph, CentralConfig())
    assert cost(result.graph, "F") <= best.cost_after * 1.02 + 1e-6
    # A robot without an edge to the others keeps its poses and says so.
    apart = replace(graph, edges=tuple(e for e in graph.edges if not e.is_separator))
    outcomes, _ = solve_group(shares(apart), CONFIG)
    assert len(outcomes[1].unreached) == 20 and not outcomes[0].unreached
    for k in range(20):
        np.testing.assert_array_equal(outcomes[1].poses[NodeId(1, k)], graph.poses[NodeId(1, k)])


def test_edges_written_backwards_are_other_measurements_and_reach_their_optimum():
    graph, _ = loops(np.random.default_rng(4), robots=3, length=12, separators=3, sigma_t=0.05, sigma_deg=1.0)
    turned = tuple(Edge(e.j, e.i, se3_inverse(e.T_i_j), e.information, e.kind) for e in graph.edges)
    backwards = replace(graph, edges=turned)
    best = optimise(backwards, CentralConfig()).cost_after
    assert abs(best - optimise(graph, CentralConfig()).cost_after) > 0.01 * best  # F weighs a shift in i's frame
    exact = CONFIG.model_copy(update={"elected_longest": 1})
    for one, lowest in ((backwards, best), (graph, optimise(graph, CentralConfig()).cost_after)):
        assert cost(optimise_distributed(one, exact).graph, "F") == pytest.approx(lowest, rel=1e-3)


def test_one_edge_backwards_between_two_ends_of_edges_to_others():
    step, across = se3(so3_exp([0, 0, 0.2]), [1.0, 0.3, 0.1]), se3(so3_exp([0, 0.3, 0]), [0.0, 4.0, 0.0])
    truth = {NodeId(r, k): np.linalg.matrix_power(step, k) for r in range(2) for k in range(3)}
    truth |= {n: across @ T for n, T in truth.items() if n.robot}
    edges = [(NodeId(r, k), NodeId(r, k + 1)) for r in range(2) for k in range(2)]
    edges[0] = edges[0][::-1]
    edges += [(NodeId(0, 0), NodeId(1, 0)), (NodeId(0, 1), NodeId(1, 2))]
    measured = tuple(Edge(i, j, se3_inverse(truth[i]) @ truth[j]) for i, j in edges)
    rng = np.random.default_rng(0)
    shaken = {n: T @ se3_exp(0.1 * rng.normal(size=6)) for n, T in truth.items()}
    result = optimise_distributed(PoseGraph(shaken, measured), CONFIG)
    assert all(o.accepted for o in result.outcomes.values()) and cost(result.graph, "F") < 1e-4


def test_the_one_with_most_to_send_is_elected_and_gathers():
    graph, _ = loops(np.random.default_rng(6), robots=3, length=12, separators=3)
    more = {n: T for n, T in graph.poses.items() if n.robot != 0 or n.index < 6}
    smaller = replace(graph, poses=more, edges=tuple(e for e in graph.edges if e.i in more and e.j in more))
    nodes = {r: ElectedNode(s, CONFIG) for r, s in shares(smaller).items()}
    queue = [m for n in nodes.values() for m in n.start()]
    seen = []
    while queue:
        message = queue.pop(0)
        seen.append((message.kind, message.sender, message.receiver))
        queue += nodes[message.receiver].handle(message)
    leader = nodes[0].leader
    assert leader in (1, 2) and {n.leader for n in nodes.values()} == {leader}
    assert all(leader in pair[1:] for pair in seen if pair[0] is not Kind.SIZE)
    assert sum(kind is Kind.CONTRIBUTION for kind, _, _ in seen) == 2


def test_the_cost_never_ends_higher():
    graph, _ = grid(np.random.default_rng(9), sigma=0.2)
    best = optimise(graph, CentralConfig()).graph
    result = optimise_distributed(best, CONFIG)
    for outcome in result.outcomes.values():
        assert not outcome.accepted and outcome.reason.startswith("the cost would rise")
    assert all(np.array_equal(T, best.poses[n]) for n, T in result.graph.poses.items())


def test_one_robot_alone_planar_graphs_and_what_is_refused():
    graph, _ = loops(np.random.default_rng(10), robots=1, length=10)
    wobbly = graph.with_poses({n: T @ se3_exp([0.1] * 6) for n, T in graph.poses.items() if n.index})
    result = optimise_distributed(wobbly, CONFIG)
    assert result.outcomes[0].accepted and cost(result.graph, "F") < 1e-6 and result.traffic.messages == 0
    flat = {NodeId(r, k): se3(np.eye(3), [k, r, 0.0]) for r in range(2) for k in range(4)}
    steps = [Edge(NodeId(r, k), NodeId(r, k + 1), se3(np.eye(3), [1.1, 0, 0])) for r in range(2) for k in range(3)]
    across = [Edge(NodeId(0, k), NodeId(1, k), se3(np.eye(3), [0, 1.05, 0])) for k in (0, 3)]
    planar = PoseGraph(flat, (*steps, *across), 2)
    result = optimise_distributed(planar, CONFIG)
    assert cost(result.graph, "F") == pytest.approx(optimise(planar, CentralConfig()).cost_after, abs=1e-6)
    with pytest.raises(BackendError, match="not an elected solver's message"):
        ElectedMessage.decode(b"\x00" * 12)


@pytest.mark.realdata
@pytest.mark.skipif(not DATA.is_dir(), reason=f"no pose graphs at {DATA} (MASLAM_DATA)")
@pytest.mark.parametrize(
    ("count", "u_best", "stationary_bytes"),
    [(2, 0.594677, None), (4, 3.222926, 18e3), (9, 6.775963, 60e3), (16, 11.543992, 166e3), (25, 20.745898, 323e3)],
)
def test_public_sets_to_a_ten_thousandth_in_a_tenth_of_the_published_bytes(count, u_best, stationary_bytes):
    files = [DATA / "multi" / f"{count}robots" / f"{r}.g2o" for r in range(count)]
    result = optimise_distributed(read_g2o(files).with_unit_weights(), CONFIG)
    assert cost(result.graph, "U") == pytest.approx(u_best, rel=1e-4)
    assert stationary_bytes is None or result.traffic.wire_bytes < 0.25 * stationary_bytes


@pytest.mark.realdata
@pytest.mark.skipif(not DATA.is_dir(), reason=f"no pose graphs at {DATA} (MASLAM_DATA)")
def test_sphere2500_in_five_parts():
    graph = read_g2o(DATA / "single" / "sphere2500.g2o").partitioned(5)
    result = optimise_distributed(graph, CONFIG)
    assert cost(result.graph, "F") == pytest.approx(1687.00581, rel=1e-4)
    assert result.traffic.wire_bytes < 200e3
