"""Exact elimination between robots: to the optimum on any shape, and nobody sees more than what is shared."""

import itertools
from dataclasses import replace

import numpy as np
import pytest
from graphs import grid, loops, ring
from scipy.linalg import eigh
from scipy.sparse import csr_array
from scipy.sparse.csgraph import maximum_bipartite_matching

from maslam.backend.central.costs import cost
from maslam.backend.central.linear import curvature_blocks, edge_costs, pose_blocks
from maslam.backend.central.optimise import optimise
from maslam.backend.config import CentralConfig, SolverConfig
from maslam.backend.distributed.compact import CompactReader, CompactWriter
from maslam.backend.distributed.exchange import optimise_distributed, solve_group
from maslam.backend.distributed.methods import node_for
from maslam.backend.distributed.multifrontal import schedule
from maslam.backend.distributed.multifrontal.elimination import Elimination
from maslam.backend.distributed.multifrontal.equations import Matrices, StepFrom, Unknowns
from maslam.backend.distributed.multifrontal.frontal_messages import FrontalKind, FrontalMessage
from maslam.backend.distributed.multifrontal.memory import best_weights
from maslam.backend.distributed.multifrontal.ordering import elimination_order, smallest_cover
from maslam.backend.distributed.multifrontal.reports import Step, Update
from maslam.backend.distributed.multifrontal.shared_poses import LocalCoordinates, read_function, write_function
from maslam.backend.distributed.places import Places
from maslam.backend.distributed.share import shares
from maslam.backend.errors import BackendError
from maslam.backend.geometry import se3, se3_inverse, so3_exp
from maslam.backend.pose_graph.graph import Edge, EdgeKind, NodeId

EXACT = SolverConfig(method="multifrontal")


def excess(graph, result):
    """Cost above the central optimum, as a share of it."""
    return cost(result.graph, "F") / optimise(graph, CentralConfig()).cost_after - 1.0


@pytest.mark.parametrize(("robots", "seed", "backwards"), [(5, 0, False), (10, 1, True), (20, 2, False)])
def test_rings_end_at_the_optimum_and_what_is_sent_does_not_grow_with_the_poses(robots, seed, backwards):
    graph = ring(robots, 40, seed, backwards)
    result = optimise_distributed(graph, EXACT)
    assert all(o.accepted for o in result.outcomes.values())
    assert excess(graph, result) < 1e-5
    longer = optimise_distributed(ring(robots, 80, seed, backwards), EXACT)
    assert longer.traffic.wire_bytes < 1.6 * result.traffic.wire_bytes


@pytest.mark.parametrize("sigma", [0.05, 0.3])
def test_grids_end_at_the_optimum_though_residuals_are_large(sigma):
    graph, _ = grid(np.random.default_rng(3), sigma=sigma)
    assert excess(graph, optimise_distributed(graph, EXACT)) < 1e-5


def test_with_a_tolerance_of_nothing_it_ends_where_steps_round():
    graph = ring(4, 10, 3)
    tight = EXACT.model_copy(update={"cost_tolerance": 0.0})
    assert abs(excess(graph, optimise_distributed(graph, tight))) < 1e-7


def test_nobody_is_sent_poses_that_it_has_no_part_in():
    """Of the interior of others nothing travels: an update names the poses that edges between robots end in, only."""
    graph, _ = loops(np.random.default_rng(6), robots=5, length=20)
    shared = {n for e in graph.edges if e.is_separator for n in (e.i, e.j)}
    group = shares(graph)
    nodes = {robot: node_for(share, EXACT) for robot, share in group.items()}
    queue = [m for node in nodes.values() for m in node.start()]
    named, updates = set(), 0
    while queue:
        message = queue.pop(0)
        if message.kind is FrontalKind.UPDATE and message.number == 0:
            boundary = Update.decode(message.body, Unknowns.ROTATION, None, True, False).boundary
            named |= set(boundary.nodes)
            updates += 1
        queue += nodes[message.receiver].handle(message)
    assert updates == 4
    assert named <= shared


