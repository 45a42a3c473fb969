"""GPS positions as priors: 2 km of drifting odometry, alone and through another robot, with outliers and levers."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from maslam.backend.central.costs import cost
from maslam.backend.central.optimise import optimise
from maslam.backend.config import CentralConfig, SolverConfig
from maslam.backend.distributed.condense import OwnGraph
from maslam.backend.distributed.contribution import contribution, decode, encode
from maslam.backend.distributed.exchange import optimise_distributed
from maslam.backend.distributed.share import shares
from maslam.backend.geometry import se3, se3_exp, se3_inverse, so3_exp
from maslam.backend.pose_graph.graph import Edge, EdgeKind, NodeId, PoseGraph, Prior

STEP_M, STEPS, SIGMA_M = 5.0, 400, 2.0
T_ENU_W = se3(so3_exp([0.0, 0.0, 1.1]) @ so3_exp([1.5707963, 0.0, 0.0]), [400.0, -250.0, 30.0])
"""East north up from a world like a camera's, turned and far away."""
ELECTED = SolverConfig(method="elected")


def path(seed: int) -> np.ndarray:
    """A camera that drives 2 km through gentle bends, over hills."""
    rng = np.random.default_rng(seed)
    T = [np.eye(4)]
    turn = 0.0
    for k in range(STEPS - 1):
        turn = 0.9 * turn + 0.02 * rng.standard_normal()
        T.append(T[-1] @ se3(so3_exp([0.004 * np.sin(k / 15), turn, 0.0]), [0.0, 0.0, STEP_M]))
    return np.array(T)


def odometry(robot: int, truth: np.ndarray, drift: float = 0.02) -> tuple[dict[NodeId, np.ndarray], list[Edge]]:
    """Poses and edges by an odometry that is ``drift`` too long and turns slowly away.

    Its edges state noise wide enough for an error that all steps have in common: a graph knows no other kind. Agents
    find the length itself (tests/mas/test_positions.py).
    """
    rng = np.random.default_rng(100 + robot)
    sigma = np.array([0.4, 0.4, 0.4, 0.002, 0.002, 0.002])
    edges, poses = [], {NodeId(robot, 0): np.eye(4)}
    for k in range(len(truth) - 1):
        step = se3_inverse(truth[k]) @ truth[k + 1]
        step[:3, 3] *= 1.0 + drift
        step = (
            step
            @ se3_exp(np.array([0.05] * 3 + [0.001] * 3) * rng.standard_normal(6))
            @ se3(so3_exp([0.0, 6e-5, 0.0]), np.zeros(3))
        )
        i, j = NodeId(robot, k), NodeId(robot, k + 1)
        edges.append(Edge(i, j, step, np.diag(1.0 / sigma**2)))
        poses[j] = poses[i] @ step
    return poses, edges


def fixes(robot: int, truth: np.ndarray, outliers: float = 0.0, lever: np.ndarray | None = None) -> list[Prior]:
    """A position every second at 10 m/s: every second node."""
    rng = np.random.default_rng(200 + robot)
    lever = np.zeros(3) if lever is None else lever
    out = []
    for k in range(0, len(truth), 2):
        seen = (T_ENU_W @ truth[k] @ np.append(lever, 1.0))[:3] + SIGMA_M * rng.standard_normal(3)
        if rng.random() < outliers:
            seen += rng.choice([-1.0, 1.0], 3) * rng.uniform(40, 150, 3)
        information = np.diag([1.0 / SIGMA_M**2] * 3 + [0.0] * 3)
        out.append(Prior(NodeId(robot, k), se3(np.eye(3), seen), information, lever=lever, bound=3.0))
    return out


def error_m(graph: PoseGraph, robot: int, truth: np.ndarray) -> float:
    """Root mean square of positions in the frame of the GPS, nothing aligned."""
    found = np.array([graph.poses[NodeId(robot, k)][:3, 3] for k in range(len(truth))])
    return float(np.sqrt(((found - (T_ENU_W @ truth)[:, :3, 3]) ** 2).sum(axis=1).mean()))


def drifted_m(poses: dict[NodeId, np.ndarray], robot: int, truth: np.ndarray) -> float:
    """Of odometry, from where it began."""
    found = np.array([poses[NodeId(robot, k)][:3, 3] for k in range(len(truth))])
    return float(np.sqrt(((found - truth[:, :3, 3]) ** 2).sum(axis=1).mean()))


def solved(graph: PoseGraph, method: str) -> PoseGraph:
    if method == "central":
        result = optimise(graph, CentralConfig(cost="F"))
        assert result.improved
        return result.graph
    found = optimise_distributed(graph, ELECTED)
    assert all(outcome.accepted for outcome in found.outcomes.values())
    return found.graph


