"""RelPose by the query's directions: depths that are wrong or unknown do no harm; wrong places are refused still."""

from dataclasses import replace

import numpy as np
import pytest
from scenes import LOOK_ALIKES, look_alikes, pair, random_descriptors

from maslam.backend.config import RelPoseConfig
from maslam.backend.errors import BackendError
from maslam.backend.geometry import rotation_angle_deg, se3_exp, se3_inverse, se3_log, transform_points
from maslam.backend.relpose.verification import PlaceView, joined, relative_pose

PNP, POINTS = RelPoseConfig(solver="pnp"), RelPoseConfig()


def judge(query, match, seed=0, config=PNP):
    return relative_pose(query, match, config, np.random.default_rng(seed))


def errors(verdict, truth):
    """Metres of the match's unit, and degrees."""
    T = verdict.T_M_Q
    metres = float(np.linalg.norm(T.translation - truth.translation))
    return metres, float(rotation_angle_deg(T.rotation.T @ truth.rotation))


def wrong_depths(view, rng):
    """Each depth off by a factor of its own, 0.5 to 0.66 or 1.5 to 2: none is right."""
    shape = (len(view.points_C), 1)
    return replace(view, points_C=view.points_C * 2.0 ** (rng.choice([-1, 1], shape) * rng.uniform(0.6, 1.0, shape)))


def half_without_depth(view, rng):
    known = rng.random(len(view.points_C)) < 0.5
    rays = view.points_C / np.linalg.norm(view.points_C, axis=1, keepdims=True)
    return replace(view, points_C=np.where(known[:, None], view.points_C, rays), depth_known=known)


def normalised(verdict, truth):
    xi = se3_log(se3_inverse(verdict.T_M_Q.se3()) @ truth.se3())
    return float(xi @ verdict.information @ xi)


@pytest.mark.parametrize("outliers", [0.0, 0.5, 0.8])
def test_wrong_depths_of_the_query_do_no_harm(outliers):
    for seed in range(12):
        rng = np.random.default_rng(seed)
        query, match, truth = pair(rng, outliers=outliers)
        query = wrong_depths(query, rng)
        verdict, other = judge(query, match, seed), judge(query, match, seed, POINTS)
        assert verdict.accepted, verdict.reason
        assert verdict.T_M_Q.scale == 1.0
        metres, degrees = errors(verdict, truth)
        assert metres < 0.05 and degrees < 0.3
        # The other solver refuses, or is wrong: the depths are what it goes by.
        assert not other.accepted or errors(other, truth)[0] > 0.05


def test_rows_without_depth_take_part():
    for seed in range(8):
        rng = np.random.default_rng(seed)
        whole, match, truth = pair(rng, outliers=0.5)
        query = half_without_depth(whole, rng)
        verdict, full = judge(query, match, seed), judge(whole, match, seed)
        assert verdict.accepted, verdict.reason
        metres, degrees = errors(verdict, truth)
        assert metres < 0.05 and degrees < 0.3
        assert verdict.guided == full.guided and verdict.inliers == full.inliers
        # Points to points goes on with the others alone.
        left, alone = judge(query, match, seed, POINTS), judge(query.with_depth(), match, seed, POINTS)
        assert left.matches < 0.7 * full.matches and left.reason == alone.reason
        assert np.array_equal(left.T_M_Q.matrix(), alone.T_M_Q.matrix())


def test_no_depth_at_all():
    query, match, truth = pair(np.random.default_rng(1), outliers=0.5)
    rays = query.points_C / np.linalg.norm(query.points_C, axis=1, keepdims=True)
    blind = replace(query, points_C=rays, depth_known=np.zeros(len(rays), dtype=bool))
    verdict = judge(blind, match)
    assert verdict.accepted and errors(verdict, truth)[0] < 0.05
    monocular = judge(replace(blind, metric=False), match)
    assert not monocular.accepted and monocular.reason == "no scale: 0 matches have a depth in the query < 6"
    assert judge(blind, match, config=POINTS).reason == "too few matches: 0 < 8"


@pytest.mark.parametrize("scale", [0.3, 2.5])
def test_monocular_pairs_take_their_scale_from_the_depths_known(scale):
    squared = []
    for seed in range(20):
        rng = np.random.default_rng(seed)
        query, match, truth = pair(rng, outliers=0.3, scale=scale, metric=False)
        verdict = judge(half_without_depth(query, rng), match, seed)
        assert verdict.accepted, verdict.reason
        metres, degrees = errors(verdict, truth)
        assert metres < 0.05 and degrees < 0.3 and abs(verdict.T_M_Q.scale / scale - 1.0) < 0.03
        squared.append((np.log(verdict.T_M_Q.scale / scale) / verdict.scale_sigma) ** 2)
        assert verdict.full_information.shape == (7, 7) and np.linalg.eigvalsh(verdict.information)[0] > 0
    # Chi square with one degree of freedom: mean 1, of 20 within 3 sigma 0.95; some modesty is allowed.
    assert 0.1 < np.mean(squared) < 1.95


