"""Masks: found or given, turned with their images, and no point lies where they are black."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
import room
from dataset_makers import (
    COUNT,
    HEIGHT,
    WIDTH,
    make_scene,
    numbered,
    own_camera,
    write_euroc,
    write_images,
    write_rendered,
)
from numpy.typing import NDArray

from maslam.backend.trajectory_error import trajectory_error
from maslam.frontend.cameras.models import RigKind
from maslam.frontend.config import OdometryConfig, StereoConfig
from maslam.frontend.datasets import ImageSequence, ReadingConfig, Severity, open_dataset
from maslam.frontend.errors import FrontendError
from maslam.frontend.image.orb_features import Detector, Pyramid
from maslam.frontend.image.used_pixels import are_used
from maslam.frontend.mapping.range_sensor import Ranging
from maslam.frontend.odometry import Odometry, OdometryResult
from maslam.frontend.tracking.initialisation import MonoStarter

MASKS = np.stack([np.full((HEIGHT, WIDTH), 255, np.uint8)] * COUNT)
for _i in range(COUNT):
    MASKS[_i, 40:, : 20 + 4 * _i] = 0


def written(folder: Path, rig: str = "stereo") -> Path:
    write_rendered(folder, make_scene(), rig)
    return folder


def opened(folder: Path, masks: Path | None = None, rig: RigKind | None = None) -> ImageSequence:
    [sequence] = open_dataset(folder, rig, reading=ReadingConfig(masks=masks)).sequences
    return sequence


def check(sequence: ImageSequence, masks: NDArray[np.uint8] = MASKS) -> None:
    for i, frame in enumerate(sequence.frames()):
        assert frame.used is not None
        np.testing.assert_array_equal(frame.used, masks[i] > 0)
        again = sequence.read(i)
        np.testing.assert_array_equal(again.used, frame.used)


NAMES = {
    "COLMAP's, beside each other": ("masks", ".png.png"),
    "COLMAP's, in the images' folder": ("masks/image_0", ".png.png"),
    "the image's": ("masks", ".png"),
    "the image's, in its folder": ("masks/image_0", ".png"),
    "the image's with another ending": ("masks", ".bmp"),
    "in mask/": ("mask", ".png"),
}


@pytest.mark.parametrize("how", NAMES)
def test_masks_are_found_by_their_names(tmp_path: Path, how: str) -> None:
    folder, suffix = NAMES[how]
    write_images(written(tmp_path) / folder, numbered(suffix), MASKS)
    sequence = opened(tmp_path)
    check(sequence)
    assert sequence.read(0).right_used is None, "the left images' masks say nothing of the right ones"
    [note] = sequence.notes
    assert f"masks {COUNT} of {COUNT} images" in note and "place descriptors see the whole images" in note
    assert f"{100 * (MASKS == 0).mean():.1f} % of the pixels give no points" in note
    assert sequence.problems == ()


@pytest.mark.parametrize("given", [True, False])
@pytest.mark.parametrize("name", ["mask.png", "camera_mask.png"])
def test_one_mask_for_all(tmp_path: Path, given: bool, name: str) -> None:
    folder = written(tmp_path / "here")
    write_images(tmp_path / ("elsewhere" if given else "here"), [name], MASKS[2:3])
    check(opened(folder, tmp_path / "elsewhere" / name if given else None), np.stack([MASKS[2]] * COUNT))


@pytest.mark.parametrize(
    ("name", "how"),
    [
        (lambda i: f"mask_{i:03d}.png", "paired by their numbers (mask_000.png is that of 000000.png)"),
        (lambda i: f"m{i + 7}.png", "as many as images, paired in order (m7.png is that of 000000.png, m12.png"),
        (lambda i: f"{'abcdefgh'[i]}.png", "as many as images, paired in order (a.png is that of 000000.png, f.png"),
    ],
)
@pytest.mark.parametrize("given", [False, True])
def test_masks_of_other_names_are_paired_by_number_or_in_order_and_said(
    tmp_path: Path, name: Callable[[int], str], how: str, given: bool
) -> None:
    folder, masks = written(tmp_path / "set"), tmp_path / ("elsewhere" if given else "set/masks")
    write_images(masks, [name(i) for i in range(COUNT)], MASKS)
    sequence = opened(folder, masks if given else None)
    check(sequence)
    assert any(f"{masks}: masks of other names than the images: {how}" in p.message for p in sequence.problems)


def test_masks_that_lack_some_are_paired_by_number_alone(tmp_path: Path) -> None:
    folder = written(tmp_path)
    write_images(folder / "masks", ["mask_2.png", "mask_4.png"], MASKS[[2, 4]])
    sequence = opened(folder)
    assert sequence.read(0).used is None
    np.testing.assert_array_equal(sequence.read(4).used, MASKS[4] > 0)
    for path in (folder / "masks").iterdir():
        path.rename(path.with_name(f"{path.stem}_of_another.png"))
    (folder / "masks" / "mask_9_of_another.png").write_bytes((folder / "masks" / "mask_2_of_another.png").read_bytes())
    sequence = opened(folder)
    assert sequence.masks is None and any("no mask of any image" in p.message for p in sequence.problems)


def test_a_mask_among_the_images_is_no_image(tmp_path: Path) -> None:
    write_images(tmp_path, [*numbered(), "mask.png"], np.concatenate([make_scene().images, MASKS[:1]]))
    (tmp_path / "camera.yaml").write_text(own_camera("rate_hz: 1\n"))
    sequence = opened(tmp_path)
    assert len(sequence) == COUNT
    check(sequence, np.stack([MASKS[0]] * COUNT))


def test_masks_of_both_cameras(tmp_path: Path) -> None:
    folder = written(tmp_path)
    write_images(folder / "masks/image_0", numbered(), MASKS)
    write_images(folder / "masks/image_1", numbered(), MASKS[::-1])
    for i, frame in enumerate(opened(folder).frames()):
        np.testing.assert_array_equal(frame.right_used, MASKS[::-1][i] > 0)


def test_any_value_but_black_is_used(tmp_path: Path) -> None:
    write_images(written(tmp_path) / "masks", numbered(), MASKS // 255)
    check(opened(tmp_path))


def test_depth_is_unknown_where_a_mask_is_black(tmp_path: Path) -> None:
    write_images(written(tmp_path, "rgbd") / "masks", numbered(), MASKS)
    for i, frame in enumerate(opened(tmp_path).frames()):
        expected = np.where(MASKS[i] > 0, make_scene().depth_mm[i] / 1000.0, 0.0)
        np.testing.assert_allclose(frame.depth_m, expected, atol=1e-6)


def test_masks_are_rectified_with_their_images(tmp_path: Path) -> None:
    """A mask that is black where the image is bright is that after rectification as well; a pixel with any part of
    black is not used."""
    scene = make_scene()
    images = np.zeros((COUNT, HEIGHT, WIDTH), np.uint8)
    images[:, 10:30, 60:90] = 255
    write_euroc(tmp_path, replace(scene, images=images))
    for cam in ("cam0", "cam1"):
        sensor = tmp_path / f"mav0/{cam}/sensor.yaml"
        sensor.write_text(sensor.read_text().replace("[0, 0, 0, 0]", "[-0.3, 0.1, 0.001, 0.002]"))
    write_images(tmp_path / "masks/cam0", [f"{stamp}.png" for stamp in scene.stamps_ns], 255 - images)
    sequence = opened(tmp_path)
    assert sequence.rectifier is not None
    for frame in sequence.frames():
        np.testing.assert_array_equal(frame.used, frame.image == 0)
        assert 0.02 < 1 - frame.used.mean() < 0.4


def test_masks_of_several_agents(tmp_path: Path) -> None:
    for name in ("agent_0", "agent_1"):
        written(tmp_path / "src" / name)
    write_images(tmp_path / "given/agent_1", numbered(), MASKS)
    (tmp_path / "given/agent_0").mkdir()
    with pytest.raises(FrontendError, match=r"agent_0: no mask of any image; that of 000000.png would be"):
        open_dataset(tmp_path / "src", reading=ReadingConfig(masks=tmp_path / "given"))
    write_images(tmp_path / "given/agent_0", numbered(), MASKS[::-1])
    first, second = open_dataset(tmp_path / "src", reading=ReadingConfig(masks=tmp_path / "given")).sequences
    check(first, MASKS[::-1])
    check(second)


def test_what_is_wrong_with_masks_is_said(tmp_path: Path) -> None:
    folder = written(tmp_path / "here")
    with pytest.raises(FrontendError, match="nowhere: no such mask"):
        opened(folder, tmp_path / "nowhere")
    write_images(folder / "masks", ["a.png"], MASKS[:1])
    [problem] = opened(folder).problems
    assert problem.severity is Severity.WARNING and "no masks are used" in problem.message
    write_images(folder / "masks", numbered(), MASKS)
    (folder / "masks/000003.png").unlink()
    sequence = opened(folder)
    [problem] = sequence.problems
    assert "no mask for 1 of 6 images (000003.png is the first): these are used whole" in problem.message
    assert sequence.read(3).used is None and sequence.read(2).used is not None
    write_images(folder / "masks", numbered(), np.zeros_like(MASKS))
    assert any("are the masks inverted" in problem.message for problem in opened(folder).problems)
    write_images(folder / "masks", numbered(), MASKS[:, ::2])
    with pytest.raises(FrontendError, match=rf"a mask of {WIDTH}x{HEIGHT // 2} pixels for images of {WIDTH}x{HEIGHT}"):
        opened(folder)


# ---- tracking

BLACK = np.full((240, 320), True)
BLACK[130:, :] = False
BLACK[:60, 200:] = False
BODY = np.random.default_rng(9).integers(0, 255, (60, 80)).astype(np.float32)
BODY = cv2.resize(BODY, (330, 240), interpolation=cv2.INTER_CUBIC).clip(0, 255).astype(np.uint8)
WALK = room.walk(24, step_m=0.1, turn_deg=2.0)


class Words:
    """A vocabulary with one word."""

    def words(self, descriptors: np.ndarray) -> np.ndarray:
        return np.zeros((len(descriptors), 2), dtype=np.int32)


def walked(kind: RigKind, masked: bool) -> tuple[OdometryResult, float]:
    """A walk with a body before the camera that moves along with it; and its error, metres."""
    scene = room.Room(5)
    config = OdometryConfig(stereo=StereoConfig(estimate_calibration=False))
    odometry = Odometry(room.rig(kind), config, Words())
    for i, T_W_C in enumerate(WALK):
        frame = scene.frame(i, T_W_C, kind)
        image = np.where(BLACK, frame.image, BODY[:, :320])
        right = None if frame.right is None else np.where(BLACK, frame.right, BODY[:, 8:328])
        depth = None if frame.depth_m is None else np.where(BLACK, frame.depth_m, np.float32(0.0 if masked else 3.0))
        used = {"used": BLACK, "right_used": BLACK} if masked else {}
        odometry.process(replace(frame, image=image, right=right, depth_m=depth, **used))
    result = odometry.finish()
    [trajectory] = result.trajectories[:1] or [None]
    if trajectory is None or len(trajectory) < len(WALK) - 6:
        return result, np.inf
    truth = WALK[np.rint(trajectory.stamps_ns / 1e8).astype(int)]
    return result, trajectory_error(trajectory.centres, truth[:, :3, 3], kind is RigKind.MONO).rmse_m


@pytest.mark.parametrize("kind", RigKind)
def test_no_point_is_where_a_mask_is_black_and_the_body_does_not_matter(kind: RigKind) -> None:
    (result, error_m), (_, without_m) = walked(kind, True), walked(kind, False)
    for views in result.views:
        assert len(views) > 500 and are_used(BLACK, views.uv.astype(np.float64)).all()
    assert error_m < 0.03 and error_m < 0.2 * without_m


ISLANDS = np.full((240, 320), True)
for _column in (70, 160, 250):
    ISLANDS[:, _column : _column + 16] = False


@pytest.mark.parametrize("kind", RigKind)
def test_points_are_not_followed_into_what_is_masked(kind: RigKind) -> None:
    """The image goes on under the mask, so that only the mask keeps points away from it."""
    scene = room.Room(5)
    config = OdometryConfig(stereo=StereoConfig(estimate_calibration=False))
    odometry = Odometry(room.rig(kind), config, Words())
    for i, T_W_C in enumerate(WALK):
        odometry.process(replace(scene.frame(i, T_W_C, kind), used=ISLANDS))
        segment = odometry._segment
        if segment is not None:
            followed = segment.tracker.followed
            assert are_used(ISLANDS, followed.uv[followed.found]).all()
    result = odometry.finish()
    assert sum(len(views) for views in result.views) > 500
    assert all(are_used(ISLANDS, views.uv.astype(np.float64)).all() for views in result.views)


def test_the_first_views_corners_are_not_followed_into_what_is_masked() -> None:
    scene = room.Room(5)
    starter = MonoStarter(
        Ranging(room.rig(RigKind.MONO), OdometryConfig().stereo, OdometryConfig().flow), OdometryConfig()
    )
    for i in range(3):
        starter.offer(replace(scene.frame(i, WALK[0 if i < 2 else 2], RigKind.MONO), used=ISLANDS))
        assert starter._views and all(are_used(ISLANDS, view.uv).all() for view in starter._views)


def test_no_disparity_is_measured_where_the_right_image_is_masked() -> None:
    frame = room.Room(5).frame(0, WALK[0], RigKind.STEREO)
    ranging = Ranging(room.rig(RigKind.STEREO), OdometryConfig().stereo, OdometryConfig().flow)
    uv = Detector(OdometryConfig().features).detect(Pyramid(frame.image, 1, 1.4), 400, np.zeros((0, 2)))[0]
    unknown = np.full(len(uv), np.nan)
    disparity, _ = ranging.measure(frame, uv, unknown)
    masked, rows = ranging.measure(replace(frame, right_used=ISLANDS), uv, unknown)
    at = uv - np.stack([disparity, np.zeros(len(uv))], axis=1)
    black = np.isfinite(disparity) & ~are_used(ISLANDS, at)
    assert black.sum() > 20 and np.isfinite(masked).sum() > 50
    assert np.isnan(masked[black]).mean() > 0.9  # rows differ by a part of a pixel
    np.testing.assert_array_equal(np.isnan(masked), np.isnan(rows))


def test_corners_keep_away_from_what_is_masked() -> None:
    scene = make_scene()
    image = cv2.resize(scene.images[0], (640, 480), interpolation=cv2.INTER_CUBIC)
    used = np.full((480, 640), True)
    used[200:300, 100:500] = False
    config = OdometryConfig().features
    uv, level, _ = Detector(config).detect(Pyramid(image, 4, 1.4, used), 800, np.zeros((0, 2)))
    assert len(uv) > 100 and len(set(level.tolist())) == 4
    assert are_used(used, uv).all()
    inside = are_used(~used, Detector(config).detect(Pyramid(image, 4, 1.4), 800, np.zeros((0, 2)))[0])
    assert inside.sum() > 10


def test_what_is_used_by_pixels() -> None:
    used = np.zeros((4, 5), dtype=bool)
    used[2, 3] = True
    at = np.array([[3.0, 2.0], [3.4, 1.6], [2.4, 2.0], [-1.0, 2.0], [5.0, 2.0], [np.nan, 2.0], [3.0, np.inf]])
    assert are_used(used, at).tolist() == [True, True, False, False, False, False, False]
    assert are_used(None, at).all()
