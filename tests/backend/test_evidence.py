"""What speaks for and against a pose, on scenes where it can be counted by hand."""

import numpy as np
import pytest
from scenes import Noise, observe, random_descriptors

from maslam.backend.config import RelPoseConfig
from maslam.backend.geometry import Sim3, se3_exp
from maslam.backend.relpose.evidence import weigh
from maslam.backend.relpose.matching import hamming_distances
from maslam.backend.relpose.verification import PlaceView, relative_pose

EXACT = Noise(pixel=0.0, disparity=0.0, bit_flip=0.05, unshared=0.0)
POSE = se3_exp([0.3, 0.0, 0.5, 0.0, 0.05, 0.0])


def wall(rng, count=1500, depth=12.0):
    """Points on a rough wall that fills the view."""
    z = depth + 0.3 * rng.normal(size=count)
    return np.column_stack([rng.uniform(-14, 14, count), rng.uniform(-8, 8, count), z])


def evidence(match, query, T=POSE):
    distances = hamming_distances(query.descriptors, match.descriptors)
    T_M_Q = Sim3(T[:3, :3], T[:3, 3], 1.0)
    return weigh(match.points_C, query.points_C, distances, T_M_Q, 0.5, 80, 0.002)


def views(points, descriptors, other_descriptors, rng, pose=POSE, other=None):
    match, _ = observe(points, descriptors, np.eye(4), EXACT, rng)
    query, _ = observe(points if other is None else other, other_descriptors, pose, EXACT, rng)
    return match, query


def test_one_place_is_repeated_alike_and_nowhere_deserted():
    rng = np.random.default_rng(0)
    points = wall(rng)
    d = random_descriptors(rng, len(points))
    e = evidence(*views(points, d, d, rng))
    assert e.alike > 0.95 and e.repeated > 0.9
    assert e.deserted < 0.05 and e.floating == 0.0


def test_half_a_view_of_other_texture_is_deserted():
    rng = np.random.default_rng(1)
    points = wall(rng)
    d = random_descriptors(rng, len(points))
    left = points[:, 0] < 0
    other = np.where(left[:, None], random_descriptors(rng, len(points)), d)
    e = evidence(*views(points, d, other, rng))
    # All that is seen of the left half; its border has right neighbours.
    assert 0.35 < e.deserted < 0.5
    assert 0.4 < e.alike < 0.6


def test_points_elsewhere_on_the_same_wall_meet_by_chance_only():
    rng = np.random.default_rng(2)
    d = random_descriptors(rng, 1500)
    e = evidence(*views(wall(rng), d, d, rng, other=wall(rng)))
    assert e.query.met > 100 and e.repeated < 0.05 and e.alike < 0.05


def test_a_cupboard_that_one_view_has_floats_before_the_wall_of_the_other():
    rng = np.random.default_rng(3)
    points = wall(rng)
    d = random_descriptors(rng, len(points))
    cupboard = np.column_stack([rng.uniform(-3, 3, 200), rng.uniform(-3, 3, 200), 9.0 + 0.1 * rng.normal(size=200)])
    behind = (np.abs(points[:, :2] * (9.0 / 12.0)) < 3.2).all(axis=1)
    both = np.concatenate([points[~behind], cupboard])
    e = evidence(*views(points, d, random_descriptors(rng, len(both)), rng, other=both))
    # A wall this sparse shows its depth in two directions of three; none of its own points floats.
    assert 0.05 < e.query.floating_share < 200 / len(both)
    assert e.floating == e.query.floating_share and e.match.floating_share == 0.0


@pytest.mark.parametrize("solver", ["points", "pnp"])
def test_a_room_that_shares_a_corner_with_another_is_refused(solver):
    """All matches of a quarter of the view are right; the rest of the rooms differs."""
    for seed in range(8):
        rng = np.random.default_rng(seed)
        points = wall(rng)
        points[:, 2] += 3.0 * (np.abs(points[:, 0]) % 4 < 2)
        d = random_descriptors(rng, len(points))
        equal = (points[:, 0] < -2) & (points[:, 1] < 1)
        other = np.where(equal[:, None], d, random_descriptors(rng, len(points)))
        elsewhere = np.where(equal[:, None], points, points + np.array([0.7, 0.4, 0.0]))
        noise = Noise()
        match, _ = observe(points, d, np.eye(4), noise, rng)
        query, _ = observe(elsewhere, other, POSE, noise, rng)
        verdict = relative_pose(query, match, RelPoseConfig(solver=solver), np.random.default_rng(seed))
        assert not verdict.accepted and verdict.kind == "contradicted", verdict.reason
        assert verdict.inliers > 40
        unweighed = RelPoseConfig(solver=solver, min_evidence=None, max_deserted=1.0)
        assert relative_pose(query, match, unweighed, np.random.default_rng(seed)).accepted


def test_words_alone_are_not_weighed_by_likeness():
    rng = np.random.default_rng(4)
    points = wall(rng)
    points[:, 2] += 3.0 * (np.abs(points[:, 0]) % 4 < 2)
    words = np.arange(len(points), dtype=np.int32)
    blank = np.zeros((len(points), 32), dtype=np.uint8)
    seen = []
    for pose in (POSE, np.eye(4)):
        view, rows = observe(points, blank, pose, Noise(), rng)
        seen.append(PlaceView(view.points_C, words=words[rows]))
    verdict = relative_pose(*seen, RelPoseConfig(), rng)
    assert verdict.accepted and verdict.log_odds is None
