"""Cameras without a calibration: EXIF as another library writes it, and focal lengths that images tell, of rendered
walks whose camera is known."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
import room
from numpy.typing import NDArray
from PIL import Image
from PIL.TiffImagePlugin import IFDRational

from maslam._pycolmap import SelfCalibration
from maslam.backend.geometry import se3, so3_exp
from maslam.frontend.cameras.models import RigKind
from maslam.frontend.datasets import ImageSequence, focal_length, open_dataset
from maslam.frontend.datasets.focal_length import RefinedFocal
from maslam.frontend.files.exif import lens_tags
from maslam.tools.cli import main

SIZE, FOCAL = (room.CAMERA.width, room.CAMERA.height), room.CAMERA.fx
K1 = -0.15


def turning(count: int) -> NDArray[np.float64]:
    """``T_W_C`` of a walk that looks far to the left and to the right."""
    poses = []
    for i in range(count):
        t = i / count
        yaw = np.radians(35.0) * np.sin(2.0 * np.pi * t)
        at = [1.4 * np.sin(2.0 * np.pi * t), 0.15 * np.sin(9.0 * t), -3.5 + 3.5 * t]
        poses.append(se3(so3_exp([0.06 * np.sin(7.0 * t), yaw, 0.03 * np.sin(5.0 * t)]), at))
    return np.stack(poses)


def bent(image: NDArray[np.uint8], k1: float) -> NDArray[np.uint8]:
    """What the same camera with a lens of ``k1`` sees."""
    u, v = (np.arange(n, dtype=np.float64) for n in SIZE)
    pixels = np.stack(np.meshgrid(u, v), axis=-1).reshape(-1, 1, 2)
    at = cv2.undistortPoints(pixels, room.CAMERA.K, np.array([k1, 0, 0, 0]), None, room.CAMERA.K)
    at = at.reshape(SIZE[1], SIZE[0], 2).astype(np.float32)
    return np.asarray(cv2.remap(image, at[..., 0], at[..., 1], cv2.INTER_CUBIC, borderMode=cv2.BORDER_REFLECT))


def write_walk(folder: Path, poses: NDArray[np.float64], k1: float = 0.0) -> Path:
    """Images alone: nothing says what camera took them."""
    (folder / "images").mkdir(parents=True)
    scene = room.Room(5)
    for i, pose in enumerate(poses):
        image, _ = scene.render(pose)
        assert cv2.imwrite(str(folder / "images" / f"{i:03d}.png"), bent(image, k1) if k1 else image)
    (folder / "times.txt").write_text("".join(f"{0.1 * i:.3f}\n" for i in range(len(poses))))
    return folder


@pytest.mark.slow
def test_a_walk_without_calibration_is_tracked_with_the_camera_that_its_images_tell(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = write_walk(tmp_path / "walk", turning(30), K1)
    assert main(["inspect", str(folder)]) == 0
    assert f"no calibration file: focal length {1.2 * SIZE[0]:.1f} px taken" in capsys.readouterr().out
    words = ["preprocess", str(folder), str(tmp_path / "out"), "--quiet", "--workers", "1"]
    assert main(words) == 0
    first = capsys.readouterr().err
    manifest = json.loads((tmp_path / "out" / "manifest.json").read_text())
    stored = manifest["agents"][0]["camera"]["stored"]
    assert stored["fx"] == pytest.approx(FOCAL, rel=0.03)
    assert stored["coefficients"][0] == pytest.approx(K1, abs=0.05) and not any(stored["coefficients"][1:])
    [note] = [line for line in manifest["settings"]["problems"] if "estimated from the images" in line]
    assert f"{stored['fx']:.1f} px" in note and f"warning: {note}" in first.splitlines()
    # A second time it is taken from the store: the same, to the letter.
    monkeypatch.setattr(focal_length, "refine", None)
    assert main(words) == 0
    assert capsys.readouterr().err == first


def known(monkeypatch: pytest.MonkeyPatch, found: RefinedFocal) -> None:
    """Reconstruction takes long: what becomes of its result does not need it."""
    for module in ("maslam.frontend.datasets.focal_length", "maslam.tools.pipeline.focal_length"):
        monkeypatch.setattr(f"{module}.refine", lambda *_: found)


def test_a_focal_length_that_cannot_be_known_stays_a_guess_and_is_noted(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    known(monkeypatch, RefinedFocal(None, 0.0, "the camera turns by 4 degrees only, 10 are needed"))
    folder = write_walk(tmp_path / "walk", turning(30)[:16])
    assert main(["preprocess", str(folder), str(tmp_path / "out"), "--quiet", "--workers", "1"]) == 0
    error = capsys.readouterr().err
    assert "the focal length is a guess, 384.0 px" in error and "could not be refined: the camera turns by 4" in error
    manifest = json.loads((tmp_path / "out" / "manifest.json").read_text())
    assert manifest["agents"][0]["camera"]["fx"] == 1.2 * SIZE[0]
    assert any("could not be refined" in line for line in manifest["settings"]["problems"])


@pytest.mark.parametrize(("focal", "said"), [(FOCAL, False), (1.08 * FOCAL, True), (0.9 * FOCAL, True), (None, False)])
def test_a_calibration_of_another_camera_is_warned_of_when_asked(
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    focal: float | None,
    said: bool,
) -> None:
    known(monkeypatch, RefinedFocal(focal, 0.0, "for a reason"))
    folder = write_walk(tmp_path / "walk", turning(30)[:3])
    (folder / "camera.yaml").write_text(
        f"width: {SIZE[0]}\nheight: {SIZE[1]}\nfx: {FOCAL}\nfy: {FOCAL}\ncx: 159.5\ncy: 119.5\n"
    )
    assert main(["inspect", str(folder), "--focal"]) == 0
    out = capsys.readouterr().out
    assert "focal length  " in out and "for a reason" in out
    assert ("is the calibration of this camera" in out) == said


def run_of(focal: float, error: float, turned: float = 40.0) -> SelfCalibration:
    return SelfCalibration(focal, 0.0, 40, 2000, error, turned)


@pytest.mark.parametrize(
    ("runs", "focal", "why"),
    [
        ([], None, "could not be reconstructed"),
        ([run_of(500, 0.3, turned=4.0)], None, "turns by 4 degrees only"),
        ([run_of(500, 0.3), run_of(501, 0.3)], 1000.0, "2 first guesses within 0.2 %"),
        ([run_of(500, 0.3), run_of(510, 0.31), run_of(490, 0.32)], 1000.0, "3 first guesses within 2.0 %"),
        ([run_of(340, 0.56), run_of(500, 0.23)], None, "no two first guesses"),
        ([run_of(340, 0.56), run_of(500, 0.23), run_of(502, 0.24)], 1000.0, ""),
        ([run_of(340, 0.25), run_of(500, 0.23), run_of(502, 0.24)], None, "fit nearly alike: 1000 px, 1004 px, 680 px"),
    ],
)
def test_reconstructions_that_contradict_each_other_tell_nothing(
    runs: list[SelfCalibration], focal: float | None, why: str
) -> None:
    found = focal_length._judged(runs, 0.5)
    assert found.focal_px == focal and why in found.why


def test_the_stretch_that_turns_most_is_chosen() -> None:
    path = np.cumsum(np.where(np.arange(200)[:, None] // 20 == 6, [3.0, 0.0], [0.0, 0.1]), axis=0)
    first = focal_length._most_turned(path)
    assert first <= 120 and first + 40 >= 140


def photograph(path: Path, tags: dict[int, object], size: tuple[int, int] = (400, 300)) -> Path:
    exif = Image.Exif()
    exif[0x010F] = "a maker"
    exif.get_ifd(0x8769).update(tags)
    Image.fromarray(np.full(size[::-1], 90, dtype=np.uint8)).save(path, exif=exif)
    return path


@pytest.mark.parametrize("suffix", [".jpg", ".png"])
def test_exif_tells_the_focal_length(tmp_path: Path, suffix: str) -> None:
    path = photograph(tmp_path / f"a{suffix}", {0xA405: 26, 0x920A: IFDRational(17, 4)})
    tags = lens_tags(path)
    assert (tags.focal_35_mm, tags.focal_mm) == (26.0, 4.25)
    # 26 mm on film whose diagonal is 43.27 mm; the image's is 500 px.
    assert tags.focal_px(400, 300) == pytest.approx(26.0 / 43.2666 * 500.0, rel=1e-5)


def test_exif_of_the_sensor_counts_before_the_film_equivalent(tmp_path: Path) -> None:
    # 4 mm on a sensor of 1000 px per cm (unit 3), 4000 px wide as taken: 400 px there, 40 px after scaling to 400 px.
    tags = {0xA405: 26, 0x920A: IFDRational(40), 0xA20E: IFDRational(1000), 0xA210: 3, 0xA002: 4000}
    assert lens_tags(photograph(tmp_path / "a.jpg", tags)).focal_px(400, 300) == pytest.approx(400.0)


@pytest.mark.parametrize("damage", ["none", "cut", "zeros", "loop", "no tags", "absurd"])
def test_without_usable_exif_the_usual_focal_length_is_taken(tmp_path: Path, damage: str) -> None:
    path = photograph(tmp_path / "a.jpg", {} if damage == "no tags" else {0xA405: 60000 if damage == "absurd" else 26})
    data = path.read_bytes()
    at = data.find(b"Exif\0\0")
    if damage == "none":
        Image.open(path).save(path, exif=b"")
    elif damage == "cut":
        path.write_bytes(data[:at] + b"Exif\0\0" + data[at + 6 : at + 20] + data[at + 200 :])
    elif damage == "zeros":
        path.write_bytes(data[: at + 6] + bytes(60) + data[at + 66 :])
    elif damage == "loop":
        path.write_bytes(data[: at + 10] + b"\xff\xff\xff\xff" + data[at + 14 :])
    assert lens_tags(path).focal_px(400, 300) is None


def test_a_folder_of_photographs_begins_with_the_focal_length_of_exif(tmp_path: Path) -> None:
    for i in range(3):
        photograph(tmp_path / f"{i}.jpg", {0xA405: 26})
    [sequence] = open_dataset(tmp_path).sequences
    assert sequence.rig.kind is RigKind.MONO and sequence.focal_guess == "EXIF of 0.jpg"
    assert sequence.rig.camera.fx == pytest.approx(300.46, abs=0.01)
    assert (sequence.rig.camera.cx, sequence.rig.camera.cy) == (199.5, 149.5)


def test_a_calibrated_sequence_is_no_guess(tmp_path: Path) -> None:
    photograph(tmp_path / "0.jpg", {0xA405: 26})
    photograph(tmp_path / "1.jpg", {0xA405: 26})
    (tmp_path / "camera.yaml").write_text("width: 400\nheight: 300\nfx: 250\nfy: 250\ncx: 199.5\ncy: 149.5\n")
    [sequence] = open_dataset(tmp_path).sequences
    assert isinstance(sequence, ImageSequence) and sequence.focal_guess == "" and sequence.rig.camera.fx == 250.0
    assert replace(sequence, focal_guess="x").focal_guess == "x"
