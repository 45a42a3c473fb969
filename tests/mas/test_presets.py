"""The five presets on made-up towns: each works, and they stand to each other as the thesis's tables say."""

from __future__ import annotations

import csv
import json
from dataclasses import dataclass
from pathlib import Path

import pytest
from factory import town

from maslam.mas.config import MasConfig
from maslam.mas.errors import MasError
from maslam.mas.evaluation.summary import Summary
from maslam.mas.policies.presets import PRESETS, policy_of, preset
from maslam.mas.simulation import run


@dataclass(frozen=True)
class Played:
    folder: Path
    summary: Summary

    @property
    def dvpr(self) -> int:
        return self.summary.traffic["dvpr"].payload_bytes


def fitting(name: str) -> MasConfig:
    """A preset for made-up place vectors, which are shorter than the predecessor's 128 numbers."""
    config = preset(name)
    code = config.places.code.removesuffix("x128")
    return config.model_copy(update={"places": config.places.model_copy(update={"code": code})})


def play(name: str, folder: Path, agents: int, keyframes: int, spacing_m: float) -> Played:
    manifest, sequences = town(agents, keyframes, spacing_m=spacing_m, drifting=0.03)
    return Played(folder, run(manifest, sequences, fitting(name), folder))


@pytest.fixture(scope="module")
def six(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Played]:
    folder = tmp_path_factory.mktemp("six")
    return {name: play(name, folder / name, 6, 22, 12.0) for name in PRESETS}


@pytest.fixture(scope="module")
def ten(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Played]:
    folder = tmp_path_factory.mktemp("ten")
    return {name: play(name, folder / name, 10, 20, 10.0) for name in ("optimised", "selection")}


def test_the_thesis_systems_and_ours_are_there() -> None:
    assert list(PRESETS) == ["predecessor", "default", "optimised", "selection", "maslam"]
    assert all(config.preset == name for name, config in PRESETS.items())
    with pytest.raises(MasError, match="no preset 'best'; there are default, maslam, optimised"):
        preset("best")
    with pytest.raises(MasError, match="no preset 'best'"):
        policy_of(MasConfig(preset="best"), 0)


@pytest.mark.parametrize("name", PRESETS)
def test_each_joins_all_agents_without_a_false_match(six: dict[str, Played], name: str) -> None:
    summary = six[name].summary
    assert summary.groups == [[0, 1, 2, 3, 4, 5]]
    assert summary.matches.accepted >= 5 and summary.matches.false_accepted == 0
    assert summary.ate_rmse_m.mean_agents is not None and summary.odometry_mean_rmse_m is not None
    assert summary.ate_rmse_m.mean_agents < summary.odometry_mean_rmse_m


def test_only_the_predecessor_trades_no_maps(six: dict[str, Played]) -> None:
    for name, played in six.items():
        bought = played.summary.traffic["mapmerge"].messages
        assert (bought == 0) == (name == "predecessor"), name


def test_the_optimised_system_explores_more_than_the_default_one(six: dict[str, Played]) -> None:
    explored = {n: p.summary.exploration_percent for n, p in six.items()}
    for ours, theirs in zip(explored["optimised"], explored["default"], strict=True):
        assert ours >= theirs
    assert min(explored["optimised"]) > 95.0
    assert sum(explored["optimised"]) > 1.1 * sum(explored["default"])


def test_place_recognition_costs_less_from_system_to_system(six: dict[str, Played]) -> None:
    bytes_of = {name: played.dvpr for name, played in six.items()}
    assert bytes_of["predecessor"] < bytes_of["selection"] < bytes_of["optimised"] < bytes_of["default"]


