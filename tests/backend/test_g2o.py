"""g2o files: what is written is read back; what is broken is named with its line."""

import numpy as np
import pytest
from graphs import grid, loops

from backend.errors import BackendError
from backend.g2o import read_g2o, write_g2o
from backend.geometry import se3, so3_exp
from backend.graph import Edge, NodeId, PoseGraph

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
        ("0410268 0.7588833", "unknown line '0410268'"),
        ("VERTEX_SE3:QUAT 3 0 0 0 0 0 1", "8 fields.*found 7"),
        ("VERTEX_SE3:QUAT 3 0 0 x 0 0 0 1", "not a number"),
        ("VERTEX_SE3:QUAT 3 0 0 nan 0 0 0 1", "NaN"),
        ("VERTEX_SE3:QUAT 3 0 0 0 0 0 0 0.5", "quaternion's length is 0.500"),
        ("VERTEX_SE3:QUAT -3 0 0 0 0 0 0 1", "not a node id"),
        (f"VERTEX_SE3:QUAT {ord('?') << 56} 0 0 0 0 0 0 1", "neither a plain number nor a symbol"),
        (STEP.replace(" 0 1 1", " 1 1 1", 1), "from node 0:1 to itself"),
    ],
)
def test_a_broken_line_is_named_or_skipped(tmp_path, line, words):
    path = tmp_path / "broken.g2o"
    path.write_text(f"{STEP}\n{line}\n")
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
    with pytest.raises(BackendError, match="2-D and 3-D"):
        read_g2o(tmp_path / "mixed.g2o")
    with pytest.raises(BackendError, match="plain ids"):
        write_g2o(tmp_path / "x.g2o", grid(np.random.default_rng(0))[0], plain_ids=True)
