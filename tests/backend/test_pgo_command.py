"""``maslam pgo`` from the command line."""

import json
from dataclasses import replace

import numpy as np
import pytest
from graphs import loops

import maslam
from maslam.backend.central.costs import cost
from maslam.backend.central.odometry import corrected
from maslam.backend.geometry import se3_exp, se3_log
from maslam.backend.pose_graph.g2o import read_g2o, write_g2o
from maslam.tools import cli
from maslam.tools.pgo.city import city
from maslam.tools.pgo.methods import METHODS, ROBUST, SELECTIONS


@pytest.fixture
def folder(tmp_path):
    graph, _ = loops(np.random.default_rng(0), robots=3, length=15)
    for robot in graph.robots:
        write_g2o(tmp_path / f"{robot}.g2o", graph.of_robot(robot))
    return tmp_path


FIELDS = ["method", "robust", "cost", "initial_cost", "certified", "gap", "iterations", "payload_bytes"]
FIELDS += ["wire_bytes", "seconds", "poses", "edges", "rejected_edges"]


@pytest.mark.parametrize("method", [m for m in METHODS if m != "elected"])
def test_every_method_reports_and_writes_what_it_reports(folder, tmp_path, capsys, method):
    out = tmp_path / "out"
    assert cli.main(["pgo", str(folder), str(out), "--method", method, "--json"]) == 0
    report = json.loads(capsys.readouterr().out)
    assert set(report) >= set(FIELDS) and report["method"] == method and report["robots"] == 3
    assert report["cost"]["F"] < report["initial_cost"]["F"]
    assert report["gap"] < (1e-9 if method == "central" else 1e-4 if "rbcd" in method else 0.2)
    assert report["certified"] or method != "central"
    assert (report["payload_bytes"] == 0) == (method == "central") and report["wire_bytes"] >= report["payload_bytes"]
    again = read_g2o([out / f"{r}.g2o" for r in range(3)])
    assert cost(again, "F") == pytest.approx(report["cost"]["F"], rel=1e-6)
    assert json.loads((out / "summary.json").read_text()) == report


def test_a_single_file_is_cut_into_robots(tmp_path, capsys):
    graph, _ = loops(np.random.default_rng(1), robots=1, length=20)
    write_g2o(tmp_path / "one.g2o", graph, plain_ids=True)
    words = ["pgo", str(tmp_path / "one.g2o"), str(tmp_path / "result.g2o"), "--agents", "4"]
    assert cli.main(words) == 0
    assert "4 robots, 20 poses" in capsys.readouterr().out
    assert read_g2o(tmp_path / "result.g2o").robots == [0, 1, 2, 3]
    assert cli.main([*words[:-1], "99", "--overwrite"]) == 1
    assert "cannot cut 20 poses" in capsys.readouterr().err


def test_mistakes_are_one_line(folder, tmp_path, capsys):
    assert cli.main(["pgo", str(tmp_path / "absent.g2o"), str(tmp_path / "o")]) == 1
    assert "absent.g2o: cannot be read" in capsys.readouterr().err
    assert cli.main(["pgo", str(folder), str(tmp_path / "o"), "--robust", "huber", "--method", "dgs"]) == 2
    assert cli.main(["pgo", str(folder), str(tmp_path / "o"), "--solver.method", "dgs"]) == 2
    assert "--method" in capsys.readouterr().err
    with open(folder / "1.g2o", "a") as file:
        file.write("nonsense 1 2\n")
    assert cli.main(["pgo", str(folder), str(tmp_path / "o")]) == 1
    assert "1.g2o:" in capsys.readouterr().err and not (tmp_path / "o").exists()
    assert cli.main(["pgo", str(folder), str(tmp_path / "o"), "--skip-broken-lines"]) == 0
    assert "skipped" in capsys.readouterr().err


def test_a_file_that_is_there_is_not_replaced_unasked(folder, tmp_path, capsys):
    """``maslam pgo robots/*.g2o`` without OUT takes the last robot's file for it."""
    files = [str(folder / f"{r}.g2o") for r in range(3)]
    before = (folder / "2.g2o").read_bytes()
    for words in (files, [*files, "--overwrite"], [files[0], str(folder), "--overwrite"]):
        assert cli.main(["pgo", *words]) == 2
        assert "is among the graphs that are read; the last path is OUT" in capsys.readouterr().err
    assert (folder / "2.g2o").read_bytes() == before and not (folder / "summary.json").exists()
    for out in (tmp_path / "out", tmp_path / "out" / "one.g2o"):
        out.parent.mkdir(exist_ok=True)
        assert cli.main(["pgo", *files, str(out)]) == 0
    assert cli.main(["pgo", *files, str(tmp_path / "out")]) == 0, "its own result is made anew"
    assert cli.main(["pgo", *files, str(tmp_path / "out" / "one.g2o")]) == 2
    assert "replace it with --overwrite" in capsys.readouterr().err
    assert cli.main(["pgo", *files, str(tmp_path / "out" / "one.g2o"), "--overwrite"]) == 0


