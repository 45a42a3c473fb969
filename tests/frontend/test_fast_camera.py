"""One camera that drives fast: what passes near it is found again although flow loses it."""

from __future__ import annotations

import numpy as np
from room import Room, rig

from maslam.backend.geometry import se3, umeyama
from maslam.frontend.cameras.models import RigKind
from maslam.frontend.config import OdometryConfig
from maslam.frontend.odometry import Odometry
from maslam.frontend.vocabulary.vocabulary import Vocabulary


def test_a_drive_that_flow_alone_loses_is_tracked_to_its_end() -> None:
    """Down a corridor of 6 m by 4 m: slow at first, then 0.9 m a frame, which moves near points by half an image."""
    corridor = Room(3, np.array([3.0, 2.0, 30.0]))
    along = -25.0 + np.cumsum([0.3] * 6 + [0.9] * 16)
    truth = np.array([[0.3 * np.sin(k / 5.0), 0.0, z] for k, z in enumerate(along)])
    odometry = Odometry(rig(RigKind.MONO), OdometryConfig(), Vocabulary.load(None))
    found = [odometry.process(corridor.frame(k, se3(np.eye(3), p), RigKind.MONO)).T_W_C for k, p in enumerate(truth)]
    tracked = [k for k, T in enumerate(found) if T is not None]
    assert len(tracked) >= 20 and tracked[-1] == 21
    centres = np.array([T[:3, 3] for T in found if T is not None])
    apart = np.linalg.norm(umeyama(truth[tracked], centres, with_scale=True) @ centres - truth[tracked], axis=1)
    assert np.sqrt((apart**2).mean()) < 0.1
    assert len(odometry.finish().tracks) == 1
