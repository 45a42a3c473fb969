"""The exported folder, judged by pycolmap, open3d and the rendered world, never by its own figures."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from maslam.frontend.files.trajectory import read_tum
from maslam.tools import cli

pycolmap = pytest.importorskip("pycolmap")
FOCAL_PX = 177.69800237267086  # of the camera that the town is rendered with


def export(run: Path, out: Path, *words: str) -> Path:
    assert cli.main(["export", str(run), str(out), "--quiet", *(words or ("--for", "colmap"))]) == 0
    return out


def read(folder: Path) -> pycolmap.Reconstruction:
    return pycolmap.Reconstruction(str(folder / "sparse" / "0"))


def off_px(model: pycolmap.Reconstruction, agent: str = "") -> NDArray[np.float64]:
    """Reprojection errors of all views, or of an agent's, computed by pycolmap's cameras."""
    out = []
    for point in model.points3D.values():
        for view in point.track.elements:
            image = model.images[view.image_id]
            if not image.name.startswith(agent):
                continue
            seen = model.cameras[image.camera_id].img_from_cam(image.cam_from_world() * point.xyz)
            assert seen is not None, "a point behind its camera"
            out.append(np.linalg.norm(seen - image.points2D[view.point2D_idx].xy))
    return np.array(out)


@pytest.mark.parametrize("fixture", ["finished", "two_cameras"])
def test_pycolmap_reads_the_team_and_its_points_lie_where_they_are_seen(
    fixture: str, request: pytest.FixtureRequest, tmp_path: Path
) -> None:
    run: Path = request.getfixturevalue(fixture)
    out = export(run, tmp_path / "out")
    model = read(out)
    keyframes = [len(read_tum(run / a / "trajectory_keyframes.tum")) for a in ("agent_00", "agent_01")]
    assert model.num_images() == sum(keyframes) and model.num_cameras() == 2
    assert {c.model.name for c in model.cameras.values()} == {"PINHOLE"}
    np.testing.assert_allclose(model.cameras[1].params, [FOCAL_PX, FOCAL_PX, 160.0, 90.0], atol=1e-9)
    errors = off_px(model)
    assert np.median(errors) <= 1.0 and errors.max() < 4.1 and model.num_points3D() > 1000
    assert min(point.track.length() for point in model.points3D.values()) >= 2
    for agent in ("agent_00", "agent_01"):
        assert np.median(off_px(model, agent)) < 0.4, "also through the bent lens"
    names = [image.name for image in model.images.values()]
    assert len(set(names)) == len(names) and {n.split("/")[0] for n in names} == {"agent_00", "agent_01"}
    assert all(n.split("/")[1:] == ["image_0", Path(n).name] for n in names), (
        "the user's names, from the agent's folder on"
    )
    for image in model.images.values():
        camera = model.cameras[image.camera_id]
        assert cv2.imread(str(out / "images" / image.name)).shape[:2] == (camera.height, camera.width)
    with open(out / "images.csv", newline="") as file:
        rows = list(csv.DictReader(file))
    assert [row["name"] for row in rows] == sorted(names)
    for agent in (0, 1):
        stamps = [int(row["stamp_ns"]) for row in rows if row["agent"] == str(agent)]
        assert stamps == read_tum(run / f"agent_{agent:02d}" / "trajectory_keyframes.tum").stamps_ns.tolist()
    assert all(Path(row["source"]).name == Path(row["name"]).name for row in rows)
    owners = {i: image.name.split("/")[0] for i, image in model.images.items()}
    shared = [p for p in model.points3D.values() if len({owners[v.image_id] for v in p.track.elements}) == 2]
    assert len(shared) > 20, "both agents see some points"


def test_bundle_adjustment_starts_near_its_optimum(two_cameras: Path, tmp_path: Path) -> None:
    """COLMAP's own adjustment gains little, and moves no camera by more than a few centimetres."""
    model = read(export(two_cameras, tmp_path / "out"))
    before, centres = np.median(off_px(model)), {i: m.projection_center() for i, m in model.images.items()}
    pycolmap.bundle_adjustment(model, pycolmap.BundleAdjustmentOptions())
    assert np.median(off_px(model)) > 0.5 * before
    ours, theirs = np.array(list(centres.values())), np.array([model.images[i].projection_center() for i in centres])
    T = pycolmap.estimate_sim3d(theirs, ours)  # images alone leave the scale open
    moved = T.scale * theirs @ T.rotation.matrix().T + T.translation - ours
    assert np.linalg.norm(moved, axis=1).max() < 0.1 and T.scale == pytest.approx(1.0, abs=0.02)


