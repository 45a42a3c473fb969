"""Sweeps with a coarse level: near the optimum after a number of sweeps that the number of robots does not change."""

import numpy as np
import pytest
from graphs import grid, loops, ring
from scipy.linalg import block_diag

from maslam.backend.central.costs import cost
from maslam.backend.central.linear import pose_blocks
from maslam.backend.central.optimise import optimise
from maslam.backend.central.similarity_edges import edges_of
from maslam.backend.config import CentralConfig, SolverConfig
from maslam.backend.distributed import exchange
from maslam.backend.distributed.exchange import optimise_distributed
from maslam.backend.distributed.message_bytes import decode, encode
from maslam.backend.distributed.messages import Coded
from maslam.backend.distributed.methods import node_for
from maslam.backend.distributed.places import SCALED, Places
from maslam.backend.distributed.share import shares
from maslam.backend.distributed.solver_stage import Round, SolverStage
from maslam.backend.distributed.two_level.answers import CoarseAnswer, Then, differences, nearest_before, summed
from maslam.backend.distributed.two_level.coded_places import CodedPlaces
from maslam.backend.distributed.two_level.codes import read_steps, write_steps
from maslam.backend.distributed.two_level.forces import read_forces, write_forces
from maslam.backend.distributed.two_level.knots import Hats, arms, carried, gathered, hats_of
from maslam.backend.distributed.two_level.tracks import tracks
from maslam.backend.distributed.wire import pack, unpack
from maslam.backend.errors import BackendError
from maslam.backend.geometry import se3, se3_exp, so3_exp
from maslam.backend.pose_graph.graph import Edge, EdgeKind, NodeId
from maslam.tools.pgo.city import city

TWO_LEVEL = SolverConfig(method="two-level")


def excess(graph, result):
    """Cost above the central optimum, as a share of it."""
    return cost(result.graph, "F") / optimise(graph, CentralConfig()).cost_after - 1.0


def random_places(rng, count, width=6):
    poses = se3(so3_exp(rng.normal(size=(count, 3))), 20.0 * rng.normal(size=(count, 3)))
    return Places(poses, 0.1 * rng.normal(size=count) if width == SCALED else np.zeros(count))


# -- the whole -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("robots", "seed"), [(8, 4), (24, 5)])
def test_cities_end_within_a_thousandth_in_sweeps_and_bytes_that_grow_with_the_robots_only(robots, seed):
    graph, _ = city(robots, 50, seed)
    result = optimise_distributed(graph, TWO_LEVEL)
    outcome = next(iter(result.outcomes.values()))
    assert outcome.accepted and not outcome.capped
    assert excess(graph, result) < 1e-3
    assert outcome.pose_sweeps < 16
    between = sum(e.is_separator for e in graph.edges)
    assert result.traffic.wire_bytes < 300 * between


@pytest.mark.parametrize(("robots", "seed", "backwards"), [(5, 0, False), (10, 1, True)])
def test_rings_end_within_a_thousandth(robots, seed, backwards):
    graph = ring(robots, 40, seed, backwards)
    assert -1e-9 < excess(graph, optimise_distributed(graph, TWO_LEVEL)) < 1e-3


def test_a_small_tolerance_leads_to_the_optimum():
    graph, _ = grid(np.random.default_rng(3), sigma=0.1)
    tight = TWO_LEVEL.model_copy(update={"two_level_tolerance": 1e-9})
    assert excess(graph, optimise_distributed(graph, tight)) < 1e-6


def test_who_may_not_go_on_says_so():
    graph, _ = city(8, 50, 4)
    result = optimise_distributed(graph, TWO_LEVEL.model_copy(update={"two_level_sweeps": 2}))
    assert all(o.accepted and o.capped for o in result.outcomes.values())
    assert excess(graph, result) > 1e-3


