"""Points that images show at one pixel are one, unless an image or their depths tell them apart."""

from __future__ import annotations

import numpy as np
import pytest

from maslam.mas.output.one_place import one_place

View = tuple[int, int, float, float]
"""Image, point, column in pixels, depth."""


def of(views: list[View], count: int = 3) -> list[int]:
    image, label = (np.array([v[k] for v in views], dtype=np.intp) for k in (0, 1))
    uv = np.array([(v[2], 50.0) for v in views]).reshape(-1, 2)
    return one_place(image, label, uv, np.array([v[3] for v in views], dtype=float), count).tolist()


def test_two_points_at_one_pixel_are_the_first_of_them() -> None:
    assert of([(0, 2, 100.0, 5.0), (0, 1, 101.0, 5.1), (1, 0, 100.0, 5.0)]) == [0, 1, 1]


def test_points_that_share_a_partner_are_one() -> None:
    views = [(0, 0, 10.0, 5.0), (0, 1, 10.5, 5.0), (4, 1, 80.0, 9.0), (4, 2, 80.5, 9.0)]
    assert of(views) == [0, 0, 0]


@pytest.mark.parametrize(
    "apart",
    [
        pytest.param((0, 1, 103.0, 5.0), id="another pixel"),
        pytest.param((0, 1, 100.5, 6.0), id="behind"),
        pytest.param((1, 1, 100.0, 5.0), id="another image"),
    ],
)
def test_others_are_two(apart: View) -> None:
    assert of([(0, 0, 100.0, 5.0), apart]) == [0, 1, 2]


def test_an_image_that_shows_both_apart_tells() -> None:
    once = [(0, 0, 100.0, 5.0), (0, 1, 100.5, 5.0)]
    assert of([*once, (1, 0, 40.0, 5.0), (1, 1, 40.5, 5.0)]) == [0, 0, 2]
    assert of([*once, (1, 0, 40.0, 5.0), (1, 1, 44.0, 5.0)]) == [0, 1, 2]


def test_nothing_is_nothing() -> None:
    assert of([], 2) == [0, 1]
