"""``maslam pgo --monocular``: graphs of one camera whose unit of length drifts, of which the truth is known."""

from __future__ import annotations

import csv
import json
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

import maslam
from maslam.backend.geometry import Array, se3, se3_exp, se3_inverse, so3_exp, umeyama
from maslam.backend.pose_graph.g2o import read_g2o, write_g2o
from maslam.backend.pose_graph.graph import Edge, EdgeKind, NodeId, PoseGraph
from maslam.tools import cli

LAP, POSES = 120, 160
SIGMA = np.array([0.005] * 3 + [0.0005] * 3)


def pose(k: int) -> Array:
    """On a wavy circle of 10 m, a round in ``LAP`` steps."""
    turn = 2 * np.pi * k / LAP
    return se3(so3_exp([0.0, 0.0, turn]), [10 * np.cos(turn), 10 * np.sin(turn), 0.5 * np.sin(3 * turn)])


def drifting(drift: float, robot: int = 0, first: int = 0, noise: float = 1.0) -> tuple[PoseGraph, dict[NodeId, float]]:
    """A round and a third with one camera, whose unit shrinks by ``exp(-drift)`` a round; poses as odometry has them.
    Every fourth pose of the second round is recognised from the first. The metres in each pose's unit."""
    rng, nodes = np.random.default_rng(robot), [NodeId(robot, k) for k in range(POSES)]
    unit = {n: float(np.exp(-drift * n.index / LAP)) for n in nodes}

    def seen(a: NodeId, b: NodeId, kind: EdgeKind) -> Edge:
        T = se3_inverse(pose(first + a.index)) @ pose(first + b.index)
        T[:3, 3] /= unit[a]
        return Edge(a, b, T @ se3_exp(noise * SIGMA * rng.normal(size=6)), np.diag(1 / SIGMA**2), kind)

    odometry = [seen(a, b, EdgeKind.ODOMETRY) for a, b in pairwise(nodes)]
    loops = [seen(nodes[k - LAP + 1], nodes[k], EdgeKind.LOOP) for k in range(LAP, POSES, 4)]
    poses = {nodes[0]: pose(first)}
    for edge in odometry:
        poses[edge.j] = poses[edge.i] @ edge.T_i_j
    return PoseGraph(poses, (*odometry, *loops)), unit


def error_m(graph: PoseGraph, first: int = 0, with_scale: bool = True) -> float:
    truth = np.array([pose(first + n.index)[:3, 3] for n in graph.nodes])
    found = np.array([graph.poses[n][:3, 3] for n in graph.nodes])
    apart = umeyama(truth, found, with_scale) @ found - truth
    return float(np.sqrt((apart**2).sum(axis=1).mean()))


def units_of(folder: Path) -> dict[NodeId, float]:
    with open(folder / "units.csv", newline="", encoding="ascii") as file:
        return {NodeId(int(r["robot"]), int(r["index"])): float(r["unit"]) for r in csv.DictReader(file)}


@pytest.mark.parametrize("method", ["central", "elected", "default"])
@pytest.mark.parametrize("weights", ["information", "unit"])
def test_the_drift_of_the_unit_is_found(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], method: str, weights: str
) -> None:
    graph, unit = drifting(0.3)
    write_g2o(tmp_path / "one.g2o", graph, plain_ids=True)
    rigid, out = tmp_path / "rigid", tmp_path / "units"
    words = ["--weights", weights, *([] if method == "default" else ["--method", method])]
    assert cli.main(["pgo", str(tmp_path / "one.g2o"), str(rigid), *words]) == 0
    assert "units of length" not in capsys.readouterr().out and not (rigid / "units.csv").exists()
    assert cli.main(["pgo", str(tmp_path / "one.g2o"), str(out), *words, "--monocular", "all"]) == 0
    said = capsys.readouterr().out
    solved = read_g2o(out / "0.g2o")
    assert error_m(graph) > 0.8 and error_m(read_g2o(rigid / "0.g2o")) > 0.15
    assert error_m(solved) < 0.08
    found = units_of(out)
    np.testing.assert_allclose([found[n] for n in unit], list(unit.values()), rtol=0.05)
    report = json.loads((out / "summary.json").read_text())
    assert report["monocular"] == [0] and report["certified"] is None
    assert report["method"] == ("elected" if method == "default" else method)
    sizes = report["units"]
    assert (sizes["smallest"], sizes["largest"]) == pytest.approx((min(found.values()), max(found.values())))
    assert f"units of length estimated for robot 0: {sizes['smallest']:.4g} to {sizes['largest']:.4g}" in said
    # Written in one unit: a rigid solver has nothing left to do.
    assert cli.main(["pgo", str(out), str(tmp_path / "again"), "--method", "central", "--weights", weights]) == 0
    assert error_m(read_g2o(tmp_path / "again" / "0.g2o")) < 0.08


