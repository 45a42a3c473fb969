"""Layouts of public data sets, small, with known content; nothing here reads through the code under test."""

from __future__ import annotations

import json
from datetime import UTC, datetime
from pathlib import Path

import cv2
import numpy as np
import yaml
from dataset_makers import (
    BASELINE_M,
    COUNT,
    CX,
    CY,
    FX,
    FY,
    HEIGHT,
    WIDTH,
    Scene,
    own_camera,
    quaternion_wxyz,
    seconds,
    write_images,
)
from numpy.typing import NDArray

Array = NDArray[np.float64]
DAY = "2011_09_26"
DRIVE = f"{DAY}/{DAY}_drive_0001_sync"
SCALE = 1000.0


def write_replica(folder: Path, scene: Scene) -> None:
    colour = np.repeat(scene.images[..., None], 3, axis=3)
    write_images(folder / "results", [f"frame{i:06d}.png" for i in range(COUNT)], colour)
    write_images(folder / "results", [f"depth{i:06d}.png" for i in range(COUNT)], scene.depth_mm)
    rows = (" ".join(f"{v:.18e}" for v in pose.ravel()) for pose in scene.poses)
    (folder / "traj.txt").write_text("\n".join(rows) + "\n")
    camera = {"w": WIDTH, "h": HEIGHT, "fx": FX, "fy": FY, "cx": CX, "cy": CY, "scale": SCALE}
    (folder.parent / "cam_params.json").write_text(json.dumps({"camera": camera}))


def matrix(values: Array) -> str:
    return "\n".join(" ".join(f"{v:.12f}" for v in row) for row in values) + "\n"


def intrinsics(scale: float = 1.0) -> Array:
    K = np.eye(4)
    K[0, 0], K[1, 1] = FX * scale, FY * scale
    K[0, 2], K[1, 2] = (CX + 0.5) * scale - 0.5, (CY + 0.5) * scale - 0.5
    return K


def write_scannet(folder: Path, scene: Scene, depth_scale: float = 1.0) -> None:
    write_images(folder / "color", [f"{i}.png" for i in range(COUNT)], np.repeat(scene.images[..., None], 3, axis=3))
    size = round(WIDTH * depth_scale), round(HEIGHT * depth_scale)
    depth = [cv2.resize(one, size, interpolation=cv2.INTER_NEAREST) for one in scene.depth_mm]
    write_images(folder / "depth", [f"{i}.png" for i in range(COUNT)], depth)
    for name in ("pose", "intrinsic"):
        (folder / name).mkdir()
    for i, pose in enumerate(scene.poses):
        (folder / "pose" / f"{i}.txt").write_text(matrix(pose))
    (folder / "intrinsic/intrinsic_color.txt").write_text(matrix(intrinsics()))
    (folder / "intrinsic/intrinsic_depth.txt").write_text(matrix(intrinsics(depth_scale)))
    for name in ("color", "depth"):
        (folder / f"intrinsic/extrinsic_{name}.txt").write_text(matrix(np.eye(4)))


def write_tartanair(folder: Path, scene: Scene, own: bool = True) -> None:
    colour = np.repeat(scene.images[..., None], 3, axis=3)
    write_images(folder / "image_left", [f"{i:06d}_left.png" for i in range(COUNT)], colour)
    write_images(folder / "image_right", [f"{i:06d}_right.png" for i in range(COUNT)], scene.rights)
    (folder / "depth_left").mkdir()
    for i in range(COUNT):
        np.save(folder / f"depth_left/{i:06d}_left_depth.npy", (scene.depth_mm[i] / 1000.0).astype(np.float32))
    forward_right_down = np.array([[0, 1, 0], [0, 0, 1], [1, 0, 0.0]])  # these axes' directions in the camera's
    rows = []
    for pose in scene.poses:
        w, x, y, z = quaternion_wxyz(pose[:3, :3] @ forward_right_down)
        rows.append(" ".join(f"{v:.15f}" for v in (*pose[:3, 3], x, y, z, w)))
    (folder / "pose_left.txt").write_text("\n".join(rows) + "\n")
    if own:
        (folder / "camera.yaml").write_text(own_camera(f"baseline_m: {BASELINE_M}\nrate_hz: 10.0\n"))