def test_features_of_the_exported_images_are_triangulated_with_the_exported_poses(
    finished: Path, tmp_path: Path
) -> None:
    """As hloc's triangulation: a database made from the model, other features, poses kept."""
    out = export(finished, tmp_path / "out", "--for", "hloc", "--agent", "0")
    model, database = read(out), tmp_path / "features.db"
    with pycolmap.Database.open(str(database)) as base:
        for camera in model.cameras.values():
            base.write_camera(camera, use_camera_id=True)
        for rig in model.rigs.values():
            base.write_rig(rig, use_rig_id=True)
        for frame in model.frames.values():
            base.write_frame(frame, use_frame_id=True)
        for image in model.images.values():
            base.write_image(image, use_image_id=True)
    options = pycolmap.FeatureExtractionOptions()
    options.num_threads = 1
    pycolmap.extract_features(str(database), str(out / "images"), extraction_options=options)
    pycolmap.match_exhaustive(str(database))
    (tmp_path / "sfm").mkdir()
    found = pycolmap.triangulate_points(model, str(database), str(out / "images"), str(tmp_path / "sfm"))
    assert found.num_reg_images() == model.num_images() and found.num_points3D() > 200
    assert found.compute_mean_reprojection_error() < 1.0


def test_images_are_undistorted_to_the_camera_of_the_model(
    two_cameras: Path, bent_images: Path, town_stereo: Path, R_rectified_left: NDArray[np.float64], tmp_path: Path
) -> None:
    """Each shows what the world's own camera saw there before the lens bent it; the others are the user's files."""
    model = read(export(two_cameras, tmp_path / "out"))
    compared = 0
    for image in model.images.values():
        agent, *inside = image.name.split("/")
        path = tmp_path / "out" / "images" / image.name
        if agent == "agent_00":
            assert path.read_bytes() == bent_images.joinpath(agent, *inside).read_bytes()
            continue
        fx, fy, cx, cy = model.cameras[image.camera_id].params
        v, u = np.mgrid[0:180, 0:320].astype(np.float64)
        rays = np.stack([(u + 0.5 - cx) / fx, (v + 0.5 - cy) / fy, np.ones_like(u)], axis=-1) @ R_rectified_left
        at = (rays[..., :2] / rays[..., 2:] * FOCAL_PX + [159.5, 89.5]).astype(np.float32)
        rendered = cv2.imread(str(town_stereo.joinpath(agent, *inside)))
        expected = cv2.remap(rendered, at, None, cv2.INTER_LINEAR)
        exported, bent = cv2.imread(str(path)), cv2.imread(str(bent_images.joinpath(agent, *inside)))
        off = [np.abs(one.astype(float) - expected).mean() for one in (exported, bent)]
        assert off[0] < 6.0 and off[0] < 0.5 * off[1]
        compared += 1
    assert compared > 3


def test_cameras_look_where_the_worlds_cameras_looked(
    two_cameras: Path, bent_images: Path, R_rectified_left: NDArray[np.float64], tmp_path: Path
) -> None:
    """Between the agents, too: the images of the second are turned by their rectification."""
    model = read(export(two_cameras, tmp_path / "out"))
    off = []
    for image in model.images.values():
        agent, _, name = image.name.split("/")
        row = np.loadtxt(bent_images / agent / "poses.txt")[int(Path(name).stem)]
        R_W_C = row.reshape(3, 4)[:, :3] @ (np.eye(3) if agent == "agent_00" else R_rectified_left.T)
        off.append(R_W_C @ image.cam_from_world().rotation.matrix())  # the same for all: from the map to the world
    apart = [np.degrees(np.linalg.norm(cv2.Rodrigues(off[0].T @ one)[0])) for one in off]
    assert max(apart) < 0.5


def test_points_have_the_colours_of_their_images(finished: Path, tmp_path: Path) -> None:
    out = export(finished, tmp_path / "out")
    model = read(out)
    images = {i: cv2.imread(str(out / "images" / m.name))[..., ::-1].astype(float) for i, m in model.images.items()}
    for point in list(model.points3D.values())[::97]:
        seen = []
        for view in point.track.elements:
            u, v = np.rint(model.images[view.image_id].points2D[view.point2D_idx].xy - 0.5).astype(int)
            seen.append(images[view.image_id][np.clip(v, 0, 179), np.clip(u, 0, 319)])
        np.testing.assert_allclose(point.color, np.mean(seen, axis=0), atol=1.01)