@pytest.mark.parametrize("metric", [True, False])
@pytest.mark.parametrize("kind", LOOK_ALIKES)
def test_look_alikes_are_refused(kind, metric):
    for seed in range(12):
        query, match = look_alikes(kind, np.random.default_rng(seed), metric)
        verdict = judge(query, match, seed)
        assert not verdict.accepted and verdict.matches > 200
        assert verdict.kind in ("too few inliers", "ambiguous", "contradicted", "no scale")


def test_depths_that_proved_right_are_evidence():
    """Things before the street that only the query has float, if its depths can be told to be right."""
    rng = np.random.default_rng(4)
    query, match, _ = pair(rng, xi=np.array([0.5, 0.0, 1.0, 0.0, 0.05, 0.0]))
    rays = np.column_stack([rng.uniform(-0.6, 0.6, 300), rng.uniform(-0.3, 0.3, 300), np.ones(300)])
    with_things = joined(query, PlaceView(2.0 * rays, random_descriptors(rng, 300)))
    blind = replace(with_things, depth_known=np.zeros(len(with_things.points_C), dtype=bool))
    sound, wrong, none = (judge(view, match) for view in (with_things, wrong_depths(with_things, rng), blind))
    assert sound.evidence.floating > 0.15 > 0.05 > wrong.evidence.floating
    assert wrong.evidence == none.evidence
    assert not sound.accepted and sound.kind == "contradicted"


def test_a_wall_alone_is_no_place():
    rng = np.random.default_rng(2)
    wall = np.column_stack([rng.uniform(-3, 3, 200), rng.uniform(-1, 1, 200), np.full(200, 4.0)])
    paper = random_descriptors(rng, 200)
    assert judge(PlaceView(wall, paper), PlaceView(wall + 0.01, paper)).kind == "ambiguous"


def test_the_same_seed_gives_the_same_verdict():
    query, match, _ = pair(np.random.default_rng(3), outliers=0.7)
    a, b = judge(query, match, 5), judge(query, match, 5)
    assert np.array_equal(a.T_M_Q.matrix(), b.T_M_Q.matrix()) and np.array_equal(a.information, b.information)
    assert (a.matches, a.inliers, a.rmse, a.log_odds) == (b.matches, b.inliers, b.rmse, b.log_odds)


def test_the_uncertainty_is_honest():
    squared = []
    for seed in range(40):
        query, match, truth = pair(np.random.default_rng(seed), outliers=0.3)
        squared.append(normalised(judge(query, match, seed), truth))
    # Chi square with 6 degrees of freedom has median 5.35, which over 6 is 0.89, and of 40 samples lies within 0.29
    # (3 sigma). The information is lowered by 1.45 for points of one surface, whose errors go together; here they do
    # not, so 0.61 is expected.
    assert abs(np.median(squared) / 6.0 - 0.61) < 0.29


def test_both_solvers_agree_on_clean_data():
    for seed in range(12):
        query, match, _ = pair(np.random.default_rng(seed))
        a, b = judge(query, match, seed), judge(query, match, seed, POINTS)
        xi = se3_log(se3_inverse(a.T_M_Q.se3()) @ b.T_M_Q.se3())
        sum_of_both = np.linalg.inv(a.information) + np.linalg.inv(b.information)
        assert xi @ np.linalg.solve(sum_of_both, xi) < 12.6  # 95 % of chi square with 6 degrees of freedom


def test_exact_directions_give_the_exact_pose():
    rng = np.random.default_rng(0)
    T = se3_exp([0.7, -0.2, 1.5, 0.02, 0.15, -0.03])
    points = rng.uniform([-6, -3, 5], [6, 3, 40], (200, 3))
    descriptors = random_descriptors(rng, 200)
    seen = wrong_depths(PlaceView(transform_points(se3_inverse(T), points), descriptors), rng)
    verdict = judge(seen, PlaceView(points, descriptors))
    assert verdict.accepted and verdict.guided == 200
    np.testing.assert_allclose(verdict.T_M_Q.se3(), T, atol=1e-7)


def test_flags_travel_with_the_rows():
    query, _, _ = pair(np.random.default_rng(0))
    half = half_without_depth(query, np.random.default_rng(1))
    both = joined(query, half)
    assert both.depth_known.tolist() == [True] * len(query.points_C) + half.depth_known.tolist()
    assert len(half.with_depth().points_C) == half.depth_known.sum() and query.with_depth() is query
    with pytest.raises(BackendError, match="flags"):
        replace(query, depth_known=np.ones(3, dtype=bool))
