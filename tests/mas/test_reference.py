"""The omniscient reference: better than odometry, and honest about what cannot be joined."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from factory import circuit, make_sequence, make_world, manifest_of, town

from maslam.backend.geometry import se3
from maslam.mas.policies.presets import preset
from maslam.mas.simulation import run
from maslam.tools.sweep.reference import make_reference


def test_one_server_does_better_than_odometry_and_no_worse_than_the_agents(tmp_path: Path) -> None:
    manifest, sequences = town(3, 60, drifting=0.03)
    config = preset("maslam")
    reference = make_reference(manifest, sequences, config)
    summary = run(manifest, sequences, config, tmp_path / "run")
    assert reference.mean_ate_m is not None and summary.odometry_mean_rmse_m is not None
    assert reference.mean_ate_m < 0.7 * summary.odometry_mean_rmse_m
    assert summary.ate_rmse_m.mean_agents is not None
    assert reference.mean_ate_m < 1.1 * summary.ate_rmse_m.mean_agents
    assert reference.groups == [[0, 1, 2]] and reference.false_matches == 0
    assert reference.keyframes == summary.keyframes
    assert all(s <= p + 1e-9 for s, p in zip(summary.exploration_percent, reference.exploration_percent, strict=True))


def test_one_camera_each_is_solved_with_its_unit(tmp_path: Path) -> None:
    world = make_world(2)
    ways = [circuit(12.0 * k, 90.0, side_m=30.0, radius_m=6.0) for k in range(3)]
    sequences = [
        make_sequence(world, way, 2, k, scale=(0.7, 1.9, 1.2)[k], drifting=0.01, unit_drift=0.001)
        for k, way in enumerate(ways)
    ]
    config = preset("maslam")
    reference = make_reference(manifest_of(sequences), sequences, config)
    summary = run(manifest_of(sequences), sequences, config, tmp_path / "run")
    assert reference.groups == [[0, 1, 2]] and reference.false_matches == 0
    assert reference.mean_ate_m is not None and summary.odometry_mean_rmse_m is not None
    assert reference.mean_ate_m < 0.7 * summary.odometry_mean_rmse_m
    assert summary.ate_rmse_m.mean_agents is not None
    assert reference.mean_ate_m < 1.1 * summary.ate_rmse_m.mean_agents


def test_agents_that_never_meet_stay_apart() -> None:
    world = make_world(1)
    near = [make_sequence(world, circuit(12.0 * k, 40.0), 1, k) for k in range(2)]
    far = make_sequence(make_world(2), np.array([se3(np.eye(3), [40.0, 0, 0]) @ T for T in circuit(0.0, 40.0)]), 1, 2)
    reference = make_reference(manifest_of([*near, far]), [*near, far], preset("maslam"))
    assert reference.groups == [[0, 1], [2]]
    frames = [len(s.trajectory) for s in (*near, far)]
    expected = [100 * (frames[0] + frames[1]) / sum(frames)] * 2 + [100 * frames[2] / sum(frames)]
    np.testing.assert_allclose(reference.exploration_percent, expected)


def test_bytes_are_those_of_key_frames_sent_once() -> None:
    manifest, sequences = town(2, 8)
    config = preset("maslam")
    reference = make_reference(manifest, sequences, config)
    expected = 0
    for sequence in sequences:
        for track in sequence.tracks:
            for k in range(len(track)):
                points = int((track.observations[:, 0] == k).sum())
                expected += 4 * sequence.places.vectors.shape[1] + 44 * min(points, config.places.max_points) + 2 * 48
    assert reference.bytes == expected
