"""A graph that does not fit is said in the summary, on the console and in the report; one that fits is not."""

from __future__ import annotations

from pathlib import Path

import pytest
from factory import circuit, make_sequence, make_world, manifest_of, town

from maslam.mas.evaluation.summary import Summary
from maslam.mas.policies.presets import preset
from maslam.mas.simulation import run
from maslam.tools.report.command import write_report
from maslam.tools.report.summary_table import table_of


def lap(folder: Path, drifting: float, **sigmas: float) -> Summary:
    """One agent round a street and on; ``drifting``: of its odometry; 0: none."""
    config = preset("default")
    places = config.places.model_copy(update={"own_age_keyframes": 40})
    optimisation = config.optimisation.model_copy(update=sigmas)
    config = config.model_copy(update={"places": places, "optimisation": optimisation})
    alone = [make_sequence(make_world(2), circuit(0.0, 126.0, side_m=30.0, radius_m=6.0), 2, drifting=drifting)]
    summary = run(manifest_of(alone), alone, config, folder)
    assert summary.matches.own_loops >= 2 and summary.matches.false_accepted == 0
    return summary


def test_edges_that_claim_too_much_are_a_warning_with_the_worst_of_them(tmp_path: Path) -> None:
    """The odometry claims to be a hundred times as good as it is: no poses can fit it and the loops."""
    small = {"odometry_sigma_share": 1e-4, "odometry_sigma_depth": 1e-5, "odometry_sigma_deg": 1e-3}
    folder = tmp_path / "run"
    (graph,) = lap(folder, 0.01, **small, match_sigma_depth=1e-4, match_sigma_deg=1e-3).graphs
    assert not graph.fits and graph.cost > 10 * graph.dof and graph.agents == [0]
    assert graph.dof == 6 * (graph.edges - 84 + 1)
    assert [m.cost for m in graph.worst] == sorted((m.cost for m in graph.worst), reverse=True)
    said = [line for line in table_of(folder).splitlines() if line.startswith("warning")]
    assert len(said) == 1 and "the graph of agent_00 does not fit" in said[0]
    assert " - ".join(graph.worst[0].ends) in said[0]
    assert "A graph that does not fit" in write_report(folder).read_text()


def test_odometry_that_drifts_more_than_it_claims_is_one(tmp_path: Path) -> None:
    """Its bias of the heading, some degrees a lap, is many of the sigmas that the settings give it."""
    (graph,) = lap(tmp_path / "run", 0.03).graphs
    assert not graph.fits and {m.kind for m in graph.worst} <= {"odometry", "loop"}


def test_edges_that_are_as_good_as_they_claim_are_none(tmp_path: Path) -> None:
    folder = tmp_path / "run"
    (graph,) = lap(folder, 0.0).graphs
    assert graph.fits and graph.dof > 0
    assert "does not fit" not in table_of(folder) and "does not fit" not in write_report(folder).read_text()


def test_each_group_has_a_graph_of_its_own_with_the_matches_between_its_agents(tmp_path: Path) -> None:
    world = make_world(1)
    paths = [circuit(0.0, 24.0), circuit(5.0, 24.0), circuit(90.0, 24.0)]
    sequences = [make_sequence(world, path, 1, a) for a, path in enumerate(paths)]
    summary = run(manifest_of(sequences), sequences, preset("default"), tmp_path / "run")
    assert [g.agents for g in summary.graphs] == summary.groups == [[0, 1], [2]]
    pair, alone = summary.graphs
    assert pair.edges == 30 + summary.matches.accepted and alone.edges == 15
    assert pair.dof == 6 * (summary.matches.accepted - 1) and alone.dof == 0 and pair.fits


@pytest.mark.parametrize("name", ["default", "optimised", "selection", "maslam"])
def test_a_town_that_goes_well_has_no_warning(name: str, tmp_path: Path) -> None:
    manifest, sequences = town(3, 24, spacing_m=8.0)
    summary = run(manifest, sequences, preset(name), tmp_path / "run")
    assert summary.matches.false_accepted == 0 and all(graph.fits for graph in summary.graphs)


def test_monocular_agents_of_two_units_fit(tmp_path: Path) -> None:
    world = make_world(4)
    scales = ((0.0, 0.5), (6.0, 0.2))
    sequences = [make_sequence(world, circuit(s, 36.0), 4, a, scale=u) for a, (s, u) in enumerate(scales)]
    summary = run(manifest_of(sequences), sequences, preset("default"), tmp_path / "run")
    assert summary.groups == [[0, 1]]
    (graph,) = summary.graphs
    assert graph.fits and graph.dof == 7 * (summary.matches.accepted - 1)
