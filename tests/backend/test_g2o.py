"""g2o files: what is written is read back; what is broken is named with its line."""

import numpy as np
import pytest
from graphs import grid, loops, measured

from maslam.backend.central.certificate import certify
from maslam.backend.central.costs import cost, edge_cost
from maslam.backend.central.graph_report import report
from maslam.backend.central.linear import isotropic_weights
from maslam.backend.central.optimise import optimise
from maslam.backend.config import CentralConfig
from maslam.backend.errors import BackendError
from maslam.backend.geometry import se3, se3_exp, so3_exp
from maslam.backend.pose_graph.g2o import read_g2o, write_g2o
from maslam.backend.pose_graph.graph import Edge, NodeId, PoseGraph, Prior

UNIT = "1 0 0 0 0 0 1 0 0 0 0 1 0 0 0 1 0 0 1 0 1"
STEP = f"EDGE_SE3:QUAT 0 1 1 0 0 0 0 0 1 {UNIT}"


def assert_same(a, b):
    assert a.nodes == b.nodes and len(a.edges) == len(b.edges) and a.dimension == b.dimension
    for n in a.nodes:
        np.testing.assert_allclose(a.poses[n], b.poses[n], atol=1e-9)
    for x, y in zip(a.edges, b.edges, strict=True):
        assert (x.i, x.j) == (y.i, y.j) and x.is_separator == y.is_separator
        np.testing.assert_allclose(x.T_i_j, y.T_i_j, atol=1e-9)
        np.testing.assert_allclose(x.information, y.information, rtol=1e-9)


def test_round_trip_of_one_file_and_of_a_set(tmp_path):
    graph, _ = grid(np.random.default_rng(0))
    write_g2o(tmp_path / "all.g2o", graph)
    assert_same(read_g2o(tmp_path / "all.g2o"), graph)
    for robot in graph.robots:
        write_g2o(tmp_path / f"{robot}.g2o", graph.of_robot(robot))
    together = read_g2o([tmp_path / f"{r}.g2o" for r in graph.robots])
    # Edges between robots stand in two files and count once.
    assert len(together.edges) == len(graph.edges) and together.nodes == graph.nodes


def test_a_planar_graph_stays_planar(tmp_path):
    information = np.eye(6)
    information[np.ix_([0, 1, 5], [0, 1, 5])] = [[4, 1, 0.5], [1, 3, 0.2], [0.5, 0.2, 9]]
    T = se3(so3_exp([0, 0, 0.3]), [1.0, 2.0, 0.0])
    graph = PoseGraph(
        {NodeId(0, 0): np.eye(4), NodeId(0, 5): T}, (Edge(NodeId(0, 0), NodeId(0, 5), T, information),), dimension=2
    )
    write_g2o(tmp_path / "flat.g2o", graph, plain_ids=True)
    assert (tmp_path / "flat.g2o").read_text().startswith("VERTEX_SE2 0 ")
    assert_same(read_g2o(tmp_path / "flat.g2o"), graph)


def test_robots_beyond_26_come_after_z(tmp_path):
    first = {NodeId(r, 7): se3(np.eye(3), [r, 0.0, 0.0]) for r in range(49)}
    write_g2o(tmp_path / "many.g2o", PoseGraph(first, ()))
    graph = read_g2o(tmp_path / "many.g2o")
    assert graph.robots == list(range(49)) and graph.poses[NodeId(26, 7)][0, 3] == 26
    text = (tmp_path / "many.g2o").read_text()
    assert str((ord("a") << 56) | 7) in text and str((ord("A") << 56) | 7) in text


def test_there_are_more_robots_than_letters(tmp_path):
    gtsam = pytest.importorskip("gtsam")
    robots = [0, 51, 52, 98, 4095]
    write_g2o(tmp_path / "many.g2o", PoseGraph({NodeId(r, 7): se3(np.eye(3), [r, 0.0, 0.0]) for r in robots}, ()))
    graph = read_g2o(tmp_path / "many.g2o")
    assert graph.robots == robots and graph.poses[NodeId(98, 7)][0, 3] == 98
    # For gtsam, robot 98 is letter 46 with an index of its own.
    values = gtsam.readG2o(str(tmp_path / "many.g2o"), True)[1]
    assert values.size() == len(robots)
    assert values.atPose3(gtsam.symbol("U", (1 << 48) + 7)).x() == 98
    with pytest.raises(BackendError, match="can name 13312 robots, not robot 13312"):
        write_g2o(tmp_path / "many.g2o", PoseGraph({NodeId(13312, 0): np.eye(4)}, ()))


