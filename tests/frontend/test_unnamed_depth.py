"""Depth pictures under names that do not say so: known by their content, used where it is clear how, else named; images
of 16 bits that a camera took are never taken for depth."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from dataset_makers import numbered, own_camera, texture, write_images
from numpy.typing import NDArray

from maslam.frontend.cameras.models import RigKind
from maslam.frontend.datasets import ImageSequence, ReadingConfig, Severity, open_dataset
from maslam.frontend.datasets.depth_look import DepthVerdict, look_for_depth
from maslam.frontend.errors import FrontendError

W, H, COUNT = 160, 120, 6
UNIT = "rate_hz: 20.0\ndepth_unit_m: 0.001\n"
CAMERA = f"width: {W}\nheight: {H}\nfx: 120\nfy: 120\ncx: 79.5\ncy: 59.5\n"
Depth = NDArray[np.float64]


def room(step: float, larger: int = 1) -> Depth:
    """Metres of depth in a room with a pillar, in closed form, from ``step`` metres on: planes and their edges."""
    focal = 120 * larger
    x, y = np.meshgrid(*((np.arange(n * larger) - (n * larger - 1) / 2) / focal for n in (W, H)))
    sides = [1.6 / np.abs(x + 0.03), 1.1 / np.maximum(y, 1e-9), 1.2 / np.maximum(-y, 1e-9), np.full_like(x, 4.0 - step)]
    pillar = np.where((x > -0.2 + step) & (x < 0.1 + step), 1.7 - 0.3 * x, np.inf)
    return np.min([*sides, pillar], axis=0)


def kinect(rng: np.random.Generator, step: float, larger: int = 1) -> NDArray[np.uint16]:
    """Millimetres in steps of an eighth of a pixel of disparity, with shadows beside edges."""
    true = room(step, larger)
    disparity = np.rint(8 * 580 * 0.075 / (true + rng.normal(0, 0.002, true.shape))) / 8
    depth = np.rint(1000 * 580 * 0.075 / disparity)
    shadow = cv2.dilate(true, np.ones((1, 5))) - true > 0.5
    depth[shadow | (cv2.resize(rng.normal(0, 1, (6, 8)), true.shape[::-1]) > 1.3)] = 0
    return depth.astype(np.uint16)


def time_of_flight(rng: np.random.Generator, step: float, larger: int = 1) -> NDArray[np.uint16]:
    """Millimetres with 1 % noise and flying pixels lost."""
    true = room(step, larger)
    depth = 1000 * true * (1 + rng.normal(0, 0.01, true.shape))
    depth[rng.random(true.shape) < 0.02] = 0
    return depth.astype(np.uint16)


def rendered(rng: np.random.Generator, step: float, larger: int = 1) -> NDArray[np.uint16]:
    """Exact, everywhere known, in TUM's unit."""
    return np.rint(5000 * room(step, larger)).astype(np.uint16)


def lidar(rng: np.random.Generator, step: float, larger: int = 1) -> NDArray[np.uint16]:
    """A row in six, as KITTI writes it: metres times 256, 0 between."""
    depth = np.rint(256 * 4 * room(step, larger))
    depth[np.arange(len(depth)) % 6 != 0] = 0
    return depth.astype(np.uint16)


DEPTHS = (kinect, time_of_flight, rendered, lidar)


def scene(rng: np.random.Generator, blur: float = 0.6) -> Depth:
    """A picture of things of every size, 0 to 1."""
    levels = [cv2.resize(rng.uniform(0, 1, (H >> k, W >> k)), (W, H), interpolation=cv2.INTER_CUBIC) for k in range(7)]
    image = sum(level * 2.0**k for k, level in enumerate(levels)) / 127
    return np.asarray(np.clip(cv2.GaussianBlur((image - 0.3) / 0.4, (0, 0), blur), 0, 1), dtype=np.float64)


def grey12(rng: np.random.Generator, blur: float = 0.6) -> NDArray[np.uint16]:
    """Linear, 12 bits, with shot noise, black and saturated places."""
    bright = 1.2 * scene(rng, blur) ** 2.2 - 0.02
    return np.clip(4095 * (bright + rng.normal(0, 0.004, (H, W))), 0, 4095).astype(np.uint16)


def thermal(rng: np.random.Generator) -> NDArray[np.uint16]:
    """Hundredths of a kelvin around 290 K, soft, with little noise."""
    return (29000 + 500 * scene(rng, 1.5) + rng.normal(0, 2, (H, W))).astype(np.uint16)


def masked(rng: np.random.Generator) -> NDArray[np.uint16]:
    """A fisheye's circle, black around."""
    u, v = np.meshgrid(np.linspace(-1, 1, W), np.linspace(-1, 1, H))
    return np.where(np.hypot(u, v) < 1.1, grey12(rng) + 300, 0).astype(np.uint16)