def test_the_root_is_sent_only_knots_forces_and_sums_of_robots_that_are_not_its_neighbours():
    """Shared poses travel between neighbours only."""
    graph, _ = loops(np.random.default_rng(6), robots=5, length=20)
    pairs = {frozenset((e.i.robot, e.j.robot)) for e in graph.edges if e.is_separator}
    stages = set()
    sent = []
    original = exchange._Post.send
    try:
        exchange._Post.send = lambda self, messages: (sent.extend(messages), original(self, messages))[1]
        optimise_distributed(graph, TWO_LEVEL)
    finally:
        exchange._Post.send = original
    for m in sent:
        if isinstance(m, Coded) and frozenset((m.sender, m.receiver)) not in pairs:
            stages.add((m.round.stage, m.round.sweep))
    assert {stage for stage, _ in stages} == {SolverStage.TWO_LEVEL}
    assert {sweep for _, sweep in stages} == {1, 2, 3, 5, 6}


@pytest.mark.parametrize("lost_at", [0, 1, 2, 3])
def test_what_one_robot_lacks_is_sent_again_however_far_the_others_have_gone(lost_at):
    """All first copies to one robot are lost, and who waits sends its last messages again, once to each other robot."""
    graph, _ = loops(np.random.default_rng(7), robots=4, length=16)
    expected, _ = exchange.solve_group(shares(graph), TWO_LEVEL)
    nodes = {robot: node_for(share, TWO_LEVEL) for robot, share in shares(graph).items()}
    queue, seen = [m for node in nodes.values() for m in node.start()], set()
    for _ in range(400):
        while queue:
            message = queue.pop(0)
            key = (message.name, message.place, message.sender, message.receiver)
            if message.receiver == lost_at and key not in seen:
                seen.add(key)
                continue
            queue += nodes[message.receiver].handle(message)
        if all(node.outcome is not None for node in nodes.values()):
            break
        for node in nodes.values():
            for message in {m.receiver: m for m in node.tick()}.values():
                queue += [message, *nodes[message.receiver].again(message)]
    for robot, outcome in expected.items():
        assert all(np.array_equal(nodes[robot].outcome.poses[n], T) for n, T in outcome.poses.items())


# -- the coarse level ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("width", [6, 7])
def test_knots_that_all_move_as_one_body_move_every_pose_so(width):
    rng = np.random.default_rng(0)
    places = random_places(rng, 30, width)
    hats, rows = hats_of(np.zeros(30, dtype=np.intp), rng.random(30) < 0.7, 3)
    centres = places.poses[rows, :3, 3] + rng.normal(size=(len(rows), 3))
    about, twist = rng.normal(size=3), 1e-3 * rng.normal(size=width)
    steps = np.einsum("mij,j->mi", arms(centres, np.broadcast_to(about, centres.shape), width), twist)
    moves = carried(hats, centres, steps, places, np.zeros(30, dtype=bool))
    wanted = np.einsum("mij,j->mi", arms(places.poses[:, :3, 3], np.broadcast_to(about, (30, 3)), width), twist)
    np.testing.assert_allclose(moves[:, :3], wanted[:, :3], atol=1e-12)
    np.testing.assert_allclose(np.einsum("nab,nb->na", places.poses[:, :3, :3], moves[:, 3:6]), wanted[:, 3:6])
    np.testing.assert_allclose(moves[:, 6:], wanted[:, 6:])


@pytest.mark.parametrize("width", [6, 7])
def test_forces_on_knots_are_the_transpose_of_their_moves(width):
    rng = np.random.default_rng(1)
    places = random_places(rng, 20, width)
    hats, rows = hats_of(np.repeat([0, 1], 10), rng.random(20) < 0.8, 2)
    centres, fixed = rng.normal(size=(len(rows), 3)), rng.random(20) < 0.3
    steps, forces = rng.normal(size=(len(rows), width)), rng.normal(size=(20, width))
    a = (carried(hats, centres, steps, places, fixed) * forces).sum()
    assert a == pytest.approx((steps * gathered(hats, centres, forces, places, fixed)).sum())


def test_no_knot_holds_two_pieces_together():
    hats, rows = hats_of(np.repeat([0, 1], 10), np.ones(20, dtype=bool), 4)
    knots = np.arange(len(rows))
    first = set(hats.first[:10].tolist()) | set((hats.first[:10] + 1)[hats.weight[:10] > 0].tolist())
    second = set(hats.first[10:].tolist()) | set((hats.first[10:] + 1)[hats.weight[10:] > 0].tolist())
    assert not first & second and first | second == set(knots.tolist())


