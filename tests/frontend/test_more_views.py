"""Further views of map points against a room whose depth is known everywhere."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import room

from maslam.backend.geometry import product, se3_inverse, transform_points
from maslam.frontend.cameras.models import RigKind
from maslam.frontend.config import MappingConfig, OdometryConfig
from maslam.frontend.errors import FrontendError
from maslam.frontend.files.point_views import PointViews, read_views, write_views
from maslam.frontend.mapping.more_views import MoreViews
from maslam.frontend.odometry import Odometry, OdometryResult

WALK = room.walk(50, step_m=0.1, turn_deg=2.0)


class Words:
    """A vocabulary with one word."""

    def words(self, descriptors: np.ndarray) -> np.ndarray:
        return np.zeros((len(descriptors), 2), dtype=np.int32)


def tracked(kind: RigKind, neighbours: int) -> tuple[OdometryResult, Odometry]:
    scene = room.Room(5)
    odometry = Odometry(room.rig(kind), OdometryConfig(mapping=MappingConfig(view_neighbours=neighbours)), Words())
    for i, T_W_C in enumerate(WALK):
        odometry.process(scene.frame(i, T_W_C, kind))
    return odometry.finish(), odometry


@pytest.fixture(scope="module", params=list(RigKind))
def both(request: pytest.FixtureRequest) -> tuple[OdometryResult, OdometryResult]:
    """The walk with and without a search for further views."""
    return tracked(request.param, 5)[0], tracked(request.param, 0)[0]


def lengths(result: OdometryResult) -> np.ndarray:
    return np.bincount(result.views[0].observations[:, 1], minlength=len(result.tracks[0].points))


def test_odometry_is_the_same_with_and_without(both: tuple[OdometryResult, OdometryResult]) -> None:
    for name in ("poses", "points", "observations", "descriptors"):
        assert getattr(both[0].tracks[0], name).tobytes() == getattr(both[1].tracks[0], name).tobytes(), name


def test_points_have_many_more_views_and_each_one_that_odometry_has(
    both: tuple[OdometryResult, OdometryResult],
) -> None:
    many, few = (result.views[0] for result in both)
    keys = [{tuple(row) for row in views.observations.tolist()} for views in (many, few)]
    assert len(keys[0]) == len(many), "a key-frame sees a point once"
    assert keys[0] > keys[1] >= {tuple(row) for row in both[0].tracks[0].observations.tolist()}
    assert lengths(both[0]).mean() > max(3.0, 1.2 * lengths(both[1]).mean())
    at = {tuple(row): uv for row, uv in zip(many.observations.tolist(), many.uv, strict=True)}
    for row, uv in zip(few.observations.tolist(), few.uv, strict=True):
        np.testing.assert_array_equal(at[tuple(row)], uv)


def test_a_view_is_where_the_true_scene_has_what_the_first_view_shows(
    both: tuple[OdometryResult, OdometryResult],
) -> None:
    many, own = both[0].views[0], {tuple(row) for row in both[1].views[0].observations.tolist()}
    frames = both[0].keyframe_indices[0]
    scene = room.Room(5)
    depths = [scene.render(WALK[i])[1] for i in frames]
    rows = {tuple(row): n for n, row in enumerate(many.observations.tolist())}
    home: dict[int, int] = {}
    for k, point in sorted(own):
        home.setdefault(point, k)
    off = []
    for k, point in sorted(rows.keys() - own):
        h = home[point]
        u, v = many.uv[rows[h, point]].astype(np.float64)
        z = float(depths[h][round(v), round(u)])
        cam = room.CAMERA
        p = np.array([[(u - cam.cx) / cam.fx * z, (v - cam.cy) / cam.fy * z, z]])
        q = transform_points(product(se3_inverse(WALK[frames[k]]), WALK[frames[h]]), p)[0]
        seen = np.array([cam.fx * q[0] / q[2] + cam.cx, cam.fy * q[1] / q[2] + cam.cy])
        off.append(np.linalg.norm(seen - many.uv[rows[k, point]]))
    assert len(off) > 200
    assert np.median(off) < 0.5 and np.percentile(off, 90) < 1.5


def test_only_the_images_of_the_neighbourhood_are_held(monkeypatch: pytest.MonkeyPatch) -> None:
    held = []
    add = MoreViews.add

    def watched(self: MoreViews, *of: object) -> None:
        add(self, *of)
        held.append(len(self._held))

    monkeypatch.setattr(MoreViews, "add", watched)
    result, odometry = tracked(RigKind.STEREO, 2)
    assert len(held) > 8 and max(held) == 5
    assert odometry._segment is not None and not odometry._segment.mapper.more_views._held
    assert len(result.views[0]) > len(result.tracks[0].observations)


def test_views_come_back_from_their_file_and_damage_is_said(tmp_path: Path) -> None:
    views = PointViews.sorted(np.array([1, 0]), np.array([2, 0]), np.array([[3.5, 4.25], [1.0, 2.0]]))
    write_views(tmp_path, 3, views)
    again = read_views(tmp_path, 3, keyframes=2, points=3)
    assert again is not None
    assert again.observations.tolist() == [[0, 0], [1, 2]] and again.uv.tolist() == [[1.0, 2.0], [3.5, 4.25]]
    assert read_views(tmp_path, 0, 2, 3) is None
    with pytest.raises(FrontendError, match=r"views_3\.npz: a view of a key-frame or point beyond"):
        read_views(tmp_path, 3, keyframes=2, points=2)
    write_views(tmp_path, 4, PointViews(views.observations, views.uv * np.nan))
    with pytest.raises(FrontendError, match=r"views_4\.npz: NaN"):
        read_views(tmp_path, 4, 2, 3)
    write_views(tmp_path, 5, PointViews(views.observations, views.uv[:1]))
    with pytest.raises(FrontendError, match=r"views_5\.npz: arrays of shapes"):
        read_views(tmp_path, 5, 2, 3)
    (tmp_path / "views_6.npz").write_bytes(b"PK\x03\x04 cut")
    with pytest.raises(FrontendError, match=r"views_6\.npz: cannot be read"):
        read_views(tmp_path, 6, 2, 3)
