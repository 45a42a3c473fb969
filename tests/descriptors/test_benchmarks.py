"""The measuring of place recognition: truth from poses and depth, public sets, scores; the weights on real images."""

from __future__ import annotations

import os
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from maslam.backend.geometry import se3, so3_exp
from maslam.descriptors.codes import Coder
from maslam.frontend.cameras.models import PinholeCamera
from maslam.tools.common.errors import ToolError
from maslam.tools.netvlad.methods import Method, coded, netvlad_method, thumbnail_method
from maslam.tools.netvlad.scores import evaluate, table
from maslam.tools.place_benchmarks.public_sets import PlaceBenchmark, corridor, fill, gardenspoint
from maslam.tools.place_benchmarks.rendered import (
    INDOORS,
    STREETS,
    Visit,
    benchmark,
    conflicts,
    load_places,
    overlap,
    save_places,
)
from tests.descriptors.conftest import textured_image

DATA = Path(os.environ.get("MASLAM_DATA", Path(__file__).parents[3] / "shared" / "data"))
CAMERA = PinholeCamera(160, 120, 80.0, 80.0, 79.5, 59.5)
WALL_M = 10.0


def _before_a_wall(x: float, heading_deg: float = 0.0, seed: int = 0) -> Visit:
    """A view of the wall z = 10 m from (x, 0, 0)."""
    pose = se3(so3_exp([0.0, np.radians(heading_deg), 0.0]), [x, 0.0, 0.0])
    u, v = np.meshgrid(np.linspace(0, 159, 12), np.linspace(0, 119, 9))
    rays = np.stack([(u.ravel() - 79.5) / 80, (v.ravel() - 59.5) / 80, np.ones(u.size)], axis=1) @ pose[:3, :3].T
    points = pose[:3, 3] + rays * np.where(rays[:, 2] > 1e-6, WALL_M / np.maximum(rays[:, 2], 1e-6), np.nan)[:, None]
    return Visit(textured_image(seed), pose, CAMERA, points)


@pytest.mark.parametrize("shift", [0.0, 5.0, 10.0, 25.0])
def test_overlap_before_a_wall_is_what_the_pinhole_says(shift: float) -> None:
    # The wall fills 160 px over 19.9 m; a step of s metres moves every point by 8 s pixels.
    columns = np.linspace(0, 159, 12)
    expected = np.mean(columns - 8 * shift >= 0)
    shares = overlap([_before_a_wall(0.0)], [_before_a_wall(shift)])
    assert shares[0, 0] == pytest.approx(expected)


def test_what_stands_in_front_hides_what_is_behind() -> None:
    far = _before_a_wall(0.0)
    near = Visit(far.image, far.T_W_C, CAMERA, far.points_W * 0.2)  # a wall at 2 m
    assert overlap([far], [near])[0, 0] == 0.0
    assert overlap([near], [far])[0, 0] == 1.0


def test_looking_away_shares_nothing() -> None:
    assert overlap([_before_a_wall(0.0)], [_before_a_wall(0.0, 180.0)])[0, 0] == 0.0


def _street(count: int = 12, step_m: float = 30.0) -> list[list[Visit]]:
    return [[_before_a_wall(k * step_m + d, seed=k) for d in (0.0, 1.0, -2.0)] for k in range(count)]


def test_benchmark_tells_right_wrong_and_undecided_apart() -> None:
    places = _street()
    made = benchmark("wall", places, STREETS, absent=0.25)
    assert len(made.references) == 9
    assert len(made.queries) == 24
    assert made.ignore is not None
    expected = np.zeros((24, 9), dtype=bool)
    for place in range(3, 12):
        expected[2 * place : 2 * place + 2, place - 3] = True
    np.testing.assert_array_equal(made.truth, expected)
    assert not made.ignore.any()
    close = benchmark("wall", _street(step_m=8.0), STREETS, absent=0.0)
    assert close.ignore is not None
    assert close.ignore[0, 1]  # 8 m on: not the same place, and the same wall in view
    assert not (close.ignore & close.truth).any()


def test_indoors_a_place_is_smaller() -> None:
    made = benchmark("wall", _street(step_m=8.0), INDOORS, absent=0.0)
    assert made.truth[0, 0]  # 1 m
    assert not made.truth[1, 0]  # 2 m


def test_places_that_share_surface_conflict() -> None:
    near, far = conflicts(_street(step_m=8.0), STREETS), conflicts(_street(step_m=30.0), STREETS)
    assert near[0, 1]
    assert not near[0, 3]
    np.testing.assert_array_equal(far, np.eye(12, dtype=bool))


