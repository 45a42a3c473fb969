"""``maslam pgo`` from the command line."""

import json

import numpy as np
import pytest
from graphs import loops

from backend.costs import cost
from backend.g2o import read_g2o, write_g2o
from tools import cli


@pytest.fixture
def folder(tmp_path):
    graph, _ = loops(np.random.default_rng(0), robots=3, length=15)
    for robot in graph.robots:
        write_g2o(tmp_path / f"{robot}.g2o", graph.of_robot(robot))
    return tmp_path


FIELDS = ["method", "robust", "cost", "initial_cost", "certified", "gap", "iterations", "payload_bytes"]
FIELDS += ["wire_bytes", "seconds", "poses", "edges", "rejected_edges"]


@pytest.mark.parametrize("method", ["central", "dgs", "jor", "sor"])
def test_every_method_reports_and_writes_what_it_reports(folder, tmp_path, capsys, method):
    out = tmp_path / "out"
    assert cli.main(["pgo", str(folder), str(out), "--method", method, "--json"]) == 0
    report = json.loads(capsys.readouterr().out)
    assert set(report) >= set(FIELDS) and report["method"] == method and report["robots"] == 3
    assert report["cost"]["F"] < report["initial_cost"]["F"]
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
    assert cli.main([*words[:-1], "99"]) == 1
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
