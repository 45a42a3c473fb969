"""The table of all kinds in the documents names what the program's own lists have, and nothing that they do not."""

from __future__ import annotations

import re
from collections.abc import Iterable
from pathlib import Path

import pytest

from maslam.frontend.cameras.calibration import Distortion
from maslam.frontend.cameras.calibration_files import numbers_alone
from maslam.frontend.cameras.calibration_files.registry import FORMATS
from maslam.frontend.datasets import camera_file, depth_files, image_headers, image_times, images, masks, readers, truth
from maslam.frontend.datasets.recordings import (
    bag,
    bag_image,
    bag_poses,
    film,
    pixel_formats,
    transforms,
    video_packets,
)
from maslam.frontend.files import pose_columns, time_units
from maslam.frontend.files.pose_arrays import ARRAY_SUFFIXES

PAGE = Path(__file__).parents[2] / "docs" / "datasets.md"


def section() -> str:
    return PAGE.read_text().split("## All kinds\n")[1].split("\n## ")[0]


def tables() -> dict[str, str]:
    """The rows of each table by its first heading."""
    found = re.findall(r"\| ([^|\n]+) \| what happens \|\n\|---\|---\|\n((?:\|.*\n)+)", section() + "\n")
    return dict(found)


def named(text: str) -> set[str]:
    return set(re.findall(r"`([^`]+)`", text))


LISTS: dict[str, tuple[str, Iterable[str]]] = {
    "layouts": ("layout", (reader.kind for reader in (*readers.OURS, readers.ANY_IMAGES))),
    "calibration formats": ("calibration", (*(one.name for one in FORMATS), "COLMAP")),
    "lenses": ("calibration", (kind.value for kind in Distortion)),
    "usual names of calibrations": ("calibration", camera_file._USUAL),
    "names of a pair's files": ("calibration", (side for pair in camera_file._SIDES for side in pair)),
    "files of numbers": ("calibration", (f"{stem}.txt" for stem in numbers_alone.STEMS)),
    "lists of times": ("times", image_times._LISTS),
    "units of time": ("times", (unit.name for unit in time_units.UNITS)),
    "names of ground truth": ("ground truth", (*truth._NAMES, *truth.POSE_FOLDERS)),
    "suffixes of ground truth": ("ground truth", truth._SUFFIXES),
    "topics of poses": ("ground truth", bag_poses.POSE_TYPES),
    "images": ("images and depth", images.IMAGE_SUFFIXES),
    "images that are refused": ("images and depth", image_headers.UNREAD),
    "depth": ("images and depth", depth_files.FLOAT_SUFFIXES),
    "masks": ("images and depth", masks._FOUND),
    "films": ("recordings", film.FILM_SUFFIXES),
    "bags": ("recordings", bag.BAG_SUFFIXES),
    "encodings": ("recordings", (name for name in pixel_formats._ENCODINGS if not name.startswith("bayer"))),
    "messages of images": ("recordings", (bag_image.IMAGE, bag_image.COMPRESSED_IMAGE, *video_packets.VIDEO_TYPES)),
    "transforms": ("recordings", transforms.TF_TYPES),
}


@pytest.mark.parametrize("what", LISTS)
def test_each_is_in_the_table(what: str) -> None:
    table, names = LISTS[what]
    missing = sorted(set(names) - named(tables()[table]))
    assert not missing, f"docs/datasets.md, All kinds, {table}: {what} that it lacks: {missing}"


def test_forms_of_poses_are_in_the_table() -> None:
    row = next(row for row in tables()["ground truth"].splitlines() if "rows of" in row)
    numbers = {int(number) for number in re.findall(r"\d+", row.partition("numbers")[0])}
    assert numbers == set(pose_columns.FORMS)


def test_no_layout_and_no_suffix_is_there_that_nobody_reads() -> None:
    rows = tables()["layout"].splitlines()
    kinds = {name for row in rows[:5] for name in named(row.split("|")[1])}
    assert kinds == set(LISTS_OF["layouts"])
    suffixes = {name for text in tables().values() for name in named(text) if re.fullmatch(r"\.[a-z0-9]+", name)}
    known = {*images.IMAGE_SUFFIXES, *image_headers.UNREAD, *depth_files.FLOAT_SUFFIXES, *film.FILM_SUFFIXES}
    assert suffixes <= known | {*bag.BAG_SUFFIXES, *truth._SUFFIXES, *truth._UNREAD, *ARRAY_SUFFIXES, ".freiburg"}


LISTS_OF = {"layouts": tuple(reader.kind for reader in (*readers.OURS, readers.ANY_IMAGES))}


def test_each_layout_has_its_row_above() -> None:
    above = PAGE.read_text().partition("## Times")[0]
    assert set(LISTS_OF["layouts"]) <= set(re.findall(r"(?m)^\| `([^`]+)` \|", above))