def test_more_than_is_worth_sending_is_refused_by_all_and_poses_stay():
    graph, _ = loops(np.random.default_rng(6), robots=4, length=20)
    result = optimise_distributed(graph, EXACT.model_copy(update={"multifrontal_most_mb": 1e-6}))
    for outcome in result.outcomes.values():
        assert not outcome.accepted and "multifrontal_most_mb" in outcome.reason
    assert all(np.array_equal(result.graph.poses[n], graph.poses[n]) for n in graph.nodes)


def test_only_what_was_lost_is_sent_again():
    """Of every update and step the first copy is lost; who waits asks, and is answered once."""
    graph, _ = loops(np.random.default_rng(7), robots=4, length=16)
    expected, _ = solve_group(shares(graph), EXACT)
    nodes = {robot: node_for(share, EXACT) for robot, share in shares(graph).items()}
    queue = [m for node in nodes.values() for m in node.start()]
    lost, arrived = set(), []
    for _ in range(400):
        while queue:
            message = queue.pop(0)
            key = (message.kind, message.number, message.sender, message.receiver)
            if message.kind is not FrontalKind.WAIT and key not in lost:
                lost.add(key)
                continue
            arrived.append(key)
            queue += nodes[message.receiver].handle(message)
        if all(node.outcome is not None for node in nodes.values()):
            break
        queue += [m for node in nodes.values() for m in node.tick()]
    sent_again = [key for key in arrived if key[0] is not FrontalKind.WAIT]
    assert len(sent_again) == len(set(sent_again)) == len(lost)
    for robot, outcome in expected.items():
        assert all(np.array_equal(nodes[robot].outcome.poses[n], T) for n, T in outcome.poses.items())


def test_an_order_of_other_robots_and_damaged_bodies_are_errors():
    graph, _ = loops(np.random.default_rng(7), robots=3, length=16)
    node = node_for(shares(graph)[1], EXACT)
    node.start()
    with pytest.raises(BackendError, match="not of its group"):
        node.handle(FrontalMessage(FrontalKind.ORDER, 0, 0, 1, bytes(4) + bytes([0, 1, 7])))
    with pytest.raises(BackendError, match="waits for something"):
        node.handle(FrontalMessage(FrontalKind.WAIT, 0, 0, 1, b"\xff"))
    with pytest.raises(BackendError, match="too early"):
        Update.decode(bytes(12), Unknowns.POSE, np.ones(6, dtype=bool), True, False)
    with pytest.raises(BackendError, match="eliminating robot's message"):
        FrontalMessage.decode(b"\xd9" + bytes(9))


def test_shares_that_do_not_fit_together_are_an_error_and_the_message_is_forgotten():
    graph, _ = loops(np.random.default_rng(7), robots=2, length=16)
    group = shares(graph)
    strange = Edge(NodeId(0, 3), NodeId(1, 40), np.eye(4), np.eye(6), EdgeKind.SEPARATOR)
    taller = replace(group[0], edges=(*group[0].edges, strange))
    with pytest.raises(BackendError, match=r"nobody has|wait for messages|too early"):
        solve_group({0: taller, 1: group[1]}, EXACT)


def test_who_ends_without_being_there_says_so(monkeypatch):
    graph = ring(4, 10, 3)
    assert not any(o.capped for o in optimise_distributed(graph, EXACT).outcomes.values())
    monkeypatch.setattr(schedule, "_MOST_PASSES", 1)
    assert all(o.capped for o in optimise_distributed(graph, EXACT).outcomes.values())


def test_steps_of_no_kind_and_too_long_ones_are_refused():
    step = Step(None, Matrices.OLD, StepFrom.BEST, 1.0, 2.0, None, (1.0, 1.0), np.ones(0, bool), np.zeros((0, 0)))
    data = step.encode(Unknowns.POSE)
    assert Step.decode(data, Unknowns.POSE, 0, False).cost == 1.0
    with pytest.raises(BackendError, match="longer than what it says"):
        Step.decode(data + b"\0", Unknowns.POSE, 0, False)
    for code in (7, 3 << 3):
        with pytest.raises(BackendError, match="of no kind"):
            Step.decode(bytes([code]) + data[1:], Unknowns.POSE, 0, False)


