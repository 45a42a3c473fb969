"""The whole default system on a made-up town whose truth is known."""

from __future__ import annotations

import csv
import json
import time
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from factory import town
from numba.core import event

from maslam.backend.pose_graph.g2o import read_g2o
from maslam.frontend.files.trajectory import read_tum
from maslam.mas import simulation
from maslam.mas.config import MasConfig, MergeConfig
from maslam.mas.evaluation.summary import Summary
from maslam.mas.policies.presets import preset
from maslam.mas.simulation import run
from maslam.tools.report.run_data import read_run
from maslam.tools.report.sections import sections
from maslam.tools.report.summary_table import table_of

# The default system, but with the last purchases that the thesis has from its optimised system on.
SYSTEM = preset("default").model_copy(update={"merge": MergeConfig()})


@pytest.fixture(scope="module")
def played(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Summary]:
    out = tmp_path_factory.mktemp("system") / "run"
    manifest, sequences = town(3, 36, spacing_m=14.0, drifting=0.03)
    return out, run(manifest, sequences, SYSTEM, out)


def rows(path: Path) -> list[dict[str, str]]:
    with open(path, newline="") as file:
        return list(csv.DictReader(file))


def test_agents_find_each_other_and_share_one_frame(played: tuple[Path, Summary]) -> None:
    _, summary = played
    assert summary.groups == [[0, 1, 2]]
    assert summary.matches.accepted >= 4
    assert summary.matches.false_accepted == 0
    matches = summary.matches
    parts = (matches.accepted, *matches.rejected.values(), *matches.skipped.values())
    assert matches.candidates == sum(parts)


def test_a_candidate_that_nobody_checked_is_skipped_and_not_rejected(played: tuple[Path, Summary]) -> None:
    out, summary = played
    candidates, messages = rows(out / "matches.csv"), rows(out / "traffic.csv")
    unchecked = Counter(r["reason"] for r in candidates if r["outcome"] != "accepted" and r["detail"] == "")
    assert unchecked == Counter(r["reason"] for r in candidates if r["outcome"] == "skipped")
    assert unchecked and summary.matches.skipped == dict(unchecked)
    between = [r for r in candidates if r["query_agent"] != r["match_agent"] and r["reason"] not in unchecked]
    checked = sum(m["kind"] == "VerifyTask" for m in messages)
    assert checked >= len(between), "each of the others was sent for a check"
    assert not summary.matches.rejected.keys() & unchecked.keys()


def test_optimisation_makes_trajectories_better(played: tuple[Path, Summary]) -> None:
    _, summary = played
    assert summary.odometry_mean_rmse_m is not None and summary.ate_rmse_m.mean_agents is not None
    assert summary.ate_rmse_m.mean_agents < summary.odometry_mean_rmse_m
    connected = [e for e in summary.ate_rmse_m.connected if e is not None]
    assert len(connected) == 3
    assert np.mean(connected) < 0.01 * np.mean([p for p in summary.path_length_m if p is not None])


def test_agents_that_descend_to_the_optimum_need_fewer_bytes(played: tuple[Path, Summary], tmp_path: Path) -> None:
    _, two_stage = played
    config = preset("default")
    solver = config.optimisation.solver.model_copy(update={"method": "rbcd"})
    optimisation = config.optimisation.model_copy(update={"solver": solver})
    manifest, sequences = town(3, 36, spacing_m=14.0, drifting=0.03)
    summary = run(manifest, sequences, config.model_copy(update={"optimisation": optimisation}), tmp_path / "run")
    assert summary.optimisations.count == two_stage.optimisations.count
    assert summary.optimisations.cost_after < 1.001 * two_stage.optimisations.cost_after
    assert summary.traffic["dopt"].payload_bytes < 0.5 * two_stage.traffic["dopt"].payload_bytes


def test_no_optimisation_raises_the_cost(played: tuple[Path, Summary]) -> None:
    out, summary = played
    events = [json.loads(line) for line in (out / "events.jsonl").read_text().splitlines()]
    optimised = [e for e in events if e["event"] == "optimised"]
    assert len(optimised) == summary.optimisations.count > 0
    assert all(e["cost_after"] <= e["cost_before"] for e in optimised)


def test_every_agent_ends_with_everyones_map(played: tuple[Path, Summary]) -> None:
    out, summary = played
    assert {(c.holder, c.owner) for c in summary.map_copies} == {(a, b) for a in range(3) for b in range(3) if a != b}
    assert min(summary.exploration_percent) > 95.0
    for copy in summary.map_copies:
        assert copy.ate_rmse_m is not None and copy.ate_rmse_m < 1.0
        held = read_tum(out / f"agent_{copy.holder:02d}" / "maps" / f"agent_{copy.owner:02d}.tum")
        assert len(held) == copy.keyframes


def test_traffic_adds_up(played: tuple[Path, Summary]) -> None:
    out, summary = played
    sent = rows(out / "traffic.csv")
    for name, figures in summary.traffic.items():
        mine = [r for r in sent if name in (r["operation"], "total")]
        assert figures.messages == len(mine)
        assert figures.wire_bytes == sum(int(r["wire_bytes"]) for r in mine)
        assert figures.payload_bytes == sum(int(r["payload_bytes"]) for r in mine)
    assert summary.traffic["negotiation"].payload_bytes == 0
    assert all(int(r["wire_bytes"]) > int(r["payload_bytes"]) for r in sent if r["kind"] != "VerifyAnswer")


def test_every_call_ends(played: tuple[Path, Summary]) -> None:
    out, _ = played
    sent = rows(out / "traffic.csv")
    events = [json.loads(line) for line in (out / "events.jsonl").read_text().splitlines()]
    ended = [e for e in events if e["event"] == "contract"]
    assert len(ended) == sum(r["kind"] == "Call" for r in sent)