@pytest.mark.parametrize("name", ["default", "optimised", "selection"])
def test_only_places_within_the_strict_distance_are_verified_and_that_costs_few_matches(
    six: dict[str, Played], tmp_path: Path, name: str
) -> None:
    """Against the same town without a strict distance, where all candidates go to geometry."""
    strict = 0.25
    manifest, sequences = town(6, 22, spacing_m=12.0, drifting=0.03)
    descriptor = manifest.descriptor.model_copy(update={"strict_threshold": strict})
    config = fitting(name)
    config = config.model_copy(update={"merge": config.merge.model_copy(update={"enabled": False})})
    summary = run(manifest.model_copy(update={"descriptor": descriptor}), sequences, config, tmp_path / "strict")
    loose = six[name]
    assert farthest(tmp_path / "strict") < strict < farthest(loose.folder)
    assert summary.matches.false_accepted == 0
    assert summary.matches.accepted >= 0.9 * loose.summary.matches.accepted
    assert summary.traffic["relpose"].payload_bytes < loose.summary.traffic["relpose"].payload_bytes


def farthest(folder: Path) -> float:
    """The largest distance of appearance between two key-frames that were candidates of two agents."""
    with (folder / "matches.csv").open() as file:
        return max(float(row["distance"]) for row in csv.DictReader(file) if row["query_agent"] != row["match_agent"])


def slowest_answer_s(played: Played) -> float:
    """The longest logical time from a match's acceptance to an optimisation of both its agents."""
    lines = (played.folder / "events.jsonl").read_text().splitlines()
    events = [json.loads(line) for line in lines]
    optimised = [(e["time_s"], set(e["members"])) for e in events if e["event"] == "optimised"]
    waits = []
    for event in (e for e in events if e["event"] == "match"):
        agents = {int(end.partition(":")[0]) for end in event["match"].split(" - ")}
        waits.append(min(at for at, members in optimised if at > event["time_s"] and agents <= members))
        waits[-1] -= event["time_s"]
    return max(waits)


def test_the_predecessor_optimises_in_the_next_step_and_others_wait(six: dict[str, Played]) -> None:
    step_s = preset("predecessor").step_s
    assert slowest_answer_s(six["predecessor"]) <= step_s < slowest_answer_s(six["default"])


def test_selection_saves_a_third_of_the_optimised_systems_questions(ten: dict[str, Played]) -> None:
    assert ten["selection"].dvpr <= 0.65 * ten["optimised"].dvpr
    for played in ten.values():
        assert played.summary.groups == [list(range(10))]
        assert played.summary.matches.false_accepted == 0


def test_the_same_seed_draws_the_same(six: dict[str, Played], tmp_path: Path) -> None:
    again = play("selection", tmp_path / "again", 6, 22, 12.0)
    for file in ("traffic.csv", "matches.csv", "timeline.csv", "events.jsonl"):
        assert (again.folder / file).read_bytes() == (six["selection"].folder / file).read_bytes(), file


def test_another_seed_draws_others(six: dict[str, Played], tmp_path: Path) -> None:
    manifest, sequences = town(6, 22, spacing_m=12.0, drifting=0.03)
    run(manifest, sequences, fitting("selection").model_copy(update={"seed": 1}), tmp_path / "other")
    ours, theirs = (f / "traffic.csv" for f in (six["selection"].folder, tmp_path / "other"))
    assert ours.read_bytes() != theirs.read_bytes()


def test_the_predecessors_published_values() -> None:
    config = preset("predecessor")
    assert config.places.code == "float32x128" and config.places.features == "words"
    assert all(c.places.certainty == "strict" for c in PRESETS.values())
    assert (config.places.gap_m, config.places.gap_keyframes) == (10.0, 0)
    assert (config.places.own_age_s, config.places.own_age_keyframes) == (30.0, None)
    assert config.relpose.min_inliers == 20 and config.relpose.hypotheses == 300
    assert config.relpose.max_hamming == 50 and config.relpose.ratio == 0.75
    assert config.consistency.min_support == 2
    assert (config.optimisation.solver.rotation_sweeps, config.optimisation.solver.pose_sweeps) == (20, 20)
    assert json.loads(config.model_dump_json())["merge"]["enabled"] is False


def test_the_optimised_systems_compare_five_frames() -> None:
    assert preset("optimised").places.latest_frames == preset("selection").places.latest_frames == 5
    assert preset("default").places.latest_frames == preset("maslam").places.latest_frames == 1
