"""Depth pictures that no name calls so, found by their content beside a camera's images."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from ..errors import FrontendError
from .depth_files import FLOAT_SUFFIXES, list_depth
from .depth_look import DepthLook, DepthVerdict, look_for_depth
from .images import header_of, list_images, read_grey, read_numbers
from .second_images import SortedImages
from .truth import POSE_FOLDERS

_SAMPLES = 5
_FOLDERS = 20  # beside the images that are looked into, at most
_KINDS = 6  # of names in one folder; of more nothing is concluded
_DIGITS = re.compile(r"\d+")
_OURS = ("masks", "mask", *POSE_FOLDERS)


@dataclass(frozen=True)
class UnnamedDepth:
    """``found``: the images of a folder, with ``depth`` where pictures are that by ``look``; ``where``: these, for
    messages."""

    found: SortedImages
    where: str = ""
    look: DepthLook | None = None


def find_unnamed_depth(folder: Path, found: SortedImages) -> UnnamedDepth:
    """What is depth by its content among the ``found`` images, among the right ones, and in other folders beside them.

    Only pictures of one channel of 16 bits beside images that are not can be it. A pair needs none.
    """
    if found.depth:
        return UnnamedDepth(found)
    kinds = _by_kind_of_name(found.files)
    if 1 < len(kinds) <= _KINDS:
        wide = {kind for kind, files in kinds.items() if _is_wide(files[0])}
        for kind in sorted(wide) if len(wide) < len(kinds) else ():
            look = _look(kinds[kind])
            if look is not None:
                depth = tuple(kinds[kind])
                files = tuple(path for path in found.files if path not in set(depth))
                where = f"{depth[0].parent}: {depth[0].name} and {len(depth) - 1} more"
                return UnnamedDepth(replace(found, files=files, depth=depth), where, look)
    if _is_wide(found.files[0]) and _verdict(found.files) is not DepthVerdict.CAMERA:
        return UnnamedDepth(found)
    if found.right:
        look = _look(found.right)
        if look is None:
            return UnnamedDepth(found)
        return UnnamedDepth(replace(found, right=(), depth=found.right), f"{found.right[0].parent}", look)
    for place in _others(folder, found):
        depth = tuple(list_images(place))
        look = _look(depth)
        if look is not None:
            return UnnamedDepth(replace(found, depth=depth), f"{place}", look)
    return UnnamedDepth(found)


def one_channel_of_16_bits(files: Sequence[Path]) -> list[NDArray[Any]]:
    """The pictures that are that; others, and those that cannot be read, are passed over."""
    return [one for path in files if _is_wide(path) and (one := _decoded(path)) is not None]


def floating_point_beside(folder: Path, found: SortedImages) -> Path | None:
    """The first folder beside the images that holds pictures of floating-point numbers, which no camera takes."""
    for place in _others(folder, found):
        files = list_depth(place)
        if files and (files[0].suffix.lower() in FLOAT_SUFFIXES or _is_real(files[0])):
            return place
    return None


def _look(files: Sequence[Path]) -> DepthLook | None:
    """The look of pictures that are depth, else None."""
    if not files or not _is_wide(files[0]):
        return None
    look = look_for_depth(one_channel_of_16_bits(_sample(files)))
    return look if look.verdict is DepthVerdict.DEPTH else None


def _verdict(files: Sequence[Path]) -> DepthVerdict:
    return look_for_depth(one_channel_of_16_bits(_sample(files))).verdict


def _sample(files: Sequence[Path]) -> list[Path]:
    chosen = sorted({round(k * (len(files) - 1) / (_SAMPLES - 1)) for k in range(_SAMPLES)})
    return [files[i] for i in chosen]


def _decoded(path: Path) -> NDArray[Any] | None:
    try:
        return read_grey(path)
    except FrontendError:
        return None


def _is_wide(path: Path) -> bool:
    """Whether the file says that it holds one channel of 16 bits."""
    try:
        header = header_of(path)
    except FrontendError:
        return False
    return header.bits == 16 and header.channels == 1


def _is_real(path: Path) -> bool:
    try:
        return path.suffix.lower() in (".tif", ".tiff") and read_numbers(path).dtype.kind == "f"
    except FrontendError:
        return False


def _by_kind_of_name(files: Sequence[Path]) -> dict[str, list[Path]]:
    """Files by their names without numbers."""
    kinds: dict[str, list[Path]] = {}
    for path in files:
        kinds.setdefault(_DIGITS.sub("0", path.name.lower()), []).append(path)
    return kinds


def _others(folder: Path, found: SortedImages) -> list[Path]:
    """Sub-folders beside the camera's images, in order of their names."""
    try:
        inside = sorted(p for p in folder.iterdir() if p.is_dir() and not p.name.startswith("."))
    except OSError:
        return []
    used = {folder / found.inside, *(path.parent for path in found.right[:1])}
    return [p for p in inside if p not in used and p.name not in _OURS][:_FOLDERS]
