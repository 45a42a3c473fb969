"""Priors (GPS among them) without an elected robot: against the central optimum of the same graph."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from graphs import drifting, loops, ring, town, with_wrong_edges
from transports import faulty

import maslam
from maslam.backend.central.costs import cost
from maslam.backend.central.optimise import optimise
from maslam.backend.central.origin import OriginPriors
from maslam.backend.config import CentralConfig, RobustConfig, SolverConfig
from maslam.backend.distributed.exchange import optimise_distributed, solve_group
from maslam.backend.distributed.methods import node_for
from maslam.backend.distributed.places import Places
from maslam.backend.distributed.share import shares
from maslam.backend.distributed.wire import pack, unpack
from maslam.backend.distributed.with_priors.alignment import origin_from, sums_of
from maslam.backend.distributed.with_priors.course import Next, PriorSums, WhatNext
from maslam.backend.distributed.with_priors.in_run import InRun
from maslam.backend.distributed.with_priors.prior_messages import PriorKind, PriorMessage, body_of, numbers_in
from maslam.backend.errors import BackendError
from maslam.backend.geometry import se3, se3_inverse, so3_exp
from maslam.backend.pose_graph.g2o import read_g2o, write_g2o
from maslam.backend.pose_graph.graph import NodeId, PoseGraph, Prior
from maslam.backend.robust.select import optimise_robustly
from maslam.tools import cli

METHODS = ["multifrontal", "two-level", "rbcd"]
T_ENU_W = se3(so3_exp([0.3, 0.2, 1.0]), [400.0, -250.0, 30.0])
"""The frame of the positions, turned and far away."""


def with_gps(graph, truth, sigma, every=10, robots=None, seed=1, **settings) -> PoseGraph:
    rng = np.random.default_rng(seed)
    information = np.diag([sigma**-2.0] * 3 + [0.0] * 3)
    nodes = [n for n in graph.nodes if n.index % every == 0 and (robots is None or n.robot in robots)]
    seen = {n: (T_ENU_W @ truth[n])[:3, 3] + sigma * rng.normal(size=3) for n in nodes}
    return replace(graph, priors=tuple(Prior(n, se3(np.eye(3), p), information, **settings) for n, p in seen.items()))


def chain(robots: int, poses: int):
    """Robots one after the other along a circle that nobody closes, a metre a step; each meets the next once."""
    graph = ring(robots, poses, 0)
    open_ = tuple(e for e in graph.edges if not (e.is_separator and {e.i.robot, e.j.robot} == {0, robots - 1}))
    radius, turns = robots * poses / (2 * np.pi), 2 * np.pi * np.arange(robots * poses) / (robots * poses)
    truth = {
        NodeId(*divmod(k, poses)): se3(so3_exp([0, 0, a]), [radius * np.sin(a), radius * (1 - np.cos(a)), 0])
        for k, a in enumerate(turns)
    }
    return replace(graph, edges=open_), truth


def above(graph: PoseGraph, method: str, **settings) -> float:
    """How far above the certified kind of optimum it ends, and that what it says of its cost is what it is."""
    best = optimise(graph, CentralConfig()).cost_after
    found = optimise_distributed(graph, SolverConfig(method=method, **settings))
    assert all(o.accepted for o in found.outcomes.values())
    assert all(o.positions for o in found.outcomes.values())
    after = cost(found.graph, "F")
    assert {o.cost_after for o in found.outcomes.values()} == {found.outcomes[0].cost_after}
    assert found.outcomes[0].cost_after == pytest.approx(after, rel=2e-3)
    return after / best - 1.0


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("robots", [None, {0}, {0, 3}], ids=["all", "one", "ends"])
def test_a_chain_of_robots_with_a_fix_every_ten_metres(method, robots) -> None:
    if method == "rbcd" and robots == {0, 3}:
        pytest.skip("between two ends that are held, a chain takes block descent more sweeps than it has")
    graph, truth = chain(4, 40)
    gap = above(with_gps(graph, truth, 2.0, robots=robots), method)
    assert gap < {"multifrontal": 1e-4, "two-level": 1e-3, "rbcd": 1e-2}[method]


@pytest.mark.parametrize("method", ["multifrontal", "two-level"])
@pytest.mark.parametrize("robots", [None, {4}], ids=["all", "one"])
def test_a_town_of_ten(method, robots) -> None:
    graph, truth = town(np.random.default_rng(0), robots=10, length=60, separators=2)
    assert above(with_gps(graph, truth, 2.0, robots=robots), method) < 1e-3


@pytest.mark.parametrize("method", METHODS)
def test_whole_poses_one_alone_among_them(method) -> None:
    graph, truth = loops(np.random.default_rng(3), robots=3, length=40)
    information = np.diag([4.0] * 3 + [100.0] * 3)
    for nodes in ((NodeId(0, 3), NodeId(2, 20)), (NodeId(1, 7),)):
        priors = tuple(Prior(n, T_ENU_W @ truth[n], information) for n in nodes)
        assert above(replace(graph, priors=priors), method) < 1e-4


@pytest.mark.parametrize("method", METHODS)
def test_the_frame_of_the_priors_is_found_and_robots_keep_their_own(method) -> None:
    """Of the graph all is where the priors say; to its robots the anchor's first pose is where it was."""
    graph, truth = loops(np.random.default_rng(0), robots=3, length=40)
    measured = with_gps(graph, truth, 0.05, every=4)
    found = optimise_distributed(measured, SolverConfig(method=method))
    off = [np.linalg.norm((found.graph.poses[n] - T_ENU_W @ truth[n])[:3, 3]) for n in graph.nodes]
    assert max(off) < 0.2
    assert np.array_equal(found.outcomes[0].poses[NodeId(0, 0)], graph.poses[NodeId(0, 0)])
    moved = found.outcomes[0].poses[NodeId(0, 0)] @ se3_inverse(found.graph.poses[NodeId(0, 0)])
    for robot, outcome in found.outcomes.items():
        for node in (NodeId(robot, 5), NodeId(robot, 39)):
            np.testing.assert_allclose(outcome.poses[node], moved @ found.graph.poses[node], atol=1e-6)