def test_a_picture_of_no_kind_is_refused_before_the_work(folder, tmp_path, capsys):
    assert cli.main(["pgo", str(folder), str(tmp_path / "out"), "--plot", str(tmp_path / "plot.xyz")]) == 2
    assert "must end in .png" in capsys.readouterr().err and not (tmp_path / "out").exists()


@pytest.mark.parametrize("weights", ["auto", "information", "unit"])
@pytest.mark.parametrize("measured", [True, False])
def test_robots_in_python_do_as_the_command_does(folder, tmp_path, weights, measured):
    if not measured:
        graph = read_g2o([folder / f"{r}.g2o" for r in range(3)])
        plain = replace(graph, edges=tuple(replace(e, information=np.eye(6)) for e in graph.edges))
        for robot in graph.robots:
            write_g2o(folder / f"{robot}.g2o", plain.of_robot(robot))
    out = tmp_path / "out.g2o"
    (tmp_path / "in").mkdir()
    for robot in range(3):
        (folder / f"{robot}.g2o").rename(tmp_path / "in" / f"{robot}.g2o")
    assert cli.main(["pgo", str(tmp_path / "in"), str(out), "--method", "elected", "--weights", weights]) == 0
    found = maslam.optimise_distributed(maslam.read_g2o(tmp_path / "in"), method="elected", weights=weights)
    maslam.write_g2o(tmp_path / "same.g2o", found.graph)
    assert (tmp_path / "same.g2o").read_bytes() == out.read_bytes()


def test_a_distributed_method_that_there_is_not_is_refused_with_the_nearest(folder):
    for name in ("electd", "central"):
        with pytest.raises(maslam.MaslamError, match=f"method: there is no '{name}', only dgs, jor"):
            maslam.optimise_distributed(maslam.read_g2o(folder), method=name)
    with pytest.raises(maslam.MaslamError, match=r"weights: there is no 'unity', only .*did you mean 'unit'"):
        maslam.optimise_distributed(maslam.read_g2o(folder), weights="unity")


def with_wrong_edges(folder):
    """Two robots' files with three wrong edges between them; the names of their ends."""
    graph, _ = loops(np.random.default_rng(2), robots=2, length=40, separators=10)
    rng = np.random.default_rng(3)
    wrong = [k for k, edge in enumerate(graph.edges) if edge.is_separator][:3]  # others join the same nodes rightly
    edges = list(graph.edges)
    for k in wrong:
        off = se3_exp(np.concatenate([rng.normal(0, 5.0, 3), rng.normal(0, 0.5, 3)]))
        edges[k] = replace(edges[k], T_i_j=edges[k].T_i_j @ off)
    folder.mkdir()
    for robot in graph.robots:
        write_g2o(folder / f"{robot}.g2o", replace(graph, edges=tuple(edges)).of_robot(robot))
    return sorted((str(edges[k].i), str(edges[k].j)) for k in wrong)


@pytest.mark.parametrize("robust", ROBUST)
def test_optimise_in_python_selects_as_the_command_does(tmp_path, capsys, robust):
    truth, out = with_wrong_edges(tmp_path / "in"), tmp_path / "out.g2o"
    words = ["--method", "central", "--robust", robust, "--weights", "information", "--robust.confidence", "0.99"]
    assert cli.main(["pgo", str(tmp_path / "in"), str(out), *words, "--json"]) == 0
    report = json.loads(capsys.readouterr().out)
    result = maslam.optimise(maslam.read_g2o(tmp_path / "in"), robust=robust, settings={"robust.confidence": 0.99})
    maslam.write_g2o(tmp_path / "same.g2o", result.graph)
    assert (tmp_path / "same.g2o").read_bytes() == out.read_bytes()
    if robust in SELECTIONS:
        assert [(str(e.i), str(e.j), e.reason) for e in result.rejected] == [
            (r["i"], r["j"], r["reason"]) for r in report["rejected"]
        ]
        assert sorted((str(e.i), str(e.j)) for e in result.rejected) == truth
        assert [bool(w < 0.5) for w in result.weights].count(True) == report["rejected_edges"] == len(truth)
    else:
        assert result.improved and not report["rejected"]


def test_a_robust_method_that_there_is_not_is_refused_with_the_nearest(folder):
    with pytest.raises(maslam.MaslamError, match=r"robust: there is no 'pmc', only none, .*; did you mean 'pcm'"):
        maslam.optimise(maslam.read_g2o(folder), robust="pmc")
    with pytest.raises(maslam.MaslamError, match="did you mean 'confidence'"):
        maslam.optimise(maslam.read_g2o(folder), robust="pcm", settings={"robust.confidense": 0.9})


