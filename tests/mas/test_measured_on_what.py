"""Figures are about what was measured: the path of placed frames, matches whose truth is known."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from factory import circuit, make_sequence, make_world, manifest_of, town
from test_sequence import write

from maslam.backend.geometry import umeyama
from maslam.frontend.files.trajectory import Trajectory
from maslam.mas.evaluation.ground_truth import _error, _Positions
from maslam.mas.policies.presets import preset
from maslam.mas.simulation import run
from maslam.tools import cli


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


def test_odometry_and_agents_are_measured_on_the_same_frames(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Two tracks that an own loop joins: odometry's error is of the frames of both, each laid on the truth by itself;
    here computed anew from the input."""
    way = np.concatenate([circuit(0.0, 30.0), circuit(6.0, 45.0)])
    alone = make_sequence(make_world(3), way, 3, 0, cuts=(60,))
    raw, truth = alone.trajectory, alone.groundtruth
    assert truth is not None
    (tmp_path / "seqs").mkdir()
    write(tmp_path / "seqs", [alone])
    assert cli.main(["run", str(tmp_path / "seqs"), str(tmp_path / "run"), "--preset", "default", "--quiet"]) == 0
    summary = json.loads((tmp_path / "run" / "summary.json").read_text())
    squares = []
    for frames in (slice(0, 60), slice(60, 150)):
        T = umeyama(truth.centres[frames], raw.centres[frames], False)
        squares.append(((T @ raw.centres[frames] - truth.centres[frames]) ** 2).sum(axis=1))
    assert summary["odometry_rmse_m"] == [pytest.approx(np.sqrt(np.concatenate(squares).mean()), rel=1e-3)]
    (odometry,), (own,) = (summary["alignments"][key] for key in ("odometry", "agents"))
    assert odometry["frames"] == own["frames"] == 150 and odometry["tracks"] == 2
    console = capsys.readouterr().out
    assert "errors measured on 150 of 150 frames read, after SE(3) alignment" in console
    assert "odometry on the same frames, after SE(3) alignment of each track by itself" in console
    assert "maps held on 50 key-frames" in console and "connected on 50 key-frames" in console
    assert cli.main(["report", str(tmp_path / "run")]) == 0
    page = (tmp_path / "run" / "report" / "index.html").read_text()
    assert "odometry on the same frames, after SE(3) alignment of each track by itself" in page


def test_tracks_without_a_place_count_for_neither(tmp_path: Path) -> None:
    """Of 108 frames the second track's 48 have no place."""
    alone = make_sequence(make_world(3), np.concatenate([circuit(0.0, 30.0), circuit(90.0, 24.0)]), 3, 0, cuts=(60,))
    summary = run(manifest_of([alone]), [alone], preset("default"), tmp_path / "run")
    assert summary.alignments is not None
    (odometry,), (own,) = summary.alignments.odometry, summary.alignments.agents
    assert odometry is not None and own is not None and odometry.frames == own.frames == 60 and odometry.tracks == 1


def test_a_camera_that_stands_has_no_error_under_a_similarity() -> None:
    """A scale of 0 would fit any track to it."""
    rng = np.random.default_rng(0)
    stands = _Positions(rng.normal(size=(20, 3)), np.tile([1.0, 2.0, 3.0], (20, 1)))
    assert _error(stands, with_scale=True) is None
    found = _error(stands, with_scale=False)
    assert found is not None and found.rmse_m > 1.0
