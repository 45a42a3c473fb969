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
from maslam.frontend.mapping.map import MapKeyFrame
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


SIZE = (100, 80)


def test_views_come_back_from_their_file_and_damage_is_said(tmp_path: Path) -> None:
    views = PointViews.sorted(np.array([1, 0]), np.array([2, 0]), np.array([[3.5, 4.25], [1.0, 2.0]]))
    write_views(tmp_path, 3, views)
    again = read_views(tmp_path, 3, keyframes=2, points=3, size_px=SIZE)
    assert again is not None
    assert again.observations.tolist() == [[0, 0], [1, 2]] and again.uv.tolist() == [[1.0, 2.0], [3.5, 4.25]]
    assert read_views(tmp_path, 0, 2, 3, SIZE) is None
    with pytest.raises(FrontendError, match=r"views_3\.npz: a view of a key-frame or point beyond"):
        read_views(tmp_path, 3, keyframes=2, points=2, size_px=SIZE)
    write_views(tmp_path, 4, PointViews(views.observations, views.uv * np.nan))
    with pytest.raises(FrontendError, match=r"views_4\.npz: NaN"):
        read_views(tmp_path, 4, 2, 3, SIZE)
    write_views(tmp_path, 5, PointViews(views.observations, views.uv[:1]))
    with pytest.raises(FrontendError, match=r"views_5\.npz: arrays of shapes"):
        read_views(tmp_path, 5, 2, 3, SIZE)


def damaged(path: Path, how: str) -> None:
    whole = path.read_bytes()
    if how == "pickled":
        np.savez(path, observations=np.array([[{}, {}]]), uv=np.zeros((1, 2)))
    elif how == "one array":
        with path.open("wb") as file:
            np.save(file, np.zeros((1, 2)))
    elif how == "another name":
        np.savez(path, observations=np.zeros((1, 2), dtype=np.int32))
    else:
        at = len(whole) // 3
        changes = {
            "text": b"no archive",
            "empty": b"",
            "cut at the front": b"PK\x03\x04 cut",
            "cut": whole[: 2 * at],
            "changed": whole[:at] + bytes(255 - b for b in whole[at : at + 60]) + whole[at + 60 :],
        }
        path.write_bytes(changes[how])


@pytest.mark.parametrize(
    "how", ["text", "empty", "cut at the front", "cut", "changed", "pickled", "one array", "another name"]
)
def test_a_damaged_file_of_views_is_said_in_our_words(tmp_path: Path, how: str) -> None:
    keyframe, point = np.divmod(np.arange(60), 30)
    write_views(tmp_path, 0, PointViews.sorted(keyframe, point, np.ones((60, 2))))
    damaged(tmp_path / "views_0.npz", how)
    with pytest.raises(FrontendError) as said:
        read_views(tmp_path, 0, 2, 30, SIZE)
    assert str(said.value) == f"{tmp_path / 'views_0.npz'}: damaged: run preprocess again, or delete it"


@pytest.mark.parametrize(
    ("uv", "far"),
    [
        *(((u, v), False) for u, v in [(0.0, 0.0), (-9.9, 87.9), (109.9, -7.9)]),
        *(((u, v), True) for u, v in [(-10.1, 5.0), (110.1, 5.0), (5.0, -8.1), (5.0, 88.1), (1e9, 5.0)]),
    ],
)
def test_a_pixel_far_outside_the_image_is_refused(tmp_path: Path, uv: tuple[float, float], far: bool) -> None:
    write_views(tmp_path, 0, PointViews.sorted(np.array([0, 1]), np.array([0, 0]), np.array([[5.0, 5.0], uv])))
    if not far:
        assert read_views(tmp_path, 0, 2, 1, SIZE) is not None
        return
    with pytest.raises(FrontendError, match=r"views_0\.npz: a view at pixel .* outside the image of 100x80"):
        read_views(tmp_path, 0, 2, 1, SIZE)


def test_a_point_is_not_found_where_the_image_shows_something_else(monkeypatch: pytest.MonkeyPatch) -> None:
    """The image of the fourth key-frame is that of another room: points project into it all the same."""
    add, strange = MoreViews.add, room.Room(77).render(WALK[20])[0]
    found: dict[bool, int] = {}
    for swapped in (False, True):
        calls: list[int] = []

        def watched(
            self: MoreViews,
            keyframe: MapKeyFrame,
            image: np.ndarray,
            used: np.ndarray | None = None,
            calls: list[int] = calls,
            swap: bool = swapped,
        ) -> None:
            calls.append(keyframe.number)
            add(self, keyframe, strange if swap and len(calls) == 4 else image, used)

        monkeypatch.setattr(MoreViews, "add", watched)
        _, odometry = tracked(RigKind.STEREO, 5)
        assert odometry._segment is not None
        found[swapped] = len(odometry._segment.mapper.more_views.found[calls[3]].point)
    assert found[False] > 100 and found[True] < 0.05 * found[False]
