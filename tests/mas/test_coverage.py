"""Coverage: what was read, tracked, placed, lost; exploration counts what has a place; errors say what on."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from factory import circuit, make_sequence, make_world, manifest_of, town

from maslam.backend.geometry import umeyama
from maslam.frontend.files.trajectory import Trajectory, read_tum
from maslam.mas.evaluation.coverage import frames_held, frames_read
from maslam.mas.manifest import LeftOutEntry, LostEntry
from maslam.mas.policies.presets import preset
from maslam.mas.sequence import AgentSequence
from maslam.mas.simulation import run

DEFAULT = preset("default")


def cut_off(sequence: AgentSequence, read: int) -> AgentSequence:
    """The same with frames that were read and lost after those that were tracked."""
    tracked = len(sequence.trajectory)
    lost = (LostEntry(first_frame=tracked, last_frame=read - 1, reason="too dark"),)
    return replace(sequence, frames=read, lost=lost)


def test_a_run_that_placed_88_of_551_frames_has_not_explored_everything(tmp_path: Path) -> None:
    alone = [cut_off(make_sequence(make_world(3), circuit(0.0, 44.0), 3), 551)]
    assert len(alone[0].trajectory) == 88
    summary = run(manifest_of(alone), alone, DEFAULT, tmp_path / "run")
    (one,) = summary.coverage
    assert (one.read, one.tracked, one.placed, one.tracks, one.tracks_placed) == (551, 88, 88, 1, 1)
    assert [(g.first_frame, g.last_frame, g.reason) for g in one.lost] == [(88, 550, "too dark")]
    assert summary.exploration_percent == [pytest.approx(100 * 88 / 551)]
    assert summary.alignments is not None and summary.alignments.agents[0] is not None
    assert (summary.alignments.agents[0].kind, summary.alignments.agents[0].frames) == ("SE(3)", 88)


def test_tracked_frames_of_a_track_that_nothing_joins_are_not_placed(tmp_path: Path) -> None:
    way = np.concatenate([circuit(0.0, 30.0), circuit(90.0, 24.0)])
    alone = [make_sequence(make_world(3), way, 3, 0, cuts=(60,))]
    summary = run(manifest_of(alone), alone, DEFAULT, tmp_path / "run")
    (one,) = summary.coverage
    assert (one.read, one.tracked, one.placed, one.tracks, one.tracks_placed) == (108, 108, 60, 2, 1)
    assert summary.exploration_percent == [pytest.approx(100 * 60 / 108)]


def test_a_sequence_without_an_agent_counts_as_read(tmp_path: Path) -> None:
    alone = [make_sequence(make_world(3), circuit(0.0, 30.0), 3)]
    left_out = (LeftOutEntry(sequence="dark", frames=140, reason="too dark"),)
    manifest = manifest_of(alone).model_copy(update={"left_out": left_out})
    summary = run(manifest, alone, DEFAULT, tmp_path / "run")
    assert summary.left_out == list(left_out)
    assert summary.exploration_percent == [pytest.approx(100 * 60 / 200)]


def test_frames_that_two_agents_have_read_count_once() -> None:
    _, (one, two) = town(2, 6)
    shared = [replace(s, source="drive", first_frame=first) for s, first in ((one, 0), (two, 12))]
    assert [s.read for s in shared] == [18, 18] and frames_read(shared) == 30
    assert frames_read([one, two]) == 36


def test_a_copy_gives_a_place_to_what_lies_between_neighbours_that_it_holds_both_of() -> None:
    """Key-frames at each third frame; a track ends after frame 29."""
    sequence = make_sequence(make_world(3), circuit(0.0, 30.0), 3, 0, cuts=(30,))
    held = frames_held(sequence, np.array([0, 1, 3, 8, 9, 10, 11])) // 100_000_000
    expected = [0, 1, 2, 3, 9, 24, 25, 26, 27, 30, 31, 32, 33]  # 9 alone; nothing between 27 and 30: another track
    assert held.tolist() == expected
    assert len(frames_held(sequence, np.array([], dtype=np.int64))) == 0
    assert frames_held(sequence, np.array([99, -1, 2])).tolist() == [600_000_000]


def test_exploration_is_own_frames_and_those_of_copies(tmp_path: Path) -> None:
    """The figure against a count from the files: all own frames, and of each copy's key-frames and what is between."""
    manifest, sequences = town(2, 14, spacing_m=5.0)
    summary = run(manifest, sequences, DEFAULT, tmp_path / "run")
    assert summary.groups == [[0, 1]] and summary.map_copies
    for me, other in ((0, 1), (1, 0)):
        folder = tmp_path / "run" / f"agent_{me:02d}"
        own = len(read_tum(folder / "trajectory.tum"))
        copied = read_tum(folder / "maps" / f"agent_{other:02d}.tum").stamps_ns
        frames = round((copied[-1] - copied[0]) / 1e8) + 1  # consecutive key-frames, ten frames a second
        assert np.allclose(np.diff(copied), 3e8, atol=2e6)
        assert summary.exploration_percent[me] == pytest.approx(100 * (own + frames) / 84)


def test_errors_say_the_scale_of_their_alignment(tmp_path: Path) -> None:
    """One camera, half a unit a metre: each unit is worth about two metres."""
    sequences = [make_sequence(make_world(4), circuit(0.0, 36.0), 4, 0, scale=0.5)]
    truth = sequences[0].groundtruth
    assert truth is not None
    known = Trajectory(truth.stamps_ns[:50], truth.poses[:50])
    summary = run(manifest_of(sequences), [replace(sequences[0], groundtruth=known)], DEFAULT, tmp_path / "run")
    assert summary.alignments is not None
    found = summary.alignments.agents[0]
    assert found is not None and (found.kind, found.frames) == ("Sim(3)", 50)
    written = read_tum(tmp_path / "run" / "agent_00" / "trajectory.tum")
    assert found.scale == pytest.approx(umeyama(known.centres, written.centres[:50], True).scale, rel=1e-6)
    assert found.scale == pytest.approx(2.0, rel=0.05)


def test_how_far_points_of_copies_are_off_is_in_metres_or_unknown(tmp_path: Path) -> None:
    """One camera: the same run in units ten times as long is off by as many metres; without a truth nobody knows."""
    world, off = make_world(4), {}
    for unit, truth in ((1.0, True), (0.1, True), (1.0, False)):
        sequences = [
            make_sequence(world, circuit(6.0 * a, 36.0), 4, a, scale=(0.5 - 0.2 * a) * unit, with_truth=truth)
            for a in range(2)
        ]
        summary = run(manifest_of(sequences), sequences, DEFAULT, tmp_path / f"{unit}{truth}")
        assert summary.groups == [[0, 1]] and summary.map_copies
        off[unit, truth] = [copy.points_off_m for copy in summary.map_copies]
    assert set(off[1.0, False]) == {None}
    assert off[0.1, True] == pytest.approx(off[1.0, True], rel=0.5)