def test_wrong_edges_are_rejected_and_named(tmp_path, capsys):
    truth = with_wrong_edges(tmp_path / "in")
    ways = [(m, r) for m in ("central", "rbcd", None) for r in ("pcm", "gnc")]
    for method, robust in ways:
        chosen = ["--method", method] if method else []
        words = [
            "pgo",
            str(tmp_path / "in"),
            str(tmp_path / "out"),
            *chosen,
            "--robust",
            robust,
            "--json",
            "--overwrite",
        ]
        assert cli.main(words) == 0
        report = json.loads(capsys.readouterr().out)
        assert sorted((r["i"], r["j"]) for r in report["rejected"]) == truth, (method, robust)
        assert report["rejected_edges"] == 3 and all(r["reason"] for r in report["rejected"])
        assert report["method"] == (method or "elected")
    assert cli.main(["pgo", str(tmp_path / "in"), str(tmp_path / "o"), "--method", "sor", "--robust", "gnc"]) == 2
    assert "--robust gnc works with" in capsys.readouterr().err
    settings = ["--method", "elected", "--robust", "gnc", "--robust.noise", "stated"]
    assert cli.main(["pgo", str(tmp_path / "in"), str(tmp_path / "o"), *settings]) == 2
    assert "an elected robot selects by --robust.confidence alone" in capsys.readouterr().err


def test_the_picture_of_cost_against_bytes(folder, tmp_path, capsys):
    words = ["pgo", str(folder), str(tmp_path / "out"), "--plot", str(tmp_path / "plot.png"), "--quiet"]
    assert cli.main(words) == 0
    assert (tmp_path / "plot.png").stat().st_size > 10_000


def test_a_city_is_what_it_says():
    graph, truth = city(4, 60, seed=1)
    assert graph.robots == [0, 1, 2, 3] and len(graph.poses) == 240
    for edge in graph.edges:
        off = se3_log(np.linalg.inv(edge.T_i_j) @ np.linalg.inv(truth[edge.i]) @ truth[edge.j])
        assert np.sqrt(off @ edge.information @ off) < 6.5
    assert sum(e.is_separator for e in graph.edges) > 10
    again, _ = city(4, 60, seed=1)
    assert [e.T_i_j.tobytes() for e in again.edges] == [e.T_i_j.tobytes() for e in graph.edges]


def test_the_benchmark_counts_what_grows(capsys):
    words = ["bench", "pgo", "--robots", "3,6", "--poses", "60", "--methods", "quick,rbcd", "--json", "--quiet"]
    assert cli.main(words) == 0
    rows = json.loads(capsys.readouterr().out)
    assert [(r["robots"], r["method"], r["poses"]) for r in rows] == [
        (3, "quick", 180),
        (3, "rbcd", 180),
        (6, "quick", 360),
        (6, "rbcd", 360),
    ]
    assert all(r["gap"] > -1e-6 and r["wire_bytes"] > r["payload_bytes"] for r in rows)
    assert cli.main(["bench", "pgo", "--methods", "magic"]) == 2


def test_the_benchmark_refuses_a_city_in_two_parts(capsys):
    graph, _ = city(4, 40, seed=0)
    met = {robot for e in graph.edges if e.is_separator for robot in (e.i.robot, e.j.robot)}
    assert 0 not in met  # the first robot met nobody
    assert cli.main(["bench", "pgo", "--robots", "4", "--poses", "40", "--methods", "quick", "--quiet"]) == 2
    assert "120 poses" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--method", "rbcd", "--solver.descent-sweeps", "2"], "sweeps allowed were made, 2:"),
        (["--method", "sor", "--solver.pose-sweeps", "1"], "(--solver.pose-sweeps)"),
        (["--method", "central", "--central.cost", "E", "--central.iterations", "1"], "(--central.iterations)"),
        (["--method", "multifrontal", "--solver.multifrontal-most-mb", "1e-5"], "result refused"),
    ],
)
def test_who_was_not_allowed_to_go_on_says_so(folder, tmp_path, capsys, options, said):
    assert cli.main(["pgo", str(folder), str(tmp_path / "o"), *options]) == ("refused" in said)
    assert said in capsys.readouterr().out
    assert cli.main(["pgo", str(folder), str(tmp_path / "p"), *options[:2]]) == 0
    assert said not in capsys.readouterr().out


def test_without_a_method_the_optimum_is_reached(folder, tmp_path, capsys):
    assert cli.main(["pgo", str(folder), str(tmp_path / "o"), "--json"]) == 0
    report = json.loads(capsys.readouterr().out)
    assert report["method"] == "elected"
    assert cli.main(["pgo", str(folder), str(tmp_path / "p"), "--method", "central", "--json"]) == 0
    best = json.loads(capsys.readouterr().out)["cost"]["F"]
    assert report["cost"]["F"] == pytest.approx(best, rel=1e-4)


