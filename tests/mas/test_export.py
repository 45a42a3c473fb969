"""An agent's maps as one: duplicates merged, and a COLMAP model that COLMAP reads."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from factory import CAMERA, heading

from maslam.backend.geometry import Array, Sim3, se3_inverse, so3_exp, transform_points
from maslam.mas.manifest import StoredCameraEntry
from maslam.mas.map_exchange.map_copy import MapCopy, SoldVersion
from maslam.mas.output.colmap import write_colmap
from maslam.mas.output.fused_map import FusedMap, fused, write_map
from maslam.mas.output.sightings import MapOwner, OwnerViews
from maslam.mas.protocol.ids import FrameId
from maslam.mas.state.keyframe import KeyFrame

POSES = np.array([heading(0.0, 2.0 * k, 0.05 * k) for k in range(3)])


def street(rng: np.random.Generator, count: int) -> Array:
    return np.column_stack([rng.uniform(-5, 5, count), rng.uniform(-2, 2, count), rng.uniform(10, 20, count)])


def map_of(
    owner: int, points: Array, references: Array, descriptors: Array | None = None, unit: float = 1.0
) -> MapCopy:
    """A held map with world points, each seen from one of three poses; the owner's unit is worth ``unit`` metres."""
    inverse = se3_inverse(POSES)
    points_C = np.array([transform_points(inverse[r], p[None])[0] for p, r in zip(points, references, strict=True)])
    poses = POSES.copy()
    poses[:, :3, 3] /= unit
    placement = Sim3(np.eye(3), np.zeros(3), unit)
    return MapCopy(
        SoldVersion(owner, owner, 1),
        (owner,),
        FrameId(owner, 0),
        placement,
        np.arange(3),
        np.arange(3) * 10**9,
        poses,
        np.ones(len(poses)),
        references,
        points_C.reshape(-1, 3) / unit,
        descriptors,
        (),
    )


def keyframe_with(index: int, points_C: Array, ids: Array) -> KeyFrame:
    """A key-frame of which only its points matter."""
    n = len(points_C)
    return KeyFrame(
        index=index,
        time_ns=index,
        stamp_ns=index,
        recording=0,
        track=0,
        T_T_C=np.eye(4),
        points_C=points_C,
        descriptors=np.zeros((n, 32), dtype=np.uint8),
        words=np.zeros(n, dtype=np.int32),
        point_ids=ids,
        first_seen=np.ones(n, dtype=bool),
        depth=15.0,
        vector=np.zeros(2, dtype=np.float32),
        textured=True,
    )


def test_what_two_maps_share_is_there_once() -> None:
    rng = np.random.default_rng(0)
    points, rows = street(rng, 300), rng.integers(0, 3, 300)
    one = map_of(0, points[:200], rows[:200])
    two = map_of(1, points[100:] + 0.001, rows[100:], unit=0.25)
    both = fused([one, two])
    assert len(both.points) == 300
    assert np.bincount(both.owners).tolist() == [200, 100]
    np.testing.assert_allclose(both.points[:100], points[:100], atol=1e-9)
    np.testing.assert_allclose(both.points[100:200], points[100:200] + 0.0005, atol=1e-9)
    assert both.labels[200:].tolist() == list(range(100, 300))


def test_what_looks_different_is_not_merged_and_what_does_not_tell_is() -> None:
    rng = np.random.default_rng(1)
    points, rows = street(rng, 60), np.zeros(60, dtype=np.int64)
    looks = [rng.integers(0, 256, (60, 32), dtype=np.uint8) for _ in range(2)]
    described = [map_of(a, points, rows, looks[a]) for a in range(2)]
    assert len(fused(described).points) == 120
    assert len(fused([described[0], map_of(1, points, rows)]).points) == 60


def test_colmap_reads_the_model_and_its_points_lie_where_its_images_see_them(tmp_path: Path) -> None:
    pycolmap = pytest.importorskip("pycolmap")
    rng = np.random.default_rng(2)
    points, rows = street(rng, 120), rng.integers(0, 3, 120)
    maps = [map_of(0, points[:80], rows[:80]), map_of(3, points[40:], rows[40:])]
    one = fused(maps)
    write_colmap(tmp_path, one, {0: MapOwner(CAMERA), 3: MapOwner(CAMERA)})
    model = pycolmap.Reconstruction(str(tmp_path))
    # What one image alone sees is a pixel of it and no point of the model: COLMAP's adjustment refuses such points.
    assert (model.num_cameras(), model.num_images(), model.num_points3D()) == (2, 6, 40)
    assert sum(i.num_points2D() for i in model.images.values()) == 160
    assert sorted(i.name for i in model.images.values())[0] == "agent_00/0.png"
    assert sorted(len(p.track.elements) for p in model.points3D.values()) == [2] * 40
    for image in model.images.values():
        row = (image.image_id - 1) % 3
        np.testing.assert_allclose(image.cam_from_world().matrix(), se3_inverse(POSES[row])[:3], atol=1e-12)
        for seen in image.points2D:
            if not seen.has_point3D():
                continue
            xyz = model.points3D[seen.point3D_id].xyz
            p = transform_points(se3_inverse(POSES[row]), xyz[None])[0]
            expected = [CAMERA.fx * p[0] / p[2] + CAMERA.cx + 0.5, CAMERA.fy * p[1] / p[2] + CAMERA.cy + 0.5]
            np.testing.assert_allclose(seen.xy, expected, atol=1e-6)


