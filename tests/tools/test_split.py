"""Sharing one sequence out to agents, against blocks and indices worked out by hand."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from maslam.backend.geometry import se3_exp, transform_points
from maslam.frontend.files.point_views import PointViews
from maslam.frontend.files.vo_files import VoTrack
from maslam.tools import cli
from maslam.tools.common.errors import UsageError
from maslam.tools.pipeline.split import cut_track, cut_views, share_out

EVERY_THIRD = [np.arange(0, 30, 3)]  # key-frames 0, 3, ... 27 of 30 frames


def test_blocks_are_equal_and_the_last_may_be_shorter() -> None:
    shares = share_out(10, [np.arange(10)], agents=3, overlap=0)
    assert [(s.first, s.last) for s in shares] == [(0, 3), (4, 7), (8, 9)]


def test_overlap_counts_keyframes_of_both_neighbours() -> None:
    shares = share_out(30, EVERY_THIRD, agents=3, overlap=2)
    # Blocks 0-9, 10-19, 20-29 hold key-frames 0 3 6 9 | 12 15 18 | 21 24 27; two more on each inner side.
    assert [(s.first, s.last) for s in shares] == [(0, 15), (6, 24), (15, 29)]
    assert [EVERY_THIRD[0][s.keyframes[0]].tolist() for s in shares] == [
        [0, 3, 6, 9, 12, 15],
        [6, 9, 12, 15, 18, 21, 24],
        [15, 18, 21, 24, 27],
    ]


def test_overlap_stops_at_the_ends() -> None:
    shares = share_out(30, EVERY_THIRD, agents=2, overlap=100)
    assert [(s.first, s.last) for s in shares] == [(0, 27), (0, 29)]


def test_a_lost_track_belongs_to_whoever_saw_it() -> None:
    shares = share_out(20, [np.array([0, 4, 8]), np.array([13, 17])], agents=2, overlap=0)
    assert [s.keyframes for s in shares] == [(slice(0, 3), slice(0, 0)), (slice(3, 3), slice(0, 2))]


def test_overlap_reaches_over_a_gap_between_tracks() -> None:
    shares = share_out(20, [np.array([0, 4, 8]), np.array([13, 17])], agents=2, overlap=1)
    assert [s.keyframes for s in shares] == [(slice(0, 3), slice(0, 1)), (slice(2, 3), slice(0, 2))]


def test_a_block_in_which_nothing_was_tracked_has_no_keyframes() -> None:
    shares = share_out(20, [np.array([0, 4, 8])], agents=2, overlap=3)
    assert shares[1].keyframes == (slice(3, 3),)


def test_where_equal_blocks_leave_none_for_the_last_they_differ_by_one() -> None:
    shares = share_out(9, [np.arange(9)], agents=6, overlap=0)
    assert [s.last - s.first + 1 for s in shares] == [1, 2, 1, 2, 1, 2]
    many = share_out(4541, [np.arange(4541)], agents=100, overlap=0)
    assert {s.last - s.first + 1 for s in many} == {45, 46}
    assert (many[0].first, many[-1].last) == (0, 4540)


def test_too_many_agents_is_a_usage_error() -> None:
    with pytest.raises(UsageError, match="--agents 4: the sequence has 3 frames"):
        share_out(3, [np.arange(3)], 4, overlap=0)


@pytest.mark.parametrize("agents", [0, -1])
def test_an_agent_at_least_is_needed(agents: int) -> None:
    with pytest.raises(UsageError, match=f"--agents {agents}: at least 1 is needed"):
        share_out(5, [np.arange(5)], agents, overlap=0)


@pytest.mark.parametrize("command", ["preprocess", "slam", "pgo"])
@pytest.mark.parametrize("agents", [0, -1])
def test_the_command_says_so_of_its_option(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], command: str, agents: int
) -> None:
    assert cli.main([command, str(tmp_path / "none"), str(tmp_path / "out"), "--agents", str(agents)]) == 2
    said = capsys.readouterr().err
    assert f"--agents: at least 1, not {agents}" in said and not (tmp_path / "out").exists()


def test_cut_track_renumbers_points_and_moves_the_origin() -> None:
    rng = np.random.default_rng(3)
    poses = se3_exp(rng.normal(size=(4, 6)))
    points = rng.normal(size=(5, 3))
    observations = np.array([[0, 0], [0, 3], [1, 1], [1, 4], [2, 1], [2, 2], [3, 0]], dtype=np.int32)
    descriptors = rng.integers(0, 256, size=(7, 32), dtype=np.uint8)
    words = rng.integers(0, 9999, size=(7, 2)).astype(np.int32)
    track = VoTrack(np.arange(4) + 100.0, poses, points, observations, descriptors, words)

    part = cut_track(track, slice(1, 3), np.array([0.0, 1.0]))

    # Key-frames 1 and 2 observe points 1, 4, 1, 2: renumbered in order 1 -> 0, 2 -> 1, 4 -> 2.
    np.testing.assert_array_equal(part.observations, [[0, 0], [0, 2], [1, 0], [1, 1]])
    np.testing.assert_array_equal(part.descriptors, descriptors[2:6])
    np.testing.assert_array_equal(part.words, words[2:6])
    np.testing.assert_allclose(part.poses[0], np.eye(4), atol=1e-12)
    np.testing.assert_allclose(poses[1] @ part.poses[1], poses[2], atol=1e-12)
    np.testing.assert_allclose(transform_points(poses[1], part.points), points[[1, 2, 4]], atol=1e-12)
    np.testing.assert_array_equal(part.stamps_s, [0.0, 1.0])
    # Key-frame 2 shows point 4 too, which odometry has not looked for; key-frame 1 shows point 3, which is not theirs.
    more = np.array([[0, 0], [1, 1], [1, 3], [1, 4], [2, 1], [2, 2], [2, 4], [3, 0]], dtype=np.int32)
    views = PointViews(more, np.arange(16, dtype=np.float32).reshape(8, 2))
    cut = cut_views(views, track, slice(1, 3))
    np.testing.assert_array_equal(cut.observations, [[0, 0], [0, 2], [1, 0], [1, 1], [1, 2]])
    np.testing.assert_array_equal(cut.uv, views.uv[[1, 3, 4, 5, 6]])
