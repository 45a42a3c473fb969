"""Vertices of FIX lines keep their poses exactly, and the others have the least cost that this leaves."""

from __future__ import annotations

import json
import logging
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from graphs import loops
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

import maslam
from maslam.backend.central.costs import cost
from maslam.backend.central.optimise import optimise
from maslam.backend.config import CentralConfig
from maslam.backend.geometry import se3, so3_exp
from maslam.backend.pose_graph.g2o import read_g2o, write_g2o
from maslam.backend.pose_graph.graph import Edge, NodeId, PoseGraph, Prior
from maslam.backend.robust.select import optimise_robustly
from maslam.tools import cli

LINE = [NodeId(0, k) for k in range(3)]


def chain(tau: tuple[float, float]) -> PoseGraph:
    """Steps of 1 m along x from 0 to a node that stands at 2.6 m; both ends are fixed."""
    poses = {node: se3(np.eye(3), [x, 0.0, 0.0]) for node, x in zip(LINE, (0.0, 1.0, 2.6), strict=True)}
    step = se3(np.eye(3), [1.0, 0.0, 0.0])
    edges = tuple(
        Edge(i, j, step, np.diag([t, t, t, 50.0, 50.0, 50.0])) for i, j, t in zip(LINE[:2], LINE[1:], tau, strict=True)
    )
    return PoseGraph(poses, edges, fixed=frozenset({LINE[0], LINE[2]}))


@pytest.mark.parametrize("convention", ["F", "U", "E"])
@pytest.mark.parametrize(("tau", "middle"), [((1.0, 1.0), 1.3), ((1.0, 3.0), 1.45)], ids=["even", "stiffer"])
def test_what_is_missing_is_shared_by_stiffness(convention: str, tau: tuple[float, float], middle: float) -> None:
    graph = chain(tau)
    found = optimise(graph, CentralConfig(cost=convention)).graph  # type: ignore[arg-type]
    assert all(np.array_equal(found.poses[node], graph.poses[node]) for node in graph.fixed)
    wanted = 1.3 if convention == "U" else middle
    np.testing.assert_allclose(found.poses[LINE[1]], se3(np.eye(3), [wanted, 0.0, 0.0]), atol=1e-6)


def pulled(robots: int = 1) -> PoseGraph:
    """A noisy graph with loops, of which three nodes are fixed away from where the edges want them."""
    graph, _ = loops(np.random.default_rng(3), robots=robots, length=12)
    nodes = graph.nodes
    poses = dict(graph.poses)
    for k, node in enumerate(nodes[4::5][:2]):
        poses[node] = poses[node] @ se3(so3_exp([0.0, 0.05, 0.1 * k]), [0.2, -0.1, 0.3 * k])
    return replace(graph, poses=poses, fixed=frozenset({nodes[0], *nodes[4::5][:2]}))


def least_cost(graph: PoseGraph) -> float:
    """F at its minimum over the free nodes, by scipy, with angles of its own."""
    free = [node for node in graph.nodes if node not in graph.fixed]
    row = {node: k for k, node in enumerate(free)}
    start = np.array([graph.poses[node] for node in free])
    weights = [
        (1.5 / np.trace(np.linalg.inv(e.information[3:, 3:])), 3.0 / np.trace(np.linalg.inv(e.information[:3, :3])))
        for e in graph.edges
    ]

    def residuals(x: np.ndarray) -> np.ndarray:
        x = x.reshape(-1, 6)
        R = start[:, :3, :3] @ Rotation.from_rotvec(x[:, 3:]).as_matrix()
        poses = {n: (R[k], start[k, :3, 3] + x[k, :3]) for n, k in row.items()}
        poses |= {n: (graph.poses[n][:3, :3], graph.poses[n][:3, 3]) for n in graph.fixed}
        out = []
        for e, (kappa, tau) in zip(graph.edges, weights, strict=True):
            (R_i, t_i), (R_j, t_j) = poses[e.i], poses[e.j]
            out.append(np.sqrt(kappa) * (R_j - R_i @ e.T_i_j[:3, :3]).ravel())
            out.append(np.sqrt(tau) * (t_j - t_i - R_i @ e.T_i_j[:3, 3]))
        return np.concatenate(out)

    return 2.0 * float(least_squares(residuals, np.zeros(6 * len(free)), xtol=1e-12, ftol=1e-12, gtol=1e-12).cost)


