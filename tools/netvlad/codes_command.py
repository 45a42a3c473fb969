"""``maslam netvlad codes``: make the codebooks of a model's product codes, and measure what each code costs."""

from __future__ import annotations

import argparse
import json
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from maslam.descriptors.card import model_path, read_card
from maslam.descriptors.codebooks import CENTRES, Codebooks, codebooks_path, train_codebooks
from maslam.descriptors.inference import NetVlad

from ..common.errors import ToolError
from ..common.progress import Progress
from ..place_benchmarks.public_sets import PlaceBenchmark, image_files, read_colour, read_grey
from .options import CACHE

CROPS = 2
"""Pieces of each photograph beside the whole: a few thousand vectors make good books."""
_CROP_SIDES = (0.5, 0.9)
_FEW = 20 * CENTRES
_WORLD = re.compile(r"(indoor|town)_(\d+)_\d+_[0-9a-f]+\.npz")


@dataclass(frozen=True)
class Material:
    """Images to make books from: about ``limit`` of the photographs, pieces included, and as many views of rendered
    worlds, spread evenly. Twice as many were no better on held-out worlds."""

    photos: Path | None
    cache: Path
    limit: int = 3000
    seed: int = 0


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Of ``maslam netvlad codes``."""
    parser.add_argument("model", metavar="NAME|MODEL.onnx", nargs="?", default="default", help="default: the shipped")
    parser.add_argument(
        "--photos", type=Path, metavar="DIR", help="photographs of any kind to make codebooks from, with pieces of them"
    )
    parser.add_argument(
        "--cache",
        type=Path,
        default=CACHE,
        metavar="DIR",
        help="rendered places, as training and calibration leave them (default: %(default)s): those of training "
        "worlds join the photographs, those of held-out worlds measure the codes; nothing is rendered",
    )
    parser.add_argument("--seed", type=int, default=0, help="of k-means and the pieces (default: %(default)s)")
    parser.add_argument("--json", action="store_true", help="the measured records instead of a table")
    parser.add_argument("--quiet", action="store_true", help="no progress")


def main(arguments: argparse.Namespace) -> None:
    """The command."""
    from ..common.progress import progress_on
    from .methods import netvlad_method
    from .scores import as_records, evaluate, table

    material = Material(arguments.photos, arguments.cache, seed=arguments.seed)
    with progress_on(quiet=arguments.quiet) as progress:
        path, books = make_codebooks(arguments.model, material, progress)
        progress.say(f"{path}: {', '.join(sorted(books.books))} from {books.data}, {path.stat().st_size / 1e3:.0f} kB")
        sets, method = held_out_sets(arguments.cache), netvlad_method(arguments.model)
        if not sets:
            progress.say(f"{arguments.cache}: no held-out world to measure on; `maslam netvlad calibrate` renders some")
        task = progress.start("measuring", len(sets))
        scores = []
        for done, one in enumerate(sets, 1):
            scores += [result.score for result in evaluate(method, one)]
            progress.advance(task, done)
    if arguments.json:
        print(json.dumps(as_records(scores), indent=1))
    elif scores:
        print(table(scores))


def make_codebooks(model: str, material: Material, progress: Progress) -> tuple[Path, Codebooks]:
    """Describe the images, make the books and put them beside the model."""
    path, card = read_card(model_path(model))
    net = NetVlad.load(path)
    photos = image_files(material.photos)[:: _every(material.photos, material.limit)] if material.photos else []
    worlds = _world_images(material.cache, material.limit)
    total = len(photos) * (1 + CROPS) + len(worlds)
    if not total:
        raise ToolError(f"nothing to make codebooks from: no --photos, and no training world in {material.cache}")
    task, rows = progress.start("describing", total), []
    rng = np.random.default_rng(material.seed)
    for image in (*_with_pieces(photos, net.colour, rng), *worlds):
        rows.append(net.describe([image])[0])
        progress.advance(task, len(rows))
    if len(rows) < _FEW:
        progress.say(f"warning: {len(rows)} vectors for {CENTRES} centres are few; {_FEW} and more make better books")
    data = f"{len(photos)} photographs with {CROPS} pieces each and {len(worlds)} views of rendered training worlds"
    task = progress.start("codebooks", 48)
    books = train_codebooks(
        np.stack(rows), card.sha256, data, material.seed, lambda done, total: progress.advance(task, done)
    )
    out = codebooks_path(path)
    books.save(out)
    return out, books


def held_out_sets(cache: Path) -> list[PlaceBenchmark]:
    """The held-out rendered worlds that lie in a cache, every place with a counterpart, as ``eval`` has them."""
    from ..place_benchmarks.rendered import HELD_OUT_SEEDS, benchmark, config_for, load_places

    found = [(kind, seed, path) for kind, seed, path in _worlds(cache) if seed >= HELD_OUT_SEEDS]
    return [benchmark(f"{kind}_{seed}", load_places(path), config_for(kind), 0.0) for kind, seed, path in found]


def _worlds(cache: Path) -> list[tuple[str, int, Path]]:
    matches = [(_WORLD.fullmatch(path.name), path) for path in sorted(cache.glob("*.npz"))]
    return [(match[1], int(match[2]), path) for match, path in matches if match]


def _world_images(cache: Path, limit: int) -> list[NDArray[np.uint8]]:
    from ..place_benchmarks.rendered import HELD_OUT_SEEDS, TRAINING_SEEDS, load_places

    paths = [path for _, seed, path in _worlds(cache) if TRAINING_SEEDS <= seed < HELD_OUT_SEEDS]
    images: list[NDArray[np.uint8]] = []
    for path in paths:
        views = [visit.image for visits in load_places(path) for visit in visits]
        share = max(1, limit // len(paths))
        images += [views[i] for i in np.unique(np.linspace(0, len(views) - 1, min(share, len(views))).astype(int))]
    return images


def _every(folder: Path, limit: int) -> int:
    return max(1, round(len(image_files(folder)) * (1 + CROPS) / limit))


def _with_pieces(paths: Sequence[Path], colour: bool, rng: np.random.Generator) -> Iterator[NDArray[np.uint8]]:
    for path in paths:
        image = read_colour(path) if colour else read_grey(path)
        yield image
        for _ in range(CROPS):
            side = rng.uniform(*_CROP_SIDES)
            height, width = (max(1, int(side * n)) for n in image.shape[:2])
            top, left = (int(rng.integers(0, n - m + 1)) for n, m in zip(image.shape, (height, width), strict=False))
            yield np.ascontiguousarray(image[top : top + height, left : left + width])
