"""What to do about sources that are not read as they are: archives, films of other kinds, a single image, images that
lie deeper."""

from __future__ import annotations

import os
from pathlib import Path

from .images import IMAGE_SUFFIXES, holds_images

_ARCHIVES = frozenset((".zip", ".tar", ".gz", ".tgz", ".bz2", ".xz", ".7z", ".rar", ".zst"))
_FILMS = frozenset(
    (".ts", ".mts", ".m2ts", ".mpg", ".mpeg", ".wmv", ".flv", ".3gp", ".ogv", ".mjpeg", ".h264", ".264", ".h265")
)
_DEEPEST, _MOST = 4, 2000  # levels, and folders looked at: a disk may be given
_SHOWN = 3


def cure_of_file(path: Path) -> str:
    """What makes a file that is not read one that is; empty where nothing is known."""
    suffix = path.suffix.lower()
    if suffix in _ARCHIVES:
        return "unpack it, and name the folder"
    if suffix in _FILMS:
        return f"ffmpeg -i {path.name} -c copy {path.stem}.mkv makes one that is read (without -c copy if that fails)"
    if suffix in IMAGE_SUFFIXES:
        return "one image; name its folder"
    if suffix == ".txt":
        return "name the folder that the images lie in"
    return ""


def hint_in(folder: Path) -> str:
    """What a folder holds that may be meant, though nothing in it is read as it is; empty where there is nothing."""
    if any((place / "manifest.json").is_file() for place in (folder, folder.parent)):
        return "agent sequences, which `maslam preprocess` made: name the images; `maslam run` takes sequences"
    for path in sorted(folder.iterdir()):
        cure = cure_of_file(path) if path.is_file() and path.suffix.lower() in (_ARCHIVES | _FILMS) else ""
        if cure:
            return f"holds {path.name}, which is not read: {cure}"
    deeper = _deeper(folder)
    if not deeper:
        return ""
    more = f" and {len(deeper) - _SHOWN} more" if len(deeper) > _SHOWN else ""
    names = ", ".join(str(path.relative_to(folder)) for path in deeper[:_SHOWN])
    above = (
        f", or {deeper[0].parent.relative_to(folder)} with what lies beside it," if deeper[0].parent != folder else ""
    )
    return f"no images directly in it, but in {names}{more}: name that folder{above} as the source"


def _deeper(folder: Path) -> list[Path]:
    """Folders below that hold images, the first in order of their names."""
    found: list[Path] = []
    for looked, (place, names, _) in enumerate(os.walk(folder)):
        path = Path(place)
        if looked >= _MOST or len(path.relative_to(folder).parts) >= _DEEPEST:
            names.clear()
        names.sort()
        if path != folder and holds_images(path):
            found.append(path)
    return found