def test_the_cost_is_the_least_that_fixed_nodes_leave() -> None:
    graph = pulled()
    found = optimise(graph, CentralConfig())
    assert all(np.array_equal(found.graph.poses[node], graph.poses[node]) for node in graph.fixed)
    assert found.cost_after == pytest.approx(least_cost(graph), rel=1e-6)
    assert found.cost_after > 1.5 * optimise(replace(graph, fixed=frozenset()), CentralConfig()).cost_after


@pytest.mark.parametrize("robust", ["gnc", "huber"])
def test_they_stay_under_robust_selection_too(robust: str) -> None:
    graph = pulled(3)
    if robust == "gnc":
        found = optimise_robustly(graph, "gnc").graph
    else:
        found = optimise(graph, CentralConfig(loss="huber")).graph
    assert all(np.array_equal(found.poses[node], graph.poses[node]) for node in graph.fixed)


def test_beside_priors_both_count() -> None:
    """A prior on the middle of the chain, and its end fixed: three springs of known stiffness."""
    graph = replace(chain((1.0, 1.0)), fixed=frozenset({LINE[2]}))
    information = np.diag([2.0, 2.0, 2.0, 50.0, 50.0, 50.0])
    graph = replace(graph, priors=(Prior(LINE[1], se3(np.eye(3), [1.0, 0.0, 0.0]), information),))
    found = optimise(graph, CentralConfig()).graph
    assert np.array_equal(found.poses[LINE[2]], graph.poses[LINE[2]])
    x = [found.poses[node][0, 3] for node in LINE]
    np.testing.assert_allclose(x, [0.2, 1.2, 2.6], atol=1e-6)  # 2 (x - 1) = 2.6 - x - 1


def said_by(words: list[str], capsys: pytest.CaptureFixture[str]) -> dict[str, object]:
    assert cli.main(["pgo", *words, "--json"]) == 0
    found: dict[str, object] = json.loads(capsys.readouterr().out)
    return found


def test_the_command_takes_the_method_that_holds_them_and_says_what_another_does_not(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    graph = pulled(3)
    write_g2o(tmp_path / "given.g2o", graph)
    given, out = read_g2o(tmp_path / "given.g2o"), tmp_path / "out.g2o"
    words = [str(tmp_path / "given.g2o"), str(out), "--overwrite"]
    report = said_by(words, capsys)
    assert report["method"] == "central" and report["certified"] is None
    assert "solved by central, which holds all vertices of FIX lines" in report["warnings"]  # type: ignore[operator]
    solved = read_g2o(out)
    assert solved.fixed == given.fixed
    for node in given.fixed:
        np.testing.assert_allclose(solved.poses[node], given.poses[node], atol=1e-10)
    assert cost(solved, "F") == pytest.approx(least_cost(given), rel=1e-6)
    for method in ("elected", "rbcd"):
        report = said_by([*words, "--method", method], capsys)
        [line] = [line for line in report["warnings"] if "FIX" in line]  # type: ignore[attr-defined]
        first, lost, *_ = sorted(given.fixed)
        assert line.startswith(f"FIX of {lost} and 1 more is not held by {method}") and "central" in line
        solved = read_g2o(out)
        np.testing.assert_allclose(solved.poses[first], given.poses[first], atol=1e-10)
        assert solved.fixed == {first}


@pytest.mark.parametrize("method", ["elected", "dgs", "central"])
def test_one_of_a_graph_is_held_by_every_method(method: str, caplog: pytest.LogCaptureFixture) -> None:
    graph = pulled(3)
    one = graph.nodes[20]
    graph = replace(graph, fixed=frozenset({one}))
    if method == "central":
        found = maslam.optimise(graph).graph
    else:
        with caplog.at_level(logging.WARNING):
            found = maslam.optimise_distributed(graph, method=method).graph  # type: ignore[arg-type]
    free = replace(graph, fixed=frozenset())
    best = optimise(free, CentralConfig()).cost_after
    assert np.array_equal(found.poses[one], graph.poses[one]) and found.fixed == {one}
    assert cost(found, "F") == pytest.approx(best, rel=0.05 if method == "dgs" else 1e-4)
    assert "FIX" not in caplog.text