def test_rendered_places_are_kept_as_they_were(tmp_path: Path) -> None:
    places = _street(3)
    save_places(tmp_path / "places.npz", places)
    again = load_places(tmp_path / "places.npz")
    for visits, loaded in zip(places, again, strict=True):
        for a, b in zip(visits, loaded, strict=True):
            np.testing.assert_array_equal(a.image, b.image)
            np.testing.assert_array_equal(a.T_W_C, b.T_W_C)
            np.testing.assert_array_equal(a.points_W, b.points_W)
            assert a.camera == b.camera


def _mean_method() -> Method:
    """Recognises images by their mean grey level: a point on a half circle."""

    def describe(image: NDArray[np.uint8]) -> NDArray[np.float32]:
        angle = np.pi * float(image.mean()) / 255
        return np.array([np.cos(angle), np.sin(angle)], dtype=np.float32)

    return Method("mean", describe, (coded(Coder.make("float32", 2, "", None)),))


def test_scores_of_a_descriptor_whose_answers_are_known() -> None:
    flat = [np.full((8, 8), level, dtype=np.uint8) for level in (10, 60, 110, 160, 210)]
    queries = [np.full((8, 8), level, dtype=np.uint8) for level in (12, 61, 118, 180)]
    truth = np.eye(4, 5, dtype=bool)
    truth[3] = [False, False, False, False, True]  # 180 lies nearer to 160, and shows the place of 210
    (found,) = evaluate(_mean_method(), PlaceBenchmark("levels", queries, flat, truth))
    score = found.score
    assert (score.dataset, score.method, score.code, score.bytes, score.queries) == (
        "levels",
        "mean",
        "float32",
        8,
        4,
    )
    assert score.recall_at_1 == pytest.approx(0.75)
    assert score.recall_at_5 == pytest.approx(1.0)
    assert score.ap == pytest.approx(0.75)  # three right answers come before the one wrong one
    assert table([score]).splitlines()[0] == "levels: 4 queries"


def test_thumbnail_is_blind_to_gain_and_offset() -> None:
    image, method = textured_image(3), thumbnail_method()
    dimmed = (image * 0.5 + 30).astype(np.uint8)
    assert float(method.describe(image) @ method.describe(dimmed)) > 0.99


@pytest.mark.parametrize("size", [(100, 300), (300, 100), (90, 120), (30, 40)])
def test_fill_cuts_and_never_stretches(size: tuple[int, int]) -> None:
    height, width = size
    y, x = np.mgrid[0:height, 0:width]
    disc = (np.hypot(x - width / 2 + 0.5, y - height / 2 + 0.5) < 0.3 * min(size)).astype(np.uint8) * 255
    out = fill(disc, 120, 90)
    assert out.shape == (90, 120)
    rows, cols = np.nonzero(out > 127)
    assert np.ptp(rows) == pytest.approx(np.ptp(cols), abs=3)


def _write_images(folder: Path, count: int) -> None:
    folder.mkdir(parents=True)
    for k in range(count):
        cv2.imwrite(str(folder / f"{k:03d}.png"), textured_image(k, 30, 40))


def test_the_corridors_list_is_read_without_unpickling(tmp_path: Path) -> None:
    _write_images(tmp_path / "places_corridor" / "query", 3)
    _write_images(tmp_path / "places_corridor" / "ref", 400)
    answers = np.empty((3, 2), dtype=object)
    for query, found in enumerate(([0, 1, 2], [300], [256, 399])):
        answers[query, 0], answers[query, 1] = query, found
    np.save(tmp_path / "places_corridor" / "ground_truth_new.npy", answers, allow_pickle=True)
    truth = corridor(tmp_path).truth
    assert [np.flatnonzero(row).tolist() for row in truth] == [[0, 1, 2], [300], [256, 399]]
    np.save(tmp_path / "places_corridor" / "ground_truth_new.npy", answers[:2], allow_pickle=True)
    with pytest.raises(ToolError, match="answers for 2 queries where 3 query images"):
        corridor(tmp_path)


def test_an_absent_set_is_one_line(tmp_path: Path) -> None:
    with pytest.raises(ToolError, match="no images found"):
        gardenspoint(tmp_path)


@pytest.mark.realdata
@pytest.mark.parametrize("reader", [gardenspoint, corridor])
def test_shipped_weights_beat_the_thumbnail_on_real_images(reader: object) -> None:
    if not (DATA / f"places_{reader.__name__}").is_dir():  # type: ignore[attr-defined]
        pytest.skip(f"{DATA} holds no place-recognition sets (MASLAM_DATA)")
    made: PlaceBenchmark = reader(DATA)  # type: ignore[operator]
    ours, thumbnail = (evaluate(method, made)[0].score for method in (netvlad_method(), thumbnail_method()))
    assert ours.recall_at_1 > thumbnail.recall_at_1 + 0.05
    assert ours.ap > thumbnail.ap