@pytest.mark.parametrize("method", [*METHODS, "elected"])
def test_a_group_without_priors_stays_in_its_own_frame(method) -> None:
    graph, truth = loops(np.random.default_rng(0), robots=4, length=30)
    apart = replace(graph, edges=tuple(e for e in graph.edges if (e.i.robot < 2) == (e.j.robot < 2)))
    measured = with_gps(apart, truth, 0.2, every=5, robots={2, 3})
    central = optimise(measured, CentralConfig()).graph
    found = optimise_distributed(measured, SolverConfig(method=method)).graph
    assert np.array_equal(found.poses[NodeId(0, 0)], graph.poses[NodeId(0, 0)])
    for node in graph.nodes:
        np.testing.assert_allclose(found.poses[node], central.poses[node], atol=0.02)
    # Both with priors: both in their frame, though no edge joins them.
    both = with_gps(apart, truth, 0.2, every=5)
    central, found = (
        optimise(both, CentralConfig()).graph,
        optimise_distributed(both, SolverConfig(method=method)).graph,
    )
    for node in graph.nodes:
        np.testing.assert_allclose(found.poses[node], central.poses[node], atol=0.02)


@pytest.mark.parametrize("method", METHODS)
def test_a_track_that_only_its_priors_place(method) -> None:
    graph, truth = loops(np.random.default_rng(3), robots=3, length=40)

    def joins(e) -> bool:
        """Robot 1's second half to its first, or to others."""
        late = [n.robot == 1 and n.index > 20 for n in (e.i, e.j)]
        return late[0] != late[1]

    apart = replace(graph, edges=tuple(e for e in graph.edges if not joins(e)))
    measured = with_gps(apart, truth, 0.2, every=5)
    assert above(measured, method) < 1e-4
    # Without any it stays where it was, and is named.
    rest = tuple(p for p in measured.priors if p.node.robot != 1 or p.node.index <= 20)
    found = optimise_distributed(replace(measured, priors=rest), SolverConfig(method=method))
    lost = tuple(NodeId(1, k) for k in range(21, 40))
    assert found.outcomes[1].unreached == lost and not found.outcomes[0].unreached
    assert all(np.array_equal(found.outcomes[1].poses[n], graph.poses[n]) for n in lost)


