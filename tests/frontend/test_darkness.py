"""A frame that is lost in the dark says so: rendered and real images made dark, with the noise of a sensor."""

from __future__ import annotations

import os
from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import room
from numpy.typing import NDArray

from maslam.backend.geometry import umeyama
from maslam.frontend.cameras.models import RigKind
from maslam.frontend.config import OdometryConfig
from maslam.frontend.datasets import open_dataset
from maslam.frontend.frames import Frame
from maslam.frontend.odometry import Odometry
from maslam.frontend.tracking.darkness import brightness
from maslam.frontend.vocabulary.vocabulary import Vocabulary

DATA = Path(os.environ.get("MASLAM_DATA", Path(__file__).parents[3] / "shared" / "data"))
Grey = NDArray[np.uint8]


def darkened(frame: Frame, gain: float, noise: float) -> Frame:
    """The frame with this share of its light; ``noise``: one sigma, grey levels."""
    rng = np.random.default_rng(frame.index)

    def dark(image: Grey) -> Grey:
        return np.clip(np.rint(gain * image + rng.normal(0, noise, image.shape)), 0, 255).astype(np.uint8)

    return replace(frame, image=dark(frame.image), right=None if frame.right is None else dark(frame.right))


def refusals(odometry: Odometry, frames: list[Frame]) -> Counter[str]:
    results = [odometry.process(frame) for frame in frames]
    assert all(("too dark" in r.reason) == (r.kind == "too dark") for r in results)
    return Counter(r.kind for r in results if r.T_W_C is None)


@pytest.mark.parametrize("kind", list(RigKind))
@pytest.mark.parametrize(("gain", "noise"), [(0.0, 0.0), (0.02, 1.0), (0.02, 3.0), (0.05, 1.0), (0.05, 3.0)])
def test_a_room_without_light_is_too_dark_at_the_start_and_on_the_way(kind: RigKind, gain: float, noise: float) -> None:
    scene, poses = room.Room(3), room.walk(40)
    frames = [scene.frame(i, pose, kind) for i, pose in enumerate(poses)]
    odometry = Odometry(room.rig(kind), OdometryConfig(), Vocabulary.load())
    never = refusals(odometry, [darkened(f, gain, noise) for f in frames[:12]])
    assert set(never) <= {"too dark"} and (gain > 0.02 or never["too dark"] >= 11)
    odometry = Odometry(room.rig(kind), OdometryConfig(), Vocabulary.load())
    light = refusals(odometry, frames[:20])
    assert "too dark" not in light
    lost = refusals(odometry, [darkened(f, gain, noise) for f in frames[20:]])
    # Where noise does not cover the image it may be followed, and then the pose is the camera's.
    assert set(lost) <= {"too dark"} and (gain > noise / 100 or lost["too dark"] >= 18)
    result = odometry.finish()
    intervals = [one for one in result.lost if one.first_ns >= frames[20].stamp_ns]
    assert all(one.kind == "too dark" for one in intervals)
    for trajectory in result.trajectories[:1]:
        truth = poses[np.rint(trajectory.stamps_ns / 1e8).astype(int), :3, 3]
        in_light = trajectory.stamps_ns < frames[20].stamp_ns
        aligned = umeyama(truth[in_light], trajectory.centres[in_light], kind is RigKind.MONO) @ trajectory.centres
        assert np.linalg.norm(aligned - truth, axis=1).max() < 0.06


def test_other_images_are_not_too_dark() -> None:
    """A bright wall, a grey one, a standing camera: another reason; a night with lamps is no darkness."""
    scene, pose = room.Room(3), room.walk(1)[0]
    for level in (60, 128, 255):
        odometry = Odometry(room.rig(RigKind.MONO), OdometryConfig(), Vocabulary.load())
        wall = scene.frame(0, pose, RigKind.MONO)
        assert "too dark" not in refusals(odometry, [replace(wall, image=np.full_like(wall.image, level))])
    odometry = Odometry(room.rig(RigKind.MONO), OdometryConfig(), Vocabulary.load())
    still = refusals(odometry, [scene.frame(i, pose, RigKind.MONO) for i in range(5)])
    assert still["the camera stands still"] == 4 and "too dark" not in still
    night = np.zeros((240, 320), dtype=np.uint8)
    assert brightness(night) == 0
    night[:, :24] = 200
    assert brightness(night) == 200


def test_a_frame_without_its_second_image_says_that() -> None:
    """Black and without its right image: that a file is missing is what can be mended."""
    frame = room.Room(3).frame(0, room.walk(1)[0], RigKind.STEREO)
    odometry = Odometry(room.rig(RigKind.STEREO), OdometryConfig(), Vocabulary.load())
    black = replace(frame, image=np.zeros_like(frame.image), right=None)
    assert refusals(odometry, [black]) == {"the right image is missing": 1}


@pytest.mark.realdata
@pytest.mark.slow
@pytest.mark.parametrize("name", ["kitti00_first200", "kitti_stereo_1", "redkitchen_first300"])
def test_real_images_made_dark_are_too_dark(name: str) -> None:
    if not (DATA / name).is_dir():
        pytest.skip(f"{DATA / name} is absent (MASLAM_DATA names the folder of the real data)")
    sequence = open_dataset(DATA / name).sequences[0]
    for gain, noise in ((0.02, 3.0), (0.05, 2.0)):
        odometry = Odometry(sequence.rig, OdometryConfig(), Vocabulary.load())
        frames = [sequence.read(i) for i in range(26)]
        assert "too dark" not in refusals(odometry, frames[:14])
        lost = refusals(odometry, [darkened(f, gain, noise) for f in frames[14:]])
        assert set(lost) == {"too dark"}
