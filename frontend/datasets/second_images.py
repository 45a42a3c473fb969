"""Which images of a folder are the camera's, which are another camera's, and which are depth: by folder and by name."""

from __future__ import annotations

import os
import re
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from pathlib import Path

from .depth_files import FLOAT_SUFFIXES, list_depth
from .images import holds_images, is_image, list_images
from .sides import pairs_of_names

_RIGHT_OF = {
    "image_0": "image_1", "left": "right", "cam0": "cam1", "image_left": "image_right", "left_images": "right_images",
    "left_camera": "right_camera", "infra1": "infra2", "image_2": "image_3", "image_00": "image_01",
    "image_02": "image_03", "cam_0": "cam_1", "camera0": "camera1", "camera_0": "camera_1", "cam_left": "cam_right",
    "camera_left": "camera_right",
}  # fmt: skip
LEFT_FOLDERS = (
    "image_0", "left", "images", "image", "rgb", "color", "colour",
    *(name for name in _RIGHT_OF if name not in ("image_0", "left")), ".",
)  # fmt: skip
_MASK = "mask"
_DEPTH_FOLDERS = ("depth_0", "depth", "depth_images", "depths")
_DEPTH = re.compile(r"(?:^|[^a-z])(?:depth|depthmap)(?![a-z])")
_RIGHT, _LEFT = (re.compile(rf"(?:^|[^a-z]){side}(?![a-z])") for side in ("right", "left"))


@dataclass(frozen=True)
class SortedImages:
    """``inside``: the sub-folder of the camera's images, ``files``; ``right`` and ``depth``: what seems to belong to
    them, in natural order; ``unused``: a folder of right images beside images that are nobody's left ones."""

    inside: str
    files: tuple[Path, ...]
    right: tuple[Path, ...] = ()
    depth: tuple[Path, ...] = ()
    unused: Path | None = None


def _places(folder: Path) -> dict[str, Path]:
    """The sub-folders by their names in lower case, and ``folder`` itself as ``.``; of names that differ by capitals
    alone, the one in lower case."""
    with os.scandir(folder) as entries:
        names = sorted((entry.name for entry in entries if entry.is_dir()), key=lambda name: name == name.lower())
    return {**{name.lower(): folder / name for name in names}, ".": folder}


def has_images(folder: Path) -> bool:
    """Whether :func:`sort_images` finds any; looks at no more names than it takes."""
    every = _places(folder)
    places = (every[name] for name in LEFT_FOLDERS if name in every)
    return any(is_image(path) and not _is_depth(path) for place in places if place.is_dir() for path in place.iterdir())


def sort_images(folder: Path) -> SortedImages | None:
    """The images in ``folder`` or its usual sub-folders; None where there are none. Images called depth are never the
    camera's, also beside its own; nor are those called right beside others called left."""
    places = _places(folder)
    for name in LEFT_FOLDERS:
        inside = places[name].name if name in places and name != "." else name
        every = list_images(folder / inside)
        files, right, depth = _by_names(every)
        if files:
            break
    else:
        return None
    other = places.get(_RIGHT_OF.get(name, ""))
    right = right or (list_images(other) if other is not None else [])
    unused = None
    if not right:
        unused = next(
            (p for one in _RIGHT_OF.values() if one != name and (p := places.get(one)) and holds_images(p)), None
        )
    if not depth:
        depth = next((found for one in _DEPTH_FOLDERS if one in places and (found := list_depth(places[one]))), [])
    if not depth:
        depth = [path for path in list_depth(folder / inside, FLOAT_SUFFIXES) if _is_depth(path)]
    return SortedImages(inside, tuple(files), tuple(right), tuple(depth), unused)


def unread_folders(folder: Path, used: Collection[Path]) -> list[str]:
    """Names of the sub-folders that hold images which are neither ``used`` nor masks."""
    known = {path.resolve() for path in used}
    return sorted(
        path.name
        for path in folder.iterdir()
        if path.is_dir()
        and not path.name.startswith(".")
        and not path.name.lower().startswith(_MASK)
        and path.resolve() not in known
        and holds_images(path)
    )


def unread_depth(folder: Path) -> Path | None:
    """A folder called depth whose files are none that depth is read from; None without one, or with such files."""
    every = _places(folder)
    places = [every[name] for name in _DEPTH_FOLDERS if name in every]
    if any(map(list_depth, places)):
        return None
    return next((p for p in places if any(f.is_file() and not f.name.startswith(".") for f in p.iterdir())), None)


def _by_names(every: Sequence[Path]) -> tuple[list[Path], list[Path], list[Path]]:
    """The camera's, right and depth images of one folder."""
    depth = [path for path in every if _is_depth(path)]
    called = set(depth)
    others = [path for path in every if path not in called] if called else list(every)
    right = [path for path in others if _is_called("right", _RIGHT, path)]
    left = [path for path in others if _is_called("left", _LEFT, path)] if right else []
    if left and right and len(left) + len(right) == len(others):
        return left, right, depth
    sides = pairs_of_names(others)
    if sides is not None:
        return list(sides.left.values()), list(sides.right.values()), depth
    return others, [], depth


def _is_depth(path: Path) -> bool:
    return _is_called("depth", _DEPTH, path)


def _is_called(word: str, pattern: re.Pattern[str], path: Path) -> bool:
    """Whether the name has the word, as a word; a search of letters first: folders have thousands of names."""
    name = path.name.lower()
    return word in name and pattern.search(name) is not None