@pytest.mark.parametrize("method", METHODS)
def test_a_kernel_and_a_lever_as_the_elected_robot_has_them(method) -> None:
    graph, truth = loops(np.random.default_rng(0), robots=2, length=18)
    lever = np.array([1.0, -2.0, 3.0])
    rng = np.random.default_rng(7)
    priors = []
    for p in with_gps(graph, truth, 0.2, every=3, lever=lever, bound=3.0).priors:
        seen = p.T_O_i[:3, 3] + (T_ENU_W @ truth[p.node])[:3, :3] @ lever
        seen = seen + (rng.random() < 0.15) * rng.choice([-1.0, 1.0], 3) * 30.0
        priors.append(replace(p, T_O_i=se3(np.eye(3), seen)))
    measured = replace(graph, priors=tuple(priors))
    elected = optimise_distributed(measured, SolverConfig(method="elected"))
    found = optimise_distributed(measured, SolverConfig(method=method))
    assert found.outcomes[0].accepted
    assert found.outcomes[0].cost_after < elected.outcomes[0].cost_after * 1.001
    off = [np.linalg.norm((found.graph.poses[n] - T_ENU_W @ truth[n])[:3, 3]) for n in graph.nodes]
    assert max(off) < 0.5


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("mono", [{0, 1, 2}, {0, 2}], ids=["all", "some"])
def test_robots_with_one_camera_get_metres(method, mono) -> None:
    graph, truth = loops(np.random.default_rng(14), robots=3, length=16, sigma_t=0.0, sigma_deg=0.0)
    rng = np.random.default_rng(15)
    units = {n: np.exp(0.3 * n.robot + 0.01 * rng.normal()) if n.robot in mono else 1.0 for n in graph.nodes}
    measured = with_gps(drifting(graph, truth, units), truth, 0.01, every=3)
    found = optimise_distributed(measured, SolverConfig(method=method), frozenset(mono))
    assert all(o.accepted and o.positions for o in found.outcomes.values())
    for node in graph.nodes:
        np.testing.assert_allclose(found.graph.poses[node][:3, 3], (T_ENU_W @ truth[node])[:3, 3], atol=0.05)
        assert found.units[node] == pytest.approx(units[node], rel=0.05)
    elected = optimise_distributed(measured, SolverConfig(method="elected"), frozenset(mono))
    assert found.outcomes[0].cost_after < elected.outcomes[0].cost_after * 1.001


def test_robust_selection_by_message_keeps_what_the_central_one_keeps() -> None:
    graph, truth = loops(np.random.default_rng(0), robots=3, length=24)
    bad, wrong = with_wrong_edges(with_gps(graph, truth, 0.2), np.random.default_rng(5), 6)
    central = optimise_robustly(bad, "gnc", CentralConfig(), RobustConfig())
    for method in ("rbcd", "elected"):
        found = optimise_distributed(bad, SolverConfig(method=method, robust="gnc"))
        kept = [verdict is None or not verdict.rejected for verdict in found.judged]
        assert kept == [w > 0.5 for w in central.weights]
        assert {(e.i, e.j) for e, k in zip(bad.edges, kept, strict=True) if not k} == wrong
        right = replace(found.graph, edges=tuple(e for e in bad.edges if (e.i, e.j) not in wrong))
        assert cost(right, "F") < optimise(right, CentralConfig()).cost_after * 1.001


@pytest.mark.parametrize("method", METHODS)
def test_two_positions_place_nothing_and_change_nothing(method) -> None:
    graph, truth = loops(np.random.default_rng(0), robots=3, length=20)
    two = with_gps(graph, truth, 0.2, every=19, robots={2})
    assert len(two.priors) == 2
    plain = optimise_distributed(graph, SolverConfig(method=method))
    found = optimise_distributed(two, SolverConfig(method=method))
    for robot, outcome in found.outcomes.items():
        assert not outcome.positions and outcome.cost_after == plain.outcomes[robot].cost_after
        assert all(np.array_equal(outcome.poses[n], T) for n, T in plain.outcomes[robot].poses.items())


@pytest.mark.parametrize("method", METHODS)
def test_the_cost_never_ends_higher(method) -> None:
    graph, truth = loops(np.random.default_rng(0), robots=3, length=30)
    best = optimise(with_gps(graph, truth, 0.2, every=5), CentralConfig())
    found = optimise_distributed(best.graph, SolverConfig(method=method, start="warm"))
    outcome = found.outcomes[0]
    assert outcome.cost_before == pytest.approx(best.cost_after, rel=1e-6)
    assert outcome.cost_after <= outcome.cost_before * (1 + 1e-9)
    assert cost(found.graph, "F") <= best.cost_after * (1 + 1e-9)


@pytest.mark.parametrize("method", METHODS)
def test_lost_repeated_late_and_disordered_messages_do_no_harm(method) -> None:
    graph, truth = loops(np.random.default_rng(4), robots=4, length=12, separators=3)
    group = shares(with_gps(graph, truth, 0.2, every=3))
    config = SolverConfig(method=method)
    expected, _ = solve_group(group, config)
    got = faulty(group, config, np.random.default_rng(1))
    for robot, outcome in expected.items():
        assert got[robot].cost_after == outcome.cost_after
        assert all(np.array_equal(got[robot].poses[n], T) for n, T in outcome.poses.items())