def test_the_run_folder_is_complete(played: tuple[Path, Summary]) -> None:
    out, summary = played
    for name in ("summary.json", "config.yaml", "timeline.csv", "events.jsonl", "matches.csv", "traffic.csv"):
        assert (out / name).is_file()
    assert json.loads((out / "summary.json").read_text()) == summary.model_dump()
    assert len(rows(out / "timeline.csv")) == summary.steps
    assert len(rows(out / "matches.csv")) == summary.matches.candidates
    for agent in range(3):
        folder = out / f"agent_{agent:02d}"
        assert len(read_tum(folder / "trajectory.tum")) == 108
        keyframes = read_tum(folder / "trajectory_keyframes.tum")
        assert len(keyframes) == 36
        graph = read_g2o(folder / "graph.g2o")
        own = [n for n in graph.nodes if n.robot == agent]
        np.testing.assert_allclose([graph.poses[n][:3, 3] for n in own], keyframes.centres, atol=1e-6)
        assert (folder / "maps" / "colmap" / "points3D.bin").stat().st_size > 10_000
        assert (folder / "map.ply").read_bytes().startswith(b"ply\nformat binary_little_endian")
    assert not out.with_name("run.part").exists()


def test_the_settings_can_be_read_back(played: tuple[Path, Summary]) -> None:
    import yaml

    out, _ = played
    assert MasConfig.model_validate(yaml.safe_load((out / "config.yaml").read_text())) == SYSTEM


def test_same_input_same_bytes(played: tuple[Path, Summary], tmp_path: Path) -> None:
    out, first = played
    manifest, sequences = town(3, 36, spacing_m=14.0, drifting=0.03)
    second = run(manifest, sequences, SYSTEM, tmp_path / "again")
    files = sorted(p.relative_to(out) for p in out.rglob("*") if p.is_file())
    assert files == sorted(p.relative_to(tmp_path / "again") for p in (tmp_path / "again").rglob("*") if p.is_file())
    different = [f for f in files if (out / f).read_bytes() != (tmp_path / "again" / f).read_bytes()]
    assert different == [Path("timing.json")]
    assert first == second


def test_our_preset_is_nearly_as_accurate_as_asking_everyone(tmp_path: Path) -> None:
    """Odometry that drifts by 3 %; one town says little, as few matches decide."""
    errors: dict[str, list[float]] = {"default": [], "maslam": []}
    for seed in range(3):
        manifest, sequences = town(3, 36, seed=seed, spacing_m=14.0, drifting=0.03)
        for name, found in errors.items():
            mean = run(manifest, sequences, preset(name), tmp_path / f"{name}{seed}").ate_rmse_m.mean_agents
            assert mean is not None
            found.append(mean)
    assert np.mean(errors["maslam"]) < 1.1 * np.mean(errors["default"])


def test_our_preset_finds_as_much_for_fewer_bytes(played: tuple[Path, Summary], tmp_path: Path) -> None:
    _, default = played
    manifest, sequences = town(3, 36, spacing_m=14.0, drifting=0.03)
    ours = run(manifest, sequences, preset("maslam"), tmp_path / "ours")
    assert ours.groups == default.groups
    assert ours.traffic["total"].wire_bytes < 0.1 * default.traffic["total"].wire_bytes
    assert min(ours.exploration_percent) >= min(default.exploration_percent)
    assert {(c.holder, c.owner) for c in ours.map_copies} == {(c.holder, c.owner) for c in default.map_copies}
    assert ours.traffic["mapmerge"].wire_bytes < 0.05 * default.traffic["mapmerge"].wire_bytes
    assert sum(c.points for c in ours.map_copies) >= 30 * sum(c.keyframes for c in ours.map_copies)
    # Half a per cent of the distance (merge.point_error), 10 m at the median here, and as much for poses.
    assert max(c.points_off_m for c in ours.map_copies) < 0.1
    events = [json.loads(line) for line in (tmp_path / "ours" / "events.jsonl").read_text().splitlines()]
    last = [e for e in events if e["event"] == "map_checked" and e["final"]]
    assert {(e["agent"], e["owner"]) for e in last} == {(c.holder, c.owner) for c in ours.map_copies}
    assert max(e["worst_off"] for e in last) < 2.0


def test_the_table_and_the_report_tell_skipped_candidates_apart(played: tuple[Path, Summary]) -> None:
    out, summary = played
    lines = [line.split(None, 1) for line in table_of(out).splitlines() if line.startswith("  ")]
    told = {line[0]: line[1] for line in lines if line[0] in ("rejected", "skipped")}
    for kind in ("rejected", "skipped"):
        counts = getattr(summary.matches, kind)
        assert told.get(kind, "") == ", ".join(f"{reason} {count}" for reason, count in sorted(counts.items()))
    page = next(s.body for s in sections(read_run(out)) if s.title == "Candidate matches and their outcome")
    assert page.count('class="outcome skipped">skipped<') == sum(summary.matches.skipped.values())


def test_what_a_run_takes_is_told_without_compiling(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    play = simulation._play

    def compiling_first(*arguments: Any) -> int:
        event.start_event("numba:compile")
        time.sleep(0.5)
        event.end_event("numba:compile")
        return play(*arguments)

    monkeypatch.setattr(simulation, "_play", compiling_first)
    manifest, sequences = town(2, 6, spacing_m=14.0)
    began = time.perf_counter()
    run(manifest, sequences, SYSTEM, tmp_path / "run")
    timing = json.loads((tmp_path / "run" / "timing.json").read_text(encoding="utf-8"))
    assert 0.0 < timing["wall_s"] < time.perf_counter() - began - 0.49
