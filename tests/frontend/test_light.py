"""A light that goes out for some frames of a walk, stays out, or falls slowly: rendered rooms with exact truth."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest
import room

from maslam.backend.geometry import umeyama
from maslam.frontend.cameras.models import RigKind
from maslam.frontend.config import OdometryConfig
from maslam.frontend.frames import Frame
from maslam.frontend.mapping.map import MapKeyFrame
from maslam.frontend.odometry import FrameResult, Odometry, OdometryResult
from maslam.frontend.tracking import light
from maslam.frontend.tracking.darkness import TOO_DARK, brightness, is_dark
from maslam.frontend.tracking.tracker import Tracker
from maslam.frontend.vocabulary.vocabulary import Vocabulary

WALK = room.walk(40, step_m=0.12, turn_deg=1.6)
FALL = 20
"""The frame in which the light goes out."""


@cache
def walk(kind: RigKind) -> list[Frame]:
    scene = room.Room(3)
    return [scene.frame(i, pose, kind) for i, pose in enumerate(WALK)]


def film(kind: RigKind, shine: Callable[[int], float]) -> tuple[OdometryResult, list[FrameResult]]:
    """The walk with the share ``shine`` of its light in each frame."""
    odometry = Odometry(room.rig(kind), OdometryConfig(), Vocabulary.load())
    results = []
    for i, frame in enumerate(walk(kind)):
        image, right = (
            None if picture is None else (shine(i) * picture).astype(np.uint8) for picture in (frame.image, frame.right)
        )
        assert image is not None
        results.append(odometry.process(replace(frame, image=image, right=right)))
    return odometry.finish(), results


def error_m(result: OdometryResult, kind: RigKind) -> float:
    """Largest error of a position after alignment."""
    (trajectory,) = result.trajectories
    truth = WALK[np.rint(trajectory.stamps_ns / 1e8).astype(int), :3, 3]
    aligned = umeyama(truth, trajectory.centres, kind is RigKind.MONO) @ trajectory.centres
    return float(np.linalg.norm(aligned - truth, axis=1).max())


@pytest.mark.parametrize("kind", [RigKind.MONO, RigKind.STEREO])
@pytest.mark.parametrize(("count", "share"), [(3, 0.02), (6, 0.02), (3, 0.03), (8, 0.03)])
def test_some_dim_frames_of_a_walk_cost_no_frame(kind: RigKind, count: int, share: float) -> None:
    result, frames = film(kind, lambda i: share if FALL <= i < FALL + count else 1.0)
    assert len(result.tracks) == 1 and all(frame.T_W_C is not None for frame in frames[FALL:])
    assert error_m(result, kind) < 0.06
    # Poses without light are not to be relied on, and it is said; those in the light are.
    assert all(frame.doubt for frame in frames[FALL : FALL + count])
    assert any(one.kind == TOO_DARK for one in result.doubtful) and not any(frame.doubt for frame in frames[:FALL])


@pytest.mark.parametrize("kind", [RigKind.MONO, RigKind.STEREO])
def test_key_frames_made_without_light_do_not_end_the_track(kind: RigKind, monkeypatch: pytest.MonkeyPatch) -> None:
    """Where the light stays out so long that they are needed, the points from before are found when it is back."""
    monkeypatch.setattr(light, "_ENOUGH", 1000)
    result, frames = film(kind, lambda i: 0.02 if FALL <= i < FALL + 3 else 1.0)
    assert any(frame.is_keyframe for frame in frames[FALL : FALL + 3])
    assert len(result.tracks) == 1 and all(frame.T_W_C is not None for frame in frames[FALL + 3 :])
    assert error_m(result, kind) < 0.06


@pytest.mark.parametrize("kind", [RigKind.MONO, RigKind.STEREO])
@pytest.mark.parametrize("falls", [True, False])
def test_what_stays_dim_but_can_be_followed_is_followed(kind: RigKind, falls: bool) -> None:
    """From a frame on, and from the first: then it makes its key-frames as ever."""
    result, frames = film(kind, lambda i: 0.08 if i >= FALL or not falls else 1.0)
    assert len(result.tracks) == 1 and all(frame.T_W_C is not None for frame in frames[FALL:])
    assert falls or sum(frame.is_keyframe for frame in frames[FALL:]) >= 5


def test_an_evening_is_no_light_that_goes_out() -> None:
    """Each key-frame is a little darker than the one before."""
    lamp, image = light.AmbientLight(), np.full((48, 64), 200, dtype=np.uint8)
    tracker, latest = cast(Tracker, None), cast(MapKeyFrame, SimpleNamespace(number=0))
    for share in 0.95 ** np.arange(80):
        dim = (share * image).astype(np.uint8)
        lamp.look(dim, tracker, latest)
        assert not lamp.out and lamp.allows_keyframe(20, OdometryConfig().pose)
        lamp.at_keyframe(dim)
    lamp.look(image, tracker, latest)
    lamp.at_keyframe(image)
    lamp.look((0.05 * image).astype(np.uint8), tracker, latest)
    assert lamp.out and not lamp.allows_keyframe(60, OdometryConfig().pose)
    assert lamp.allows_keyframe(59, OdometryConfig().pose)


def test_dark_is_what_is_not_bright() -> None:
    rng = np.random.default_rng(0)
    for top in (5, 19, 20, 21, 22, 40, 255):
        image = rng.integers(0, top + 1, (48, 64)).astype(np.uint8)
        for share in (0.0, 0.04, 0.05, 0.06, 0.5):
            lit = np.where(rng.random(image.shape) < share, 200, image).astype(np.uint8)
            assert is_dark(lit) == (brightness(lit) <= 20)