def date_text(stamp_ns: int) -> str:
    whole = datetime.fromtimestamp(stamp_ns // 10**9, UTC)
    return f"{whole:%Y-%m-%d %H:%M:%S}.{stamp_ns % 10**9:09d}"


def listed(values: Array) -> str:
    return " ".join(f"{v:.12e}" for v in np.asarray(values).ravel())


def write_kitti_raw(root: Path, scene: Scene) -> Path:
    """The drive's folder."""
    drive = root / DRIVE
    lines = ["calib_time: 09-Jan-2012 13:57:47", "corner_dist: 9.950000e-02"]
    for i, (name, images) in enumerate((("00", scene.images), ("01", scene.rights))):
        write_images(drive / f"image_{name}/data", [f"{k:010d}.png" for k in range(COUNT)], images)
        (drive / f"image_{name}/timestamps.txt").write_text("".join(date_text(int(t)) + "\n" for t in scene.stamps_ns))
        P = np.array([[FX, 0, CX, -FX * BASELINE_M * i], [0, FY, CY, 0], [0, 0, 1, 0]])
        lines += [
            f"S_{name}: {WIDTH + 10:.6e} {HEIGHT + 10:.6e}",
            f"S_rect_{name}: {WIDTH:.6e} {HEIGHT:.6e}",
            f"R_rect_{name}: {listed(np.eye(3))}",
            f"P_rect_{name}: {listed(P)}",
        ]
    (root / DAY / "calib_cam_to_cam.txt").write_text("\n".join(lines) + "\n")
    return drive


def write_tum_vi(folder: Path, scene: Scene, T_camera_imu: Array) -> None:
    names = [f"{stamp}.png" for stamp in scene.stamps_ns]
    for cam, images in (("cam0", scene.images), ("cam1", scene.rights)):
        write_images(folder / f"mav0/{cam}/data", names, [image.astype(np.uint16) * 257 for image in images])
        rows = "".join(f"{name[:-4]},{name}\n" for name in names)
        (folder / f"mav0/{cam}/data.csv").write_text("#timestamp [ns],filename\n" + rows)
    camera = {
        "camera_model": "pinhole",
        "distortion_model": "radtan",
        "distortion_coeffs": [0.0] * 4,
        "intrinsics": [FX, FY, CX, CY],
        "resolution": [WIDTH, HEIGHT],
    }
    T_right_left = np.eye(4)
    T_right_left[0, 3] = -BASELINE_M
    chain = {
        "cam0": {**camera, "T_cam_imu": T_camera_imu.tolist()},
        "cam1": {**camera, "T_cam_imu": (T_right_left @ T_camera_imu).tolist(), "T_cn_cnm1": T_right_left.tolist()},
    }
    (folder / "dso").mkdir()
    (folder / "dso/camchain.yaml").write_text(yaml.safe_dump(chain))
    rows = []
    for stamp, pose in zip(scene.stamps_ns, scene.poses, strict=True):
        body = pose @ T_camera_imu
        rows.append(",".join(map(repr, [int(stamp), *body[:3, 3].tolist(), *quaternion_wxyz(body[:3, :3]).tolist()])))
    (folder / "mav0/mocap0").mkdir()
    (folder / "mav0/mocap0/data.csv").write_text("#timestamp [ns], p_RS_R_x [m], ...\n" + "\n".join(rows) + "\n")


def pose_fields(pose: Array) -> str:
    w, x, y, z = quaternion_wxyz(pose[:3, :3])
    return " ".join(f"{v:.15f}" for v in (*pose[:3, 3], x, y, z, w))


def write_associations(folder: Path, scene: Scene, form: str = "rgb depth gt", name: str = "associations.txt") -> None:
    names = [f"{seconds(int(stamp))}.png" for stamp in scene.stamps_ns]
    write_images(folder / "rgb", names, np.repeat(scene.images[..., None], 3, axis=3))
    write_images(folder / "depth", names, scene.depth_mm * 5)
    lines = []
    for i, file in enumerate(names):
        parts = {
            "rgb": f"{file[:-4]} rgb/{file}",
            "depth": f"{seconds(int(scene.stamps_ns[i]) + 7_000_000)} depth/{file}",
            "gt": f"{file[:-4]} {pose_fields(scene.poses[i])}",
        }
        lines.append(" ".join(parts[part] for part in form.split()))
    (folder / name).write_text("\n".join(lines) + "\n")
    (folder / "camera.yaml").write_text(own_camera())


def write_nerfstudio(folder: Path, scene: Scene, depth: bool = True, **camera: object) -> None:
    """``camera``: keys of the file; by default focal lengths and centre, where the first pixel's is (0.5, 0.5)."""
    colour = np.repeat(scene.images[..., None], 3, axis=3)
    write_images(folder / "images", [f"frame_{i + 1:05d}.png" for i in range(COUNT)], colour)
    opengl = np.array([[1, 0, 0, 0], [0, -1, 0, 0], [0, 0, -1, 0], [0, 0, 0, 1.0]])  # its y is up, its z behind
    frames = []
    for i, pose in enumerate(scene.poses):
        frames.append(
            {"file_path": f"images/frame_{i + 1:05d}.png", "transform_matrix": (pose @ opengl).tolist()}
            | ({"depth_file_path": f"depth/{i}.png"} if depth else {})
        )
    if depth:
        write_images(folder / "depth", [f"{i}.png" for i in range(COUNT)], scene.depth_mm)
    frames = [frames[i] for i in (3, 0, 5, 1, 2, 4)]  # COLMAP's order is none
    camera = camera or {
        "camera_model": "OPENCV", "w": WIDTH, "h": HEIGHT, "fl_x": FX, "fl_y": FY, "cx": CX + 0.5, "cy": CY + 0.5,
        "k1": 0.0, "k2": 0.0, "p1": 0.0, "p2": 0.0,
    }  # fmt: skip
    (folder / "transforms.json").write_text(json.dumps({**camera, "frames": frames}))


def write_openloris(folder: Path, scene: Scene) -> None:
    names = [f"{seconds(int(stamp))}.png" for stamp in scene.stamps_ns]
    for inside, images in (("color", np.repeat(scene.images[..., None], 3, axis=3)), ("aligned_depth", scene.depth_mm),
                           ("depth", scene.depth_mm[:, ::2, ::2])):  # fmt: skip
        write_images(folder / inside, names, images)
        rows = "".join(f"{name[:-4]} {inside}/{name}\n" for name in names)
        (folder / f"{inside}.txt").write_text("#Time Filename\n" + rows)
    matrix = "!!opencv-matrix\n      rows: 1\n      cols: {}\n      dt: d\n      data: {}\n"
    (folder / "sensors.yaml").write_text(
        "%YAML:1.0\n---\nd400_color_optical_frame:\n   sensor_type: camera\n   sensor_name: d400_color_optical_frame\n"
        f"   fps: 30\n   width: {WIDTH}\n   height: {HEIGHT}\n   model: pinhole\n"
        f"   intrinsics: {matrix.format(4, [FX, CX, FY, CY])}   distortion_model: radial-tangential\n"
        f"   distortion_coefficients: {matrix.format(5, [0.0] * 5)}t265_fisheye1_optical_frame:\n   model: pinhole\n"
    )
    (folder / "trans_matrix.yaml").write_text("%YAML:1.0\n---\ntrans_matrix: []\n")
    rows = (f"{seconds(int(t))} {pose_fields(pose)}\n" for t, pose in zip(scene.stamps_ns, scene.poses, strict=True))
    (folder / "groundtruth.txt").write_text("#Time px py pz qx qy qz qw\n" + "".join(rows))


def write_icl_nuim(folder: Path, scene: Scene) -> None:
    """Depth first, counted from 0; poses in a world whose y is up, of a camera whose y is up."""
    names = [f"{i}.png" for i in range(COUNT)]
    write_images(folder / "rgb", names, np.repeat(scene.images[..., None], 3, axis=3))
    write_images(folder / "depth", names, scene.depth_mm * 5)
    lines = [f"{i} depth/{i}.png {i} rgb/{i}.png" for i in range(COUNT)]
    (folder / "associations.txt").write_text("\n".join(lines) + "\n")
    rows = []
    for i, pose in enumerate(scene.poses):
        up = pose.copy()
        up[[0, 1, 2, 1], [1, 0, 1, 2]] *= -1.0
        up[1, 3] *= -1.0
        rows.append(f"{i} {pose_fields(up)}")
    (folder / "livingRoom2.gt.freiburg").write_text("\n".join(rows) + "\n")
