"""``maslam netvlad eval``: options, and which descriptors are tried on which sets."""

from __future__ import annotations

import argparse
import json
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from ..common.errors import ToolError, UsageError
from .options import (
    add_held_out_options,
    add_input_options,
    add_revisit_options,
    add_world_options,
    input_form_of,
    kinds_of,
    needing_torch,
    revisits_of,
)

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from maslam.descriptors.inference import NetVlad

    from ..common.progress import Progress
    from ..place_benchmarks.public_sets import PlaceBenchmark
    from .methods import Method
    from .scores import Evaluation

METHODS = ("netvlad", "rootsift-vlad", "bag-of-words", "thumbnail", "random-weights")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Models, baselines, sets, and what is made of them."""
    parser.add_argument(
        "--model",
        metavar="NAME|FILE",
        action="append",
        help="shipped model by name, or any ONNX place descriptor, with or without a card (default: the shipped one); "
        "may be repeated",
    )
    parser.add_argument(
        "--methods",
        metavar="LIST",
        default=",".join(METHODS[:-1]),
        help=f"of {', '.join(METHODS)} (default: all but the last)",
    )
    parser.add_argument("--random", action="store_true", help="random-weights too (needs maslam[train])")
    parser.add_argument("--sets", metavar="LIST", help="real sets and worlds by the table's names (default: all)")
    parser.add_argument(
        "--sequence",
        type=Path,
        metavar="DATASET",
        action="append",
        default=[],
        help="your own images with ground truth, as one more set; may be repeated",
    )
    parser.add_argument("--data", type=Path, metavar="DIR", help="folder of the real sets (default: $MASLAM_DATA)")
    parser.add_argument(
        "--photos", type=Path, metavar="DIR", help="what baselines are fitted on (default: `photos` of the data folder)"
    )
    parser.add_argument(
        "--fit-worlds",
        type=int,
        default=1,
        metavar="N",
        help="training worlds of each kind that baselines are fitted on, too (default: %(default)s)",
    )
    parser.add_argument("--vocabulary", type=Path, metavar="FILE", help="of bag-of-words (default: the shipped one)")
    parser.add_argument("--json", action="store_true", help="print JSON records instead of a table")
    parser.add_argument("--out", type=Path, metavar="DIR", help="pictures: curves, hits and misses, recall over bytes")
    add_input_options(parser)
    add_world_options(parser)
    add_held_out_options(parser)
    add_revisit_options(parser)


def main(arguments: argparse.Namespace) -> None:
    """Evaluate; print the table or the records; draw."""
    from ..common.progress import progress_on
    from .scores import as_records, evaluate, table

    names = _names("--methods", arguments.methods, METHODS)
    if arguments.random and "random-weights" not in names:
        names = (*names, "random-weights")
    with progress_on(quiet=arguments.quiet) as progress, _one_thread():
        benchmarks, coloured = _benchmarks(arguments, progress), {}
        nets = _nets(arguments) if "netvlad" in names else []
        methods = _methods(arguments, nets, names, progress)
        if any(method.colour for method in methods):
            coloured = {one.name: one for one in _photographed(arguments, progress, colour=True)}
        task = progress.start("evaluating", len(methods) * len(benchmarks))
        results: list[list[Evaluation]] = []
        for one in benchmarks:
            results.append([])
            for method in methods:
                results[-1] += evaluate(method, coloured.get(one.name, one) if method.colour else one)
                progress.advance(task, len(methods) * (len(results) - 1) + methods.index(method) + 1)
        scores = [evaluation.score for of_set in results for evaluation in of_set]
        if arguments.out is not None:
            from .score_figures import draw_evaluation
            from .training_figures import draw_calibrations

            paths = draw_evaluation(benchmarks, results, arguments.out)
            for path in paths + draw_calibrations([net.card for net in nets], arguments.out):
                progress.say(f"wrote {path}")
    print(json.dumps(as_records(scores), indent=1) if arguments.json else table(scores))


def _benchmarks(arguments: argparse.Namespace, progress: Progress) -> list[PlaceBenchmark]:
    """Real sets, the user's sequences among them, and rendered held-out worlds."""
    from ..place_benchmarks.rendered import HELD_OUT_SEEDS, benchmark, config_for
    from .train import render_worlds

    worlds = {
        f"{kind}_{HELD_OUT_SEEDS + k}": (kind, HELD_OUT_SEEDS + k)
        for kind in kinds_of(arguments)
        for k in range(arguments.worlds)
    }
    made = _photographed(arguments, progress)
    if arguments.sets is not None:
        chosen = _names("--sets", arguments.sets, (*(one.name for one in made), *worlds))
        made = [one for one in made if one.name in chosen]
        worlds = {name: world for name, world in worlds.items() if name in chosen}
    rendered = render_worlds(list(worlds.values()), arguments.places, arguments.cache, arguments.workers, progress)
    made += [benchmark(f"{kind}_{seed}", places, config_for(kind), 0.0) for (kind, seed), places in rendered.items()]
    if not made:
        data = _data(arguments)
        raise ToolError(
            f"{f'{data}: holds no place-recognition set' if data else 'no folder of real sets (--data)'}, and neither "
            "a rendered world (--worlds) nor a sequence (--sequence) is asked for"
        )
    return made