@pytest.mark.parametrize("method", ["central", "elected"])
def test_one_robots_drift_is_gone(method: str) -> None:
    truth = path(1)
    poses, edges = odometry(0, truth)
    drift = drifted_m(poses, 0, truth)
    assert drift > 10.0
    graph = PoseGraph(poses, tuple(edges), priors=tuple(fixes(0, truth)))
    assert error_m(solved(graph, method), 0, truth) < 0.1 * drift


@pytest.mark.parametrize("method", ["central", "elected"])
def test_a_robot_without_gps_is_bent_by_its_matches_with_one_that_has_it(method: str) -> None:
    truth = path(1)
    first, edges = odometry(0, truth)
    second, more = odometry(1, truth, drift=0.015)
    drift = drifted_m(second, 1, truth)
    matches = [
        Edge(NodeId(0, k), NodeId(1, k), np.eye(4), np.diag([1 / 0.1**2] * 3 + [1 / 0.005**2] * 3), EdgeKind.SEPARATOR)
        for k in range(5, STEPS, 20)
    ]
    graph = PoseGraph({**first, **second}, (*edges, *more, *matches), priors=tuple(fixes(0, truth)))
    found = solved(graph, method)
    assert error_m(found, 0, truth) < 0.1 * drifted_m(first, 0, truth)
    assert error_m(found, 1, truth) < 0.1 * drift


@pytest.mark.parametrize("method", ["central", "elected"])
def test_outliers_and_the_antennas_place_do_no_harm(method: str) -> None:
    truth = path(2)
    poses, edges = odometry(0, truth)
    clean = PoseGraph(poses, tuple(edges), priors=tuple(fixes(0, truth)))
    lever = np.array([1.0, -2.0, -6.0])
    dirty = replace(clean, priors=tuple(fixes(0, truth, outliers=0.15, lever=lever)))
    assert error_m(solved(dirty, method), 0, truth) < 1.5 * error_m(solved(clean, method), 0, truth) + 0.2
    # The antenna's place counts: taken for the camera's, it is off by its distance.
    blind = replace(dirty, priors=tuple(replace(p, lever=np.zeros(3)) for p in dirty.priors))
    assert error_m(solved(blind, method), 0, truth) > error_m(solved(dirty, method), 0, truth) + 1.0


def test_elected_reaches_the_central_optimum_of_whole_poses() -> None:
    """Priors with rotation, without a kernel: F itself, in its own frame."""
    truth = path(3)[:40]
    poses, edges = odometry(0, truth)
    priors = [Prior(NodeId(0, k), T_ENU_W @ truth[k], np.diag([4.0] * 3 + [100.0] * 3)) for k in (0, 17, 39)]
    graph = PoseGraph(poses, tuple(edges), priors=tuple(priors)).partitioned(2)
    central = optimise(graph, CentralConfig(cost="F"))
    elected = optimise_distributed(graph, ELECTED)
    assert cost(elected.graph, "F") == pytest.approx(central.cost_after, rel=1e-3)


def test_two_positions_place_nothing_and_change_nothing() -> None:
    truth = path(3)[:40]
    poses, edges = odometry(0, truth)
    graph = PoseGraph(poses, tuple(edges), priors=tuple(fixes(0, truth)[:2]))
    found = optimise_distributed(graph, ELECTED)
    T = np.array([found.outcomes[0].poses[n] for n in graph.nodes])
    np.testing.assert_allclose(T, np.array([poses[n] for n in graph.nodes]), atol=1e-6)


def test_priors_travel_and_are_counted() -> None:
    truth = path(3)[:40]
    poses, edges = odometry(0, truth)
    graph = PoseGraph(poses, tuple(edges), priors=tuple(fixes(0, truth, lever=np.array([1.0, 0.0, 2.0]))))
    share = shares(graph)[0]
    mine = contribution(share, OwnGraph(share), 0, 1, 10.0)
    data = encode(mine)
    read = decode(data, 0).priors
    assert read.nodes == mine.priors.nodes
    np.testing.assert_allclose(read.measured, mine.priors.measured, atol=1e-4)
    np.testing.assert_allclose(read.lever, mine.priors.lever, atol=1e-6)
    np.testing.assert_allclose(read.tau, mine.priors.tau, rtol=1e-6)
    assert (read.bound == 3.0).all()
    without = shares(replace(graph, priors=()))[0]
    alone = encode(contribution(without, OwnGraph(without), 0, 1, 10.0))
    assert 20 * 30 < len(data) - len(alone) < 20 * 60
