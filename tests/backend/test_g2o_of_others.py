"""g2o files as other programs write them: marks and line ends, symbols, landmarks, sets that say things twice."""

import json
from itertools import count

import numpy as np
import pytest
from graphs import loops

from maslam.backend.central.costs import cost
from maslam.backend.central.optimise import optimise
from maslam.backend.config import CentralConfig
from maslam.backend.errors import BackendError
from maslam.backend.geometry import quat_wxyz_from_rotation, se3, se3_inverse, so3_exp
from maslam.backend.pose_graph.g2o import read_g2o, write_g2o
from maslam.backend.pose_graph.graph import NodeId
from maslam.tools import cli

UNIT = "1 0 0 0 0 0 1 0 0 0 0 1 0 0 0 1 0 0 1 0 1"
WEIGHTS = "400 0 0 0 0 0 400 0 0 0 0 400 0 0 0 900 0 0 900 0 900"


def edge(i, j, T, weights=WEIGHTS, digits=9):
    w, x, y, z = quat_wxyz_from_rotation(T[:3, :3])
    return f"EDGE_SE3:QUAT {i} {j} " + " ".join(f"{v:.{digits}g}" for v in [*T[:3, 3], x, y, z, w]) + f" {weights}"


def vertex(i, T):
    w, x, y, z = quat_wxyz_from_rotation(T[:3, :3])
    return f"VERTEX_SE3:QUAT {i} " + " ".join(f"{v:.9g}" for v in [*T[:3, 3], x, y, z, w])


@pytest.fixture(scope="module")
def ring():
    """A ring of 12 nodes with loops, noisy: vertices and edges ``(i, j, T_i_j)`` by plain numbers, and F's optimum."""
    rng = np.random.default_rng(5)
    truth = [se3(so3_exp([0, 0, np.pi * k / 6]), [3 * np.cos(k * np.pi / 6), 3 * np.sin(k * np.pi / 6), 0.1 * k])
             for k in range(12)]  # fmt: skip
    pairs = [(k, k + 1) for k in range(11)] + [(0, 11), (1, 10), (0, 6), (3, 9)]
    noise = [se3(so3_exp(0.01 * rng.normal(size=3)), 0.03 * rng.normal(size=3)) for _ in pairs]
    return truth, [(i, j, se3_inverse(truth[i]) @ truth[j] @ n) for (i, j), n in zip(pairs, noise, strict=True)]


def lines_of(ring, name=lambda k: k):
    truth, edges = ring
    return [vertex(name(k), T) for k, T in enumerate(truth)] + [edge(name(i), name(j), T) for i, j, T in edges]


def lowest(path, **kept):
    return optimise(read_g2o(path, **kept), CentralConfig()).cost_after


def alone(ring, tmp_path):
    (tmp_path / "alone.g2o").write_text("\n".join(lines_of(ring)) + "\n")
    return lowest(tmp_path / "alone.g2o")


def robots_of(ring, tmp_path, shift=lambda k: k):
    """Files of two robots, nodes 0 to 5 and 6 to 11, each with the edges between them."""
    truth, edges = ring
    files = []
    for robot in range(2):
        mine = range(6 * robot, 6 * robot + 6)
        lines = [vertex(shift(k), truth[k]) for k in mine]
        lines += [edge(shift(i), shift(j), T) for i, j, T in edges if i in mine or j in mine]
        files.append(tmp_path / f"{robot}.g2o")
        files[-1].write_text("\n".join(lines) + "\n")
    return files


