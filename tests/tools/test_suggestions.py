"""The nearest known names to a wrong one."""

from __future__ import annotations

import pytest

from maslam._suggestions import did_you_mean, nearest

OPTIONS = ("--agents", "--rig", "--odometry.keyframes.min-flow", "--odometry.mono.min-flow-px", "--relpose.min-inliers")


@pytest.mark.parametrize(
    ("wrong", "first"),
    [
        ("--agnets", "--agents"),
        ("--odometry.keyframe.min-flow", "--odometry.keyframes.min-flow"),
        ("--min-inliers", "--relpose.min-inliers"),
        ("--relpos.min-inlier", "--relpose.min-inliers"),
        ("--keyframes.min-flow", "--odometry.keyframes.min-flow"),
        ("--min-flow", "--odometry.keyframes.min-flow"),
    ],
)
def test_the_nearest_name_comes_first(wrong: str, first: str) -> None:
    assert nearest(wrong, OPTIONS)[0] == first


def test_nothing_is_near_to_nonsense() -> None:
    assert nearest("--xyzzy", OPTIONS) == []


def test_three_names_at_most() -> None:
    assert len(nearest("--seed", [f"--part{k}.seed" for k in range(9)])) == 3


def test_the_words() -> None:
    assert did_you_mean("defualt", ["default", "maslam"]) == "; did you mean 'default'?"
    assert did_you_mean("zzz", ["default", "maslam"]) == "; there are default, maslam"
    assert did_you_mean("zzz", [f"name{k}" for k in range(50)], "; see the list") == "; see the list"