def test_a_point_has_every_view_of_its_owner_where_it_was_measured(tmp_path: Path) -> None:
    pycolmap = pytest.importorskip("pycolmap")
    rng = np.random.default_rng(4)
    points, rows = street(rng, 30), np.sort(rng.integers(0, 3, 30))
    copy = map_of(0, points, rows)
    ids = rng.permutation(40)[:30]  # the owner's numbers of its points; it has ten more
    keyframes = [keyframe_with(k, copy.points_C[rows == k].astype(np.float32), ids[rows == k]) for k in range(3)]
    # Every key-frame shows every point, measured a little off its projection, and something that is not in the map.
    project = CAMERA.fx, CAMERA.fy, CAMERA.cx, CAMERA.cy
    seen, off = [], rng.normal(0.0, 0.5, (3, 30, 2))
    for k, T_W_C in enumerate(POSES):
        p = transform_points(se3_inverse(T_W_C), points)
        uv = p[:, :2] / p[:, 2:] * project[:2] + project[2:] + off[k]
        seen.append(np.vstack([uv, [[5.0, 5.0]]]))
    views = OwnerViews(np.array([0, 31, 62, 93]), np.tile(np.append(ids, 77), 3), np.concatenate(seen))
    one = fused([copy])
    write_colmap(tmp_path, one, {0: MapOwner(CAMERA, keyframes, views, ("a.png", "b/c.png", "d.png"))})
    model = pycolmap.Reconstruction(str(tmp_path))
    assert model.compute_mean_track_length() == 3.0
    assert [i.name for i in sorted(model.images.values(), key=lambda i: i.image_id)] == ["a.png", "b/c.png", "d.png"]
    for number, point in model.points3D.items():
        # The point lies where its views see it best, not where the map has it.
        fitted = [transform_points(se3_inverse(T_W_C), point.xyz[None])[0] for T_W_C in POSES]
        at = np.array([p[:2] / p[2] * project[:2] + project[2:] for p in fitted])
        away = np.linalg.norm(at - [seen[k][number - 1] for k in range(3)], axis=1)
        assert point.error == pytest.approx(away.mean())
        assert (away**2).mean() < (off[:, number - 1] ** 2).sum(axis=1).mean()
        for element in point.track.elements:
            measured = seen[element.image_id - 1][number - 1] + 0.5
            np.testing.assert_allclose(model.images[element.image_id].points2D[element.point2D_idx].xy, measured)


TURN = so3_exp([0.01, -0.02, 0.015])
LENSES = {
    "none": ((), 1),
    "radial-tangential": ((-0.28, 0.07, 0.0002, -0.0004), 4),
    "radial-tangential, eight": ((0.3, -0.05, 0.001, 0.0005, 0.01, 0.6, -0.03, 0.02), 6),
    "equidistant": ((0.01, -0.004, 0.002, -0.0005), 5),
}


