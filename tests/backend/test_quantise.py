"""Points in four bytes: how far off they come back, and which are chosen."""

import numpy as np
import pytest
from scenes import pair, random_descriptors

from maslam.backend.config import RelPoseConfig
from maslam.backend.errors import BackendError
from maslam.backend.relpose.point_coding import BITS, as_sent, pack_points, unpack_points, worth_sending
from maslam.backend.relpose.verification import PlaceView, relative_pose


def test_the_grid_is_as_fine_as_it_says():
    rng = np.random.default_rng(0)
    points = np.column_stack([rng.uniform(-0.8, 0.8, 500), rng.uniform(-0.6, 0.6, 500), np.ones(500)])
    points *= 1.0 / rng.uniform(0.01, 1.0, 500)[:, None]
    back = unpack_points(*pack_points(points))
    plane, plane_back = points / points[:, 2:], back / back[:, 2:]
    steps = np.ptp(plane[:, :2], axis=0) / (2 ** np.array(BITS[:2]) - 1)
    assert (np.abs(plane - plane_back)[:, :2] <= 0.5001 * steps).all()
    inverse = 1.0 / points[:, 2]
    assert np.abs(inverse - 1.0 / back[:, 2]).max() <= 0.5001 * inverse.max() / (2 ** BITS[2] - 1)


def test_nothing_comes_back_at_infinity():
    points = np.array([[0.0, 0.0, 1.0], [10.0, 5.0, 1e6], [0.1, 0.2, 3.0]])
    assert np.isfinite(unpack_points(*pack_points(points))).all()
    assert unpack_points(*pack_points(np.zeros((0, 3)))).shape == (0, 3)
    one = np.array([[0.3, -0.1, 2.0]])
    np.testing.assert_allclose(unpack_points(*pack_points(one)), one, rtol=1e-6)
    with pytest.raises(BackendError, match="behind"):
        pack_points(np.array([[0.0, 0.0, -1.0]]))


def test_what_looks_like_nothing_else_is_sent_first():
    rng = np.random.default_rng(1)
    points = np.column_stack([rng.uniform(-1, 1, 300), rng.uniform(-1, 1, 300), np.ones(300)])
    descriptors = random_descriptors(rng, 300)
    brick = random_descriptors(rng, 1)[0]
    descriptors[100:] = brick  # two thirds of the view are one brick again and again
    rows = worth_sending(points, descriptors, 60)
    assert len(set(rows.tolist())) == 60
    assert (rows < 100).mean() > 0.8
    # Every part of the image sends something before any part sends its third.
    quarter = (points[rows[:40], 0] > 0).astype(int) * 2 + (points[rows[:40], 1] > 0)
    assert np.bincount(quarter, minlength=4).min() >= 5
    assert worth_sending(points[:1], descriptors[:1], 60).tolist() == [0]


@pytest.mark.parametrize("width", [16, 8])
def test_a_pose_is_found_from_few_bytes(width):
    for seed in range(4):
        query, match, truth = pair(np.random.default_rng(seed), outliers=0.2)
        sent, size = as_sent(query, 200, "grid", width)
        assert size == 200 * (4 + width) + 24
        verdict = relative_pose(sent, match, RelPoseConfig(), np.random.default_rng(seed))
        assert verdict.accepted, verdict.reason
        assert np.linalg.norm(verdict.T_M_Q.translation - truth.translation) < 0.05


def test_a_descriptor_has_one_of_three_lengths():
    with pytest.raises(BackendError, match="uint8"):
        PlaceView(np.ones((2, 3)), np.zeros((2, 12), dtype=np.uint8))
