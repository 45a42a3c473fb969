"""RelPose on scenes whose truth is known: true pairs are found, look-alikes are not, and every refusal says why."""

import numpy as np
import pytest
from scenes import LOOK_ALIKES, Noise, look_alikes, observe, pair, random_descriptors, street

from maslam._replaced import replaced
from maslam.backend.config import RelPoseConfig
from maslam.backend.errors import BackendError
from maslam.backend.geometry import rotation_angle_deg, se3_exp, se3_inverse, se3_log
from maslam.backend.relpose.alignment import _damped_step, _median
from maslam.backend.relpose.matching import hamming_distances, mutual_matches, unique_word_matches
from maslam.backend.relpose.verification import PlaceView, relative_pose

CONFIG = RelPoseConfig()


def judge(query, match, seed=0, config=CONFIG):
    return relative_pose(query, match, config, np.random.default_rng(seed))


def errors(verdict, truth):
    """Metres of the match's unit, degrees, and the scale's share."""
    T = verdict.T_M_Q
    return (
        float(np.linalg.norm(T.translation - truth.translation)),
        float(rotation_angle_deg(T.rotation.T @ truth.rotation)),
        abs(T.scale / truth.scale - 1.0),
    )


@pytest.mark.parametrize("outliers", [0.0, 0.5, 0.8])
def test_true_pairs_are_found_with_small_error(outliers):
    found = []
    for seed in range(12):
        query, match, truth = pair(np.random.default_rng(seed), outliers=outliers)
        verdict = judge(query, match, seed)
        assert verdict.accepted, verdict.reason
        assert verdict.T_M_Q.scale == 1.0
        found.append(errors(verdict, truth))
    metres, degrees, _ = np.median(found, axis=0)
    assert metres < 0.02 and degrees < 0.05
    assert np.max(found, axis=0)[0] < 0.1


@pytest.mark.parametrize("scale", [0.3, 2.5])
def test_monocular_pairs_bring_their_scale(scale):
    for seed in range(6):
        query, match, truth = pair(np.random.default_rng(seed), outliers=0.5, scale=scale, metric=False)
        verdict = judge(query, match, seed)
        assert verdict.accepted, verdict.reason
        metres, degrees, relative = errors(verdict, truth)
        assert metres < 0.1 and degrees < 0.2 and relative < 0.03


def test_the_direction_of_the_result():
    # The query camera stands 2 m right of the match camera and looks 5 degrees further right; exp bends the way there.
    query, match, _ = pair(np.random.default_rng(0), xi=np.array([2.0, 0, 0, 0, np.radians(5.0), 0]))
    T = judge(query, match).T_M_Q
    np.testing.assert_allclose(T.translation, [2.0, 0.0, -0.087], atol=0.05)
    np.testing.assert_allclose(T.rotation[:, 2], [np.sin(np.radians(5)), 0, np.cos(np.radians(5))], atol=2e-3)


def test_the_uncertainty_is_honest():
    squared = []
    for seed in range(40):
        query, match, truth = pair(np.random.default_rng(seed), outliers=0.3)
        verdict = judge(query, match, seed)
        xi = se3_log(se3_inverse(verdict.T_M_Q.se3()) @ truth.se3())
        squared.append(xi @ verdict.information @ xi)
    # Chi square with 6 degrees of freedom: mean 6, of 40 samples within 1.7 (3 sigma). Some modesty is allowed.
    assert 2.0 < np.mean(squared) < 7.7


@pytest.mark.parametrize("metric", [True, False])
@pytest.mark.parametrize("kind", LOOK_ALIKES)
def test_look_alikes_are_refused(kind, metric):
    """The same descriptors at other points: hundreds of tentative matches, none of them right."""
    for seed in range(25):
        query, match = look_alikes(kind, np.random.default_rng(seed), metric)
        verdict = judge(query, match, seed)
        assert not verdict.accepted and verdict.matches > 200
        assert verdict.kind in ("too few inliers", "ambiguous", "contradicted")


def test_windows_that_repeat_are_not_matched():
    rng = np.random.default_rng(0)
    x, y, z = np.meshgrid([-8.0, 9.0], np.arange(-6, 2, 0.8), np.arange(3, 60, 0.8), indexing="ij")
    facade = np.stack([x, y, z], axis=-1).reshape(-1, 3)
    few = random_descriptors(rng, 40)
    for seed in range(10):
        rng = np.random.default_rng(seed)
        views = [observe(facade, few[rng.integers(0, 40, len(facade))], np.eye(4), Noise(), rng)[0] for _ in range(2)]
        assert not judge(*views, seed).accepted


