"""How well places are recognised: any descriptor on any benchmark, as the table that ``maslam netvlad eval`` prints."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from descriptors.calibration import Retrieval, precision_recall, retrieve
from descriptors.inference import NetVlad, to_working_size
from tools.netvlad_data import PlaceBenchmark, corridor, gardenspoint

Vectors = NDArray[np.float32]
_THUMBNAIL = (16, 12)


@dataclass(frozen=True)
class Method:
    """A descriptor under test: ``describe`` maps one grey image to a unit vector; ``dims``: prefixes of it to try."""

    name: str
    describe: Callable[[NDArray[np.uint8]], Vectors]
    dims: tuple[int, ...]


@dataclass(frozen=True)
class Score:
    """One row of the table. ``ap``: average precision of "nearest neighbour, if near enough"; ``ms``: for one
    image, one thread."""

    dataset: str
    method: str
    code: str
    bytes: int
    queries: int
    recall_at_1: float
    recall_at_5: float
    ap: float
    ms: float


def netvlad_method(model: str | Path = "default") -> Method:
    """A shipped or a user's ONNX model; whole vector and its first half."""
    net = NetVlad.load(model)
    dims = (net.dim, net.dim // 2) if net.dim >= 256 else (net.dim,)
    return Method(f"netvlad:{net.name}", lambda image: net.describe([image])[0], dims)


def thumbnail_method() -> Method:
    """The standardised 16x12 thumbnail: what any descriptor must beat."""

    def describe(image: NDArray[np.uint8]) -> Vectors:
        small = cv2.resize(image, _THUMBNAIL, interpolation=cv2.INTER_AREA).astype(np.float32).ravel()
        centred = small - small.mean()
        return np.asarray(centred / max(float(np.linalg.norm(centred)), 1e-6), dtype=np.float32)

    return Method("thumbnail", describe, (_THUMBNAIL[0] * _THUMBNAIL[1],))


def random_method(images: Sequence[NDArray[np.uint8]], seed: int = 0) -> Method:
    """Our architecture before any training (k-means centres and principal axes from ``images``): what training must
    add to. Needs torch."""
    import torch

    from descriptors.config import NetVladConfig
    from descriptors.initialisation import initialise
    from descriptors.netvlad import build_network

    config, pixels = NetVladConfig(), NetVlad.load().card.input_pixels
    network = build_network(config, seed)
    height = round((pixels * 3 / 4) ** 0.5)
    stack = np.stack(
        [cv2.resize(image, (round(pixels / height), height), interpolation=cv2.INTER_AREA) for image in images]
    )
    initialise(network, stack, np.random.default_rng(seed))

    def describe(image: NDArray[np.uint8]) -> Vectors:
        with torch.no_grad():
            return np.asarray(network(torch.from_numpy(to_working_size(image, pixels))[None, None])[0].numpy())

    return Method("random-weights", describe, (config.dim,))


def public_benchmarks(root: Path) -> list[PlaceBenchmark]:
    """The real sets that are present under the data folder."""
    readers = {"places_gardenspoint": gardenspoint, "places_corridor": corridor}
    return [read(root) for name, read in sorted(readers.items()) if (root / name).is_dir()]


def evaluate(method: Method, benchmark: PlaceBenchmark) -> list[Score]:
    """A row for each prefix of the method's vector."""
    start = time.process_time()
    queries, references = (
        np.stack([method.describe(image) for image in side]) for side in (benchmark.queries, benchmark.references)
    )
    ms = 1e3 * (time.process_time() - start) / (len(queries) + len(references))
    scores = []
    for dim in method.dims:
        found = retrieve(_prefix(queries, dim), _prefix(references, dim), benchmark.truth)
        ap = precision_recall(found).average_precision()
        figures = (found.recall_at(1), found.recall_at(5), ap, ms)
        scores.append(
            Score(benchmark.name, method.name, f"float32x{dim}", 4 * dim, len(queries), *(round(x, 4) for x in figures))
        )
    return scores


def retrieval_for_thresholds(method: Method, benchmark: PlaceBenchmark) -> Retrieval:
    """Nearest neighbours with the benchmark's undecided pairs left out: what a distance threshold is calibrated on."""
    queries, references = (
        np.stack([method.describe(image) for image in side]) for side in (benchmark.queries, benchmark.references)
    )
    return retrieve(queries, references, benchmark.truth, ignore=benchmark.ignore)


def table(scores: Sequence[Score]) -> str:
    """The scores as text, one line each, sets together."""
    widths = {"dataset": 24, "method": 24, "code": 12, "bytes": 6, "queries": 7}
    figures = {"recall_at_1": "R@1", "recall_at_5": "R@5", "ap": "AP"}
    lines = [
        " ".join(
            [*(f"{name:{width}}" for name, width in widths.items()), *(f"{f:>6}" for f in figures.values()), "    ms"]
        )
    ]
    for record in as_records(sorted(scores, key=lambda score: score.dataset)):
        cells = [f"{record[name]!s:{width}}" for name, width in widths.items()]
        lines.append(" ".join([*cells, *(f"{record[name]:6.3f}" for name in figures), f"{record['ms']:6.1f}"]))
    return "\n".join(lines)


def as_records(scores: Sequence[Score]) -> list[dict[str, object]]:
    """For ``--json``."""
    return [asdict(score) for score in scores]


def _prefix(vectors: Vectors, dim: int) -> Vectors:
    cut = vectors[:, :dim]
    return np.asarray(cut / np.maximum(np.linalg.norm(cut, axis=1, keepdims=True), 1e-12), dtype=np.float32)
