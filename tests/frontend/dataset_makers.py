"""Small data sets with known content, written as each kind is laid out; nothing here reads through the code under
test."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

WIDTH, HEIGHT, COUNT = 96, 64, 6
FX, FY, CX, CY, BASELINE_M = 80.0, 80.0, 47.5, 31.5, 0.25
START_NS, STEP_NS = 1_403_715_274_312_143_104, 50_000_000


@dataclass(frozen=True)
class Scene:
    """What a data set is made of: grey images, right images, depth in millimetres, time stamps and poses."""

    images: NDArray[np.uint8]
    rights: NDArray[np.uint8]
    depth_mm: NDArray[np.uint16]
    stamps_ns: NDArray[np.int64]
    poses: NDArray[np.float64] = field(repr=False)


def make_scene(start_ns: int = START_NS, step_ns: int = STEP_NS) -> Scene:
    rng = np.random.default_rng(7)
    images = np.stack([texture(rng) for _ in range(COUNT)])
    rights = np.stack([texture(rng) for _ in range(COUNT)])
    depth = rng.integers(400, 8000, (COUNT, HEIGHT, WIDTH)).astype(np.uint16)
    depth[:, :4, :4] = 0
    poses = np.tile(np.eye(4), (COUNT, 1, 1))
    for i in range(COUNT):
        angle = 0.1 * i
        poses[i, :3, :3] = [[np.cos(angle), 0, np.sin(angle)], [0, 1, 0], [-np.sin(angle), 0, np.cos(angle)]]
        poses[i, :3, 3] = [0.5 * i, 0.01 * i * i, 1.5 * i]
    return Scene(images, rights, depth, start_ns + step_ns * np.arange(COUNT), poses)


def texture(rng: np.random.Generator) -> NDArray[np.uint8]:
    """Smooth enough that resampling by a millionth of a pixel changes nothing."""
    noise = rng.uniform(0, 255, (HEIGHT // 4, WIDTH // 4)).astype(np.float32)
    return np.clip(cv2.resize(noise, (WIDTH, HEIGHT), interpolation=cv2.INTER_CUBIC), 0, 255).astype(np.uint8)


def seconds(stamp_ns: int) -> str:
    return f"{stamp_ns // 10**9}.{stamp_ns % 10**9:09d}"


def write_images(folder: Path, names: list[str], images: NDArray) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    for name, image in zip(names, images, strict=True):
        assert cv2.imwrite(str(folder / name), image)


def numbered(suffix: str = ".png") -> list[str]:
    return [f"{i:06d}{suffix}" for i in range(COUNT)]


def kitti_rows(poses: NDArray[np.float64]) -> str:
    return "".join(" ".join(f"{v:.12e}" for v in pose[:3].ravel()) + "\n" for pose in poses)


def tum_rows(stamps_ns: NDArray[np.int64], poses: NDArray[np.float64]) -> str:
    lines = []
    for stamp, pose in zip(stamps_ns, poses, strict=True):
        half = np.arctan2(pose[0, 2], pose[0, 0]) / 2  # the scenes only turn about y
        x, y, z = pose[:3, 3]
        lines.append(f"{seconds(stamp)} {x:.12f} {y:.12f} {z:.12f} 0 {np.sin(half):.12f} 0 {np.cos(half):.12f}\n")
    return "".join(lines)


def write_kitti(folder: Path, scene: Scene, labels: bool = True, colour: bool = False) -> None:
    left, right = ("image_2", "image_3") if colour else ("image_0", "image_1")
    write_images(folder / left, numbered(), scene.images)
    write_images(folder / right, numbered(), scene.rights)
    rows = []
    for camera in range(4):
        offset = -FX * BASELINE_M * (camera % 2)
        label = f"P{camera}: " if labels else ""
        rows.append(f"{label}{FX} 0 {CX} {offset} 0 {FY} {CY} 0 0 0 1 0\n")
    (folder / "calib.txt").write_text("".join(rows if labels else rows[:2]))
    relative = scene.stamps_ns - scene.stamps_ns[0]
    (folder / "times.txt").write_text("".join(f"{seconds(t)}\n" for t in relative))
    (folder / "poses.txt").write_text(kitti_rows(scene.poses))


SENSOR = """%YAML:1.0
sensor_type: camera
T_BS:
  cols: 4
  rows: 4
  data: [{T}]