def test_pairs_are_found_by_words_alone():
    rng = np.random.default_rng(1)
    points = street(rng, 1500)
    words = rng.integers(0, 10_000, len(points)).astype(np.int32)
    blank = np.zeros((len(points), 32), dtype=np.uint8)
    T = se3_exp([0.5, 0.1, 1.0, 0.01, 0.1, 0.0])
    views = []
    for pose in (T, np.eye(4)):
        view, rows = observe(points, blank, pose, Noise(), rng)
        seen = words[rows].copy()
        wrong = rng.random(len(seen)) < 0.4  # a descriptor near a cell's border falls into another word
        seen[wrong] = rng.integers(0, 10_000, int(wrong.sum()))
        views.append(PlaceView(view.points_C, words=seen))
    verdict = judge(*views)
    assert verdict.accepted, verdict.reason
    assert np.linalg.norm(verdict.T_M_Q.translation - T[:3, 3]) < 0.05
    elsewhere = PlaceView(street(rng, len(views[0].points_C)), words=views[0].words)
    assert not judge(elsewhere, views[1]).accepted


def test_every_refusal_says_why():
    rng = np.random.default_rng(2)
    query, match, _ = pair(rng)
    few = PlaceView(query.points_C[:7], query.descriptors[:7])
    assert judge(few, match).reason.startswith("too few matches: ") and judge(few, match).T_M_Q is None
    nothing = PlaceView(np.zeros((0, 3)), np.zeros((0, 32), dtype=np.uint8))
    assert judge(nothing, match).reason == "too few matches: 0 < 8"
    assert judge(match, nothing).reason == "too few matches: 0 < 8"

    line = np.column_stack([np.linspace(-3, 3, 80), np.full(80, 0.5), np.full(80, 10.0)])
    descriptors = random_descriptors(rng, 80)
    verdict = judge(PlaceView(line, descriptors), PlaceView(line, descriptors))
    assert not verdict.accepted and verdict.kind in ("degenerate", "too few inliers")

    # One papered wall: the same paper hangs in other rooms, so a wall alone is no place.
    wall = np.column_stack([rng.uniform(-3, 3, 200), rng.uniform(-1, 1, 200), np.full(200, 4.0)])
    paper = random_descriptors(rng, 200)
    assert judge(PlaceView(wall, paper), PlaceView(wall + 0.01, paper)).kind == "ambiguous"

    # The same picture at half the size is no place match when both cameras know what a metre is.
    model = PlaceView(query.points_C * 0.4, query.descriptors)
    assert not judge(model, match).accepted

    strict = CONFIG.model_copy(update={"min_inliers": 5000})
    assert judge(query, match, config=strict).reason.endswith("< 5000")
    accepted = judge(query, match)
    assert accepted.accepted and accepted.reason == accepted.kind == "accepted" and accepted.rmse < 0.3


def test_the_same_seed_gives_the_same_verdict():
    query, match, _ = pair(np.random.default_rng(3), outliers=0.7)
    a, b = judge(query, match, 5), judge(query, match, 5)
    assert np.array_equal(a.T_M_Q.matrix(), b.T_M_Q.matrix()) and np.array_equal(a.information, b.information)
    assert (a.matches, a.inliers, a.rmse) == (b.matches, b.inliers, b.rmse)


def test_distances_and_matches_against_the_plain_definition():
    rng = np.random.default_rng(4)
    a, b = random_descriptors(rng, 30), random_descriptors(rng, 40)
    b[:10] = a[5:15]
    plain = np.array([[sum(bin(x ^ y).count("1") for x, y in zip(p, q, strict=True)) for q in b] for p in a])
    distances = hamming_distances(a, b)
    assert np.array_equal(distances, plain)
    assert mutual_matches(distances, 50, 0.8).tolist() == [[5 + k, k] for k in range(10)]
    b[20] = a[5]  # two equally good partners: with the ratio test, no match
    assert [5, 0] not in mutual_matches(hamming_distances(a, b), 50, 0.8).tolist()
    words_a, words_b = np.array([3, 5, 5, 9, 1], np.int32), np.array([9, 5, 3, 3, 1], np.int32)
    assert unique_word_matches(words_a, words_b).tolist() == [[3, 0], [4, 4]]


