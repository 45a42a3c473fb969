"""Exports of runs that came from a film, a fisheye, a bag of two robots: a room of known walls is the truth."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from recording_makers import IMAGE, INFO, Channel, image_message, info_message, turn_film, write_film
from room import BASELINE_M, CAMERA, Room, walk

import maslam
from maslam.backend.geometry import se3
from maslam.frontend.cameras.models import PinholeCamera
from maslam.frontend.files.trajectory import read_tum
from maslam.tools import cli

pycolmap = pytest.importorskip("pycolmap")
FRAMES = 36
START_NS = 1_700_000_000_000_000_000
FISHEYE_PX, LENS = 230.0, (0.02, -0.01, 0.003, -0.001)
WIDE = PinholeCamera(640, 480, 260.0, 260.0, 319.5, 239.5)


def camera_text(focal_px: float, more: str = "") -> str:
    c = CAMERA
    return f"width: {c.width}\nheight: {c.height}\nfx: {focal_px}\nfy: {focal_px}\ncx: {c.cx}\ncy: {c.cy}\n{more}"


@pytest.fixture(scope="module")
def film(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The run of a film that is stored on its side, with a flag by which players turn it."""
    folder, room = tmp_path_factory.mktemp("film"), Room(3)
    upright = [room.render(pose)[0] for pose in walk(FRAMES)]
    write_film(folder / "my walk.mp4", [cv2.rotate(image, cv2.ROTATE_90_COUNTERCLOCKWISE) for image in upright], 10.0)
    turn_film(folder / "my walk.mp4", 90)
    (folder / "my walk.yaml").write_text(camera_text(CAMERA.fx))
    maslam.slam(folder / "my walk.mp4", folder / "run")
    return folder / "run"


