"""Headings of odometry as unknowns: a track that turns evenly is found and mended, right odometries stay."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from graphs import loops
from test_lengths import LENGTHS, error

import maslam
from maslam._replaced import replaced
from maslam.backend.central.costs import cost
from maslam.backend.central.headings import with_corrections
from maslam.backend.central.odometry import corrected, freedom, metric_edges
from maslam.backend.central.optimise import optimise
from maslam.backend.central.similarity_edges import Descended
from maslam.backend.central.trust_region import anchors
from maslam.backend.config import CentralConfig, SolverConfig
from maslam.backend.distributed.exchange import optimise_distributed, solve_group
from maslam.backend.distributed.incremental.update_node import UpdateNode
from maslam.backend.distributed.share import shares
from maslam.backend.errors import BackendError
from maslam.backend.pose_graph.g2o import read_g2o, write_g2o
from maslam.backend.pose_graph.graph import EdgeKind
from maslam.tools import cli

SIGMA_DEG = 0.04
TURNS = {0: [0.0, 0.0, 0.04], 1: [0.03, 0.0, 0.0], 2: [0.0, -0.05, 0.02], 3: [0.0, 0.0, 0.0]}
"""By how much more odometry is to turn, degrees a metre."""


def turning(seed=0, turns=TURNS, lengths=None, **kwargs):
    """Four robots on crossing circles; odometry that turns too little by their ``turns``; the true poses."""
    given = {"sigma_t": 0.01, "sigma_deg": 0.02, "separators": 6, **kwargs}
    graph, truth = loops(np.random.default_rng(seed), **given)
    # Not by the library's own: each step is turned back over its length.
    edges = []
    for e in graph.edges:
        T = e.T_i_j.copy()
        if e.kind is EdgeKind.ODOMETRY:
            T[:3, :3] = T[:3, :3] @ _turn(-np.radians(turns.get(e.i.robot, np.zeros(3))) * np.linalg.norm(T[:3, 3]))
            T[:3, 3] /= (lengths or {}).get(e.i.robot, 1.0)
        edges.append(replace(e, T_i_j=T))
    return replace(graph, edges=tuple(edges)), truth


def _turn(w):
    """Rodrigues' formula."""
    a = np.linalg.norm(w)
    if a == 0.0:
        return np.eye(3)
    x, y, z = w / a
    K = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sin(a) * K + (1 - np.cos(a)) * K @ K


def central(graph, sigma_deg=SIGMA_DEG):
    return optimise(graph, CentralConfig(length_sigma=0.01, heading_sigma_deg=sigma_deg))


def test_a_track_that_turns_evenly_is_found_and_mended() -> None:
    graph, truth = turning()
    found, plain = central(graph), central(graph, 0.0)
    assert plain.turns == {} and found.lengths == {}
    for robot, turn in TURNS.items():
        assert np.degrees(found.turns[robot]) == pytest.approx(turn, abs=0.015)
    assert error(found.graph.poses, truth) < 0.7 * error(plain.graph.poses, truth)


def test_lengths_and_headings_that_are_both_off() -> None:
    graph, truth = turning(lengths=LENGTHS)
    found, plain = central(graph), central(graph, 0.0)
    off = np.array([found.lengths[r] - LENGTHS[r] for r in graph.robots])
    assert np.abs(off - off.mean()).max() < 0.003
    assert np.degrees(found.turns[0]) == pytest.approx(TURNS[0], abs=0.015)
    assert error(found.graph.poses, truth) < 0.8 * error(plain.graph.poses, truth)


def test_right_headings_stay_as_they_are_bit_for_bit() -> None:
    graph, _ = turning(turns={})
    found, plain = central(graph), optimise(graph, CentralConfig())
    assert found.turns == {} and found.cost_after == plain.cost_after
    assert all(np.array_equal(found.graph.poses[n], plain.graph.poses[n]) for n in graph.nodes)


def test_matches_that_do_not_fit_are_no_evidence() -> None:
    """Clear turns, seen by matches that are twice as bad as they state."""
    graph, _ = turning(turns={robot: [3.0 * x for x in turn] for robot, turn in TURNS.items()})
    rng = np.random.default_rng(3)

    def worse(e):
        T = e.T_i_j.copy()
        if e.kind is not EdgeKind.ODOMETRY:
            T[:3, :3] = T[:3, :3] @ _turn(2.0 * np.radians(0.02) * rng.normal(size=3))
            T[:3, 3] += 2.0 * 0.01 * rng.normal(size=3)
        return replace(e, T_i_j=T)

    assert central(graph).turns != {}
    assert central(replace(graph, edges=tuple(worse(e) for e in graph.edges))).turns == {}


