"""Images for training and evaluating NetVLAD: photographs from a folder, and the public place-recognition sets on
disk."""

from __future__ import annotations

import pickletools
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from ..common.errors import ToolError

_SUFFIXES = {".jpg", ".jpeg", ".png"}


def image_files(folder: Path) -> list[Path]:
    """The image files of a folder by name; an absent or empty folder is an error."""
    files = sorted(p for p in folder.glob("*") if p.suffix.lower() in _SUFFIXES) if folder.is_dir() else []
    if not files:
        raise ToolError(f"{folder}: no images found")
    return files


def read_grey(path: Path) -> NDArray[np.uint8]:
    """One image ``(H, W)`` uint8."""
    return _read(path, cv2.IMREAD_GRAYSCALE)


def read_colour(path: Path) -> NDArray[np.uint8]:
    """One image ``(H, W, 3)`` uint8, BGR."""
    return _read(path, cv2.IMREAD_COLOR)


def _read(path: Path, flags: int) -> NDArray[np.uint8]:
    image = cv2.imread(str(path), flags)
    if image is None:
        raise ToolError(f"{path}: cannot be decoded as an image")
    return np.asarray(image, dtype=np.uint8)


def fill(image: NDArray[np.uint8], width: int, height: int) -> NDArray[np.uint8]:
    """The largest centred cut of the wanted shape, resized to ``(height, width)``."""
    h, w = image.shape
    scale = max(width / w, height / h)
    cut_w, cut_h = min(w, round(width / scale)), min(h, round(height / scale))
    left, top = (w - cut_w) // 2, (h - cut_h) // 2
    method = cv2.INTER_AREA if scale < 1 else cv2.INTER_LINEAR
    return np.asarray(
        cv2.resize(image[top : top + cut_h, left : left + cut_w], (width, height), interpolation=method), dtype=np.uint8
    )


def read_photos(folder: Path, width: int = 240, height: int = 180) -> NDArray[np.uint8]:
    """All photographs of a folder, ``(n, height, width)`` uint8."""
    return np.stack([fill(read_grey(path), width, height) for path in image_files(folder)])


@dataclass(frozen=True)
class PlaceBenchmark:
    """Q queries against R references: images of any size, grey ``(h, w)`` or BGR ``(h, w, 3)``.

    ``truth`` ``(Q, R)`` bool: the reference shows the query's place; a query may have no place to find. ``ignore``
    ``(Q, R)`` bool or None: pairs that are neither right nor wrong, as far as thresholds are concerned (recall
    counts them as wrong). ``barred`` ``(Q, R)`` bool or None: pairs that are never compared (the query itself, its
    neighbours in time); ``truth`` is False there. ``poses``: ``T_W_C`` of queries ``(Q, 4, 4)`` and references
    ``(R, 4, 4)`` where known, for people to look at.
    """

    name: str
    queries: list[NDArray[np.uint8]]
    references: list[NDArray[np.uint8]]
    truth: NDArray[np.bool_]
    ignore: NDArray[np.bool_] | None = None
    barred: NDArray[np.bool_] | None = None
    poses: tuple[NDArray[np.float64], NDArray[np.float64]] | None = None


def gardenspoint(root: Path, tolerance: int = 2, colour: bool = False) -> PlaceBenchmark:
    """GardensPoint day against night, cut from figures: the same number is the same place, within ``tolerance``
    images."""
    folder, read = root / "places_gardenspoint", read_colour if colour else read_grey
    references, queries = ([read(p) for p in image_files(folder / side)] for side in ("gt", "query"))
    apart = np.abs(np.arange(len(queries))[:, None] - np.arange(len(references)))
    return PlaceBenchmark("places_gardenspoint", queries, references, apart <= tolerance)


def corridor(root: Path, colour: bool = False) -> PlaceBenchmark:
    """The corridor set (Milford, IJRR 2013) with its own list of right answers."""
    folder, read = root / "places_corridor", read_colour if colour else read_grey
    references, queries = ([read(p) for p in image_files(folder / side)] for side in ("ref", "query"))
    truth = np.zeros((len(queries), len(references)), dtype=bool)
    for query, answers in enumerate(_read_truth(folder / "ground_truth_new.npy", len(queries))):
        truth[query, sorted(answers)] = True
    return PlaceBenchmark("places_corridor", queries, references, truth)


def _read_truth(path: Path, queries: int) -> list[frozenset[int]]:
    """The pickled object array ``[[query, [references]], ...]``, its integers picked out without unpickling
    anything."""
    data = path.read_bytes()
    header = 10 + int.from_bytes(data[8:10], "little")
    truth: dict[int, frozenset[int]] = {}
    query, opened = -1, False
    answers: list[int] | None = None
    for opcode, argument, _ in pickletools.genops(data[header:]):
        if opcode.name == "EMPTY_LIST":
            answers, opened = ([] if opened else None), True  # the first list is the whole table
        elif isinstance(argument, int) and opcode.name.startswith("BININT"):
            if answers is None:
                query = argument
            else:
                answers.append(argument)
        elif opcode.name in {"APPEND", "APPENDS"} and answers is not None:
            truth[query], answers = frozenset(answers), None
    if sorted(truth) != list(range(queries)):
        raise ToolError(f"{path}: answers for {len(truth)} queries where {queries} query images lie beside it")
    return [truth[q] for q in range(queries)]
