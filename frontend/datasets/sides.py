"""Left and right images of one folder, distinguished by one mark in their names (``0000_L``, ``cam1_0000``)."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from ..errors import FrontendError
from .images import header_of

_MARKS = tuple(
    re.compile(pattern)
    for pattern in (
        "((?i:left|right))",
        "((?<![A-Za-z])[LlRr](?![A-Za-z])|(?<=[a-z])[LR](?![A-Za-z]))",
        r"(?<![A-Za-z])(?i:cam|camera|img|image|im|infra|ir)[-_]?(\d)(?!\d)",
    )
)
_RIGHT_OF = {"left": "right", "l": "r", "0": "1", "1": "2", "2": "3"}
_FEWEST = 3  # pairs: of fewer, names say little


@dataclass(frozen=True)
class Sides:
    """``left`` and ``right``: files by the rest of their names, in the order in which they came; ``names``: what the
    right image of each rest in ``left`` would be called."""

    left: dict[str, Path]
    right: dict[str, Path]
    names: dict[str, str]


def sides_of(files: Sequence[Path], words_only: bool = False) -> Sides | None:
    """The two sides, where every name has exactly one mark, of the same kind, and none comes twice; else None.
    ``words_only``: by left and right, or L and R, not by numbers of cameras."""
    marks = _MARKS[:2] if words_only else _MARKS
    return next((sides for mark in marks if (sides := _marked(files, mark)) is not None), None)


def pairs_of_names(files: Sequence[Path]) -> Sides | None:
    """The two sides, where moreover each image of one of them has its partner in the other, of the same size."""
    sides = sides_of(files)
    if sides is None:
        return None
    both = [rest for rest in sides.left if rest in sides.right]
    if len(both) < max(_FEWEST, min(len(sides.left), len(sides.right))):
        return None
    looked_at = {both[0], both[len(both) // 2], both[-1]}
    alike = all(_same_size(sides.left[rest], sides.right[rest]) for rest in looked_at)
    return sides if alike else None


def _marked(files: Sequence[Path], mark: re.Pattern[str]) -> Sides | None:
    by_side: dict[str, dict[str, Path]] = {}
    names: dict[str, str] = {}
    for path in files:
        matches = list(mark.finditer(path.stem))
        if len(matches) != 1:
            return None
        start, end = matches[0].span(1)
        side, rest = path.stem[start:end], f"{path.stem[:start]}\0{path.stem[end:]}".lower()
        by_side.setdefault(side.lower(), {})[rest] = path
        if side.lower() in _RIGHT_OF:
            names[rest] = f"{path.name[:start]}{_written_as(side, _RIGHT_OF[side.lower()])}{path.name[end:]}"
    left = next((side for side, right in _RIGHT_OF.items() if by_side.keys() == {side, right}), None)
    if left is None or sum(map(len, by_side.values())) < len(files):
        return None
    return Sides(by_side[left], by_side[_RIGHT_OF[left]], names)


def _written_as(side: str, other: str) -> str:
    """``other`` with capitals where ``side`` has them."""
    return other.upper() if side.isupper() else other.title() if side.istitle() else other


def _same_size(left: Path, right: Path) -> bool:
    """Whether both are of one size, as far as their files say one."""
    try:
        one, other = header_of(left), header_of(right)
    except FrontendError:
        return True
    return (one.width, one.height) == (other.width, other.height)
