"""Detection, description, patch alignment, disparity and matching against constructions with a known answer."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest
import room

from maslam.frontend.cameras.models import RigKind
from maslam.frontend.config import FeatureConfig, FlowConfig, MappingConfig, StereoConfig
from maslam.frontend.estimation.self_calibration import pair_shift
from maslam.frontend.frames import Frame
from maslam.frontend.image.guided_matching import OrbFeatures, guided_match
from maslam.frontend.image.optical_flow import follow, follow_both_ways
from maslam.frontend.image.orb_features import EDGE_PX, Detector, Pyramid, describe, spread_cells
from maslam.frontend.image.patch_alignment import align, cut_patches, half_sized
from maslam.frontend.mapping.range_sensor import Ranging, depth_at, measure_disparity

NOTHING = np.zeros((0, 2))


def texture(seed: int = 0, height: int = 240, width: int = 320) -> np.ndarray:
    """Smooth noise: corners everywhere, exact under interpolation."""
    rng = np.random.default_rng(seed)
    image = sum(
        cv2.resize(rng.standard_normal((height // c, width // c)), (width, height), interpolation=cv2.INTER_CUBIC)
        for c in (5, 11, 30)
    )
    return np.clip(128 + 35 * np.asarray(image), 0, 255).astype(np.uint8)


def shifted(image: np.ndarray, matrix: np.ndarray) -> np.ndarray:
    """The image in which pixel ``x`` of the source lies at ``matrix @ (x, 1)``."""
    return cv2.warpAffine(
        image, matrix, (image.shape[1], image.shape[0]), flags=cv2.INTER_CUBIC, borderMode=cv2.BORDER_REFLECT
    )


def test_corners_spread_over_an_image_whose_texture_is_all_on_one_side() -> None:
    image = texture()
    image[:, 160:] = 128 + (image[:, 160:].astype(int) - 128) // 5
    uv, level, strength = Detector(FeatureConfig()).detect(Pyramid(image, 4, 1.4), 600, NOTHING)
    cells = {(int(x) // 40, int(y) // 40) for x, y in uv}
    assert len(cells) >= 44  # of 48
    assert (uv[:, 0] > 160).mean() > 0.15
    assert (np.diff(strength) <= 0).all()
    assert set(level.tolist()) == {0, 1, 2, 3}


def test_detection_keeps_away_from_points_already_there_and_finds_nothing_in_nothing() -> None:
    pyramid = Pyramid(texture(), 1, 1.4)
    detector = Detector(FeatureConfig())
    first, _, _ = detector.detect(pyramid, 300, NOTHING)
    more, _, _ = detector.detect(pyramid, 300, first)
    if len(more):
        assert np.linalg.norm(more[:, None] - first[None], axis=-1).min() > 3.0
    flat = Pyramid(np.full((240, 320), 90, dtype=np.uint8), 4, 1.4)
    assert len(detector.detect(flat, 300, NOTHING)[0]) == 0


def test_cells_that_are_taken_are_not_filled() -> None:
    uv = np.array([[10.0, 10.0], [200.0, 100.0], [202.0, 102.0], [300.0, 200.0]])
    chosen = spread_cells(uv, np.array([[12.0, 11.0]]), 320, 240, 100)
    assert chosen.tolist() == [1, 3]


def test_levels_share_pixel_centres() -> None:
    pyramid = Pyramid(texture(), 3, 1.5)
    corner = np.array([[-0.5, -0.5], [319.5, 239.5]])
    for level, image in enumerate(pyramid.levels):
        at = pyramid.from_base(corner, level)
        np.testing.assert_allclose(at, [[-0.5, -0.5], [image.shape[1] - 0.5, image.shape[0] - 0.5]], atol=1e-9)
        np.testing.assert_allclose(pyramid.to_base(at, level), corner, atol=1e-9)


def test_descriptors_and_angles_are_those_of_opencvs_orb() -> None:
    image = texture()
    orb = cv2.ORB_create(200, nlevels=1, edgeThreshold=EDGE_PX + 1)
    theirs, rows = orb.detectAndCompute(image, None)
    uv = np.array([k.pt for k in theirs])
    ours = describe(Pyramid(image, 1, 1.4), uv, np.zeros(len(uv), dtype=np.int8))
    turn = np.abs((ours.angle_deg - np.array([k.angle for k in theirs]) + 180) % 360 - 180)
    assert np.median(turn) < 0.2 and turn.max() < 2.0
    distance = np.unpackbits(ours.descriptors ^ rows, axis=1).sum(axis=1)
    assert np.mean(distance == 0) > 0.9


def test_points_at_the_border_get_no_descriptor() -> None:
    ours = describe(Pyramid(texture(), 1, 1.4), np.array([[3.0, 3.0], [160.0, 120.0]]), np.zeros(2, dtype=np.int8))
    assert np.isnan(ours.angle_deg[0]) and np.isfinite(ours.angle_deg[1])
    assert not ours.descriptors[0].any()


@pytest.mark.parametrize("scale", [1.0, 1.25, 0.8])
def test_patches_are_found_to_a_fraction_of_a_pixel_under_scale_turn_and_light(scale: float) -> None:
    image = texture(1)
    c, s = scale * np.cos(0.1), scale * np.sin(0.1)
    matrix = np.array([[c, -s, 30.0 - 40 * (scale - 1) * 4], [s, c, -20.0 - 30 * (scale - 1) * 4]])
    target = np.clip(0.7 * shifted(image, matrix).astype(float) + 20, 0, 255).astype(np.uint8)
    uv, _, _ = Detector(FeatureConfig()).detect(Pyramid(image, 1, 1.4), 200, NOTHING)
    truth = uv @ matrix[:, :2].T + matrix[:, 2]
    inside = ((truth > 15) & (truth < [305, 225])).all(axis=1)
    uv, truth = uv[inside], truth[inside]
    warp = np.broadcast_to(matrix[:, :2], (len(uv), 2, 2)).copy()
    patches = cut_patches(half_sized(image, 1), uv)
    found, ok = align(patches, half_sized(target, 1), warp, truth + np.array([3.0, -2.0]), 0.8, 16.0)
    error = np.linalg.norm(found - truth, axis=1)
    assert ok.mean() > 0.85
    assert np.median(error[ok]) < 0.1


def test_a_flat_patch_and_one_at_the_border_are_not_found() -> None:
    image = texture(2)
    image[:, :100] = 77
    uv = np.array([[50.0, 120.0], [318.0, 120.0], [200.0, 120.0]])
    warp = np.broadcast_to(np.eye(2), (3, 2, 2)).copy()
    _, ok = align(cut_patches(half_sized(image, 1), uv), half_sized(image, 1), warp, uv, 0.8, 16.0)
    assert ok.tolist() == [False, False, True]


def test_a_patch_of_one_grey_beside_an_edge_is_not_found() -> None:
    """Its border has gradients, its pixels have none."""
    image = np.full((80, 80), 40, dtype=np.uint8)
    image[46:, :], image[:, 46:] = 200, 90
    uv, warp = np.array([[40.0, 40.0]]), np.eye(2)[None]
    _, ok = align(cut_patches([image], uv), [image], warp, uv + 4.0, 0.8, 16.0)
    assert not ok.any()


def test_flow_follows_a_shift_and_survives_no_points_at_all() -> None:
    image = texture(3)
    target = shifted(image, np.array([[1.0, 0, 7.3], [0, 1.0, -4.6]]))
    uv, _, _ = Detector(FeatureConfig()).detect(Pyramid(image, 1, 1.4), 100, NOTHING)
    found, ok = follow_both_ways(image, target, uv, uv, FlowConfig())
    assert ok.mean() > 0.8
    assert np.median(np.abs(found[ok] - uv[ok] - [7.3, -4.6])) < 0.05
    found, ok = follow(image, target, NOTHING, NOTHING, FlowConfig())
    assert found.shape == (0, 2) and ok.shape == (0,)


@pytest.mark.parametrize("row_offset", [0.0, -0.8])
def test_disparity_is_measured_to_a_fraction_of_a_pixel_without_expectation(row_offset: float) -> None:
    left = texture(4, 300, 480)
    right = shifted(left, np.array([[1.0, 0, -23.4], [0, 1.0, row_offset]]))
    uv, _, _ = Detector(FeatureConfig()).detect(Pyramid(left, 1, 1.4), 200, NOTHING)
    uv = uv[uv[:, 0] > 45]
    unknown = np.full(len(uv), np.nan)
    disparity, row = measure_disparity(left, right, uv, unknown, np.zeros(len(uv)), FlowConfig(), StereoConfig())
    assert np.isfinite(disparity).mean() > 0.8
    assert np.nanmedian(np.abs(disparity - 23.4)) < 0.05
    assert np.nanmedian(np.abs(row - row_offset)) < 0.05


def test_depth_is_read_inside_surfaces_and_not_across_edges() -> None:
    depth = np.full((40, 60), 2.0, dtype=np.float32)
    depth[:, 30:] = 5.0
    depth[10, 10] = 0.0
    depth[25:, :25] = (2.0 + 0.01 * np.arange(25)).astype(np.float32)
    uv = np.array([[20.4, 5.0], [29.6, 5.0], [10.0, 10.3], [45.0, 20.0], [12.25, 33.0], [0.2, 5.0]])
    found = depth_at(depth, uv, 0.03)
    np.testing.assert_allclose(found[[0, 3]], [2.0, 5.0])
    np.testing.assert_allclose(found[4], 2.1225, atol=1e-6)
    assert np.isnan(found[[1, 2, 5]]).all()


def test_a_rig_back_projects_what_it_projects() -> None:
    ranging = Ranging(room.rig(RigKind.STEREO), StereoConfig(), FlowConfig())
    ranging.calib = np.random.default_rng(1).normal(0.0, 1.0, len(ranging.calib))
    points = np.array([[0.5, 0.2, 3.0], [-1.0, 0.4, 5.0]])
    uv, depth = ranging.project(np.eye(4), points)
    disparity = ranging.cam[4] / depth
    for _ in range(5):  # what the calibration does to it depends on where the right camera sees the point
        disparity = ranging.cam[4] / depth + pair_shift(uv, disparity, ranging.cam, ranging.calib)[:, 0]
    np.testing.assert_allclose(ranging.back_project(uv, disparity), points, atol=1e-3)
    assert np.isnan(ranging.project(np.eye(4), np.array([[0.0, 0.0, -1.0]]))[0]).all()


def test_rendered_stereo_and_depth_agree() -> None:
    scene, pose = room.Room(5), room.walk(1)[0]
    stereo = Ranging(room.rig(RigKind.STEREO), StereoConfig(), FlowConfig())
    frame = scene.frame(0, pose, RigKind.STEREO)
    _, depth = scene.render(pose)
    uv, _, _ = Detector(FeatureConfig()).detect(Pyramid(frame.image, 1, 1.4), 300, NOTHING)
    truth = stereo.cam[4] / depth_at(depth, uv, 0.03)
    measured, _ = stereo.measure(frame, uv, np.full(len(uv), np.nan))
    both = np.isfinite(truth) & np.isfinite(measured)
    assert both.mean() > 0.6
    assert np.median(np.abs(measured - truth)[both]) < 0.1
    assert np.isnan(stereo.measure(Frame(0, 0, frame.image), uv, np.full(len(uv), np.nan))).all()


def test_guided_matching_takes_the_nearest_descriptor_within_reach_once() -> None:
    rng = np.random.default_rng(6)
    descriptors = rng.integers(0, 256, (30, 32), dtype=np.uint8)
    uv = rng.uniform(0, 300, (30, 2))
    level = np.zeros(30, dtype=np.int8)
    order = rng.permutation(30)
    settings = MappingConfig(match_distance=50, match_ratio=0.9)
    known, shuffled = OrbFeatures(uv, level, descriptors), OrbFeatures(uv[order], level, descriptors[order])
    match = guided_match(replace(known, uv=uv + 2.0), np.full(30, 5.0), shuffled, settings)
    np.testing.assert_array_equal(order[match], np.arange(30))
    far = guided_match(replace(known, uv=uv + 20.0), np.full(30, 5.0), shuffled, settings)
    assert (far[far >= 0] != np.argsort(order)[far >= 0]).all()
    pair = OrbFeatures(np.repeat(uv[:1], 2, axis=0), np.zeros(2), np.repeat(descriptors[:1], 2, axis=0))
    twice = guided_match(pair, np.full(2, 5.0), known, settings)
    assert sorted(twice.tolist()) == [-1, 0]
    nothing = OrbFeatures(np.zeros((0, 2)), np.zeros(0), descriptors[:0])
    assert guided_match(nothing, np.zeros(0), known, settings).shape == (0,)