def test_numbers_that_have_no_finite_solution_are_refused():
    rows = np.arange(2)
    for huge in (1e308, np.inf):
        blocks = [(rows[None], huge * np.ones((1, 2, 2))), (rows[None], huge * np.eye(2)[None])]
        with pytest.raises(BackendError, match="no finite solution"):
            Elimination(blocks, rows[:1], rows[1:], 2, 1)
    sound = Elimination([(rows[None], 2.0 * np.eye(2)[None])], rows[:1], rows[1:], 2, 1)
    with pytest.raises(BackendError, match="no finite solution"):
        sound.pushed(np.array([[[np.inf]], [[0.0]]]))
    with pytest.raises(BackendError, match="too long for a message"):
        CompactWriter().steps([float("nan")])


def test_second_derivatives_of_a_linear_problem_are_no_step():
    with pytest.raises(BackendError, match="second derivatives"):
        Step.decode(bytes([1 + Unknowns.UNIT | Matrices.EXACT << 3]), Unknowns.POSE, 0, False)


# -- the parts ---------------------------------------------------------------------------------------------------------


def test_elimination_is_a_schur_complement():
    rng = np.random.default_rng(0)
    root = rng.normal(size=(24, 24))
    whole = root @ root.T + np.eye(24)
    rows = np.arange(8)[None]
    inner, outer = np.array([1, 2, 4, 6, 7]), np.array([0, 3, 5])
    found = Elimination([(rows, whole[None])], inner, outer, 8, 3)
    i, o = ((k[:, None] * 3 + np.arange(3)).ravel() for k in (inner, outer))
    expected = whole[np.ix_(o, o)] - whole[np.ix_(o, i)] @ np.linalg.solve(whole[np.ix_(i, i)], whole[np.ix_(i, o)])
    np.testing.assert_allclose(found.left, expected, atol=1e-9)
    assert found.convex
    b = rng.normal(size=(8, 3, 1))
    left, gain = found.pushed(b)
    x_outer = np.linalg.solve(expected, left.ravel())
    x_inner = found.solved(b, x_outer.reshape(-1, 3, 1)).ravel()
    solution = np.linalg.solve(whole, b.ravel())
    np.testing.assert_allclose(x_outer, solution[o], atol=1e-9)
    np.testing.assert_allclose(x_inner, solution[i], atol=1e-9)
    assert gain + left.ravel() @ x_outer == pytest.approx(b.ravel() @ solution)
    assert not Elimination([(rows, (whole - 30.0 * np.eye(24))[None])], inner, outer, 8, 3).convex


def test_curvature_completes_the_second_derivative():
    rng = np.random.default_rng(1)
    T_i, T_j, T_ij = (se3(so3_exp(rng.normal(size=(3, 3))), rng.normal(size=(3, 3))) for _ in range(3))
    kappa, tau = rng.uniform(1, 5, (2, 3))

    def cost_at(x):
        moved_i = se3(T_i[:, :3, :3] @ so3_exp(x[:, 3:6]), T_i[:, :3, 3] + x[:, :3])
        moved_j = se3(T_j[:, :3, :3] @ so3_exp(x[:, 9:]), T_j[:, :3, 3] + x[:, 6:9])
        return edge_costs(moved_i, moved_j, T_ij, kappa, tau)

    h, numeric = 1e-4, np.zeros((3, 12, 12))
    for a, b in itertools.product(range(12), range(12)):
        for sa, sb in itertools.product((1, -1), (1, -1)):
            x = np.zeros((3, 12))
            x[:, a] += sa * h
            x[:, b] += sb * h
            numeric[:, a, b] += sa * sb * cost_at(x) / (4 * h * h)
    exact = pose_blocks(T_i[:, :3, :3], T_j[:, :3, :3], T_ij, kappa, tau)[0]
    exact = exact + curvature_blocks(T_i, T_j, T_ij, kappa, tau)
    np.testing.assert_allclose(exact, 0.5 * numeric, atol=1e-5)


