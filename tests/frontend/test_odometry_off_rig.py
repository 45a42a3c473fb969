"""A drive through the rendered town with a rig that is not what its calibration says: images bent by a known amount."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from maslam.backend.geometry import se3_inverse
from maslam.frontend.config import OdometryConfig
from maslam.frontend.datasets import ImageSequence, open_dataset
from maslam.frontend.odometry import Odometry, OdometryResult
from maslam.frontend.vocabulary.vocabulary import Vocabulary
from maslam.tools.worlds.config import RenderConfig
from maslam.tools.worlds.dataset import render_dataset

pytestmark = pytest.mark.slow
FRAMES, OFFSET_PX, ROW_PX, ROLL_DEG, K1 = 40, -1.6, 1.2, 0.2, 0.02
SUB_PATH_M = 10.0


@pytest.fixture(scope="module")
def drive(tmp_path_factory: pytest.TempPathFactory) -> ImageSequence:
    out = tmp_path_factory.mktemp("town")
    config = RenderConfig(agents=1, frames=FRAMES, width=512, height=208, seed=4, cheap=True)
    render_dataset(config, out, workers=2)
    return open_dataset(out).sequences[0]


def bent(image: np.ndarray, sequence: ImageSequence, k1: float, right: bool) -> np.ndarray:
    """The image of a camera with radial distortion ``k1``; a right one also turned, shifted and set off."""
    camera = sequence.rig.camera
    h, w = image.shape
    x, y = np.meshgrid(np.arange(w, dtype=np.float64), np.arange(h, dtype=np.float64))
    if right:
        # From pixels of the new image back: first the shift, then the roll about the principal point.
        c, s = np.cos(np.radians(ROLL_DEG)), np.sin(np.radians(ROLL_DEG))
        u, v = x - camera.cx + OFFSET_PX, y - camera.cy - ROW_PX
        x, y = c * u + s * v + camera.cx, -s * u + c * v + camera.cy
    pixels = np.stack([x.ravel(), y.ravel()], axis=1).reshape(-1, 1, 2)
    ideal = cv2.undistortPoints(pixels, camera.K, np.array([k1, 0, 0, 0]), None, camera.K).reshape(h, w, 2)
    at = ideal.astype(np.float32)
    return cv2.remap(image, at[..., 0], at[..., 1], cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)


def driven(sequence: ImageSequence, k1: float | None, estimate: bool = True) -> tuple[OdometryResult, np.ndarray]:
    """The result, and errors of 10 m sub-paths ``(n,)`` as shares of their length; ``k1`` None: the rig as it is."""
    config = OdometryConfig.model_validate({"stereo": {"estimate_calibration": estimate}})
    odometry = Odometry(sequence.rig, config, Vocabulary.load(None))
    for i in range(len(sequence)):
        frame = sequence.read(i)
        if k1 is not None:
            left, right = np.asarray(frame.image), np.asarray(frame.right)
            frame = replace(frame, image=bent(left, sequence, k1, False), right=bent(right, sequence, k1, True))
        odometry.process(frame)
    result = odometry.finish()
    assert sequence.groundtruth is not None and not result.lost and len(result.tracks) == 1
    est, truth = result.trajectories[0].poses, sequence.groundtruth.poses
    way = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(truth[:, :3, 3], axis=0), axis=1))])
    errors = []
    for i in range(len(truth)):
        j = int(np.searchsorted(way, way[i] + SUB_PATH_M))
        if j < len(truth):
            error = se3_inverse(se3_inverse(truth[i]) @ truth[j]) @ se3_inverse(est[i]) @ est[j]
            errors.append(np.linalg.norm(error[:3, 3]) / (way[j] - way[i]))
    return result, np.array(errors)


def test_a_true_rig_is_left_true(drive: ImageSequence) -> None:
    result, errors = driven(drive, None)
    assert errors.mean() < 0.004
    stats = result.stats
    assert abs(stats["disparity_offset_px"]) < 0.1 and abs(stats["row_offset_px"]) < 0.05
    assert abs(stats["right_turn_z_deg"]) < 0.02 and abs(stats["lens_k1"]) < 0.01


def test_what_a_rig_is_off_by_is_found_and_does_not_hurt(drive: ImageSequence, tmp_path: Path) -> None:
    result, errors = driven(drive, K1)
    assert errors.mean() < 0.007
    stats = result.stats
    # The right image's content moves right by -OFFSET_PX: disparities grow by OFFSET_PX.
    assert stats["disparity_offset_px"] == pytest.approx(OFFSET_PX, abs=0.15)
    assert stats["row_offset_px"] == pytest.approx(ROW_PX, abs=0.1)
    assert stats["right_turn_z_deg"] == pytest.approx(ROLL_DEG, abs=0.03)
    assert 0.5 * K1 < stats["lens_k1"] + 0.35 * stats["lens_k2"] < 1.5 * K1
    _, without = driven(drive, K1, estimate=False)
    assert without.mean() > 3.0 * errors.mean()