def _nets(arguments: argparse.Namespace) -> list[NetVlad]:
    from .foreign_model import load_model

    form = input_form_of(arguments)
    return [load_model(model, form) for model in arguments.model or ["default"]]


def _methods(
    arguments: argparse.Namespace, nets: list[NetVlad], names: tuple[str, ...], progress: Progress
) -> list[Method]:
    from maslam.frontend.vocabulary.vocabulary import Vocabulary

    from .methods import netvlad_methods, random_method, sift_method, thumbnail_method, words_method
    from .sift_vlad import fitted

    made = netvlad_methods(nets)
    photos, views = _fit_images(arguments, progress) if {"rootsift-vlad", "random-weights"} & set(names) else ([], [])
    if "rootsift-vlad" in names:
        # The codebook from real images where there are any: one half made of rendered walls finds fewer real places.
        task, images = progress.start("fitting rootsift-vlad", len(photos) + len(views)), photos + views
        model = fitted(photos or views, images, arguments.cache, lambda done: progress.advance(task, done))
        made.append(sift_method(model))
    if "bag-of-words" in names:
        made.append(words_method(Vocabulary.load(arguments.vocabulary)))
    if "thumbnail" in names:
        made.append(thumbnail_method())
    if "random-weights" in names:
        with needing_torch():
            made.append(random_method(photos + views))
    return made


def _fit_images(
    arguments: argparse.Namespace, progress: Progress
) -> tuple[list[NDArray[np.uint8]], list[NDArray[np.uint8]]]:
    """Photographs and rendered training worlds: what our own projection is fitted on, and nothing that is tested."""
    from ..place_benchmarks.public_sets import read_photos
    from ..place_benchmarks.rendered import TRAINING_SEEDS
    from .train import KINDS, MaterialConfig, render_worlds

    data = _data(arguments)
    folder = arguments.photos or (data / "photos" if data else None)
    photos = list(read_photos(folder)) if folder and (arguments.photos or folder.is_dir()) else []
    wanted = [(kind, TRAINING_SEEDS + k) for kind in KINDS for k in range(arguments.fit_worlds)]
    rendered = render_worlds(wanted, MaterialConfig().places, arguments.cache, arguments.workers, progress)
    views = [visit.image for places in rendered.values() for visits in places for visit in visits]
    if not photos and not views:
        raise ToolError(
            f"{f'{folder}: ' if folder else ''}no photographs to fit the baselines on, and no training worlds either "
            "(--photos, --fit-worlds, or --methods without rootsift-vlad and random-weights)"
        )
    progress.say(f"baselines are fitted on {len(photos)} photographs and {len(views)} views of training worlds")
    return photos, views


def _names(option: str, text: str, known: tuple[str, ...]) -> tuple[str, ...]:
    chosen = tuple(word for word in text.split(",") if word)
    for name in chosen:
        if name not in known:
            raise UsageError(f"{option} {name}: not one of {', '.join(known) or 'nothing'}")
    return tuple(name for name in known if name in chosen)


def _photographed(arguments: argparse.Namespace, progress: Progress, colour: bool = False) -> list[PlaceBenchmark]:
    """Public sets and the user's sequences; ``colour``: the images as colour networks see them."""
    from ..common.progress import counter
    from ..place_benchmarks.revisits import posed_benchmark
    from .scores import public_benchmarks

    data = _data(arguments)
    made = public_benchmarks(data, colour=colour) if data else []
    for folder in arguments.sequence:
        tick = counter(progress, f"reading {folder}{' in colour' if colour else ''}")
        made.append(posed_benchmark(folder, revisits_of(arguments), tick, colour))
        if made[-1].name in [one.name for one in made[:-1]]:
            raise UsageError(f"--sequence {folder}: another set has the name {made[-1].name}, too")
    return made


def _data(arguments: argparse.Namespace) -> Path | None:
    named = arguments.data or os.environ.get("MASLAM_DATA")
    return Path(named) if named else None


@contextmanager
def _one_thread() -> Iterator[None]:
    """OpenCV on one thread, as the table states of its times."""
    import cv2

    before = cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        yield
    finally:
        cv2.setNumThreads(before)
