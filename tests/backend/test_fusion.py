"""Maps of points joined."""

import numpy as np
import pytest
from scenes import random_descriptors, street

from maslam.backend.errors import BackendError
from maslam.backend.fusion import PointMap, fuse


def owner(robot, count):
    return np.full(count, robot, dtype=np.int32)


def test_shared_points_are_merged_and_others_kept():
    rng = np.random.default_rng(0)
    points, descriptors = street(rng, 300), random_descriptors(rng, 300)
    a = PointMap(points[:200], owner(0, 200), descriptors[:200])
    b = PointMap(points[100:] + 0.01, owner(1, 200), descriptors[100:])
    joined, labels = fuse([a, b], radius=0.05)
    assert len(joined.points) == 300
    assert (joined.owners == 0).sum() == 200
    np.testing.assert_allclose(joined.points[:100], points[:100])
    np.testing.assert_allclose(joined.points[100:200], points[100:200] + 0.005)
    assert np.array_equal(joined.descriptors[:200], descriptors[:200])
    assert np.array_equal(labels, [*range(200), *range(100, 300)])


def test_what_only_lies_close_is_not_merged():
    rng = np.random.default_rng(1)
    points = street(rng, 100)
    a = PointMap(points, owner(0, 100), random_descriptors(rng, 100))
    b = PointMap(points + 0.01, owner(1, 100), random_descriptors(rng, 100))
    assert len(fuse([a, b], radius=0.05)[0].points) == 200
    # Points of one map are never merged with each other.
    twice = PointMap(np.repeat(points, 2, axis=0), owner(0, 200))
    assert len(fuse([twice], radius=0.05)[0].points) == 200


def test_maps_without_points():
    empty = PointMap(np.zeros((0, 3)), owner(0, 0))
    assert len(fuse([], 0.1)[0].points) == len(fuse([empty], 0.1)[0].points) == 0
    one = PointMap(np.eye(3), owner(3, 3))
    assert fuse([one, empty], 0.1)[0].owners.tolist() == [3, 3, 3]
    with pytest.raises(BackendError, match="owners"):
        PointMap(np.eye(3), owner(0, 2))