@pytest.mark.parametrize("fixture", ["finished", "two_cameras"])
def test_transforms_show_in_nerfstudios_axes_what_the_model_shows(
    fixture: str, request: pytest.FixtureRequest, tmp_path: Path
) -> None:
    """Its cameras look along -Z with +Y up; its points, read by open3d, project to the model's pixels."""
    open3d = pytest.importorskip("open3d")
    out = export(request.getfixturevalue(fixture), tmp_path / "out", "--for", "nerfstudio")
    model, said = read(out), json.loads((out / "transforms.json").read_text())
    cloud = open3d.io.read_point_cloud(str(out / said["ply_file_path"]))
    points, ids = np.asarray(cloud.points), sorted(model.points3D)
    np.testing.assert_allclose(np.asarray(cloud.colors)[0] * 255, model.points3D[ids[0]].color, atol=0.51)
    applied = np.array(said["applied_transform"])
    xyz = np.array([model.points3D[i].xyz for i in ids])
    np.testing.assert_allclose(points, xyz @ applied[:, :3].T + applied[:, 3], atol=1e-4)
    place = {i: k for k, i in enumerate(ids)}
    by_name = {f"images/{image.name}": image for image in model.images.values()}
    assert {frame["file_path"] for frame in said["frames"]} == set(by_name) and said["camera_model"] == "PINHOLE"
    errors = []
    for frame in said["frames"]:
        image, c = by_name[frame["file_path"]], {**said, **frame}
        assert (out / frame["file_path"]).is_file() and frame["colmap_im_id"] == image.image_id
        T_G_N = np.linalg.inv(frame["transform_matrix"])
        seen = np.array([place[p.point3D_id] for p in image.points2D], dtype=int)
        p = points[seen] @ T_G_N[:3, :3].T + T_G_N[:3, 3]
        assert (p[:, 2] < 0).all()
        uv = np.column_stack([c["fl_x"] * p[:, 0] / -p[:, 2] + c["cx"], c["fl_y"] * p[:, 1] / p[:, 2] + c["cy"]])
        errors += np.linalg.norm(uv - [q.xy for q in image.points2D], axis=1).tolist()
        assert np.array(frame["transform_matrix"])[2, 1] > 0.9, "a level camera's up is the world's"
    assert np.median(errors) <= 1.0
    assert ("fl_x" in said) == (len(model.cameras) == 1)


def test_one_agent_alone_has_its_images_and_the_top_level_camera(finished: Path, tmp_path: Path) -> None:
    out = export(finished, tmp_path / "out", "--for", "gsplat", "--agent", "1")
    model, said = read(out), json.loads((out / "transforms.json").read_text())
    assert {i.name.split("/")[0] for i in model.images.values()} == {"agent_01"} and model.num_cameras() == 1
    assert said["w"] == 320 and "w" not in said["frames"][0] and np.median(off_px(model)) <= 1.0
    assert min(point.track.length() for point in model.points3D.values()) >= 2


def test_all_placed_frames_stand_on_the_trajectory(finished: Path, tmp_path: Path) -> None:
    model = read(export(finished, tmp_path / "out", "--for", "nerfstudio", "--frames", "all"))
    for agent in ("agent_00", "agent_01"):
        path = read_tum(finished / agent / "trajectory.tum")
        mine = sorted((i.name, i.projection_center()) for i in model.images.values() if i.name.startswith(agent))
        assert len(mine) == len(path) == 20, "names are in order of time"
        np.testing.assert_allclose([centre for _, centre in mine], path.centres, atol=1e-6)
    assert np.median(off_px(model)) <= 1.0


def test_agents_that_nothing_joins_are_no_one_model(
    apart: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    model = read(export(apart, tmp_path / "largest"))
    assert len({i.name.split("/")[0] for i in model.images.values()}) == 1
    said = capsys.readouterr().out
    assert "left out: agent_01: no match joins them to the others; --groups all exports each group" in said
    out = export(apart, tmp_path / "all", "--for", "colmap", "--groups", "all")
    for number, agent in enumerate(("agent_00", "agent_01")):
        inside = out / f"group_{number:02d}"
        model = read(inside)
        assert {i.name.split("/")[0] for i in model.images.values()} == {agent} and np.median(off_px(model)) <= 1.0
        assert (inside / "transforms.json").is_file()
    record = json.loads((out / "export.json").read_text())
    assert [m["folder"] for m in record["models"]] == ["group_00", "group_01"] and record["left_out"] == []