def test_central_and_elected_end_at_one_minimum_which_is_below_the_rigid_one(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Units of 1 are allowed, so that the rigid minimum, which is certified, bounds it. Information that is far from
    isotropic tells F from E."""
    graph, _ = drifting(0.1)
    stretched = np.diag([1.0, 400.0, 1.0, 1.0, 1.0, 25.0])
    uneven = tuple(replace(e, information=e.information @ stretched) for e in graph.edges)
    write_g2o(tmp_path / "one.g2o", replace(graph, edges=uneven), plain_ids=True)
    ends = {}
    for name, words in (
        ("rigid", ["--method", "central"]),
        ("central", ["--method", "central", "--monocular", "all"]),
        ("elected", ["--monocular", "all"]),
    ):
        assert cli.main(["pgo", str(tmp_path / "one.g2o"), str(tmp_path / name), *words, "--json"]) == 0
        report = json.loads(capsys.readouterr().out)
        assert report["minimised"] == "F"
        ends[name] = report["cost"]["F"]
    assert ends["central"] == pytest.approx(ends["elected"], rel=1e-6)
    assert ends["central"] < ends["rigid"]


def test_robots_with_the_metre_give_it_to_the_others(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Robot 1 is metric; 0 has one camera, and starts in a unit of its own."""
    blind, unit = drifting(0.2)
    metric, _ = drifting(0.0, robot=1, first=10)
    between = []
    for k in range(10, 150, 7):
        a, b = NodeId(1, k - 10), NodeId(0, k)
        between.append(Edge(a, b, se3_exp(np.zeros(6)), np.diag(1 / SIGMA**2), EdgeKind.SEPARATOR))
    # What robot 0 measures is in its unit: a third of a metre at first.
    small = blind.rescaled({0: 3.0})
    team = PoseGraph({**small.poses, **metric.poses}, (*small.edges, *metric.edges, *between))
    (tmp_path / "in").mkdir()
    for robot in (0, 1):
        write_g2o(tmp_path / "in" / f"{robot}.g2o", team.of_robot(robot))
    assert cli.main(["pgo", str(tmp_path / "in"), str(tmp_path / "out"), "--monocular", "0", "--json"]) == 0
    report = json.loads(capsys.readouterr().out)
    assert report["monocular"] == [0] and report["robots"] == 2
    found = units_of(tmp_path / "out")
    assert all(found[NodeId(1, k)] == 1.0 for k in range(POSES))
    np.testing.assert_allclose([found[n] for n in unit], [u / 3.0 for u in unit.values()], rtol=0.03)
    solved = read_g2o(tmp_path / "out" / "0.g2o")
    mine = PoseGraph({n: T for n, T in solved.poses.items() if n.robot == 0}, ())
    assert error_m(mine, with_scale=False) < 0.08


def test_a_graph_in_python_is_solved_as_by_the_command(tmp_path: Path) -> None:
    graph, _ = drifting(0.3)
    write_g2o(tmp_path / "one.g2o", graph, plain_ids=True)
    assert cli.main(["pgo", str(tmp_path / "one.g2o"), str(tmp_path / "out.g2o"), "--monocular", "all"]) == 0
    found = maslam.optimise_distributed(maslam.read_g2o(tmp_path / "one.g2o"), method="elected", monocular=[0])
    maslam.write_g2o(tmp_path / "same.g2o", found.graph, plain_ids=True)
    assert (tmp_path / "same.g2o").read_bytes() == (tmp_path / "out.g2o").read_bytes()


@pytest.mark.parametrize(("words", "said"), [
    (["--monocular", "7"], "there is no robot 7, only 0"),
    (["--monocular", "left"], "all, or numbers of robots"),
    (["--monocular", ""], "--monocular '': all, or numbers of robots"),
    (["--monocular", "all", "--robust", "pcm"], "judges rigid graphs only"),
    (["--monocular", "all", "--plot", "bytes.png"], "compares methods on rigid graphs"),
])  # fmt: skip
def test_what_does_not_go_together_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], words: list[str], said: str
) -> None:
    write_g2o(tmp_path / "one.g2o", drifting(0.0)[0], plain_ids=True)
    assert cli.main(["pgo", str(tmp_path / "one.g2o"), str(tmp_path / "out"), *words]) == 2
    assert said in capsys.readouterr().err and not (tmp_path / "out").exists()