def test_a_track_is_as_stiff_as_its_edges_with_what_is_between_left_free():
    """Against the Schur complement of the edges' own Gauss-Newton matrices, where measurements hold exactly."""
    rng, n = np.random.default_rng(2), 9
    poses = [np.eye(4)]
    for _ in range(n - 1):
        poses.append(poses[-1] @ se3_exp(np.array([1.0, 0.1, 0.0, *0.3 * rng.normal(size=3)])))
    T = np.array(poses)
    measured = np.linalg.inv(T[:-1]) @ T[1:]
    information = [np.diag([t] * 3 + [r] * 3) for t, r in rng.uniform(20.0, 500.0, size=(n - 1, 2))]
    edges = edges_of(
        [Edge(NodeId(0, k), NodeId(0, k + 1), measured[k], information[k], EdgeKind.ODOMETRY) for k in range(n - 1)],
        np.array([(k, k + 1) for k in range(n - 1)]),
    )
    hessian, _ = pose_blocks(T[:-1, :3, :3], T[1:, :3, :3], measured, edges.kappa, edges.tau)
    H = np.zeros((6 * n, 6 * n))
    for k in range(n - 1):
        H[6 * k : 6 * k + 12, 6 * k : 6 * k + 12] += hessian[k]
    ends = np.r_[0:6, 6 * (n - 1) : 6 * n]
    inner = np.setdiff1d(np.arange(6 * n), ends)
    schur = H[np.ix_(ends, ends)] - H[np.ix_(ends, inner)] @ np.linalg.solve(H[np.ix_(inner, inner)], H[inner][:, ends])
    hats = Hats(np.array([0, 0]), np.array([0.0, 1.0]))
    centres = T[[0, -1], :3, 3]
    places = Places(T, np.zeros(n))
    linked, links = tracks(np.array([0, n - 1]), hats, centres, edges, places, 6)
    assert linked.tolist() == [0]
    # A pose turns in its own frame, a knot in the common one.
    turned = block_diag(np.eye(3), T[0, :3, :3].T, np.eye(3), T[-1, :3, :3].T)
    middle = 0.5 * (centres[0] + centres[1])
    there = [arms(middle[None], c[None], 6)[0] for c in centres]
    difference = np.concatenate([-there[0], there[1]], axis=1)
    np.testing.assert_allclose(difference.T @ links[0] @ difference, turned.T @ schur @ turned, rtol=1e-6, atol=1e-6)


# -- bytes -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("by_column", [False, True])
@pytest.mark.parametrize("size", [0.3, 2.0, 1e5])
def test_steps_come_back_in_about_the_bits_that_they_hold(by_column, size):
    rng = np.random.default_rng(3)
    steps = np.rint(rng.laplace(0.0, size, (200, 6))).astype(np.int64)
    data = write_steps(steps, by_column)
    assert np.array_equal(read_steps(data, 200, 6, by_column), steps)
    _, counts = np.unique(steps, return_counts=True)
    share = counts / counts.sum()
    if size < 10:
        # The code gives a number a whole bit at least: half a bit above what it holds.
        assert 8 * len(data) < steps.size * (0.5 - (share * np.log2(share)).sum())
    assert write_steps(np.zeros((4, 6), dtype=np.int64)) == b""


def test_damaged_steps_are_an_error():
    steps = np.array([[5, -3, 0], [1, 200, 7]])
    data = write_steps(steps)
    for bad, count in ((data[:-1], 2), (data + b"\x01", 2), (b"\xff" * 40, 2), (data, 1), (b"\x00", 0)):
        with pytest.raises(BackendError):
            read_steps(bad, count, 3)


def test_knots_moves_come_back_whatever_they_are_predicted_from():
    rng = np.random.default_rng(4)
    steps = rng.integers(-900, 900, (12, 6))
    centres = 10.0 * rng.normal(size=(12, 3))
    assert np.array_equal(summed(differences(steps, centres, 0.1), centres, 0.1), steps)
    # Knots that move as one body take next to nothing.
    twist = np.array([300.0, -200.0, 10.0, 40.0, 5.0, -60.0])
    lever = 0.1
    whole = np.concatenate(
        [twist[:3] + lever * np.cross(twist[3:], centres), np.broadcast_to(twist[3:], (12, 3))], axis=1
    )
    found = differences(np.rint(whole).astype(np.int64), centres, lever)
    assert np.abs(found[1:]).max() <= 2