def test_matches_one_by_one_cost_less_than_solving_anew(folder, tmp_path, capsys):
    out = tmp_path / "one"
    words = ["pgo", str(folder), str(out), "--matches-one-by-one", "--link.solved-anew", "2", "--quiet"]
    assert cli.main([*words, "--json"]) == 0
    report = json.loads(capsys.readouterr().out)
    updates, graph = report["updates"], read_g2o(sorted(folder.glob("*.g2o")))
    between = sum(e.is_separator for e in graph.edges)
    assert updates["matches"] == between - 2 and updates["anew"]["solved"] == 2
    assert report["gap"] < 1e-4 and updates["largest_excess"] <= 5e-5
    total = updates["first"]["bytes"] + updates["matches"] * updates["bytes"]["mean"]
    assert report["wire_bytes"] == round(total)
    assert updates["bytes"]["mean"] < updates["anew"]["bytes"]["mean"]
    assert cost(read_g2o(sorted(out.glob("*.g2o"))), "F") == pytest.approx(report["cost"]["F"], rel=1e-6)
    # Ten times the rate takes less time, and the same bytes.
    fast = [*words[:2], str(tmp_path / "two"), *words[3:], "--link.rate-kbit", "96", "--link.delay-s", "0.05"]
    assert cli.main([*fast, "--json"]) == 0
    faster = json.loads(capsys.readouterr().out)["updates"]
    assert faster["bytes"] == updates["bytes"]
    assert faster["seconds"]["mean"] == pytest.approx(0.1 * updates["seconds"]["mean"])
    assert cli.main([*words, "--overwrite"]) == 0
    said = capsys.readouterr().out
    assert f"{updates['matches']} matches one by one, mean: {updates['bytes']['mean']:.0f} bytes" in said


@pytest.mark.parametrize(
    ("words", "code", "said"),
    [
        (["--matches-one-by-one", "--method", "rbcd"], 2, "--matches-one-by-one works with --method elected"),
        (["--matches-one-by-one", "--robust", "pcm"], 2, "not --robust pcm"),
        (["--link.delay-s", "1"], 2, "--link.delay-s is of --matches-one-by-one"),
        (["--matches-one-by-one", "--plot", "a.png"], 2, "--plot compares methods"),
        (["--matches-one-by-one", "--link.rate-kbit", "0"], 2, "rate-kbit"),
        (["--matches-one-by-one", "--solver.elected-longest", "5"], 2, "leaves out poses that later matches need"),
    ],
)
def test_what_does_not_go_with_matches_one_by_one(folder, tmp_path, capsys, words, code, said):
    assert cli.main(["pgo", str(folder), str(tmp_path / "o"), *words]) == code
    assert said in capsys.readouterr().err


def test_a_single_robot_has_no_matches_to_come(tmp_path, capsys):
    graph, _ = loops(np.random.default_rng(1), robots=1, length=20)
    write_g2o(tmp_path / "one.g2o", graph, plain_ids=True)
    assert cli.main(["pgo", str(tmp_path / "one.g2o"), str(tmp_path / "o.g2o"), "--matches-one-by-one"]) == 1
    assert "the graph has one robot" in capsys.readouterr().err


def test_lengths_of_odometry_are_found_where_they_are_asked_for(tmp_path, capsys):
    """Not without the option; with it the written edges carry the lengths, so that they fit the written poses."""
    graph, _ = loops(np.random.default_rng(0), sigma_t=0.01, sigma_deg=0.02, separators=6)
    off = corrected(graph, {0: 1 / 1.02, 1: 1 / 0.985, 2: 1 / 1.01, 3: 1 / 0.99})
    write_g2o(tmp_path / "in.g2o", off)
    costs = {}
    for name, words in {
        "plain": ["--method", "elected"],
        "elected": ["--method", "elected", "--solver.length-sigma", "0.01"],
        "central": ["--method", "central", "--central.length-sigma", "0.01"],
    }.items():
        out = tmp_path / name
        assert cli.main(["pgo", str(tmp_path / "in.g2o"), str(out), *words]) == 0
        said = capsys.readouterr().out
        assert ("odometry's lengths are off" in said) == (name != "plain")
        costs[name] = cost(read_g2o(sorted(out.glob("*.g2o"))), "F")
    assert costs["central"] == pytest.approx(costs["elected"], rel=1e-3) and costs["central"] < 0.5 * costs["plain"]
    for words in (["--method", "rbcd", "--solver.length-sigma", "0.01"], ["--central.length-sigma", "0.01"]):
        assert cli.main(["pgo", str(tmp_path / "in.g2o"), str(tmp_path / "no"), *words]) == 2
        assert "length-sigma works with --method" in capsys.readouterr().err
