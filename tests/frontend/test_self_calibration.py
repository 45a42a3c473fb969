"""The residual calibration of a rig against finite differences of a camera that has it, and against its own inverse."""

from __future__ import annotations

import cv2
import numpy as np

from maslam.frontend.estimation.self_calibration import (
    LENS,
    N_ALL,
    N_LENS,
    RIGHT,
    CalibrationFilter,
    basis,
    distort,
    pair_shift,
    physical,
    prior_information,
    undistort,
    with_rows,
)

CAM = np.array([700.0, 700.0, 600.0, 180.0, 380.0])
WIDTH, HEIGHT = 1200, 370
SMALL = 1e-4


def pixels(count: int = 300, seed: int = 3) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    return rng.uniform([0, 0], [WIDTH, HEIGHT], (count, 2)), rng.uniform(2.0, 60.0, count)


def by_opencv(rays: np.ndarray, turn: np.ndarray, lens: np.ndarray, shift: np.ndarray) -> np.ndarray:
    K = np.array([[CAM[0], 0, CAM[2] + shift[0]], [0, CAM[1], CAM[3] + shift[1]], [0, 0, 1]])
    return cv2.projectPoints(rays, turn, np.zeros(3), K, lens)[0].reshape(-1, 2)


def test_the_model_is_that_of_a_camera_with_opencvs_lens_turned_a_little() -> None:
    uv, disparity = pixels()
    n = len(uv)
    ideal = np.column_stack([(uv - CAM[2:4]) / CAM[:2], np.ones(n)])
    right = ideal - np.column_stack([disparity / CAM[0], np.zeros((n, 2))])
    phi = basis(uv, disparity, CAM, N_ALL)
    zero = np.zeros(5)
    plain = by_opencv(ideal, np.zeros(3), zero, np.zeros(2)), by_opencv(right, np.zeros(3), zero, np.zeros(2))
    places = {"k1": 0, "k2": 1, "p1": 2, "p2": 3, "q1": 2, "q2": 3, "m1": 0}
    for k, name in enumerate(LENS + RIGHT):
        lens, turn, shift = zero.copy(), np.zeros(3), np.zeros(2)
        if name in places:
            lens[places[name]] = SMALL
        elif name[0] == "w":
            turn["xyz".index(name[1])] = SMALL
        else:
            shift["xy".index(name[1])] = SMALL * CAM[0]
        moved_left = by_opencv(ideal, np.zeros(3), lens, np.zeros(2)) - plain[0] if name in LENS else np.zeros((n, 2))
        moved_right = by_opencv(right, turn, lens, shift) - plain[1]
        d_change, row_change = moved_left[:, 0] - moved_right[:, 0], moved_right[:, 1] - moved_left[:, 1]
        expected = np.column_stack([moved_left, d_change, row_change])
        np.testing.assert_allclose(phi[:, :, k] * SMALL * CAM[0], expected, atol=3e-4, err_msg=name)


def test_bending_undoes_straightening_for_what_rectification_leaves() -> None:
    parameters = np.random.default_rng(0).normal(0.0, 4.0, N_ALL)
    uv, _ = pixels()
    assert np.abs(undistort(uv, CAM, parameters) - uv).max() > 1.0
    np.testing.assert_allclose(distort(undistort(uv, CAM, parameters), CAM, parameters), uv, atol=0.05)


def test_the_prior_speaks_of_pixels_not_of_parameters() -> None:
    H = prior_information(WIDTH, HEIGHT, CAM, 2.0, 0.5, N_ALL)
    assert np.linalg.eigvalsh(H).min() > 0
    # A common shift of the right image by 2 px is one standard deviation ...
    shift = np.zeros(N_ALL)
    shift[N_LENS + RIGHT.index("cx")] = 2.0
    np.testing.assert_allclose(shift @ H @ shift, 1.0, rtol=1e-9)
    # ... a turn by as much is a little more, by its distortion; both against each other leave that alone.
    turn = np.zeros(N_ALL)
    turn[N_LENS + RIGHT.index("wy")] = -2.0
    assert 1.5 < turn @ H @ turn < 5.0
    assert (shift + turn) @ H @ (shift + turn) < turn @ H @ turn - 1.0


def test_rows_alone_tell_a_turn_of_the_right_camera_in_spite_of_wrong_matches() -> None:
    uv, disparity = pixels(2000)
    rng = np.random.default_rng(5)
    truth = np.zeros(N_ALL)
    for name, value in (("wx", 3.0), ("wy", 15.0), ("wz", -2.0), ("cy", 4.0), ("q2", -5.0)):
        truth[N_LENS + RIGHT.index(name)] = value
    row = pair_shift(uv, disparity, CAM, truth)[:, 1] + rng.normal(0, 0.2, len(uv))
    row[::10] += rng.uniform(-4, 4, len(row[::10]))
    prior = prior_information(WIDTH, HEIGHT, CAM, 2.0, 2.0, N_ALL)
    mean, H = with_rows(uv, disparity, row, CAM, prior, np.zeros(N_ALL), 0.3)
    error = basis(uv, disparity, CAM, N_ALL)[:, 3] @ (mean - truth)
    assert np.sqrt((error**2).mean()) < 0.05
    wz = N_LENS + RIGHT.index("wz")
    assert abs(mean[wz] - truth[wz]) < 0.1 and np.sqrt(np.linalg.inv(H)[wz, wz]) < 0.1
    assert abs(physical(mean, CAM)["right_turn_z_deg"] - np.degrees(-2.0 / CAM[0])) < 0.01


def test_a_calibration_filter_adds_up_what_windows_gain_and_forgets_slowly() -> None:
    prior, gained = np.array([[4.0]]), np.array([[50.0]])
    filtered = CalibrationFilter.at_start(prior)
    first = filtered.after(np.array([0.3]), gained)
    drift = 0.02**2 / 4.0
    np.testing.assert_allclose(first.estimate.information, 1.0 / (1.0 / 54.0 + drift))
    np.testing.assert_array_equal(first.estimate.mean, [0.3])
    # Many windows: the variance settles where what is gained makes up for the drift, v = 1 / (1 / v + gained) + drift.
    for _ in range(2000):
        filtered = filtered.after(np.array([0.3]), gained)
    v = 1.0 / filtered.estimate.information[0, 0]
    assert abs(v - drift - 1.0 / (1.0 / v + 50.0)) < 1e-12 and v > drift
