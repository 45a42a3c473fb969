"""``maslam netvlad calibrate``: measure a model on places with known truth and write its thresholds into a card."""

from __future__ import annotations

import shutil
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from maslam._atomic import replacing
from maslam._replaced import replaced
from maslam.descriptors.calibration import Retrieval, accepted, calibrate, retrieve
from maslam.descriptors.card import MODELS, Calibration, ModelCard, read_card, write_card
from maslam.descriptors.codebooks import codebooks_path
from maslam.descriptors.inference import NetVlad

from ..common.errors import UsageError
from ..common.progress import Progress
from ..common.text_table import aligned
from ..place_benchmarks.public_sets import PlaceBenchmark
from ..place_benchmarks.rendered import HELD_OUT_SEEDS, benchmark, config_for
from ..place_benchmarks.revisits import RevisitSettings, posed_benchmark
from .train import KINDS, render_worlds


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


def own_benchmarks(
    folders: Sequence[Path], settings: RevisitSettings, colour: bool, progress: Progress
) -> tuple[list[PlaceBenchmark], str]:
    """A user's own data sets with ground truth, in ``colour`` for a colour network, and what was measured on, in
    words for the card."""
    sets: list[PlaceBenchmark] = []
    for folder in folders:
        tasks: list[int] = []

        def advance(done: int, total: int, tasks: list[int] = tasks, name: str = folder.name) -> None:
            if not tasks:
                tasks.append(progress.start(f"reading {name}", total))
            progress.advance(tasks[0], done)

        sets.append(posed_benchmark(folder, settings, advance, colour))
    names = [one.name for one in sets]
    if len(set(names)) < len(names):
        raise UsageError(f"--sequence: two data sets have one name: {', '.join(sorted(names))}")
    return sets, (
        f"own sequences {', '.join(names)}; same place within {settings.radius_m:g} m and {settings.angle_deg:g} "
        f"degrees, {settings.apart_s:g} s or more apart, a frame each {settings.spacing_m:g} m"
    )


def world_benchmarks(
    settings: CalibrationSettings, cache: Path, workers: int, progress: Progress
) -> tuple[list[PlaceBenchmark], str]:
    """The held-out rendered worlds, and what was measured on, in words for the card."""
    sets = held_out_benchmarks(settings, cache, workers, progress)
    names = ", ".join(one.name for one in sets)
    return sets, f"rendered held-out worlds {names}; {settings.absent:.0%} of the places have no reference"


def target(model: str, out: Path | None) -> Path | None:
    """Path of the calibrated card: None beside the model itself. A shipped model, asked for by its name, keeps
    its card."""
    if out is None and not model.endswith(".onnx"):
        raise UsageError(
            f"{model}: a shipped model keeps the card it came with; --out FILE.onnx makes a copy with your thresholds"
        )
    if out is not None and out.suffix != ".onnx":
        raise UsageError(f"--out {out}: a copy of the model is meant, FILE.onnx (its card goes beside it)")
    return out


def calibrate_model(
    model: str | Path,
    benchmarks: Sequence[PlaceBenchmark],
    data: str,
    settings: CalibrationSettings,
    progress: Progress,
    out: Path | None = None,
) -> tuple[Path, ModelCard]:
    """Measure ``model`` on the sets, write both thresholds into its card, or into that of a copy ``out``; the card's
    path and content. ``data``: the sets in words."""
    path, card = read_card(model)
    net = NetVlad.load(model)
    task = progress.start("describing", len(benchmarks))
    retrievals = {}
    for number, one in enumerate(benchmarks):
        retrievals[one.name] = retrieval(net, one)
        progress.advance(task, number + 1)
    result = calibrate(retrievals, data, settings.precision, settings.candidate_share, settings.candidate_precision)
    limits = {"threshold": result.strict.distance, "candidate_threshold": result.candidate.distance}
    written = replaced(card, calibration=result, **limits)
    if out is not None and out.resolve() != path.resolve():
        _copy(path, out)
        path = out
    write_card(path, written)
    return path.with_suffix(".json"), written


def _copy(model: Path, out: Path) -> None:
    """A model with its codebooks, which are those of its weights."""
    out.parent.mkdir(parents=True, exist_ok=True)
    for source, copy in ((model, out), (codebooks_path(model), codebooks_path(out))):
        if source == model or source.is_file():
            with replacing(copy) as part:
                shutil.copyfile(source, part)


def retrieval(net: NetVlad, benchmark: PlaceBenchmark) -> Retrieval:
    """Nearest neighbours with the undecided pairs and those that are never compared left out; each image described
    once."""
    images = {id(image): image for image in (*benchmark.queries, *benchmark.references)}
    vectors = dict(zip(images, net.describe(list(images.values())), strict=True))
    queries, references = (
        np.stack([vectors[id(image)] for image in side]) for side in (benchmark.queries, benchmark.references)
    )
    masks = [mask for mask in (benchmark.ignore, benchmark.barred) if mask is not None]
    return retrieve(queries, references, benchmark.truth, ignore=np.logical_or.reduce(masks) if masks else None)


def summary_lines(path: Path, calibration: Calibration, precision: float) -> list[str]:
    """Result of the calibration as text: the card written, both thresholds, each set by itself, and what to doubt."""
    lines = [f"{path}: {'a shipped card rewritten' if path.parent.resolve() == MODELS else 'written'}"]
    rows = [["", "distance", "precision", "recall"]]
    for name, point in (("strict", calibration.strict), ("candidate", calibration.candidate)):
        rows.append([name, f"{point.distance:.3f}", f"{point.precision:.3f}", f"{point.recall:.3f}"])
    for one in calibration.sets:
        name = f"strict, {one.name} alone ({one.findable} of {one.queries} queries have a place to find)"
        if one.strict is None:
            rows.append([name, "none", "-", "-"])
        else:
            rows.append([name, *(f"{x:.3f}" for x in (one.strict.distance, one.strict.precision, one.strict.recall))])
    lines += aligned(rows)
    matches, enough = accepted(calibration), round(1.0 / max(1.0 - precision, 1e-3))
    if matches < enough:
        lines.append(
            f"warning: {matches} matches stand at the strict threshold; a precision of {precision:g} takes {enough} "
            "to tell: use more or longer sequences"
        )
    return lines
