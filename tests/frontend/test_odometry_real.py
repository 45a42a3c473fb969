"""Accuracy on real images, against their ground truth."""

from __future__ import annotations

import os
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from maslam.backend.geometry import umeyama
from maslam.frontend.config import OdometryConfig
from maslam.frontend.datasets import open_dataset
from maslam.frontend.odometry import Odometry, OdometryResult
from maslam.frontend.vocabulary.vocabulary import Vocabulary

DATA = Path(os.environ.get("MASLAM_DATA", Path(__file__).parents[3] / "shared" / "data"))
pytestmark = [pytest.mark.realdata, pytest.mark.slow]


def tracked(name: str, first: int = 0, last: int | None = None) -> tuple[OdometryResult, np.ndarray, np.ndarray]:
    """The result, with estimated and true camera centres ``(n, 3)`` of the first track's frames."""
    folder = DATA / name
    if not folder.is_dir():
        pytest.skip(f"{folder} is absent (MASLAM_DATA names the folder of the real data)")
    sequence = open_dataset(folder).sequences[0]
    odometry = Odometry(sequence.rig, OdometryConfig(), vocabulary())
    for i in range(first, len(sequence) if last is None else last):
        odometry.process(sequence.read(i))
    result = odometry.finish()
    truth = sequence.groundtruth
    if not result.tracks or truth is None:
        return result, np.zeros((0, 3)), np.zeros((0, 3))
    index = truth.nearest(result.trajectories[0].stamps_ns, 1_000_000)
    return result, result.trajectories[0].centres[index >= 0], truth.centres[index[index >= 0]]


@cache
def vocabulary() -> Vocabulary:
    return Vocabulary.load(None)


def ate_m(estimate: np.ndarray, truth: np.ndarray, with_scale: bool) -> float:
    error = umeyama(truth, estimate, with_scale) @ estimate - truth
    return float(np.sqrt((error**2).sum(axis=1).mean()))


def test_a_car_with_stereo_is_followed_to_centimetres() -> None:
    result, estimate, truth = tracked("kitti_stereo_1")
    assert len(result.tracks) == 1 and len(estimate) == 51 and not result.lost
    assert ate_m(estimate, truth, False) < 0.045
    # Rows of this pair differ by up to 1.5 pixels in the corners: its right camera looks 1.5 degrees inwards.
    assert 1.2 < result.stats["right_turn_y_deg"] < 1.9
    assert np.bincount(result.tracks[0].observations[:, 0]).min() > 100
    assert np.ptp(result.tracks[0].words[:, 1]) > 100


def test_a_car_with_one_camera_is_followed() -> None:
    result, estimate, truth = tracked("kitti00_first200")
    assert len(result.tracks) == 1 and len(estimate) >= 195
    assert ate_m(estimate, truth, True) < 0.5  # 0.2; 1.4 with the lens's residual distortion left in
    assert 0.005 < result.stats["lens_k1"] < 0.025


@pytest.mark.parametrize(("first", "last"), [(0, 160), (140, 300)])
def test_each_half_of_a_room_is_followed_with_rgbd(first: int, last: int) -> None:
    result, estimate, truth = tracked("redkitchen_first300", first, last)
    assert len(result.tracks) == 1 and len(estimate) == last - first and not result.lost
    assert ate_m(estimate, truth, False) < 0.04  # 0.018 and 0.026; with depth taken as registered 0.023 and 0.041


def test_a_drone_that_stands_still_makes_no_map() -> None:
    result, _, _ = tracked("euroc_still")
    assert all(len(track) <= 2 for track in result.tracks)
    for trajectory in result.trajectories:
        assert np.linalg.norm(trajectory.centres - trajectory.centres[0], axis=1).max() < 0.01