def test_gtsam_reads_what_is_written(tmp_path):
    gtsam = pytest.importorskip("gtsam")
    graph, _ = loops(np.random.default_rng(1), robots=2, length=5)
    write_g2o(tmp_path / "g.g2o", graph)
    factors, values = gtsam.readG2o(str(tmp_path / "g.g2o"), True)
    assert factors.size() == len(graph.edges) and values.size() == len(graph.poses)
    T = values.atPose3(gtsam.symbol("b", 3)).matrix()
    np.testing.assert_allclose(T, graph.poses[NodeId(1, 3)], atol=1e-9)


def test_poses_may_be_missing(tmp_path):
    path = tmp_path / "edges.g2o"
    path.write_text(f"# a comment\n\n{STEP}\n \n{STEP.replace(' 0 1 1', ' 1 2 1', 1)}\nFIX 0\n")
    graph = read_g2o(path)
    np.testing.assert_allclose([graph.poses[NodeId(0, k)][0, 3] for k in range(3)], [0, 1, 2])


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("VERTEX_SE3:QUAT 3 1_0.5 0 0 0 0 0 1", "not a number: '1_0.5'"),
        ("VERTEX_SE3:QUAT 3 1,5 0 0 0 0 0 1", "not a number: '1,5'.*decimal comma"),
        ("VERTEX_SE3:QUAT 3 1e200 0 0 0 0 0 1", "1e.200 in a pose is beyond"),
        (STEP.replace(UNIT, UNIT.replace("1 0 0 0 0 0 1", "1 0 0 0 0 0 1e99")), "1e.99 in an information matrix"),
        ("PARAMS_SE3OFFSET 0 0 0 0 0 0 0 x", "not a number: 'x'"),
        ("PARAMS_SE3OFFSET 0 0 0", "has 8 fields after its name, found 3"),
        ("VERTEX_SE3:QUAT ٣ 0 0 0 0 0 0 1", "not a node id"),
        ("0410268 0.7588833", "unknown line '0410268'"),
        ("VERTEX_SE3:QUAT 3 0 0 0 0 0 1", "8 fields.*found 7"),
        ("VERTEX_SE3:QUAT 3 0 0 x 0 0 0 1", "not a number"),
        ("VERTEX_SE3:QUAT 3 0 0 nan 0 0 0 1", "NaN"),
        ("VERTEX_SE3:QUAT 3 0 0 0 0 0 0 0.5", "quaternion's length is 0.500"),
        ("VERTEX_SE3:QUAT -3 0 0 0 0 0 0 1", "not a node id"),
        ("PARAMS_SE3OFFSET 0 1 0 0 0 0 0 1", "sensor's offset.*not supported"),
        (STEP.replace(" 0 1 1", " 1 1 1", 1), "from node 0:1 to itself"),
    ],
)
def test_a_broken_line_is_named_or_skipped(tmp_path, line, words):
    path = tmp_path / "broken.g2o"
    path.write_text(f"{STEP}\n{line}\n", encoding="utf-8")
    with pytest.raises(BackendError, match=rf"broken.g2o:2: .*{words}"):
        read_g2o(path)
    skipped = []
    assert len(read_g2o(path, skipped).edges) == 1 and len(skipped) == 1


