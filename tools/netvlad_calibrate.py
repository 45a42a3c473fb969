"""``maslam netvlad calibrate``: measure a model on places with known truth and write its thresholds into its card."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from descriptors.calibration import calibrate, pool
from descriptors.card import ModelCard, read_card, write_card
from tools.netvlad_data import PlaceBenchmark
from tools.netvlad_eval import netvlad_method, retrieval_for_thresholds
from tools.netvlad_train import KINDS, render_worlds
from tools.netvlad_worlds import HELD_OUT_SEEDS, benchmark, config_for
from tools.progress import Progress


@dataclass(frozen=True)
class CalibrationSettings:
    """``worlds`` held-out worlds of each kind, ``places`` places each, a share ``absent`` of which has no reference
    to be found.

    The strict threshold keeps ``precision``; the candidate threshold keeps ``candidate_share`` of the right nearest
    neighbours as long as ``candidate_precision`` of what it lets through is right.
    """

    worlds: int = 2
    places: int = 120
    absent: float = 0.3
    precision: float = 0.99
    candidate_share: float = 0.97
    candidate_precision: float = 0.5
    kinds: tuple[str, ...] = KINDS


def held_out_benchmarks(
    settings: CalibrationSettings, cache: Path, workers: int, progress: Progress
) -> list[PlaceBenchmark]:
    """The rendered worlds that no training sees; named ``town_9500`` and so on."""
    wanted = [(kind, HELD_OUT_SEEDS + k) for kind in settings.kinds for k in range(settings.worlds)]
    rendered = render_worlds(wanted, settings.places, cache, workers, progress)
    return [
        benchmark(f"{kind}_{seed}", places, config_for(kind), settings.absent)
        for (kind, seed), places in rendered.items()
    ]


def calibrate_model(
    model: str | Path, settings: CalibrationSettings, cache: Path, workers: int, progress: Progress
) -> ModelCard:
    """Measure ``model`` on the held-out worlds together, write the thresholds into its card, and return the card."""
    path, card = read_card(model)
    benchmarks = held_out_benchmarks(settings, cache, workers, progress)
    method = netvlad_method(model)
    retrievals = [retrieval_for_thresholds(method, one) for one in benchmarks]
    data = (
        "rendered held-out worlds "
        + ", ".join(one.name for one in benchmarks)
        + f"; {settings.absent:.0%} of the places have no reference"
    )
    result = calibrate(
        pool(retrievals), data, settings.precision, settings.candidate_share, settings.candidate_precision
    )
    written = card.model_copy(
        update={
            "calibration": result,
            "threshold": result.strict.distance,
            "candidate_threshold": result.candidate.distance,
        }
    )
    write_card(path, written)
    return written


def random_pairs_distance(model: str | Path, benchmarks: list[PlaceBenchmark], seed: int = 0) -> tuple[float, float]:
    """Mean and standard deviation of the distance between images of different places: where chance matches lie."""
    method, rng = netvlad_method(model), np.random.default_rng(seed)
    samples: list[float] = []
    for one in benchmarks:
        queries, references = (
            np.stack([method.describe(image) for image in side]) for side in (one.queries, one.references)
        )
        wrong = ~one.truth if one.ignore is None else ~one.truth & ~one.ignore
        rows, cols = np.nonzero(wrong)
        chosen = rng.choice(len(rows), min(2000, len(rows)), replace=False)
        samples += np.linalg.norm(queries[rows[chosen]] - references[cols[chosen]], axis=1).tolist()
    return float(np.mean(samples)), float(np.std(samples))
