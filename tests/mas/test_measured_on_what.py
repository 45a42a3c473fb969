"""Figures are about what was measured: the path of placed frames, matches whose truth is known."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from factory import circuit, make_sequence, make_world, manifest_of, town

from maslam.frontend.files.trajectory import Trajectory
from maslam.mas.policies.presets import preset
from maslam.mas.simulation import run


def test_the_path_is_that_of_the_frames_that_have_a_place(tmp_path: Path) -> None:
    """Frames 20 to 39 are lost: what was driven there is not measured, and not counted either."""
    alone = make_sequence(make_world(0), circuit(0.0, 40.0), 0, 0)
    raw, truth = alone.trajectory, alone.groundtruth
    assert truth is not None
    kept = np.r_[0:20, 40 : len(raw)]
    lossy = replace(alone, trajectory=Trajectory(raw.stamps_ns[kept], raw.poses[kept]))
    summary = run(manifest_of([lossy]), [lossy], preset("maslam"), tmp_path / "run")
    steps = np.linalg.norm(np.diff(truth.centres, axis=0), axis=1)
    assert summary.path_length_m[0] == pytest.approx(steps[:19].sum() + steps[40:].sum())
    whole = run(manifest_of([alone]), [alone], preset("maslam"), tmp_path / "whole")
    assert whole.path_length_m[0] == pytest.approx(steps.sum())


def test_matches_without_truth_are_not_said_to_be_right(tmp_path: Path) -> None:
    manifest, sequences = town(2, 30, spacing_m=10.0)
    blind = [sequences[0], replace(sequences[1], groundtruth=None)]
    summary = run(manifest, blind, preset("maslam"), tmp_path / "run")
    assert summary.matches.accepted > 0 and summary.matches.own_loops == 0
    assert summary.matches.false_accepted is None