def test_files_that_hold_no_graph(tmp_path):
    (tmp_path / "empty.g2o").write_text("\n")
    with pytest.raises(BackendError, match="no vertex and no edge"):
        read_g2o(tmp_path / "empty.g2o")
    with pytest.raises(BackendError, match="cannot be read"):
        read_g2o(tmp_path / "absent.g2o")
    (tmp_path / "mixed.g2o").write_text(f"{STEP}\nVERTEX_SE2 1 0 0 0\n")
    with pytest.raises(BackendError, match=r"a 2-D line, and .*:1 is a 3-D one"):
        read_g2o(tmp_path / "mixed.g2o")
    with pytest.raises(BackendError, match="plain ids"):
        write_g2o(tmp_path / "x.g2o", grid(np.random.default_rng(0))[0], plain_ids=True)


def step(i, j, x=1.0, information=UNIT):
    return f"EDGE_SE3:QUAT {i} {j} {x} 0 0 0 0 0 1 {information}"


def vertex(i, x=0.0):
    return f"VERTEX_SE3:QUAT {i} {x} 0 0 0 0 0 1"


def test_ids_of_any_size_and_with_gaps(tmp_path):
    path = tmp_path / "big.g2o"
    huge = ord("?") << 56
    path.write_text("\n".join([step(7, 1000000007), step(1000000007, huge + 5), step(7, huge + 5, 2.0)]))
    graph = read_g2o(path)
    assert graph.robots == [0] and [n.index for n in graph.nodes] == [7, 1000000007, huge + 5]
    # Odometry joins nodes that follow each other, whatever lies between their numbers.
    assert [e.kind for e in graph.edges] == ["odometry", "odometry", "loop"]
    np.testing.assert_allclose(graph.poses[NodeId(0, huge + 5)][0, 3], 2.0)
    # Beside symbols, such an id is a mistake.
    path.write_text(f"{step(ord('a') << 56, (ord('a') << 56) + 1)}\n{vertex(huge)}\n")
    with pytest.raises(BackendError, match=r"big.g2o:2: id \d+ is neither a plain number nor a symbol"):
        read_g2o(path)
    with pytest.raises(BackendError, match="cannot hold the index"):
        write_g2o(path, graph)


def test_plain_ids_in_a_set_one_robot_a_file(tmp_path):
    a, b = tmp_path / "0.g2o", tmp_path / "1.g2o"
    # Numbered through: a node is of the robot whose file holds its vertex; what both files hold counts once.
    between = step(1, 3, 5.0)
    a.write_text("\n".join([vertex(0), vertex(1, 1.0), step(0, 1), between]))
    b.write_text("\n".join([vertex(2), vertex(3, 1.0), step(2, 3), between]))
    graph = read_g2o([a, b])
    assert graph.nodes == [(0, 0), (0, 1), (1, 2), (1, 3)] and len(graph.edges) == 3
    assert [e.is_separator for e in graph.edges] == [False, True, False]
    # Each robot counts from 0: every file means its own nodes.
    b.write_text("\n".join([vertex(0), vertex(1, 1.0), step(0, 1)]))
    a.write_text("\n".join([vertex(0), vertex(1, 1.0), step(0, 1)]))
    graph = read_g2o([a, b])
    assert graph.nodes == [(0, 0), (0, 1), (1, 0), (1, 1)] and len(graph.edges) == 2


def test_what_stands_twice_in_a_file_counts_twice_and_only_the_first_is_odometry(tmp_path):
    path = tmp_path / "twice.g2o"
    path.write_text("\n".join([step(0, 1), step(1, 2), step(0, 1)]))
    graph = read_g2o(path)
    assert [e.kind for e in graph.edges] == ["odometry", "odometry", "loop"]
    assert report(graph).repeated == ((NodeId(0, 0), NodeId(0, 1)),)


@pytest.mark.parametrize("dimension", [2, 3])
def test_priors_are_read_and_written(tmp_path, dimension):
    T = se3(so3_exp([0, 0, 0.3]), [1.0, 2.0, 0.0])
    information = np.eye(6)
    information[np.ix_([0, 1, 5], [0, 1, 5])] = [[4, 1, 0.5], [1, 3, 0.2], [0.5, 0.2, 9]]
    a, b = NodeId(0, 0), NodeId(0, 1)
    graph = PoseGraph({a: np.eye(4), b: T}, (Edge(a, b, T),), dimension, (Prior(b, T, information),))
    write_g2o(tmp_path / "p.g2o", graph, plain_ids=True)
    again = read_g2o(tmp_path / "p.g2o")
    assert_same(again, graph)
    assert again.priors[0].node == b
    np.testing.assert_allclose(again.priors[0].T_O_i, T, atol=1e-9)
    np.testing.assert_allclose(again.priors[0].information, information)


