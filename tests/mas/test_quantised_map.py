"""What of a map is sold, how exactly, and in how few bits."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from map_driver import driver, see

from maslam.backend.geometry import Sim3, rotation_angle_deg, se3_exp, se3_inverse
from maslam.mas.map_exchange.coding.point_selection import well_spread
from maslam.mas.map_exchange.coding.quantised_map import Steps, poses_of, quantised, quantised_match, size
from maslam.mas.map_exchange.coding.rice import BitReader, BitWriter, CodingError
from maslam.mas.map_exchange.publisher import Publisher
from maslam.mas.protocol.ids import MatchId

# -- numbers in bits --------------------------------------------------------------------------------------------------


@given(st.lists(st.tuples(st.integers(0, 2**32 - 1), st.integers(0, 31)), max_size=60))
@settings(max_examples=100, deadline=None)
def test_numbers_come_back(pairs: list[tuple[int, int]]) -> None:
    writer = BitWriter()
    writer.put([v for v, _ in pairs], [c for _, c in pairs])
    reader = BitReader(writer.data)
    assert reader.get([c for _, c in pairs]).tolist() == [v for v, _ in pairs]
    reader.end()


def test_bits_that_end_too_early_are_an_error() -> None:
    writer = BitWriter()
    writer.put_signed([-5, 1000, 3], 0)
    with pytest.raises(CodingError):
        BitReader(writer.data[:-1]).get_signed(0, 3)
    with pytest.raises(CodingError):
        BitReader(writer.data).get(0, 10**9)


def test_numbers_of_a_geometric_law_take_little_more_than_their_entropy() -> None:
    p = 1 / 230
    values = np.random.default_rng(0).geometric(p, 5000) - 1
    entropy = -(p * np.log2(p) + (1 - p) * np.log2(1 - p)) / p
    writer = BitWriter()
    writer.put(values, 0)
    assert entropy < 8 * len(writer.data) / len(values) < entropy + 0.5


# -- what the lattice loses -------------------------------------------------------------------------------------------


def test_points_and_poses_are_as_exact_as_the_settings_say() -> None:
    state, keyframes = driver(20)
    see(state, keyframes, 20)
    stock = Publisher(state).latest(closing=False)
    assert stock is not None
    copy, config = stock.map, state.config.merge
    apart, away = [], []
    for row, keyframe in enumerate(keyframes):
        for point in copy.points_C()[copy.references == row]:
            nearest = np.linalg.norm(keyframe.points_C - point, axis=1).min()
            apart.append(nearest / np.linalg.norm(point))
            away.append(np.linalg.norm(point))
    assert len(apart) >= 30 * 20
    assert np.median(apart) <= config.point_error
    assert np.max(apart) <= 2.0 * config.point_error, "half the diagonal of a cell, sqrt(3) of half its step"
    off = se3_inverse(np.array(state.poses)) @ copy.poses_F()
    depth = np.median([k.depth for k in keyframes])
    assert np.linalg.norm(off[:, :3, 3], axis=1).max() <= config.pose_error * depth
    assert np.radians(rotation_angle_deg(off[:, :3, :3]).max()) <= config.pose_error


def test_a_key_frame_with_thirty_points_takes_less_than_a_hundred_bytes() -> None:
    state, keyframes = driver()
    see(state, keyframes, 40)
    stock = Publisher(state).latest(closing=False)
    assert stock is not None
    assert stock.map.counts.min() >= 30
    assert len(stock.whole.bits) < 100 * 40


def test_poses_and_matches_survive_any_rotation() -> None:
    rng = np.random.default_rng(1)
    steps = Steps.of(0.005, 0.001, 10.0)
    poses = se3_exp(np.concatenate([rng.normal(0, 50, (50, 3)), rng.normal(0, 2, (50, 3))], axis=1))
    back = poses_of(quantised(poses, steps), steps)
    assert np.abs(back[:, :3, 3] - poses[:, :3, 3]).max() <= 0.5 * size(steps.position) + 1e-9
    assert np.radians(rotation_angle_deg(np.swapaxes(back[:, :3, :3], 1, 2) @ poses[:, :3, :3]).max()) < 0.001
    T = Sim3(poses[0, :3, :3], poses[0, :3, 3], 1.7)
    ids, rows = np.array([[3, 1, 9]]), quantised_match(T, steps)[None]
    state, keyframes = driver(3)
    see(state, keyframes, 3)
    stock = Publisher(state).latest(closing=False)
    assert stock is not None
    reported = replace(stock.map, steps=steps, matches=ids, transforms=rows).reported_matches()[0]
    assert reported.id == MatchId(0, 3, 1, 9)
    np.testing.assert_allclose(reported.T_M_Q.matrix(), T.matrix(), rtol=2e-3, atol=0.02)


def test_the_points_sold_are_near_ones_from_all_over_the_image() -> None:
    rng = np.random.default_rng(2)
    z = rng.uniform(2.0, 40.0, 500)
    points = np.column_stack([rng.uniform(-1, 1, 500) * z, rng.uniform(-0.5, 0.5, 500) * z, z])
    chosen = well_spread(points, np.arange(500), 36)
    assert len(np.unique(chosen)) == 36
    assert np.median(z[chosen]) < 0.5 * np.median(z)
    direction = points[chosen, :2] / points[chosen, 2:]
    for side in (direction[:, 0] > 0, direction[:, 1] > 0):
        assert 12 <= side.sum() <= 24
    assert well_spread(points, np.array([5, 3]), 36).tolist() == [3, 5]