CAMERAS = {
    "10 bits": lambda rng: grey12(rng) >> 2,
    "12 bits": grey12,
    "12 bits shifted up": lambda rng: grey12(rng) << 4,
    "8 bits in 16": lambda rng: np.round(255 * scene(rng)).astype(np.uint16),
    "night": lambda rng: np.clip(30 + grey12(rng).astype(float) ** 2 / 40950, 0, 4095).astype(np.uint16),
    "soft": lambda rng: grey12(rng, 2.0),
    "thermal": thermal,
    "fisheye": masked,
}


@pytest.mark.parametrize("make", DEPTHS)
@pytest.mark.parametrize("larger", [1, 4])
def test_depth_of_every_kind_is_recognised(make: object, larger: int) -> None:
    rng = np.random.default_rng(3)
    pictures = [make(rng, 0.1 * i, larger) for i in range(3)]  # type: ignore[operator]
    assert look_for_depth(pictures).verdict is DepthVerdict.DEPTH


@pytest.mark.parametrize("kind", CAMERAS)
def test_images_of_16_bits_are_not_taken_for_depth(kind: str) -> None:
    rng = np.random.default_rng(5)
    assert look_for_depth([CAMERAS[kind](rng) for _ in range(4)]).verdict is DepthVerdict.CAMERA


def test_a_picture_without_noise_and_edges_is_doubtful() -> None:
    u, v = np.meshgrid(np.arange(W), np.arange(H))
    assert look_for_depth([(2000 + 5 * u + 3 * v).astype(np.uint16)]).verdict is DepthVerdict.DOUBT


def write(folder: Path, names: list[str], make: object, extra: str | None = None) -> None:
    """Depth by ``make``, or 8-bit colour for None, and a calibration with the lines ``extra``."""
    rng = np.random.default_rng(1)
    colour = [np.repeat((255 * scene(rng)).astype(np.uint8)[..., None], 3, axis=2) for _ in names]
    pictures = colour if make is None else [make(rng, 0.1 * i) for i in range(len(names))]  # type: ignore[operator]
    write_images(folder, names, pictures)  # type: ignore[arg-type]
    if extra is not None:
        (folder / "camera.yaml").write_text(CAMERA + extra)


def opened(folder: Path, rig: RigKind | None = None) -> ImageSequence:
    [sequence] = open_dataset(folder, rig, strict=False).sequences
    return sequence


def said(sequence: ImageSequence, severity: Severity = Severity.WARNING) -> list[str]:
    return [problem.message for problem in sequence.problems if problem.severity is severity]


@pytest.mark.parametrize("name", ["range", "image_0", "cam1", "."])
def test_depth_alone_is_refused(tmp_path: Path, name: str) -> None:
    write(tmp_path / name, numbered(), kinect, UNIT)
    with pytest.raises(FrontendError, match=r"the images are depth pictures by their content .* no camera's: put the"):
        open_dataset(tmp_path / name)


def test_depth_alone_is_tracked_where_the_user_says_that_a_camera_took_it(tmp_path: Path) -> None:
    write(tmp_path, numbered(), kinect, UNIT)
    assert len(open_dataset(tmp_path, reading=ReadingConfig(depth_by_content=False)).sequences[0]) == COUNT


@pytest.mark.parametrize("name", ["range", "d", "cam1", "right"])
def test_depth_in_a_folder_of_any_name_is_the_images_depth(tmp_path: Path, name: str) -> None:
    left = "left" if name == "right" else "rgb"
    write(tmp_path / left, numbered(), None)
    write(tmp_path / name, numbered(), kinect)
    (tmp_path / "camera.yaml").write_text(CAMERA + UNIT)
    sequence = opened(tmp_path)
    assert sequence.rig.kind is RigKind.RGBD and not sequence.right
    expected = cv2.imread(str(tmp_path / name / numbered()[2]), cv2.IMREAD_UNCHANGED) * 0.001
    np.testing.assert_allclose(sequence.read(2).depth_m, expected, atol=1e-6)
    [warning] = said(sequence)
    assert f"{tmp_path / name}: depth pictures by their content" in warning and "taken as the images' depth" in warning


def test_depth_among_the_images_is_their_depth(tmp_path: Path) -> None:
    write(tmp_path, [f"{i:04d}_c.png" for i in range(COUNT)], None, UNIT)
    write(tmp_path, [f"{i:04d}_d.png" for i in range(COUNT)], rendered)
    sequence = opened(tmp_path)
    assert sequence.rig.kind is RigKind.RGBD and len(sequence) == COUNT
    assert [path.name for path in sequence.left] == [f"{i:04d}_c.png" for i in range(COUNT)]


def test_depth_numbered_with_the_images_is_refused_with_its_share(tmp_path: Path) -> None:
    write(tmp_path, [f"{2 * i:04d}.png" for i in range(COUNT)], None, UNIT)
    write(tmp_path, [f"{2 * i + 1:04d}.png" for i in range(COUNT)], kinect)
    [error] = said(opened(tmp_path), Severity.ERROR)
    assert "of 8 looked at) are depth pictures" in error