def letters(k):
    return ((ord("a") + k // 6) << 56) + k % 6


@pytest.mark.parametrize(
    ("mark", "ends", "encoding"), [("\ufeff", "\r\n", "utf-8"), ("", "\r", "ascii"), ("\ufeff", "\n", "utf-16-le")]
)
def test_marks_and_line_ends(ring, tmp_path, mark, ends, encoding):
    path = tmp_path / "windows.g2o"
    path.write_bytes((mark + ends.join(lines_of(ring)) + ends).encode(encoding))
    assert lowest(path) == pytest.approx(alone(ring, tmp_path), rel=1e-9)


def test_symbols_of_one_robot_are_kept(ring, tmp_path, capsys):
    path, out = tmp_path / "x.g2o", tmp_path / "out.g2o"
    path.write_text("\n".join(lines_of(ring, lambda k: (ord("x") << 56) + k)) + "\n")
    assert cli.main(["pgo", str(path), str(out), "--method", "central"]) == 0
    ids = [line.split()[1] for line in out.read_text().splitlines() if line.startswith("VERTEX")]
    assert ids == [str((ord("x") << 56) + k) for k in range(12)]
    capsys.readouterr()
    far = edge((ord("x") << 56) + 2, (ord("x") << 56) + 8, se3(np.eye(3), [50.0, 0, 0]))
    path.write_text("\n".join([*lines_of(ring, lambda k: (ord("x") << 56) + k), far]) + "\n")
    words = ["pgo", str(path), str(out), "--method", "central", "--robust", "gnc", "--json", "--overwrite"]
    assert cli.main(words) == 0
    assert [(r["i"], r["j"]) for r in json.loads(capsys.readouterr().out)["rejected"]] == [("x2", "x8")]


def test_labelled_symbols_are_kept_and_readable(ring, tmp_path, capsys):
    gtsam = pytest.importorskip("gtsam")
    path, out = tmp_path / "swarm.g2o", tmp_path / "out"
    name = lambda k: gtsam.LabeledSymbol(ord("g"), ord("AB"[k // 6]), k % 6).key()  # noqa: E731
    path.write_text("\n".join(lines_of(ring, name)) + "\n")
    assert cli.main(["pgo", str(path), str(out), "--method", "central", "--monocular", "gA,gB"]) == 0
    assert "units of length estimated for robots gA, gB" in capsys.readouterr().out
    assert sorted(p.name for p in out.glob("*.g2o")) == ["gA.g2o", "gB.g2o"]
    ids = {int(line.split()[1]) for line in (out / "gB.g2o").read_text().splitlines() if line.startswith("VERTEX")}
    assert ids >= {name(k) for k in range(6, 12)}
    assert [str(n) for n in read_g2o(path).nodes] == [f"g{r}{k}" for r in "AB" for k in range(6)]
    assert read_g2o(path).robots == read_g2o(sorted(out.glob("*.g2o"))).robots


@pytest.mark.parametrize("shift", [lambda k: k, letters], ids=["plain", "symbols"])
@pytest.mark.parametrize("whole", [lambda k: k, letters], ids=["whole plain", "whole symbols"])
@pytest.mark.parametrize("digits", [9, 5])
def test_a_file_with_everything_beside_the_robots_files_counts_once(ring, tmp_path, shift, whole, digits):
    files = robots_of(ring, tmp_path, shift)
    truth, edges = ring
    full = [vertex(whole(k), T) for k, T in enumerate(truth)]
    full += [edge(whole(i), whole(j), T, digits=digits) for i, j, T in edges]
    (tmp_path / "fullGraph.g2o").write_text("\n".join(full) + "\n")
    notes = []
    found = lowest([*files, tmp_path / "fullGraph.g2o"], notes=notes)
    assert found == pytest.approx(alone(ring, tmp_path), rel=1e-6)
    assert any("fullGraph.g2o left out" in note for note in notes)


def test_a_joint_graph_that_cannot_be_compared_is_refused_by_name(ring, tmp_path):
    files = robots_of(ring, tmp_path, letters)
    truth, edges = ring
    joint = tmp_path / "full_graph.g2o"
    other = [edge(i, j, T @ se3(np.eye(3), [0.3, 0, 0])) for i, j, T in edges]
    joint.write_text("\n".join([vertex(k, T) for k, T in enumerate(truth)] + other) + "\n")
    with pytest.raises(BackendError, match=r"full_graph.g2o: named like a joint graph"):
        read_g2o([*files, joint])
    more = edge(letters(5), letters(9), se3_inverse(truth[5]) @ truth[9])
    extra = vertex(letters(11) + 1, truth[11])
    joint = tmp_path / "z.g2o"
    joint.write_text("\n".join([*lines_of(ring, letters), more, extra]) + "\n")
    with pytest.raises(BackendError, match=r"z.g2o: holds all that the other files hold, and more"):
        read_g2o([*files, joint])


def test_robots_alike_are_no_joint_graph(tmp_path):
    straight = [vertex(k, se3(np.eye(3), [k, 0, 0])) for k in range(6)]
    steps = [edge(k, k + 1, se3(np.eye(3), [1, 0, 0])) for k in range(5)]
    files = [tmp_path / f"{robot}.g2o" for robot in range(3)]
    for path in files:
        path.write_text("\n".join([*straight, *steps]) + "\n")
    graph = read_g2o(files)
    assert graph.robots == [0, 1, 2] and len(graph.edges) == 15


@pytest.mark.parametrize("digits", [4, 7])
def test_an_edge_in_two_files_in_other_digits_or_inverted_counts_once(ring, tmp_path, digits):
    files = robots_of(ring, tmp_path, letters)
    once = lowest(files)
    _, edges = ring
    between = [(i, j, T) for i, j, T in edges if i < 6 <= j]
    own = [line for line in files[1].read_text().splitlines() if not _joins(line)]
    rounded = [edge(letters(i), letters(j), T, digits=digits) for i, j, T in between]
    inverted = [edge(letters(j), letters(i), se3_inverse(T)) for i, j, T in between]
    for again in (rounded, inverted):
        files[1].write_text("\n".join([*own, *again]) + "\n")
        notes = []
        assert lowest(files, notes=notes) == pytest.approx(once, rel=1e-9)
        assert any(f"{len(between)} edges stand in two files" in note and "0:5 - 1:0" in note for note in notes)
    # Another look at the same place counts, and is named.
    i, j, T = between[0]
    files[1].write_text("\n".join([*own, edge(letters(i), letters(j), T @ se3(np.eye(3), [0.05, 0, 0]))]) + "\n")
    notes = []
    assert len(read_g2o(files, notes=notes).edges) == len(edges) + 1
    assert any("1 pairs of nodes have different edges in two files" in note for note in notes)


def _joins(line):
    tag, i, j, *_ = line.split()
    return tag.startswith("EDGE") and int(i) >> 56 != int(j) >> 56


def test_ends_of_edges_to_others_may_stand_in_both_files_under_plain_ids(ring, tmp_path):
    files = robots_of(ring, tmp_path)
    once = lowest(files)
    truth, _ = ring
    for path, other in zip(files, (6, 5), strict=True):
        path.write_text(path.read_text() + vertex(other, truth[other]) + "\n")
    graph = read_g2o(files)
    assert [n.robot for n in graph.nodes] == [0] * 6 + [1] * 6
    assert optimise(graph, CentralConfig()).cost_after == pytest.approx(once, rel=1e-9)


def test_each_robots_own_file_says_where_its_nodes_are(ring, tmp_path):
    files = robots_of(ring, tmp_path, letters)
    truth, _ = ring
    elsewhere = se3(so3_exp([0, 0, 1.0]), [40.0, 0, 0])
    files[0].write_text(files[0].read_text() + vertex(letters(6), elsewhere @ truth[6]) + "\n")
    files[1].write_text(files[1].read_text() + vertex(letters(5), elsewhere @ truth[5]) + "\n")
    for order in (files, files[::-1]):
        graph = read_g2o(order)
        for k in (5, 6):
            np.testing.assert_allclose(graph.poses[NodeId(k // 6, k % 6)], truth[k], atol=1e-6)


def test_a_node_that_stands_twice_in_different_places_is_named(ring, tmp_path):
    path, notes = tmp_path / "twice.g2o", []
    path.write_text("\n".join([*lines_of(ring), vertex(3, se3(np.eye(3), [50, 50, 50]))]) + "\n")
    graph = read_g2o(path, notes=notes)
    np.testing.assert_allclose(graph.poses[NodeId(0, 3)], ring[0][3], atol=1e-6)
    assert any("1 nodes stand twice" in note and "0:3" in note for note in notes)
    notes.clear()
    path.write_text("\n".join([*lines_of(ring), vertex(3, ring[0][3])]) + "\n")
    read_g2o(path, notes=notes)
    assert notes == []


def noted(path, lines):
    notes = []
    path.write_text("\n".join(lines) + "\n")
    graph = read_g2o(path, notes=notes)
    return graph, notes


def test_an_edge_twice_in_one_file_counts_twice_and_is_said_with_the_count(ring, tmp_path):
    lines = lines_of(ring)
    i, j, T = ring[1][-1]
    for again in (lines[-1], edge(i, j, T, digits=4), edge(j, i, se3_inverse(T))):
        graph, notes = noted(tmp_path / "twice.g2o", [*lines, again])
        assert len(graph.edges) == len(ring[1]) + 1
        [note] = notes
        assert note.startswith("1 edges stand twice in one file") and "0:3 - 0:9" in note
    _, notes = noted(tmp_path / "twice.g2o", [*lines, edge(i, j, T @ se3(np.eye(3), [0.05, 0.0, 0.0]))])
    assert notes == [], "another look at the place is another edge"


def test_fix_lines_are_read_and_written_back(ring, tmp_path):
    path, lines = tmp_path / "fixed.g2o", lines_of(ring)
    graph, notes = noted(path, [*lines, "FIX 0 5", "FIX 7"])
    assert notes == [] and graph.fixed == {NodeId(0, 0), NodeId(0, 5), NodeId(0, 7)}
    write_g2o(tmp_path / "again.g2o", graph, plain_ids=True)
    assert read_g2o(tmp_path / "again.g2o").fixed == graph.fixed
    cut = graph.partitioned(3)
    assert cut.fixed == {node for node in cut.poses if node.index in (0, 5, 7)}
    assert cut.of_robot(cut.robots[0]).fixed == {node for node in cut.fixed if node.robot == cut.robots[0]}
    graph, [note] = noted(path, [*lines, "FIX 99"])
    assert note == f"{path}:28: FIX of 0:99, of which there is no pose" and not graph.fixed
    with pytest.raises(BackendError, match=r"g2o:28: 'x' is not a node id"):
        noted(path, [*lines, "FIX x"])


def test_landmarks_are_kept_beside_and_a_missing_matrix_is_the_identity_and_both_are_said(ring, tmp_path, capsys):
    truth, edges = ring
    bare = [edge(i, j, T, weights="").strip() for i, j, T in edges]
    points = ["VERTEX_TRACKXYZ 100 1 2 3", "EDGE_SE3_TRACKXYZ 0 100 0 1 2 3 1 0 0 1 0 1"]
    path, whole = tmp_path / "points.g2o", tmp_path / "whole.g2o"
    path.write_text("\n".join([*(vertex(k, T) for k, T in enumerate(truth)), points[0], *bare, points[1]]) + "\n")
    full = [edge(i, j, T, weights=UNIT) for i, j, T in edges]
    whole.write_text("\n".join([*(vertex(k, T) for k, T in enumerate(truth)), *full]) + "\n")
    assert lowest(path) == pytest.approx(lowest(whole), rel=1e-12)
    assert cli.main(["pgo", str(path), str(tmp_path / "out.g2o")]) == 0
    said = capsys.readouterr().out
    assert "1 landmarks and 1 measurements of them are kept beside the poses" in said
    assert "15 EDGE_SE3:QUAT lines without an information matrix: the identity is taken" in said
    flat = tmp_path / "flat.g2o"
    flat.write_text(
        "VERTEX_SE2 0 0 0 0\nVERTEX_SE2 1 1 0 0\nVERTEX_XY 7 1 1\nEDGE_SE2 0 1 1 0 0\nEDGE_SE2_XY 0 7 1 1 1 0 1\n"
    )
    notes = []
    assert len(read_g2o(flat, notes=notes).edges) == 1 and len(notes) == 2


def test_a_graph_without_any_information_is_refused(ring, tmp_path, capsys):
    path = tmp_path / "zero.g2o"
    path.write_text("\n".join(line.replace(WEIGHTS, "0 " * 20 + "0") for line in lines_of(ring)) + "\n")
    assert cli.main(["pgo", str(path), str(tmp_path / "out.g2o")]) == 1
    assert capsys.readouterr().err == f"maslam: {path}: no edge has information: every information matrix is zero\n"


def test_two_groups_of_robots_are_each_solved(tmp_path, capsys):
    graph, _ = loops(np.random.default_rng(9), robots=4, length=12, sigma_t=0.05)
    apart = [e for e in graph.edges if (e.i.robot < 2) == (e.j.robot < 2)]
    path = tmp_path / "groups.g2o"
    write_g2o(path, type(graph)(graph.poses, tuple(apart)))
    best = lowest(path)
    for method in ("rbcd", "elected"):
        assert cli.main(["pgo", str(path), str(tmp_path / f"{method}.g2o"), "--method", method, "--json"]) == 0
        report = json.loads(capsys.readouterr().out)
        assert report["cost"]["F"] == pytest.approx(best, rel=1e-3) and report["unreached_poses"] == 0
        assert cost(read_g2o(tmp_path / f"{method}.g2o"), "F") == pytest.approx(best, rel=1e-3)


def rising(monkeypatch):
    """Let the elected robot find a higher cost between robots at each look."""
    from maslam.backend.distributed import elected

    costs = count(0.0, 1e9)
    monkeypatch.setattr(elected, "cost_between", lambda groups, places: (next(costs), 0.0))


def test_a_large_gain_that_rounding_hides_is_a_refusal_too(ring, tmp_path, capsys, monkeypatch):
    from maslam.backend.distributed import elected

    (tmp_path / "in.g2o").write_text("\n".join(lines_of(ring)) + "\n")
    monkeypatch.setattr(elected, "cost_between", lambda groups, places: (0.0, 1e9))
    words = ["pgo", str(tmp_path / "in.g2o"), str(tmp_path / "out.g2o"), "--method", "elected", "--agents", "2"]
    assert cli.main(words) == 1
    assert "the gain is less than what rounding may have changed" in capsys.readouterr().err
    assert not (tmp_path / "out.g2o").exists()


def test_a_refused_result_is_said_is_no_success_and_is_not_written(ring, tmp_path, capsys, monkeypatch):

    (tmp_path / "in.g2o").write_text("\n".join(lines_of(ring)) + "\n")
    words = ["pgo", str(tmp_path / "in.g2o"), str(tmp_path / "out"), "--method", "elected", "--agents", "2"]
    with monkeypatch.context() as patch:
        rising(patch)
        assert cli.main(words) == 1
        told = capsys.readouterr()
        assert "result refused, poses as they were: the cost would rise" in told.out
        assert "nothing is written" in told.out and told.err.count("\n") == 1
        assert "out: not written: the solver refused its own result (the cost would rise" in told.err
        assert not (tmp_path / "out").exists()
        assert cli.main([*words, "--json"]) == 1 and json.loads(capsys.readouterr().out)["refused"]
    assert cli.main(words) == 0
    written = {path.name: path.read_bytes() for path in (tmp_path / "out").iterdir()}
    rising(monkeypatch)
    assert cli.main([*words, "--overwrite"]) == 1
    assert {path.name: path.read_bytes() for path in (tmp_path / "out").iterdir()} == written


def test_what_is_optimal_already_is_no_refusal(ring, tmp_path, capsys):
    (tmp_path / "in.g2o").write_text("\n".join(lines_of(ring)) + "\n")
    assert cli.main(["pgo", str(tmp_path / "in.g2o"), str(tmp_path / "once.g2o"), "--method", "central"]) == 0
    for proof in ([], ["--no-certificate"]):
        words = ["pgo", str(tmp_path / "once.g2o"), str(tmp_path / "twice.g2o"), "--overwrite", *proof]
        assert cli.main([*words, "--method", "elected", "--agents", "2"]) == 0
        assert "refused" not in capsys.readouterr().out


def test_an_edge_to_a_vertex_that_is_not_there_names_line_and_vertex(ring, tmp_path, capsys):
    lines = lines_of(ring)
    vertices = [line for line in lines if line.startswith("VERTEX")]
    gone = vertices[-1]
    path = tmp_path / "in.g2o"
    kept = [line for line in lines if line != gone]
    path.write_text("\n".join(kept) + "\n")
    missing = gone.split()[1]
    first = next(n for n, line in enumerate(kept, 1) if line.startswith("EDGE") and missing in line.split()[1:3])
    assert cli.main(["pgo", str(path), str(tmp_path / "out.g2o"), "--method", "central"]) == 0
    said = (
        f"note: {path}:{first}: an edge to vertex {missing}, which no VERTEX line gives: its pose is taken from there"
    )
    assert said in capsys.readouterr().out
    edges_alone = [line for line in lines if line not in vertices]
    path.write_text("\n".join(edges_alone) + "\n")
    assert cli.main(["pgo", str(path), str(tmp_path / "out.g2o"), "--method", "central", "--overwrite"]) == 0
    assert "no VERTEX line" not in capsys.readouterr().out, "files without any are of a common kind"


def test_a_file_of_vertices_alone_beside_others_is_read(ring, tmp_path, capsys):
    """Three files, as sets with a joint graph have; one holds no edge."""
    lines = lines_of(ring)
    for name, some in (("a", lines), ("b", lines), ("c", [line for line in lines if line.startswith("VERTEX")])):
        (tmp_path / f"{name}.g2o").write_text("\n".join(some) + "\n")
    words = [str(tmp_path / f"{name}.g2o") for name in "abc"]
    assert cli.main(["pgo", *words, str(tmp_path / "out"), "--method", "central"]) == 0
    # Two times the graph, and a robot whose 12 poses nothing joins.
    said = capsys.readouterr()
    assert not said.err and "36 poses" in said.out


def test_odd_nodes_are_named(ring, tmp_path, capsys):
    path = tmp_path / "in.g2o"
    path.write_text("\n".join([*lines_of(ring), "VERTEX_SE3:QUAT 999 5 5 5 0 0 0 1"]) + "\n")
    assert cli.main(["pgo", str(path), str(tmp_path / "out.g2o"), "--method", "central"]) == 0
    said = capsys.readouterr().out
    assert "1 nodes without odometry from the node before: a999" in said or "before: 0:999" in said


def test_a_prior_of_a_vertex_that_is_not_there_and_lines_of_two_kinds_are_named(ring, tmp_path):
    path, lines = tmp_path / "in.g2o", lines_of(ring)
    path.write_text("\n".join([*lines, f"EDGE_SE3_PRIOR 977 0 0 0 0 0 0 0 1 {WEIGHTS}"]) + "\n")
    notes: list[str] = []
    read_g2o(path, notes=notes)
    assert f"{path}:{len(lines) + 1}: a prior of vertex 977, which no VERTEX line gives" in notes[0]
    path.write_text("\n".join([*lines, "VERTEX_SE2 978 0 0 0"]) + "\n")
    with pytest.raises(BackendError, match=rf"in.g2o:{len(lines) + 1}: a 2-D line, and .*in.g2o:1 is a 3-D one"):
        read_g2o(path)