@pytest.fixture(scope="module")
def fisheye(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The run of a folder of one fisheye's images."""
    folder, room = tmp_path_factory.mktemp("fisheye"), Room(3)
    (folder / "drive" / "images").mkdir(parents=True)
    u, v = np.meshgrid(np.arange(CAMERA.width, dtype=np.float64), np.arange(CAMERA.height, dtype=np.float64))
    K = np.array([[FISHEYE_PX, 0, CAMERA.cx], [0, FISHEYE_PX, CAMERA.cy], [0, 0, 1.0]])
    pixels = np.stack([u.ravel(), v.ravel()], axis=1)[:, None]
    at = cv2.fisheye.undistortPoints(pixels, K, np.array(LENS), P=WIDE.K).reshape(*u.shape, 2).astype(np.float32)
    for i, pose in enumerate(walk(FRAMES)):
        image = cv2.remap(room.render(pose, WIDE)[0], at[..., 0], at[..., 1], cv2.INTER_LINEAR)
        cv2.imwrite(str(folder / "drive" / "images" / f"{i:06d}.png"), image)
    matrix = f"[{FISHEYE_PX}, {FISHEYE_PX}, {CAMERA.cx}, {CAMERA.cy}]"
    (folder / "drive" / "camchain.yaml").write_text(
        f"cam0:\n  camera_model: pinhole\n  intrinsics: {matrix}\n  distortion_model: equidistant\n"
        f"  distortion_coeffs: {list(LENS)}\n  resolution: [{CAMERA.width}, {CAMERA.height}]\n"
    )
    maslam.slam(folder / "drive", folder / "run")
    return folder / "run"


def robot(room: Room, poses: NDArray[np.float64], name: str) -> list[Channel]:
    """A rectified stereo camera's topics."""
    stamps = [START_NS + 100_000_000 * i for i in range(len(poses))]
    T_left_right = se3(np.eye(3), [BASELINE_M, 0.0, 0.0])
    K, size = CAMERA.K, (CAMERA.width, CAMERA.height)
    out = []
    for side, T in (("left", np.eye(4)), ("right", T_left_right)):
        images = [room.render(pose @ T)[0] for pose in poses]
        P = np.hstack([K, [[-CAMERA.fx * T[0, 3]], [0.0], [0.0]]])
        out += [
            Channel(
                f"/{name}/{side}/image_rect",
                IMAGE,
                stamps,
                lambda s, i, images=images: image_message(s, stamps[i], images[i], "mono8"),
            ),
            Channel(
                f"/{name}/{side}/camera_info", INFO, stamps, lambda s, i, P=P: info_message(s, stamps[i], size, K, P=P)
            ),
        ]
    return out


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The run of a bag of two robots, who walk through one room side by side."""
    pytest.importorskip("rosbags", reason="the extra `bags` is not installed")
    from recording_makers import write_ros2

    folder, room = tmp_path_factory.mktemp("bag"), Room(3)
    path = walk(FRAMES)
    beside = path[8:] @ se3(np.eye(3), [0.1, 0.05, 0.0])
    write_ros2(folder / "drive", [*robot(room, path[:28], "alice"), *robot(room, beside, "bob")])
    assert maslam.slam(folder / "drive", folder / "run").summary.groups == [[0, 1]]
    return folder / "run"


def exported(run: Path, out: Path, *words: str) -> tuple[pycolmap.Reconstruction, dict[str, object]]:
    assert cli.main(["export", str(run), str(out), "--for", "colmap", "--quiet", *words]) == 0
    record: dict[str, object] = json.loads((out / "export.json").read_text())
    return pycolmap.Reconstruction(str(out / "sparse" / "0")), record


def off_px(model: pycolmap.Reconstruction) -> NDArray[np.float64]:
    out = []
    for point in model.points3D.values():
        for view in point.track.elements:
            image = model.images[view.image_id]
            seen = model.cameras[image.camera_id].img_from_cam(image.cam_from_world() * point.xyz)
            out.append(np.linalg.norm(seen - image.points2D[view.point2D_idx].xy))
    return np.array(out)


def number_of(name: str) -> int:
    return int(Path(name).stem)


def shown_as_in_the_room(model: pycolmap.Reconstruction, out: Path, poses: NDArray[np.float64], levels: float) -> None:
    """Each image shows what the room's walls look like through the model's camera from where it truly was, and half a
    pixel to any side less well."""
    room, inner = Room(3), np.s_[4:-4, 4:-4]
    for image in list(model.images.values())[::6]:
        c = model.cameras[image.camera_id]
        found = cv2.imread(str(out / "images" / image.name), cv2.IMREAD_COLOR)
        assert found.shape == (c.height, c.width, 3)
        off = {}
        for right, down in ((0, 0), (0.5, 0), (-0.5, 0), (0, 0.5), (0, -0.5)):
            camera = PinholeCamera(
                c.width, c.height, *c.params[:2], c.params[2] - 0.5 + right, c.params[3] - 0.5 + down
            )
            wanted = cv2.GaussianBlur(room.render(poses[number_of(image.name)], camera)[0].astype(float), (0, 0), 0.7)
            off[right, down] = float(np.abs(found.mean(axis=2) - wanted)[inner].mean())
        assert off[0, 0] < levels and all(1.1 * off[0, 0] < other for side, other in off.items() if side != (0, 0)), off


def stand_where_they_were(model: pycolmap.Reconstruction, poses: NDArray[np.float64], within_m: float) -> None:
    """Cameras after the similarity that fits them best to the true places, by pycolmap."""
    images = list(model.images.values())
    places = np.array([poses[number_of(image.name)][:3, 3] for image in images])
    centres = np.array([image.projection_center() for image in images])
    T = pycolmap.estimate_sim3d(centres, places)
    assert T is not None
    np.testing.assert_allclose(np.array([T * centre for centre in centres]), places, atol=within_m)


def test_a_film(film: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    model, record = exported(film, tmp_path / "out", "--frames", "all")
    assert "arbitrary unit" in capsys.readouterr().out
    assert [a["unit"] for a in record["models"][0]["agents"]] == ["arbitrary"]  # type: ignore[index]
    assert all(image.name.startswith("agent_00/my_walk.mp4/") for image in model.images.values())
    assert np.median(off_px(model)) <= 1.0 and model.num_points3D() > 200
    shown_as_in_the_room(model, tmp_path / "out", walk(FRAMES), 16.0)
    stand_where_they_were(model, walk(FRAMES), 0.03)


def test_a_fisheye(fisheye: Path, tmp_path: Path) -> None:
    model, _ = exported(fisheye, tmp_path / "out", "--frames", "all")
    assert {camera.model.name for camera in model.cameras.values()} == {"PINHOLE"}
    assert np.median(off_px(model)) <= 1.0 and model.num_points3D() > 200
    assert len(model.images) == len(read_tum(fisheye / "agent_00" / "trajectory.tum"))
    shown_as_in_the_room(model, tmp_path / "out", walk(FRAMES), 12.0)
    stand_where_they_were(model, walk(FRAMES), 0.03)


def test_a_bag_of_two_robots(bag: Path, tmp_path: Path) -> None:
    model, record = exported(bag, tmp_path / "team")
    names = {image.name for image in model.images.values()}
    inside = [{name.split("/", 1)[1] for name in names if name.startswith(agent)} for agent in ("agent_00", "agent_01")]
    assert all(inside) and len(names) == len(model.images) == sum(map(len, inside))
    assert {
        path.relative_to(tmp_path / "team/images").as_posix() for path in (tmp_path / "team/images").rglob("*.png")
    } == names
    assert np.median(off_px(model)) <= 1.0
    shared = sum(
        len({model.images[e.image_id].name.split("/")[0] for e in point.track.elements}) == 2
        for point in model.points3D.values()
    )
    assert shared > 20, "points that both robots see"
    assert [a["sequence"] for a in record["models"][0]["agents"]] == ["alice", "bob"]  # type: ignore[index]
    alone, _ = exported(bag, tmp_path / "one", "--agent", "1")
    assert {image.name for image in alone.images.values()} == {f"agent_01/{name}" for name in inside[1]}
    with (tmp_path / "team" / "images.csv").open() as file:
        rows = [line.strip().split(",") for line in file][1:]
    assert {cell for row in rows for cell in row} >= names and len(rows) == len(names)
