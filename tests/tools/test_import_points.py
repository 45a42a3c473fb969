"""Given points instead of depth images: one camera becomes as metric as with the sensor that made the points."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml

from maslam.backend.geometry import quat_wxyz_from_rotation, se3, se3_inverse, so3_exp, transform_points
from maslam.frontend.errors import FrontendError
from maslam.frontend.files.cloud_files import read_cloud
from maslam.frontend.files.trajectory import read_kitti_poses
from maslam.frontend.files.vo_files import read_tracks
from maslam.tools import cli

T_B_C = se3(so3_exp([0.0, 0.4, 0.0]) @ np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]]), [0.3, 0.1, 0.5])
"""A camera on a scanner whose axes are forward, left, up."""
NAME = "agent_00"


class Walk:
    """One agent's images with their true poses and depth."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.times = np.loadtxt(folder / "times.txt")
        self.poses = read_kitti_poses(folder / "poses.txt")[1]
        text = (folder / "camera.yaml").read_text()
        entry = yaml.safe_load(text)
        camera = entry.get("camera", entry)
        self.fx, self.fy, self.cx, self.cy = (float(camera[key]) for key in ("fx", "fy", "cx", "cy"))
        unit = float(entry.get("depth_unit_m", 0.001))
        files = sorted((folder / "depth_0").iterdir())
        self.depth = [cv2.imread(str(file), cv2.IMREAD_UNCHANGED).astype(float) * unit for file in files]

    def seen(self, k: int, step: int = 6) -> np.ndarray:
        """Every ``step``-th pixel of image ``k`` as a point in its camera."""
        v, u = np.mgrid[2 : self.depth[k].shape[0] : step, 2 : self.depth[k].shape[1] : step]
        z = self.depth[k][v, u]
        p = np.stack([(u - self.cx) / self.fx * z, (v - self.cy) / self.fy * z, z], axis=-1)
        return np.asarray(p[z > 0])

    def write_poses(self, path: Path, T_C_B: np.ndarray) -> None:
        T = self.poses @ T_C_B
        q = quat_wxyz_from_rotation(T[:, :3, :3])[:, [1, 2, 3, 0]]
        np.savetxt(path, np.column_stack([self.times, T[:, :3, 3], q]), "%.9f")


@pytest.fixture(scope="module")
def walk(indoor_rgbd: Path) -> Walk:
    return Walk(indoor_rgbd / NAME)


def scans(walk: Walk, folder: Path) -> list[str]:
    """A scan between each two images, in the scanner's axes; poses are the scanner's."""
    walk.write_poses(folder / "poses.txt", se3_inverse(T_B_C))
    (folder / "points").mkdir()
    for k, t in enumerate(walk.times):
        points = transform_points(T_B_C, walk.seen(k)).astype("<f4")
        np.column_stack([points, np.zeros(len(points), "<f4")]).astype("<f4").tofile(folder / "points" / f"{t:.9f}.bin")
    return [f"--T-body-camera={','.join(map(repr, T_B_C.ravel().tolist()))}"]


def cloud(walk: Walk, folder: Path) -> list[str]:
    """All that is seen at all, as one map."""
    walk.write_poses(folder / "poses.txt", np.eye(4))
    world = np.concatenate([transform_points(T, walk.seen(k, 8)) for k, T in enumerate(walk.poses)]).astype("<f4")
    head = f"ply\nformat binary_little_endian 1.0\nelement vertex {len(world)}\n"
    head += "property float x\nproperty float y\nproperty float z\nend_header\n"
    (folder / "points").write_bytes(b"")
    (folder / "points").rename(folder / "points.ply")
    (folder / "points.ply").write_bytes(head.encode() + world.tobytes())
    return []


def observed(walk: Walk, folder: Path) -> list[str]:
    """Map points as another system has them, with the images that see each."""
    walk.write_poses(folder / "poses.txt", np.eye(4))
    rows = ["image,x,y,z"]
    for k, T in enumerate(walk.poses):
        rows += [f"{k:06d}.png,{x!r},{y!r},{z!r}" for x, y, z in transform_points(T, walk.seen(k)).tolist()]
    (folder / "points.csv").write_text("\n".join(rows) + "\n")
    return []


def colmap(walk: Walk, folder: Path) -> list[str]:
    walk.write_poses(folder / "poses.txt", np.eye(4))
    model = folder / "points"
    model.mkdir()
    images, points = ["# Image list"], ["# 3D point list"]
    for k, T in enumerate(walk.poses):
        images += [f"{k + 1} 1 0 0 0 0 0 0 1 {k:06d}.png", "" if k % 2 else "1.0 2.0 -1"]
        start = len(points)
        world = transform_points(T, walk.seen(k)).tolist()
        points += [f"{start + i} {x!r} {y!r} {z!r} 1 1 1 0.5 {k + 1} {i}" for i, (x, y, z) in enumerate(world)]
    (model / "images.txt").write_text("\n".join(images) + "\n")
    (model / "points3D.txt").write_text("\n".join(points) + "\n")
    return []


def imported(walk: Walk, folder: Path, words: list[str]) -> int:
    points = next(path for path in folder.iterdir() if path.stem == "points")
    out, source = str(folder / "seqs"), str(walk.folder)
    return cli.main(
        ["import", str(folder / "poses.txt"), source, out, "--rig", "mono", "--points", str(points), *words, "--quiet"]
    )


