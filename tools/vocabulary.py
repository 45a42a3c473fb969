"""``maslam vocabulary``: train a vocabulary of ORB words from folders of images, or show what one holds."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from .common.errors import ToolError

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from maslam.frontend.vocabulary.vocabulary import Vocabulary

    from .common.progress import Progress

_MIN_DESCRIPTORS = 50
"""An image with fewer does not show how words are spread over images."""
_FAST_THRESHOLD = 12
"""Grey levels; the odometry looks for corners as faint."""


@dataclass(frozen=True)
class TrainingSettings:
    """``features`` ORB key-points per image; ``every``: use each n-th image of a folder."""

    branching: int = 10
    depth: int = 4
    features: int = 600
    every: int = 1
    seed: int = 0


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Arguments of the two actions."""
    actions = parser.add_subparsers(dest="action", metavar="ACTION", required=True)
    train = actions.add_parser("train", help="cluster the ORB descriptors of many images")
    train.add_argument(
        "out", metavar="OUT", type=Path, help="file to write: .npz our own form, any other name DBoW2's text form"
    )
    train.add_argument(
        "sources", metavar="DIR", type=Path, nargs="+", help="folders, searched for images in all their sub-folders"
    )
    defaults = TrainingSettings()
    train.add_argument(
        "--branching", type=int, default=defaults.branching, help="children of a node (default: %(default)s)"
    )
    train.add_argument("--depth", type=int, default=defaults.depth, help="levels below the root (default: %(default)s)")
    train.add_argument(
        "--features", type=int, default=defaults.features, help="ORB key-points per image (default: %(default)s)"
    )
    train.add_argument(
        "--every", type=int, default=defaults.every, help="use every n-th image of a folder (default: %(default)s)"
    )
    train.add_argument("--seed", type=int, default=defaults.seed, help="(default: %(default)s)")
    train.add_argument("--quiet", action="store_true", help="no progress")
    info = actions.add_parser("info", help="branching, depth, nodes on each level, weights")
    info.add_argument("file", metavar="FILE", type=Path, nargs="?", help="vocabulary (default: the shipped one)")


def main(arguments: argparse.Namespace) -> None:
    """Do the action asked for."""
    if arguments.action == "info":
        from maslam.frontend.vocabulary.vocabulary import DEFAULT_PATH, Vocabulary

        path = arguments.file or DEFAULT_PATH
        print("\n".join(vocabulary_info(path, Vocabulary.load(path))))
        return
    from .common.progress import progress_on

    settings = TrainingSettings(
        arguments.branching, arguments.depth, arguments.features, arguments.every, arguments.seed
    )
    with progress_on(quiet=arguments.quiet) as progress:
        vocabulary = train_from_images(arguments.sources, settings, progress)
    vocabulary.save(arguments.out)
    print("\n".join(vocabulary_info(arguments.out, vocabulary)))


def vocabulary_info(path: Path, vocabulary: Vocabulary) -> list[str]:
    """Contents of a vocabulary, one line each."""
    import numpy as np

    levels, leaves = vocabulary.levels, vocabulary.is_leaf
    lines = [
        f"{path}: branching {vocabulary.branching}, depth {vocabulary.depth}, "
        f"{len(vocabulary)} nodes, {int(leaves.sum())} words",
        f"  node ids need {2 if len(vocabulary) <= 2**16 else 4} bytes",
    ]
    for level in range(1, int(levels.max()) + 1):
        on_level = levels == level
        lines.append(f"  level {level}: {int(on_level.sum())} nodes, {int((on_level & leaves).sum())} of them words")
    weights = vocabulary.weights[leaves]
    shares = np.percentile(weights, [0, 50, 100])
    lines.append(f"  weights (idf): {shares[0]:.2f} to {shares[2]:.2f}, median {shares[1]:.2f}")
    return lines


def train_from_images(sources: Sequence[Path], settings: TrainingSettings, progress: Progress) -> Vocabulary:
    """A vocabulary of all images under ``sources``, each folder's in natural order. ``ToolError`` where they are too
    few."""
    import numpy as np

    from maslam.frontend.vocabulary.training import train_vocabulary

    if settings.branching < 2 or settings.depth < 1 or settings.features < _MIN_DESCRIPTORS or settings.every < 1:
        raise ToolError(f"branching >= 2, depth >= 1, features >= {_MIN_DESCRIPTORS} and every >= 1 are needed")
    paths = [path for source in sources for path in _images_under(source, settings.every)]
    images = _describe_all(paths, settings.features, progress)
    total = sum(map(len, images))
    if total < settings.branching**2:
        raise ToolError(
            f"{len(paths)} images with {total} descriptors in {', '.join(map(str, sources))}: too few for a vocabulary"
        )
    progress.say(
        f"{total} descriptors of {len(images)} images ({len(paths) - len(images)} with too few left out); clustering"
    )
    return train_vocabulary(images, np.random.default_rng(settings.seed), settings.branching, settings.depth)


def _images_under(source: Path, every: int) -> list[Path]:
    from maslam.frontend.datasets.images import list_images, natural_key

    if not source.is_dir():
        raise ToolError(f"{source}: no such folder")
    folders = [source, *sorted((p for p in source.rglob("*") if p.is_dir()), key=lambda p: natural_key(str(p)))]
    # Depth images are no photographs; a right image shows what the left one does.
    used = [
        folder for folder in folders if not folder.name.startswith(("depth", "image_1", "image_3", "right", "cam1"))
    ]
    return [path for folder in used for path in list_images(folder)[::every] if ".depth." not in path.name]


def _describe_all(paths: Sequence[Path], features: int, progress: Progress) -> list[NDArray[np.uint8]]:
    from maslam.frontend.datasets.images import read_grey
    from maslam.frontend.datasets.pixel_values import PixelValues

    task = progress.start("describing images", len(paths))
    images = []
    for done, path in enumerate(paths, 1):
        descriptors = describe_orb(PixelValues().levels(read_grey(path)), features)
        if len(descriptors) >= _MIN_DESCRIPTORS:
            images.append(descriptors)
        progress.advance(task, done)
    return images


def describe_orb(image: NDArray[np.uint8], features: int) -> NDArray[np.uint8]:
    """OpenCV's ORB, whose descriptors the odometry computes too, at corners that ORB finds itself."""
    import cv2
    import numpy as np

    _, descriptors = cv2.ORB.create(features, fastThreshold=_FAST_THRESHOLD).detectAndCompute(image, None)
    return np.zeros((0, 32), np.uint8) if descriptors is None else np.asarray(descriptors, dtype=np.uint8)