def test_depth_without_a_unit_is_named_and_not_used(tmp_path: Path) -> None:
    write(tmp_path / "rgb", numbered(), None)
    write(tmp_path / "range", numbered(), kinect)
    (tmp_path / "camera.yaml").write_text(CAMERA + "rate_hz: 20.0\n")
    sequence = opened(tmp_path)
    assert sequence.rig.kind is RigKind.MONO
    [warning] = said(sequence)
    assert "range: depth pictures" in warning and "not used: add depth_unit_m (metres a step) to" in warning
    assert opened(tmp_path, RigKind.RGBD).rig.kind is RigKind.RGBD


def test_depth_that_belongs_to_no_image_is_named_and_not_used(tmp_path: Path) -> None:
    write(tmp_path / "rgb", numbered(), None)
    write(tmp_path / "range", [f"z_{letter}.png" for letter in "abcdef"], kinect)
    (tmp_path / "camera.yaml").write_text(CAMERA + UNIT)
    sequence = opened(tmp_path)
    assert sequence.rig.kind is RigKind.MONO
    [warning] = said(sequence)
    assert "which are not used" in warning and "neither times nor numbers in common" in warning


def test_depth_listed_as_images_is_refused(tmp_path: Path) -> None:
    write(tmp_path / "d", numbered(), kinect)
    (tmp_path / "rgb.txt").write_text("".join(f"{0.05 * i:.2f} d/{name}\n" for i, name in enumerate(numbered())))
    (tmp_path / "camera.yaml").write_text(CAMERA)
    with pytest.raises(FrontendError, match="the images are depth pictures"):
        open_dataset(tmp_path)


def test_a_second_camera_of_16_bits_is_no_depth(tmp_path: Path) -> None:
    rng = np.random.default_rng(2)
    write(tmp_path / "rgb", numbered(), None)
    write_images(tmp_path / "thermal", numbered(), [thermal(rng) for _ in range(COUNT)])  # type: ignore[arg-type]
    (tmp_path / "camera.yaml").write_text(CAMERA + UNIT)
    assert opened(tmp_path).rig.kind is RigKind.MONO and not said(opened(tmp_path))


def test_small_textures_of_8_bits_are_looked_at_as_before(tmp_path: Path) -> None:
    rng = np.random.default_rng(2)
    write_images(tmp_path, numbered(), [texture(rng) for _ in range(COUNT)])  # type: ignore[arg-type]
    (tmp_path / "camera.yaml").write_text(own_camera("rate_hz: 20.0\n"))
    assert not opened(tmp_path).problems


def test_depth_beside_a_camera_of_16_bits_is_its_depth(tmp_path: Path) -> None:
    rng = np.random.default_rng(2)
    write_images(tmp_path / "left", numbered(), [grey12(rng) for _ in range(COUNT)])  # type: ignore[arg-type]
    write(tmp_path / "z16", numbered(), kinect)
    (tmp_path / "camera.yaml").write_text(CAMERA + UNIT)
    assert opened(tmp_path).rig.kind is RigKind.RGBD


@pytest.mark.parametrize("suffix", [".npy", ".tiff"])
def test_floating_point_pictures_beside_the_images_are_named(tmp_path: Path, suffix: str) -> None:
    write(tmp_path / "rgb", numbered(), None)
    (tmp_path / "z").mkdir()
    for i in range(COUNT):
        file, depth = tmp_path / "z" / f"{i:06d}{suffix}", room(0.1 * i).astype(np.float32)
        assert suffix == ".npy" or cv2.imwrite(str(file), depth)
        if suffix == ".npy":
            np.save(file, depth)
    (tmp_path / "camera.yaml").write_text(CAMERA + UNIT)
    [warning] = said(opened(tmp_path))
    assert warning == (
        f"{tmp_path / 'z'}: pictures of floating-point numbers beside the images, which are not used: "
        "call the folder depth if they are depth in metres"
    )
    (tmp_path / "z").rename(tmp_path / "depth")
    sequence = opened(tmp_path)
    assert sequence.rig.kind is RigKind.RGBD
    np.testing.assert_allclose(sequence.read(1).depth_m, room(0.1), rtol=1e-6)


def test_depth_in_a_topic_that_is_not_called_so_is_refused(tmp_path: Path) -> None:
    pytest.importorskip("rosbags", reason="the extra `bags` is not installed")
    from recording_makers import Channel, image_message, write_ros1

    rng = np.random.default_rng(1)
    stamps = [10**18 + 50_000_000 * i for i in range(COUNT)]
    for name, pictures in (("range", [kinect(rng, 0.1 * i) for i in range(COUNT)]), ("ir", [thermal(rng)] * COUNT)):
        folder = tmp_path / name
        folder.mkdir()
        (folder / "camera.yaml").write_text(CAMERA)
        channel = Channel(
            f"/cam/{name}",
            "sensor_msgs/msg/Image",
            stamps,
            lambda store, i, pictures=pictures: image_message(store, stamps[i], pictures[i], "16UC1"),  # type: ignore[misc]
        )
        write_ros1(folder / "run.bag", [channel])
    with pytest.raises(FrontendError, match=r"run.bag: the images are depth pictures by their content"):
        open_dataset(tmp_path / "range")
    assert len(open_dataset(tmp_path / "ir").sequences[0]) == COUNT
