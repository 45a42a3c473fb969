"""``maslam calibrate`` on images of a board, made pixel by pixel from the rays of a camera that is known."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from maslam.frontend.cameras.calibration import Distortion
from maslam.frontend.cameras.calibration_files import read_calibration
from maslam.tools.calibration.film import frames_of
from maslam.tools.cli import main

SIZE = (320, 240)
K = np.array([[262.0, 0, 163.5], [0, 265.0, 117.0], [0, 0, 1.0]])
RADTAN = np.array([-0.21, 0.06, 0.0012, -0.0008])
FISHEYE_K = np.array([[150.0, 0, 163.5], [0, 151.0, 117.0], [0, 0, 1.0]])
FISHEYE = np.array([-0.03, 0.01, -0.004, 0.001])
POINTS = (7, 5)
"""Inner corners."""
FINER = 3


def rays(fisheye: bool) -> NDArray[np.float64]:
    """Viewing directions ``(h, w, 2)``, x/z and y/z, of an image ``FINER`` times as fine."""
    u, v = ((np.arange(FINER * n) + 0.5) / FINER - 0.5 for n in SIZE)
    pixels = np.stack(np.meshgrid(u, v), axis=-1).reshape(-1, 1, 2)
    if fisheye:
        xy = cv2.fisheye.undistortPoints(pixels, FISHEYE_K, FISHEYE)
    else:
        criteria = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 50, 1e-12)
        xy = cv2.undistortPoints(pixels, K, RADTAN, criteria=criteria)
    return xy.reshape(FINER * SIZE[1], FINER * SIZE[0], 2)


def picture(directions: NDArray[np.float64], turn_deg: tuple[float, float, float], place: tuple[float, ...]) -> NDArray:
    """A chessboard with a white border, squares of side 1, whose middle stands at ``place`` in the camera's frame."""
    R, _ = cv2.Rodrigues(np.radians(np.array(turn_deg)))
    d = np.concatenate([directions, np.ones((*directions.shape[:2], 1))], axis=-1) @ R
    start = -np.array(place) @ R
    at = start[:2] - d[..., :2] * (start[2] / d[..., 2:])
    column, row = at[..., 0] + (POINTS[0] + 1) / 2, at[..., 1] + (POINTS[1] + 1) / 2
    inside = (column > 0) & (row > 0) & (column < POINTS[0] + 1) & (row < POINTS[1] + 1)
    dark = inside & ((np.floor(column) + np.floor(row)) % 2 == 0)
    fine = np.where(dark, 40.0, 215.0)
    return fine.reshape(SIZE[1], FINER, SIZE[0], FINER).mean(axis=(1, 3))


def views(
    count: int, tilt_deg: float, spread: float, seed: int = 1
) -> list[tuple[tuple[float, ...], tuple[float, ...]]]:
    """Slants and places of the board, in squares."""
    rng = np.random.default_rng(seed)
    out = []
    for _ in range(count):
        turn = rng.uniform(-1, 1, 3) * [tilt_deg, tilt_deg, tilt_deg / 2]
        z = rng.uniform(9.0, 14.0)
        out.append((tuple(turn), (rng.uniform(-0.27, 0.27) * z * spread, rng.uniform(-0.22, 0.22) * z * spread, z)))
    return out


def images(
    fisheye: bool = False, count: int = 24, tilt_deg: float = 35.0, spread: float = 1.0
) -> list[NDArray[np.uint8]]:
    directions, rng = rays(fisheye), np.random.default_rng(2)
    nearer = 0.6 if fisheye else 1.0
    out = []
    for turn, place in views(count, tilt_deg, spread):
        seen = picture(directions, turn, tuple(np.array(place) * nearer))  # type: ignore[arg-type]
        out.append(np.clip(np.rint(seen + rng.normal(0, 2.0, seen.shape)), 0, 255).astype(np.uint8))
    return out


