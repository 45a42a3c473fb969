"""Finished runs to export, made once: two agents in one frame, the same two apart, a team of two different cameras."""

from __future__ import annotations

import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

import maslam

BENT_FOCAL_PX, BENT_LENS = 230.0, (-0.25, 0.06, 0.001, -0.0005)
BENT_TURN, BASELINE_M = (0.05, -0.04, 0.02), 0.54  # of the right camera in the left one: rotation vector, radians
SIZE = (320, 180)


class Lonely(maslam.Policy):
    """Asks nobody, so that nobody finds anybody."""

    def ask(self, state: maslam.AgentState, outlook: maslam.Outlook, keyframe: int) -> list[int]:
        return []

    def optimise(self, state: maslam.AgentState, outlook: maslam.Outlook) -> list[int]:
        return []

    def buy(self, state: maslam.AgentState, outlook: maslam.Outlook) -> list[int]:
        return []


@pytest.fixture(scope="session")
def finished(town_stereo: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The RUN folder of two agents with equal stereo cameras, who are in one frame."""
    out = tmp_path_factory.mktemp("finished") / "run"
    assert maslam.slam(town_stereo, out, seed=3).summary.groups == [[0, 1]]
    return out


@pytest.fixture(scope="session")
def apart(finished: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The same two, who never ask each other."""
    out = tmp_path_factory.mktemp("apart") / "run"
    run = maslam.run(finished / "sequences", out, policy=Lonely())
    assert run.summary.groups == [[0], [1]]
    return out


@pytest.fixture(scope="session")
def bent_images(town_stereo: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """agent_00 as rendered; agent_01 through another, bent lens, calibrated by Kalibr."""
    folder = tmp_path_factory.mktemp("bent") / "team"
    shutil.copytree(town_stereo / "agent_00", folder / "agent_00")
    source, bent = town_stereo / "agent_01", folder / "agent_01"
    R_left_right = cv2.Rodrigues(np.array(BENT_TURN))[0]
    for side, turn in (("image_0", np.eye(3)), ("image_1", R_left_right)):
        (bent / side).mkdir(parents=True)
        for path in sorted((source / side).iterdir()):
            cv2.imwrite(
                str(bent / side / path.name), cv2.remap(cv2.imread(str(path)), *_bent_maps(turn), cv2.INTER_CUBIC)
            )
    for name in ("times.txt", "poses.txt"):
        shutil.copyfile(source / name, bent / name)
    lens = f"[{', '.join(map(str, BENT_LENS))}]"
    middle = f"{BENT_FOCAL_PX}, {BENT_FOCAL_PX}, 159.5, 89.5"
    keys = {
        "camera_model": "pinhole",
        "intrinsics": f"[{middle}]",
        "distortion_model": "radtan",
        "distortion_coeffs": lens,
        "resolution": f"[{SIZE[0]}, {SIZE[1]}]",
    }
    lines = [f"{key}: {value}" for key, value in keys.items()]
    text = "cam0:\n" + "".join(f"  {line}\n" for line in lines)
    text += f"cam1:\n  T_cn_cnm1: {T_right_left().tolist()}\n"
    text += "".join(f"  {line}\n" for line in lines)
    (bent / "camchain.yaml").write_text(text)
    return folder


@pytest.fixture(scope="session")
def two_cameras(bent_images: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The RUN folder of agents whose cameras differ, who are in one frame."""
    out = tmp_path_factory.mktemp("two_cameras") / "run"
    assert maslam.slam(bent_images, out, seed=3).summary.groups == [[0, 1]]
    return out


def T_right_left() -> NDArray[np.float64]:
    """``(4, 4)``: from the left bent camera to the right one."""
    T_left_right = np.eye(4)
    T_left_right[:3, :3], T_left_right[0, 3] = cv2.Rodrigues(np.array(BENT_TURN))[0], BASELINE_M
    return np.linalg.inv(T_left_right)


@pytest.fixture(scope="session")
def R_rectified_left() -> NDArray[np.float64]:
    """``(3, 3)``: how OpenCV turns the left bent camera so that rows of both are common."""
    T, none, K = T_right_left(), np.zeros(4), np.eye(3)
    return cv2.stereoRectify(K, none, K, none, (2, 2), T[:3, :3].copy(), T[:3, 3:].copy())[0]


def rendered_K() -> NDArray[np.float64]:
    """Of the camera that the town is rendered with: 84 degrees wide."""
    focal = 177.69800237267086
    return np.array([[focal, 0.0, 159.5], [0.0, focal, 89.5], [0.0, 0.0, 1.0]])


def _bent_maps(R_left_own: NDArray[np.float64]) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Where each pixel of a bent image, of a camera turned by ``R_left_own``, lies in the rendered one."""
    u, v = np.meshgrid(np.arange(SIZE[0], dtype=np.float64), np.arange(SIZE[1], dtype=np.float64))
    K = np.array([[BENT_FOCAL_PX, 0.0, 159.5], [0.0, BENT_FOCAL_PX, 89.5], [0.0, 0.0, 1.0]])
    criteria = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 100, 1e-12)
    pixels = np.stack([u.ravel(), v.ravel()], axis=1)[:, None]
    at = cv2.undistortPoints(pixels, K, np.array(BENT_LENS), R=R_left_own, P=rendered_K(), criteria=criteria)
    at = at.reshape(SIZE[1], SIZE[0], 2).astype(np.float32)
    return at[..., 0], at[..., 1]