@pytest.mark.parametrize("write", [scans, cloud, observed, colmap])
def test_points_measure_what_the_depth_sensor_would(
    write: Callable[[Walk, Path], list[str]], walk: Walk, tmp_path: Path
) -> None:
    assert imported(walk, tmp_path, write(walk, tmp_path)) == 0
    manifest = json.loads((tmp_path / "seqs" / "manifest.json").read_text())
    assert manifest["scale"] == "metric"
    assert manifest["agents"][0]["camera"]["kind"] == "mono"
    (track,) = read_tracks(tmp_path / "seqs" / NAME)
    views = np.load(tmp_path / "seqs" / NAME / "views_0.npz")
    times = np.loadtxt(walk.folder / "times.txt")
    off, single = [], np.bincount(track.observations[:, 1], minlength=len(track.points)) == 1
    for k, stamp in enumerate(track.stamps_s):
        rows = views["observations"][:, 0] == k
        p = transform_points(se3_inverse(track.poses[k]), track.points[views["observations"][rows, 1]])
        u, v = np.rint(views["uv"][rows]).astype(int).T
        image = walk.depth[int(np.abs(times - times[0] - stamp).argmin())]
        kernel = np.ones((7, 7))  # at an edge a pixel's own depth is as good as its neighbour's
        smooth = cv2.dilate(image, kernel) < 1.05 * cv2.erode(image, kernel)
        known = smooth[v, u] & (image[v, u] > 0)
        off.append(np.abs(p[known, 2] / image[v, u][known] - 1.0))
    share = np.concatenate(off)
    assert len(share) > 500
    assert np.median(share) < 0.01
    assert np.mean(share > 0.1) < 0.05
    # One view is enough where depth is measured; rays alone need three.
    assert single.sum() > 100


def test_points_of_another_frame_are_refused(walk: Walk, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    cloud(walk, tmp_path)
    points = read_cloud(tmp_path / "points.ply")
    (tmp_path / "points.ply").unlink()
    np.save(tmp_path / "points.npy", 1.8 * points)
    assert imported(walk, tmp_path, []) == 1
    assert "are the points in the frame and the unit of the poses?" in capsys.readouterr().err
    np.save(tmp_path / "points.npy", points + 1000.0)
    assert imported(walk, tmp_path, []) == 1
    assert "no given point is where an image has a key-point" in capsys.readouterr().err
    np.save(tmp_path / "points.npy", points + np.array([2.0, 0.0, 0.0]))
    assert imported(walk, tmp_path, []) == 0
    assert "% of the depths measured are those of the images' rays" in capsys.readouterr().err
    np.save(tmp_path / "points.npy", points)
    words = ["import", str(tmp_path / "poses.txt"), str(walk.folder), str(tmp_path / "s"), "--quiet"]
    assert cli.main([*words, "--points", str(tmp_path / "points.npy")]) == 1
    assert "--rig mono takes points instead" in capsys.readouterr().err
    (tmp_path / "table.csv").write_text("image,x,y,z\nother_1.png,1,2,3\n")
    assert cli.main([*words, "--rig", "mono", "--points", str(tmp_path / "table.csv")]) == 1
    assert "none of its 1 points is seen" in capsys.readouterr().err
    (tmp_path / "table.csv").write_text("image,x,y,z\n000001.png,1,2\n")
    assert cli.main([*words, "--rig", "mono", "--points", str(tmp_path / "table.csv")]) == 1
    assert "table.csv:2: not 4 columns" in capsys.readouterr().err


CLOUD = np.array([[1.5, -2.25, 3.0], [0.125, 8.0, -1.0]])


def cloud_bytes(form: str) -> bytes:
    rows = "".join(f"7 {x} {y} {z}\n" for x, y, z in CLOUD)
    ply = "ply\nformat {}\ncomment made here\nelement vertex 2\nproperty uchar red\nproperty {} x\nproperty {} y\n"
    ply += "property {} z\nelement face 0\nproperty list uchar int vertex_indices\nend_header\n"
    records = np.array([(7, *row) for row in CLOUD], dtype=[("r", "u1"), ("x", "<f8"), ("y", "<f8"), ("z", "<f8")])
    pcd = "# .PCD v0.7\nVERSION 0.7\nFIELDS i x y z\nSIZE 1 8 8 8\nTYPE U F F F\nCOUNT 1 1 1 1\nWIDTH 2\nHEIGHT 1\n"
    pcd += "POINTS 2\nDATA {}\n"
    return {
        "a.ply": ply.format("ascii 1.0", *["float"] * 3).encode() + rows.encode(),
        "b.ply": ply.format("binary_little_endian 1.0", *["double"] * 3).encode() + records.tobytes(),
        "c.ply": ply.format("binary_big_endian 1.0", *["double"] * 3).encode()
        + records.astype([("r", "u1"), ("x", ">f8"), ("y", ">f8"), ("z", ">f8")]).tobytes(),
        "a.pcd": pcd.format("ascii").encode() + rows.encode(),
        "b.pcd": pcd.format("binary").encode() + records.tobytes(),
        "a.bin": np.column_stack([CLOUD, [0.5, 0.5]]).astype("<f4").tobytes(),
        "a.xyz": "".join(f"{x} {y} {z} 255\n" for x, y, z in CLOUD).encode(),
        "a.csv": b"x,y,z\r\n" + "".join(f"{x},{y},{z}\r\n" for x, y, z in CLOUD).encode(),
    }[form]


@pytest.mark.parametrize("form", ["a.ply", "b.ply", "c.ply", "a.pcd", "b.pcd", "a.bin", "a.xyz", "a.csv"])
def test_a_cloud_in_every_form_is_the_same(form: str, tmp_path: Path) -> None:
    content = cloud_bytes(form)
    (tmp_path / form).write_bytes(content)
    np.testing.assert_array_equal(read_cloud(tmp_path / form), CLOUD)
    (tmp_path / form).write_bytes(content[:-9])
    with pytest.raises(FrontendError, match=form):
        read_cloud(tmp_path / form)