@pytest.mark.parametrize("lens", LENSES)
def test_files_that_are_not_rectified_have_their_own_camera_in_the_model(tmp_path: Path, lens: str) -> None:
    """Pixels are those of the files, as OpenCV projects; COLMAP's own camera projects each point to them."""
    pycolmap = pytest.importorskip("pycolmap")
    coefficients, number = LENSES[lens]
    stored = StoredCameraEntry(
        distortion=lens.partition(",")[0],
        fx=300.0,
        fy=310.0,
        cx=322.0,
        cy=239.0,
        coefficients=coefficients,
        rotation=tuple(TURN.ravel()),
    )
    camera = CAMERA.model_copy(update={"stored": stored})
    rng = np.random.default_rng(6)
    points = street(rng, 25)
    copy = map_of(0, points, np.zeros(25, dtype=np.int64))
    inside = [transform_points(se3_inverse(T_W_C), points) for T_W_C in POSES]
    uv = [p[:, :2] / p[:, 2:] * [camera.fx, camera.fy] + [camera.cx, camera.cy] for p in inside]
    views = OwnerViews(np.array([0, 25, 50, 75]), np.tile(np.arange(25), 3), np.concatenate(uv))
    keyframes = [keyframe_with(0, copy.points_C.astype(np.float32), np.arange(25))]
    keyframes += [keyframe_with(k, np.zeros((0, 3), dtype=np.float32), np.zeros(0, dtype=np.int64)) for k in (1, 2)]
    write_colmap(tmp_path, fused([copy]), {0: MapOwner(camera, keyframes, views)})
    model = pycolmap.Reconstruction(str(tmp_path))
    (theirs,) = model.cameras.values()
    assert int(theirs.model.value) == number and model.num_points3D() == 25
    K = np.array([[stored.fx, 0, stored.cx], [0, stored.fy, stored.cy], [0, 0, 1.0]])
    for k, p in enumerate(inside):
        seen = (p @ TURN)[:, None]  # from the rectified camera to the stored one
        if lens == "equidistant":
            expected = cv2.fisheye.projectPoints(seen, np.zeros(3), np.zeros(3), K, np.array(coefficients))[0]
        else:
            expected = cv2.projectPoints(seen, np.zeros(3), np.zeros(3), K, np.array(coefficients))[0]
        image = model.images[k + 1]
        found = np.array([q.xy for q in image.points2D])
        order = [q.point3D_id - 1 for q in image.points2D]
        np.testing.assert_allclose(found, expected[order, 0] + 0.5, atol=1e-3)
        for q in image.points2D:
            in_camera = image.cam_from_world() * model.points3D[q.point3D_id].xyz
            np.testing.assert_allclose(theirs.img_from_cam(in_camera), q.xy, atol=1e-2)


def test_an_image_sees_a_merged_point_once(tmp_path: Path) -> None:
    """Two of a map's points are one to the merged map, and both are seen by the first image."""
    pycolmap = pytest.importorskip("pycolmap")
    points = np.array([[0.0, 0.0, 12.0], [0.01, 0.0, 12.0], [1.0, 0.0, 15.0]])
    copy = map_of(0, points, np.array([0, 0, 1]))
    one = FusedMap((copy,), points[[0, 2]], np.zeros(2, dtype=np.int32), np.array([0, 0, 1]))
    write_colmap(tmp_path, one, {0: MapOwner(CAMERA)})
    model = pycolmap.Reconstruction(str(tmp_path))
    assert model.num_points3D() == 0
    assert [i.num_points2D() for i in sorted(model.images.values(), key=lambda i: i.image_id)] == [1, 1, 0]


def test_points_that_images_show_at_one_pixel_are_one_point_with_the_views_of_both(tmp_path: Path) -> None:
    """Odometry lost a point after its first key-frame, and made it anew; the second shows both at one pixel."""
    pycolmap = pytest.importorskip("pycolmap")
    place = np.array([0.5, 0.2, 14.0])
    copy = map_of(0, np.array([place, place + 0.002, [-2.0, 0.0, 15.0]]), np.array([0, 1, 0]))
    keyframes = [
        keyframe_with(k, copy.points_C[copy.references == k].astype(np.float32), np.array(ids))
        for k, ids in enumerate([[0, 2], [1], []])
    ]
    seen = [transform_points(se3_inverse(T_W_C), place[None])[0] for T_W_C in POSES]
    uv = [p[:2] / p[2] * [CAMERA.fx, CAMERA.fy] + np.array([CAMERA.cx, CAMERA.cy]) for p in seen]
    away = np.array([9.0, 9.0])
    views = OwnerViews(
        np.array([0, 2, 4, 5]), np.array([0, 2, 0, 1, 1]), np.array([uv[0], away, uv[1], uv[1] + 0.4, uv[2]])
    )
    one = fused([copy])
    write_colmap(tmp_path, one, {0: MapOwner(CAMERA, keyframes, views, ("a.png", "b.png", "c.png"))})
    model = pycolmap.Reconstruction(str(tmp_path))
    (point,) = model.points3D.values()
    assert sorted(element.image_id for element in point.track.elements) == [1, 2, 3]
    np.testing.assert_allclose(point.xyz, place, atol=0.1)


def test_an_agent_without_points_has_an_empty_map(tmp_path: Path) -> None:
    nothing = fused([map_of(0, np.zeros((0, 3)), np.zeros(0, dtype=np.int64))])
    assert len(nothing.points) == 0
    write_map(tmp_path / "map.ply", nothing)
    write_colmap(tmp_path / "colmap", nothing, {0: MapOwner(CAMERA)})
    assert (tmp_path / "colmap" / "points3D.bin").read_bytes() == bytes(8)