@pytest.mark.parametrize("method", ["dgs", "jor", "sor", "rbcd-async"])
def test_methods_that_use_no_priors_name_those_that_do(method) -> None:
    graph, truth = loops(np.random.default_rng(4), robots=2, length=12)
    with pytest.raises(BackendError, match=f"central, elected, multifrontal, two-level, rbcd, not by {method}"):
        optimise_distributed(with_gps(graph, truth, 0.2), SolverConfig(method=method))


def test_the_place_of_a_frame_from_sums_of_two_robots() -> None:
    """Against the transform that made them: positions and one whole pose, in 3-D and in the plane."""
    rng = np.random.default_rng(2)
    for dimension, turn in ((3, [0.5, -1.0, 2.0]), (2, [0.0, 0.0, 2.5])):
        origin = se3(so3_exp(turn), [5e5, -4e6, 0.0 if dimension == 2 else 300.0])
        sums = []
        for robot in range(2):
            there = rng.normal(size=(7, 3)) * 50.0
            there[:, 2] *= dimension - 2
            poses = origin @ se3(np.tile(np.eye(3), (7, 1, 1)), there)
            wanted = se3(np.tile(np.eye(3), (7, 1, 1)), there)
            priors = OriginPriors(
                tuple(NodeId(robot, k) for k in range(7)),
                wanted,
                np.where(np.arange(7) == 0, 100.0 * robot, 0.0),
                rng.uniform(1, 4, 7),
                np.zeros((7, 3)),
                np.full(7, np.inf),
            )
            sums.append(sums_of(priors, Places(poses, np.zeros(7)), None, 1.0))
        assert sums[1].turning == 1 and sums[0].turning == 0
        both = replace(sums[0], numbers=sums[0].numbers + sums[1].numbers)
        found = origin_from(both, False, dimension)
        np.testing.assert_allclose(found.rotation, origin[:3, :3], atol=1e-5)
        np.testing.assert_allclose(found.translation, origin[:3, 3], atol=1e-2)


def test_messages_come_out_as_they_went_in_and_nonsense_is_refused() -> None:
    step = Next(WhatNext.RUN, widen=2.5, cost_before=3.0, cost_after=1.0)
    message = PriorMessage(PriorKind.NEXT, 7, 1, 2, body_of(step.numbers()))
    read = unpack(1, 2, pack(message))
    assert read == message and read.decides and not read.asks
    assert Next.of(numbers_in(read.body)).widen == 2.5
    inner = InRun(3, message)
    with pytest.raises(BackendError, match="not a message of a run"):
        unpack(1, 2, pack(inner))
    for body in (b"123", body_of(np.array([np.nan])), body_of(np.zeros(3))):
        with pytest.raises(BackendError):
            Next.of(numbers_in(body))
        with pytest.raises(BackendError):
            PriorSums.of(numbers_in(body))
    graph, truth = loops(np.random.default_rng(4), robots=3, length=12)
    node = node_for(shares(with_gps(graph, truth, 0.2))[0], SolverConfig(method="rbcd"))
    node.start()
    with pytest.raises(BackendError, match="tree of members"):
        node.handle(PriorMessage(PriorKind.NEXT, 0, 1, 0, body_of(step.numbers())))
    with pytest.raises(BackendError, match="runs ahead"):
        node.handle(InRun(9, replace(message, sender=1, receiver=0)))
    with pytest.raises(BackendError, match="handed a message from 1 for 2"):
        node.handle(message)


def test_the_command_uses_them_and_says_who_can(tmp_path, capsys) -> None:
    graph, truth = loops(np.random.default_rng(0), robots=2, length=20)
    path = tmp_path / "gps.g2o"
    write_g2o(path, with_gps(graph, truth, 1.0, every=4))
    best = optimise(read_g2o(path), CentralConfig()).cost_after
    for method in ("multifrontal", "two-level"):
        assert cli.main(["pgo", str(path), str(tmp_path / f"{method}.g2o"), "--method", method, "--json"]) == 0
        assert json.loads(capsys.readouterr().out)["cost"]["F"] < best * 1.001
        assert len(read_g2o(tmp_path / f"{method}.g2o").priors) == 10
    for method in ("sor", "quick"):
        assert cli.main(["pgo", str(path), str(tmp_path / "out.g2o"), "--method", method]) == 1
        (line,) = capsys.readouterr().err.splitlines()
        assert line.endswith(f"central, elected, multifrontal, two-level, rbcd, not by {method}")
    with pytest.raises(maslam.MaslamError, match="not by quick"):
        maslam.optimise_distributed(read_g2o(path), method="quick")