def write_folder(folder: Path, made: list[NDArray[np.uint8]]) -> Path:
    folder.mkdir()
    for i, image in enumerate(made):
        assert cv2.imwrite(str(folder / f"{i:03d}.png"), image)
    return folder


def write_film(path: Path, made: list[NDArray[np.uint8]], repeat: int) -> Path:
    """A film that rests on each view, blurred by motion in all frames but the last of each."""
    film = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*"MJPG"), 10.0, SIZE, True)
    for image in made:
        for k in range(repeat):
            seen = cv2.blur(image, (9, 1)) if k < repeat - 1 else image
            film.write(cv2.cvtColor(seen, cv2.COLOR_GRAY2BGR))
    film.release()
    return path


POINTS_OPTION = ("--points", f"{POINTS[0]}x{POINTS[1]}", "--quiet")


@pytest.mark.parametrize("fisheye", [False, True], ids=["radial-tangential", "equidistant"])
def test_a_known_camera_is_found_with_its_uncertainty(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], fisheye: bool
) -> None:
    folder = write_folder(tmp_path / "board", images(fisheye, spread=1.8 if fisheye else 1.0))
    out, png = tmp_path / "camera.yaml", tmp_path / "cover.png"
    model = "equidistant" if fisheye else "radial-tangential"
    assert (
        main(["calibrate", str(folder), str(out), *POINTS_OPTION, "--model", model, "--png", str(png), "--json"]) == 0
    )
    found = json.loads(capsys.readouterr().out)
    true_K, true_lens = (FISHEYE_K, FISHEYE) if fisheye else (K, RADTAN)
    truth = [true_K[0, 0], true_K[1, 1], true_K[0, 2], true_K[1, 2], *true_lens]
    for (name, one), true in zip(found["parameters"].items(), truth, strict=True):
        assert abs(one["value"] - true) < max(5.0 * one["sigma"], 1e-4), name
    assert abs(found["parameters"]["fx"]["value"] / true_K[0, 0] - 1.0) < 0.005
    assert (
        found["rms_px"] < 0.3
        and found["covered"] > 0.6
        and not found["warnings"]
        and found["parameters"]["fx"]["sigma"] < 1.0
    )
    # The file is read back by the front end as what was found.
    camera = read_calibration(out).left
    assert camera.size == SIZE and camera.distortion is Distortion(model)
    read = (camera.fx, camera.fy, camera.cx, camera.cy, *camera.coefficients)
    assert read == tuple(one["value"] for one in found["parameters"].values())
    # OpenCV reads it too.
    stored = cv2.FileStorage(str(out), cv2.FILE_STORAGE_READ)
    np.testing.assert_array_equal(stored.getNode("camera_matrix").mat(), camera.K)
    picture = cv2.imread(str(png))
    assert picture is not None and picture.shape[:2] == (720, 960)


def test_a_film_gives_its_sharp_views(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    film = write_film(tmp_path / "board.avi", images(count=16), repeat=5)
    out = tmp_path / "camera.yaml"
    assert main(["calibrate", str(film), str(out), *POINTS_OPTION, "--views", "12", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["frames"] == 80 and 8 <= len(found["views_used"]) <= 12
    assert all(int(name.split()[1]) % 5 == 4 for name in found["views_used"])
    assert abs(found["parameters"]["fx"]["value"] / K[0, 0] - 1.0) < 0.01


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (lambda: images(count=5), "only 5 sharp views of the board; 8 are needed"),
        (lambda: images(count=12, tilt_deg=2.0), "slants differ by"),
        (lambda: [np.full(SIZE[::-1], 90, dtype=np.uint8)] * 3, "no chessboard of 7x5 points in 3 frames"),
        (
            lambda: [*images(count=9), np.zeros((100, 100), dtype=np.uint8)],
            "100x100 pixels, but the images before have",
        ),
    ],
    ids=["few", "alike", "none", "sizes"],
)
def test_what_does_not_determine_a_camera_is_refused_in_a_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], make: object, said: str
) -> None:
    folder = write_folder(tmp_path / "board", make())  # type: ignore[operator]
    assert main(["calibrate", str(folder), str(tmp_path / "camera.yaml"), *POINTS_OPTION]) == 1
    error = capsys.readouterr().err.splitlines()
    assert said in error[-1] and error[-1].startswith("maslam: ")
    assert not (tmp_path / "camera.yaml").exists()