def test_indefinite_information_is_made_semidefinite_and_reported(tmp_path):
    path = tmp_path / "odd.g2o"
    # Eigenvalues of the (y, roll) pair are 3 and -1; both diagonal blocks alone are positive.
    mixed = "1 0 0 0 0 0 1 0 2 0 0 1 0 0 0 1 0 0 1 0 1"
    lost = "1 0 0 0 0 0 1 0 0 0 0 -1 0 0 0 1 0 0 1 0 1"
    lines = [step(0, 1), step(1, 2, 1.0, mixed), step(0, 2, 2.5), step(1, 3, 2.0, lost), step(2, 3)]
    path.write_text("\n".join(lines))
    graph = read_g2o(path)
    found = report(graph)
    assert found.indefinite == (1, 3) and found.weightless == (3,) and found.parts == 1
    assert any("2 edges with indefinite information" in line for line in found.lines())
    kappa, tau = isotropic_weights(graph.arrays().information)
    # F uses the blocks: untouched where these are positive, next to nothing where not; never negative or infinite.
    np.testing.assert_allclose(kappa, [0.5, 0.5, 0.5, 0.5, 0.5])
    np.testing.assert_allclose(tau, [1, 1, 1, 0, 1], atol=1e-9)
    rng = np.random.default_rng(0)
    shaken = graph.with_poses({n: T @ se3_exp(0.3 * rng.normal(size=6)) for n, T in graph.poses.items()})
    assert (edge_cost(shaken, "E") >= 0).all()
    # The loop of three is 0.5 too long, as springs in a row; in E the edge without information on z still holds x,
    # as a spring beside the second.
    assert optimise(graph, CentralConfig()).cost_after == pytest.approx(0.5**2 / 3, rel=1e-4)
    geodesic = optimise(graph, CentralConfig(cost="E")).cost_after
    assert geodesic == pytest.approx(0.5 * 0.5**2 / (2 + 1 / 1.5), rel=1e-4)
    assert certify(optimise(graph, CentralConfig()).graph).certified


def test_a_condition_of_1e11_keeps_its_weights(tmp_path):
    path = tmp_path / "intel.g2o"
    path.write_text("EDGE_SE2 0 1 1 0 0 1e11 0 0 1 0 50\nEDGE_SE2 1 2 1 0 0 2 0 0 2 0 7\n")
    kappa, tau = isotropic_weights(read_g2o(path).arrays().information, 2)
    np.testing.assert_allclose(kappa, [50, 7])
    np.testing.assert_allclose(tau, [2.0 / (1 + 1e-11), 2.0])
    assert not report(read_g2o(path)).indefinite


def test_a_torus_without_odometry_is_solved_and_certified():
    rng = np.random.default_rng(1)
    truth = {}
    for u in range(24):
        for v in range(12):
            a, b = 2 * np.pi * u / 24, 2 * np.pi * v / 12
            position = [(8 + 3 * np.cos(b)) * np.cos(a), (8 + 3 * np.cos(b)) * np.sin(a), 3 * np.sin(b)]
            truth[NodeId(0, 12 * u + v)] = se3(so3_exp([0, 0, a]) @ so3_exp([0, -b, 0]), position)
    sigma = np.array([0.1] * 3 + [0.05] * 3)
    edges = []
    for n in truth:
        u, v = divmod(n.index, 12)
        for other in (12 * ((u + 1) % 24) + v, 12 * u + (v + 1) % 12):
            if rng.random() < 0.85:
                edges.append(measured(truth, n, NodeId(0, other), "loop", sigma, np.diag(sigma**-2.0), rng))
    graph = PoseGraph({n: np.eye(4) for n in truth}, tuple(edges))
    best = optimise(graph, CentralConfig())
    assert certify(best.graph).certified and best.cost_after < cost(graph.with_poses(truth), "F")