@pytest.mark.parametrize("knots", [0, 1, 2, 63, 64, 65, 129, 500])
def test_the_nearest_knot_before_each_is_found(knots):
    centres = np.random.default_rng(knots).normal(size=(knots, 3)) * [30.0, 30.0, 0.0]
    found = nearest_before(centres)
    assert len(found) == max(knots - 1, 0)
    for k, near in enumerate(found, start=1):
        assert near == np.argmin(np.linalg.norm(centres[:k] - centres[k], axis=1))


def test_a_robot_of_many_knots_needs_no_table_of_all_pairs():
    """A hundred thousand knots: all pairs would be 80 GB."""
    centres = np.stack([np.arange(100_000.0), np.zeros(100_000), np.zeros(100_000)], axis=1)
    assert np.array_equal(nearest_before(centres), np.arange(99_999))


@pytest.mark.parametrize("width", [6, 7])
def test_forces_come_back_and_the_one_on_the_whole_robot_most_exactly(width):
    rng = np.random.default_rng(5)
    forces, centres = rng.normal(size=(9, width)), 5.0 * rng.normal(size=(9, 3))
    sigmas = np.array([0.02, 0.002, 0.01])
    cost_, found = read_forces(write_forces(12.5, forces, centres, sigmas, 1e-3), centres, sigmas, width)
    assert cost_ == 12.5
    unit = np.repeat(1.0 / sigmas, (3, 3, 1))[:width]
    # What rounding added pulls between knots; as a force on all of them next to nothing is left.
    left = found - forces
    assert np.abs(left[:, :3].sum(axis=0)).max() <= 1e-3 / 16 * unit[0]
    assert np.abs(left[:, :3]).max() <= 2e-3 * unit[0]
    with pytest.raises(BackendError, match="finite"):
        read_forces(np.array([np.nan]).tobytes() + bytes(4), centres, sigmas, width)


def test_answers_and_places_come_back_and_damaged_ones_are_errors():
    rng = np.random.default_rng(6)
    steps = rng.integers(-40, 40, (7, 6))
    answer = CoarseAnswer(Then.SWEEP, False, 0.5, np.array([0.5, 0.25, 1.0]), steps)
    found = CoarseAnswer.decode(answer.encode(), 7, 6)
    assert np.array_equal(found.steps, steps) and found.grid == 0.5 and found.sigmas.tolist() == [0.5, 0.25, 1.0]
    assert CoarseAnswer.decode(CoarseAnswer(Then.END, True).encode(), 7, 6).capped
    for bad in (b"", b"\x07", b"\x00" + np.float32(-1).tobytes(), answer.encode()[:-1]):
        with pytest.raises(BackendError):
            CoarseAnswer.decode(bad, 7, 6)
    places, known = random_places(rng, 10), rng.random(10) < 0.7
    coded = CodedPlaces.of(places, known, np.array([0.02, 0.002, 0.01]), 6)
    back = CodedPlaces.decode(coded.encode(), 10, 6)
    assert np.array_equal(back.known, known)
    np.testing.assert_allclose(back.places.poses[:, :3, 3], places.poses[known, :3, 3], atol=0.02 / 16)
    with pytest.raises(BackendError):
        CodedPlaces.decode(coded.encode()[:-3], 10, 6)


def test_far_places_take_coarser_steps_instead_of_being_cut():
    places = random_places(np.random.default_rng(7), 3)
    places.poses[1, 0, 3] = 1e12
    found = CodedPlaces.of(places, np.ones(3, dtype=bool), np.array([0.02, 0.002, 0.01]), 6)
    assert CodedPlaces.decode(found.encode(), 3, 6).places.poses[1, 0, 3] == pytest.approx(1e12, rel=1e-6)


@pytest.mark.parametrize("ends", [(0, 1), (300, 20000)])
def test_coded_messages_survive_both_forms_of_bytes(ends):
    message = Coded(*ends, Round(SolverStage.TWO_LEVEL, 130, 4), b"\x01\x02")
    for found in (decode(encode(message)), unpack(*ends, pack(message))):
        assert found == message
    with pytest.raises(BackendError):
        decode(b"\x3f" + bytes(4))