def test_the_result_is_the_minimum_and_the_evidence_its_marginal_likelihood() -> None:
    """Against F of the best poses for given rates, and differences of it: no derivative, no Schur complement."""
    graph, _ = turning(robots=2, length=40, separators=8, turns={0: [0.0, 0.05, 0.12], 1: [0.08, 0.0, -0.1]})
    found = central(graph)
    sigma = np.radians(SIGMA_DEG)

    def best(rates):
        turned = corrected(graph, {}, {0: rates[:3], 1: rates[3:]})
        return optimise(turned.with_poses(found.graph.poses), CentralConfig(start="given")).cost_after

    def joint(rates):
        return best(rates) + float((rates**2).sum()) / sigma**2

    at = np.concatenate([found.turns[0], found.turns[1]])
    least, step = joint(at), 0.1 * sigma
    axes = step * np.eye(6)
    up, down = (np.array([joint(at + sign * a) for a in axes]) for sign in (1, -1))
    # Where a parabola through three values is least, along each axis: at the rates themselves.
    assert np.abs(0.5 * (up - down) / (up - 2 * least + down)).max() * step < 0.02 * sigma
    half = np.diag(0.5 * (up - 2 * least + down)) / step**2
    for a in range(6):
        for b in range(a):
            across = joint(at + axes[a] + axes[b]) - up[a] - up[b] + least
            half[a, b] = half[b, a] = 0.5 * across / step**2
    odds = 0.5 * (best(np.zeros(6)) - least) - 0.5 * np.linalg.slogdet(half * sigma**2)[1]
    solved = optimise(graph, CentralConfig()).graph
    a = solved.arrays()
    edges, steps = metric_edges(solved, 0.01, sigma)
    start, kept = Descended(a.poses, np.zeros(len(a.poses)), 0), np.ones(len(a.poses), dtype=bool)
    reported = with_corrections(edges, start, anchors(a), kept, steps, freedom(solved)).headings
    assert reported.used and reported.evidence == pytest.approx(odds, abs=0.5)


def test_elected_ends_where_central_does() -> None:
    graph, truth = turning(1, lengths=LENGTHS)
    whole = central(graph)
    config = SolverConfig(method="elected", length_sigma=0.01, heading_sigma_deg=SIGMA_DEG)
    found = optimise_distributed(graph, config)
    assert all(outcome.accepted for outcome in found.outcomes.values())
    for robot in graph.robots:
        assert np.degrees(found.turns[robot]) == pytest.approx(np.degrees(whole.turns[robot]), abs=2e-3)
    assert error(found.graph.poses, truth) < 1.02 * error(whole.graph.poses, truth)
    mended = corrected(found.graph, found.lengths, found.turns)
    best = corrected(whole.graph, whole.lengths, whole.turns)
    assert cost(mended, "F") == pytest.approx(cost(best, "F"), rel=1e-3)


def test_what_does_not_go_together_says_so() -> None:
    graph, _ = turning()
    alone = SolverConfig(method="elected", heading_sigma_deg=SIGMA_DEG)
    with pytest.raises(BackendError, match="beside lengths"):
        optimise_distributed(graph, alone)
    config = SolverConfig(method="elected", length_sigma=0.01, heading_sigma_deg=SIGMA_DEG)
    with pytest.raises(BackendError, match="need elected_longest 1"):
        optimise_distributed(graph, replaced(config, elected_longest=5))
    with pytest.raises(BackendError, match="beside lengths"):
        optimise(graph, CentralConfig(heading_sigma_deg=SIGMA_DEG))
    group = shares(graph, length_sigma=0.01, heading_sigma=float(np.radians(SIGMA_DEG)))
    outcomes, _ = solve_group(group, config)
    assert any(outcomes[3].turn)
    with pytest.raises(BackendError, match="no lengths or headings"):
        UpdateNode(group[3], outcomes[3], None, config)  # type: ignore[arg-type]  # refused before it is looked at


def test_the_command_writes_them_corrected_and_says_so(tmp_path, capsys) -> None:
    graph, _ = turning()
    path, out = tmp_path / "in.g2o", tmp_path / "out.g2o"
    write_g2o(path, graph)
    options = ["--central.length-sigma", ".01", "--central.heading-sigma-deg", str(SIGMA_DEG)]
    assert cli.main(["pgo", str(path), str(out), "--method", "central", *options]) == 0
    assert "odometry turns evenly, and is written corrected" in capsys.readouterr().out
    assert cli.main(["pgo", str(path), str(out), "--method", "central", "--overwrite", "--json", *options]) == 0
    reported = json.loads(capsys.readouterr().out)
    assert reported["turns_deg_m"]["0"] == pytest.approx(TURNS[0], abs=0.012) and reported["lengths"] == {}
    written = read_g2o(out)
    assert cost(written, "F") == pytest.approx(reported["cost"]["F"], rel=1e-2)
    assert reported["cost"]["F"] < 0.8 * optimise(graph, CentralConfig()).cost_after
    assert cli.main(["pgo", str(path), str(out), "--method", "central", "--overwrite", *options[2:]]) == 2
    assert "--central.length-sigma" in capsys.readouterr().err
    with pytest.raises(maslam.MaslamError, match="beside lengths"):
        maslam.optimise(graph, settings={"heading_sigma_deg": SIGMA_DEG})
