"""The directory: each key-frame travels once, and the agents live on without it."""

from __future__ import annotations

import csv
from pathlib import Path

from factory import circuit, make_sequence, make_world, manifest_of, town
from saboteurs import live

from maslam.mas.config import FaultsConfig
from maslam.mas.evaluation.ground_truth import groups_of
from maslam.mas.policies.presets import preset
from maslam.mas.protocol.accounting import Traffic
from maslam.mas.simulation import run


def test_each_key_frame_is_told_once_and_to_one_agent(tmp_path: Path) -> None:
    manifest, sequences = town(4, 24, spacing_m=12.0, drifting=0.03)
    summary = run(manifest, sequences, preset("maslam"), tmp_path / "run")
    with open(tmp_path / "run" / "traffic.csv", newline="") as file:
        queries = [r for r in csv.DictReader(file) if r["kind"] == "OwnerQuery"]
    assert {r["recipient"] for r in queries} == {"0"}, "the lowest that answers"
    assert len(queries) == sum(len(s.keyframe_stamps_ns) for s in sequences[1:]), "agent 0 needs no message"
    assert summary.groups == [[0, 1, 2, 3]] and summary.matches.false_accepted == 0


def test_bytes_of_place_recognition_grow_with_key_frames_not_with_agents_squared() -> None:
    each = {}
    for agents in (3, 6):
        manifest, sequences = town(agents, 20, spacing_m=10.0, drifting=0.03)
        environment, _ = live(manifest, sequences, preset("maslam"))
        count = environment.transport.by_operation[Traffic.DVPR]
        each[agents] = count.wire_bytes / sum(len(s.keyframe_stamps_ns) for s in sequences[1:])
    assert each[6] < 1.1 * each[3]


def test_where_the_directory_leaves_the_next_one_takes_over() -> None:
    manifest, sequences = town(4, 40, spacing_m=12.0, drifting=0.03)
    config = preset("maslam").model_copy(update={"faults": FaultsConfig.model_validate({"leave_s": {0: 2.0}})})
    environment, evaluator = live(manifest, sequences, config)
    assert any({1, 2, 3} <= set(group) for group in groups_of(environment.agents))
    errors = evaluator.connected_errors(environment.agents)
    assert max(errors[a].rmse_m for a in (1, 2, 3)) < 1.0
    assert not any(environment.agents[a].context.ledger.running() for a in (1, 2, 3))


def test_agents_with_one_camera_each_find_their_common_unit(tmp_path: Path) -> None:
    """An elected solver knows one unit of length; members with units of their own agree in rounds instead."""
    world = make_world(0)
    sequences = [make_sequence(world, circuit(12.0 * a, 45.0), 0, a, scale=(0.5, 2.0, 1.3)[a]) for a in range(3)]
    summary = run(manifest_of(sequences), sequences, preset("maslam"), tmp_path / "run")
    assert summary.scale == "arbitrary" and summary.groups == [[0, 1, 2]] and summary.matches.false_accepted == 0
    connected = [e for e in summary.ate_rmse_m.connected if e is not None]
    assert len(connected) == 3 and max(connected) < 0.6