rate_hz: 20
resolution: [{w}, {h}]
camera_model: pinhole
intrinsics: [{fx}, {fy}, {cx}, {cy}] #fu, fv, cu, cv
distortion_model: radial-tangential
distortion_coefficients: [{d}]
"""


def write_euroc_camera(
    cam: Path,
    images: NDArray,
    stamps_ns: NDArray[np.int64],
    T_body_camera: NDArray,
    distortion: tuple[float, ...] = (0, 0, 0, 0),
) -> None:
    names = [f"{stamp}.png" for stamp in stamps_ns]
    write_images(cam / "data", names, images)
    rows = "".join(f"{stamp},{name}\r\n" for stamp, name in zip(stamps_ns, names, strict=True))
    (cam / "data.csv").write_text("#timestamp [ns],filename\r\n" + rows)
    text = ", ".join(map(str, np.asarray(T_body_camera).ravel()))
    height, width = images[0].shape
    values = {
        "T": text,
        "w": width,
        "h": height,
        "fx": FX,
        "fy": FY,
        "cx": CX,
        "cy": CY,
        "d": ", ".join(map(str, distortion)),
    }
    (cam / "sensor.yaml").write_text(SENSOR.format(**values))


def write_euroc(folder: Path, scene: Scene) -> None:
    T_body_left = np.array([[0, 0, 1, 0.1], [-1, 0, 0, 0.2], [0, -1, 0, 0.3], [0, 0, 0, 1.0]])
    T_left_right = np.eye(4)
    T_left_right[0, 3] = BASELINE_M
    write_euroc_camera(folder / "mav0/cam0", scene.images, scene.stamps_ns, T_body_left)
    write_euroc_camera(folder / "mav0/cam1", scene.rights, scene.stamps_ns, T_body_left @ T_left_right)
    state = folder / "mav0/state_groundtruth_estimate0"
    state.mkdir()
    rows = []
    for stamp, T_W_C in zip(scene.stamps_ns, scene.poses, strict=True):
        body = T_W_C @ np.linalg.inv(T_body_left)
        q = quaternion_wxyz(body[:3, :3])
        rows.append(",".join(map(repr, [int(stamp), *body[:3, 3].tolist(), *q.tolist(), *([0.0] * 9)])))
    (state / "data.csv").write_text("#timestamp, p_x, ...\n" + "\n".join(rows) + "\n")


def quaternion_wxyz(rotation: NDArray[np.float64]) -> NDArray[np.float64]:
    """By eigenvectors (Bar-Itzhack 2000): another way than the code under test."""
    r = rotation
    K = np.array([
        [r[0, 0] - r[1, 1] - r[2, 2], 0, 0, 0],
        [r[1, 0] + r[0, 1], r[1, 1] - r[0, 0] - r[2, 2], 0, 0],
        [r[2, 0] + r[0, 2], r[2, 1] + r[1, 2], r[2, 2] - r[0, 0] - r[1, 1], 0],
        [r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1], r[0, 0] + r[1, 1] + r[2, 2]],
    ])  # fmt: skip
    _, vectors = np.linalg.eigh(K / 3.0)
    x, y, z, w = vectors[:, -1]
    return np.array([w, x, y, z])


DEPTH_FOCAL_PX = 585.0 * WIDTH / 640
COLOUR_RIGHT_OF_DEPTH_M = 0.025


def write_seven_scenes(folder: Path, scene: Scene) -> None:
    """``scene.depth_mm`` as the depth camera's; ``scene.poses`` are the colour camera's, files hold the other's."""
    write_images(folder, [f"frame-{i:06d}.color.png" for i in range(COUNT)], scene.images)
    stored = np.where(scene.depth_mm == 0, 65535, scene.depth_mm).astype(np.uint16)
    stored[:, 0, 0] = 0
    write_images(folder, [f"frame-{i:06d}.depth.png" for i in range(COUNT)], stored)
    for i, T_W_C in enumerate(scene.poses):
        pose = T_W_C.copy()
        pose[:3, 3] -= COLOUR_RIGHT_OF_DEPTH_M * T_W_C[:3, 0]  # the depth camera, to the left of the colour camera
        (folder / f"frame-{i:06d}.pose.txt").write_text(
            "\n".join("\t ".join(f"{v:.16e}" for v in row) + "\t " for row in pose) + "\n"
        )
    (folder / "camera.txt").write_text(f"# a comment\n{FX} {FY} {CX} {CY}\n# another\n")


def write_tum(folder: Path, scene: Scene) -> None:
    names = [f"{seconds(stamp)}.png" for stamp in scene.stamps_ns]
    write_images(folder / "rgb", names, np.repeat(scene.images[..., None], 3, axis=3))
    depth_stamps = scene.stamps_ns + 7_000_000
    depth_names = [f"{seconds(stamp)}.png" for stamp in depth_stamps]
    write_images(folder / "depth", depth_names, scene.depth_mm * 5)
    head = "# color images\n# file: 'x.bag'\n# timestamp filename\n"
    (folder / "rgb.txt").write_text(head + "".join(f"{n[:-4]} rgb/{n}\n" for n in names))
    (folder / "depth.txt").write_text(head + "".join(f"{n[:-4]} depth/{n}\n" for n in depth_names))
    (folder / "groundtruth.txt").write_text(
        "# timestamp tx ty tz qx qy qz qw\n" + tum_rows(scene.stamps_ns, scene.poses)
    )
    (folder / "camera.yaml").write_text(own_camera())


def own_camera(extra: str = "") -> str:
    return f"width: {WIDTH}\nheight: {HEIGHT}\nfx: {FX}\nfy: {FY}\ncx: {CX}\ncy: {CY}\n{extra}"


def write_rendered(folder: Path, scene: Scene, rig: str) -> None:
    """One agent's folder as ``docs/architecture.md`` lays it down."""
    write_images(folder / "image_0", numbered(), np.repeat(scene.images[..., None], 3, axis=3))
    extra = "rate_hz: 20.0\n"
    if rig == "stereo":
        write_images(folder / "image_1", numbered(), np.repeat(scene.rights[..., None], 3, axis=3))
        extra += f"baseline_m: {BASELINE_M}\n"
    if rig == "rgbd":
        write_images(folder / "depth_0", numbered(), scene.depth_mm)
        extra += "depth_unit_m: 0.001\n"
    (folder / "camera.yaml").write_text(own_camera(extra))
    (folder / "times.txt").write_text("".join(f"{seconds(t)}\n" for t in scene.stamps_ns))
    (folder / "poses.txt").write_text(kitti_rows(scene.poses))