def test_a_corner_of_the_image_alone_is_not_enough(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    small = []
    for turn, _ in views(10, 35.0, 0.0):
        small.append(np.rint(picture(rays(False), turn, (-5.0, -4.0, 18.0))).astype(np.uint8))  # type: ignore[arg-type]
    folder = write_folder(tmp_path / "board", small)
    assert main(["calibrate", str(folder), str(tmp_path / "camera.yaml"), *POINTS_OPTION]) == 1
    assert " % are needed" in capsys.readouterr().err.splitlines()[-1]


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--points", "7"], "--points 7"),
        (["--points", "2x9"], "at least 3"),
        (["--marker", "2"], "--marker 2"),
        (["--dictionary", "X"], "--dictionary X"),
        (["--views", "3"], "--views 3"),
    ],
)
def test_wrong_options(tmp_path: Path, capsys: pytest.CaptureFixture[str], words: list[str], said: str) -> None:
    assert main(["calibrate", str(tmp_path), str(tmp_path / "camera.yaml"), *words]) == 2
    assert said in capsys.readouterr().err


def test_sources_that_are_none(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "film.mp4").write_bytes(b"no film")
    for source, said in (("film.mp4", "not a film"), ("nowhere", "no such file"), ("", "no images")):
        assert main(["calibrate", str(tmp_path / source), str(tmp_path / "camera.yaml"), "--quiet"]) == 1
        assert said in capsys.readouterr().err


@pytest.mark.parametrize("kind", ["charuco", "circles", "asymmetric-circles"])
def test_other_boards_are_found_where_they_are(kind: str) -> None:
    """OpenCV's own picture of the board under a known homography."""
    from maslam.tools.calibration.board import Board, BoardKind

    board = Board(BoardKind(kind), *((6, 5) if kind == "charuco" else (4, 7)))
    step = 40
    if kind == "charuco":
        markers = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50)
        drawn = cv2.aruco.CharucoBoard((6, 5), 1.0, 0.75, markers).generateImage((6 * step, 5 * step))
        origin = -0.5  # the first corner of the first square lies at (0, 0)
    else:
        points = board._points()[:, :2]
        drawn = np.full((8 * step, 6 * step), 255, dtype=np.uint8)
        radius = 8 if kind == "asymmetric-circles" else 12
        for x, y in points:
            cv2.circle(drawn, (round((x + 1) * step), round((y + 1) * step)), radius, 0, -1, cv2.LINE_AA)
        origin = float(step)
    H = np.array([[0.9, 0.08, 70.0], [-0.05, 0.92, 60.0], [0.0002, 0.0001, 1.0]])
    seen = cv2.warpPerspective(drawn, H, (440, 420), borderValue=255, flags=cv2.INTER_AREA)
    found = board.find(np.asarray(seen, dtype=np.uint8))
    assert found is not None
    points, uv = found
    expected = cv2.perspectiveTransform((points[:, None, :2] * step + origin), H)[:, 0]
    assert len(uv) >= 12 and np.abs(uv - expected).max() < 1.0


def test_images_of_12_bits_in_16_are_seen_in_their_own_range(tmp_path: Path) -> None:
    [image] = images(count=1)
    assert cv2.imwrite(str(tmp_path / "deep.png"), (image.astype(np.uint16) << 4) + 7)
    count, frames = frames_of(tmp_path, 1)
    [(name, grey)] = frames
    assert (count, name, grey.dtype) == (1, "deep.png", np.uint8)
    assert np.corrcoef(grey.ravel(), image.ravel())[0, 1] > 0.999 and np.ptp(grey) > 0.7 * np.ptp(image)