def test_local_coordinates_leave_a_part_that_hangs_free_next_to_nothing():
    """A chain far from the origin: what it says of its first pose is rounding, and the way back is exact."""
    rng = np.random.default_rng(2)
    poses = se3(so3_exp(0.3 * rng.normal(size=(5, 3))), 1e3 + np.arange(15.0).reshape(5, 3))
    ends = np.array([(k, k + 1) for k in range(4)])
    measured = se3_inverse(poses[:-1]) @ poses[1:]
    hessian, _ = pose_blocks(poses[:-1, :3, :3], poses[1:, :3, :3], measured, np.full(4, 1e5), np.full(4, 2e3))
    whole = np.zeros((30, 30))
    for (i, j), block in zip(ends, hessian, strict=True):
        at = np.r_[6 * i : 6 * i + 6, 6 * j : 6 * j + 6]
        whole[np.ix_(at, at)] += block
    b = rng.normal(size=30)
    coordinates = LocalCoordinates(Places(poses, np.zeros(5)), np.zeros(5, dtype=int), 6, np.ones(5, dtype=bool))
    local, local_b = coordinates.local(whole, b)
    assert np.abs(local[~coordinates.carried]).max() < 1e-6
    assert coordinates.carried.sum() == 24
    np.testing.assert_allclose(coordinates.matrix(local), whole, atol=1e-5)
    np.testing.assert_allclose(coordinates.vector(local_b), b, atol=1e-9)


@pytest.mark.parametrize(("condition", "number_bytes"), [(1.0, 1), (1e5, 2), (1e13, 4)])
def test_rounded_functions_say_the_same_in_every_direction(condition, number_bytes):
    rng = np.random.default_rng(4)
    basis = np.linalg.qr(rng.normal(size=(40, 40)))[0]
    hessian = (basis * np.geomspace(1.0, condition, 40)) @ basis.T * 1e3
    carried = np.ones(40, dtype=bool)
    carried[:6] = False
    out = CompactWriter()
    write_function(out, hessian, carried)
    data = out.bytes()
    inner = int(carried.sum())
    fixed = 1 + 4 * inner + 4 * (6 * inner + 21)
    assert (len(data) - fixed) / (inner * (inner + 1) / 2) == number_bytes
    source = CompactReader(data)
    found = read_function(source, carried)
    assert source.empty
    np.testing.assert_allclose(found[:6], hessian[:6], rtol=1e-6)
    ratio = eigh(found[6:, 6:], hessian[6:, 6:], eigvals_only=True) if condition < 1e10 else np.ones(1)
    assert ratio[0] > 0.79 and ratio[-1] < 1.26


def test_a_cover_is_as_small_as_the_largest_matching():
    rng = np.random.default_rng(5)
    for _ in range(50):
        pairs = {(int(a), int(b)) for a, b in rng.integers(0, 8, (rng.integers(1, 20), 2))}
        left, right = smallest_cover(pairs)
        assert all(a in left or b in right for a, b in pairs)
        matrix = np.zeros((8, 8))
        for a, b in pairs:
            matrix[a, b] = 1
        matched = (maximum_bipartite_matching(csr_array(matrix), perm_type="column") >= 0).sum()
        assert len(left) + len(right) == matched
    assert smallest_cover([(3, k) for k in range(4)]) == ({3}, set())
    assert smallest_cover([(k, k) for k in range(4)]) == (set(), {0, 1, 2, 3})


def test_the_order_takes_the_ends_of_a_chain_first_and_the_anchor_last():
    chain = {(k, k + 1): 1 for k in range(6)}
    order, squares = elimination_order(range(7), chain, 3)
    assert order[-1] == 3 and squares == 6
    star = {(0, k): 2 for k in range(1, 6)}
    order, squares = elimination_order(range(6), star, 5)
    assert order[-1] == 5 and squares == 5 * 4


def test_the_best_mix_is_that_of_a_quadratic():
    rng = np.random.default_rng(6)
    root = rng.normal(size=(6, 6))
    H, b = root @ root.T + np.eye(6), rng.normal(size=6)
    points = rng.normal(size=(4, 6))
    rhs = np.array([b - H @ x for x in points])
    moves, changes = points[:-1] - points[-1], rhs[:-1] - rhs[-1]
    weights, gain = best_weights((*(moves @ rhs[-1]), *(moves @ changes.T).ravel()))
    mix = points[-1] + np.array(weights) @ moves

    def value(x):
        return x @ H @ x - 2 * b @ x

    assert value(points[-1]) - value(mix) == pytest.approx(gain, rel=1e-4)
    for shift in np.eye(3):
        assert value(mix + 1e-2 * shift @ moves) > value(mix)
        assert value(mix - 1e-2 * shift @ moves) > value(mix)
    assert best_weights(()) == ((), 0.0)