def test_views_that_make_no_sense_are_refused():
    points = np.ones((3, 3))
    with pytest.raises(BackendError, match="descriptors or words"):
        PlaceView(points)
    with pytest.raises(BackendError, match="finite"):
        PlaceView(points * np.nan, words=np.zeros(3, np.int32))
    with pytest.raises(BackendError, match="uint8"):
        PlaceView(points, np.zeros((3, 32)))
    with pytest.raises(BackendError, match="in common"):
        judge(PlaceView(points, words=np.zeros(3, np.int32)), PlaceView(points, np.zeros((3, 32), np.uint8)))


@pytest.mark.parametrize("unit", [1e-4, 1 / 50.0, 1.0, 500.0])
def test_a_unit_is_no_reason_against_a_match_but_a_distance_is(unit):
    # One camera in a street has a unit of 20 m, one in a drone of 100 m; whatever it is, the query is 6 m ahead.
    ahead = [0.5, 0.0, 6.0, 0.0, 0.05, 0.0]
    query, match, truth = pair(np.random.default_rng(3), xi=ahead, scale=unit, metric=False)
    found = judge(query, match)
    assert found.accepted and found.T_M_Q.scale == pytest.approx(truth.scale, rel=0.05)
    nearer = np.linalg.norm(truth @ query.points_C - truth.translation, axis=1)
    ratio = np.median(nearer / np.linalg.norm(truth @ query.points_C, axis=1))
    assert 0.4 < ratio < 0.85
    narrow = judge(query, match, config=replaced(CONFIG, max_distance_ratio=1.1))
    assert narrow.kind == "implausible scale" and "times as far from the points" in narrow.reason
    assert judge(match, query, config=replaced(CONFIG, max_distance_ratio=1.1)).kind == "implausible scale"
    assert judge(query, match, config=replaced(CONFIG, max_distance_ratio=1.2 / ratio)).accepted


def test_the_scale_brings_its_own_uncertainty():
    squared = []
    for seed in range(30):
        query, match, truth = pair(np.random.default_rng(seed), outliers=0.3, scale=2.0, metric=False)
        verdict = judge(query, match, seed)
        assert verdict.full_information.shape == (7, 7) and verdict.information.shape == (6, 6)
        squared.append((np.log(verdict.T_M_Q.scale / truth.scale) / verdict.scale_sigma) ** 2)
        # Marginalising the scale leaves what the covariance of the rigid part says.
        covariance = np.linalg.inv(verdict.full_information)
        np.testing.assert_allclose(np.linalg.inv(verdict.information), covariance[:6, :6], rtol=1e-6, atol=1e-15)
    # Chi square with one degree of freedom, of 30 samples within 3 sigma: 1 +- 0.77; some modesty is allowed.
    assert 0.15 < np.mean(squared) < 1.8
    metric = judge(*pair(np.random.default_rng(0))[:2])
    assert metric.scale_sigma == 0.0 and not metric.full_information[6].any()


@pytest.mark.parametrize("n", [1, 2, 3, 8, 101])
def test_medians_are_numpys(n: int) -> None:
    rng = np.random.default_rng(n)
    for values in (rng.normal(size=n), rng.integers(0, 3, n).astype(float), np.ones(n), np.arange(n, 0.0, -1.0)):
        assert _median(values.copy()) == np.median(values)


@pytest.mark.parametrize("size", [6, 7])
def test_steps_solve_the_normal_equations(size: int) -> None:
    rng = np.random.default_rng(size)
    A, gradient = rng.normal(size=(20, 7)), rng.normal(size=7)
    hessian = A.T @ A
    step = _damped_step(hessian, gradient, size)
    np.testing.assert_allclose(step[:size], -np.linalg.solve(hessian[:size, :size], gradient[:size]), rtol=1e-7)
    assert not step[size:].any()


def test_steps_in_a_direction_that_nothing_tells_are_finite() -> None:
    row = np.array([1.0, 2.0, 0.0, -1.0, 0.5, 0.0, 0.0])
    assert np.isfinite(_damped_step(np.outer(row, row), row, 7)).all()
