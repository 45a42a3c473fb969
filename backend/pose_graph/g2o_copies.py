"""Files of a set that are copies of each other: the same measurements would be those of two robots."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from pathlib import Path

from ..errors import BackendError
from .g2o_ids import SYMBOL_SHIFT
from .g2o_lines import G2oLine


def check_given_once(files: Sequence[Path]) -> None:
    """:class:`BackendError` where a file stands twice in a set, also by a link or another path to it."""
    seen: dict[Path, int] = {}
    for k, path in enumerate(files):
        first = seen.setdefault(path.resolve(), k)
        if first != k:
            also = "" if files[first] == path else f" (also as {files[first]})"
            raise BackendError(f"{path}: given twice{also}: each file is a robot of its own; leave one out")


def copies(files: Sequence[Path], lines: Sequence[G2oLine]) -> list[str]:
    """A sentence where ``files`` hold the same ``lines``, in whatever order, with plain ids, and so are robots alike.
    Symbols name robots, whichever file they stand in."""
    held: dict[int, list[tuple[str, tuple[int, ...], bytes]]] = defaultdict(list)
    for line in lines:
        if any(number >> SYMBOL_SHIFT for number in line.ids):
            return []
        held[line.file].append((line.tag, line.ids, line.values.tobytes()))
    seen: dict[tuple[tuple[str, tuple[int, ...], bytes], ...], int] = {}
    again = [
        (file, first) for file in sorted(held) if (first := seen.setdefault(tuple(sorted(held[file])), file)) != file
    ]
    if not again:
        return []
    (file, first), more = again[0], f", and {len(again) - 1} more such files" if len(again) > 1 else ""
    return [
        f"{files[file]} holds the same {len(held[file])} lines as {files[first]}{more}: taken as robots alike; leave "
        "one out if it is a copy, or cut one graph into robots with --agents"
    ]
