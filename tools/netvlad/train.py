"""``maslam netvlad train`` and ``export``: images in, a checkpoint out; a checkpoint in, an ONNX model with its
card out."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from maslam._settings import Settings
from maslam.descriptors.card import ModelCard, file_sha256, write_card

from ..common.errors import ToolError
from ..common.parallel import core_count, run_jobs
from ..common.progress import Progress
from ..place_benchmarks.public_sets import read_photos
from ..place_benchmarks.rendered import (
    HELD_OUT_SEEDS,
    TRAINING_SEEDS,
    Visit,
    benchmark,
    config_for,
    conflicts,
    rendered_places,
)

if TYPE_CHECKING:
    from maslam.descriptors.config import TrainingConfig
    from maslam.descriptors.training.network import NetVladNetwork
    from maslam.descriptors.training.trainer import PlaceSet

KINDS = ("indoor", "town")


class MaterialConfig(Settings):
    """Material of a training run."""

    towns: int = Field(4, ge=0, description="rendered towns to train on")
    indoors: int = Field(4, ge=0, description="rendered indoor floors to train on")
    places: int = Field(220, gt=1, description="of each world, three visits each")
    held_out_places: int = Field(120, ge=0, description="of one more world of each kind, to watch the training by")
    photo_weight: float = Field(0.5, ge=0, description="share of the photographs, relative to the other two")
    town_weight: float = Field(0.25, ge=0, description="share of all towns together")
    indoor_weight: float = Field(0.25, ge=0, description="share of all indoor floors together")
    strips: float = Field(0.3, ge=0, le=1, description="share of photographs made look-alikes by a common strip")


@dataclass(frozen=True)
class TrainJob:
    """``photos``: folder of photographs or None; ``out``: folder for checkpoints and log; ``cache``: folder for
    rendered places; ``start``: a checkpoint whose weights training goes on from."""

    out: Path
    photos: Path | None
    cache: Path
    start: Path | None = None
    workers: int = 0


def train(job: TrainJob, config: TrainingConfig, material: MaterialConfig, progress: Progress) -> Path:
    """Train to the configured number of steps; the checkpoint's path. An unfinished training in ``job.out`` is
    taken up again.

    Writes ``log.jsonl`` (one line for each 50 steps) and its curves, ``training.png``, beside the checkpoint.
    """
    from maslam.descriptors.training.trainer import Trainer

    from .training_figures import training_picture

    job.out.mkdir(parents=True, exist_ok=True)
    done, unfinished, log = job.out / "checkpoint.pt", job.out / "unfinished.pt", job.out / "log.jsonl"
    sets = gather(job, material, progress)
    trainer = Trainer(config, sets)
    if unfinished.is_file():
        trainer.resume(unfinished)
        progress.say(f"goes on at step {trainer.step}")
    elif job.start is not None:
        fresh = trainer.start_from(job.start)
        progress.say(f"weights of {job.start}" + (f"; new: {', '.join(fresh)}" if fresh else ""))
    else:
        trainer.start()
    task = progress.start("training", config.steps)
    for line in trainer.run(watcher(job, material, config, progress)):
        progress.advance(task, line.step)
        shown = " ".join(f"{name} {value:.3f}" for name, value in line.validation.items())
        progress.say(f"step {line.step}: loss {line.loss:.3f} right {line.accuracy:.3f} {shown}")
        with log.open("a", encoding="utf-8") as file:
            figures = {
                "step": line.step,
                "loss": line.loss,
                "right": line.accuracy,
                "scale": line.scale,
                **line.validation,
            }
            file.write(json.dumps(figures) + "\n")
        if line.step % config.checkpoint_every == 0:
            trainer.save(unfinished)
            training_picture(log, job.out / "training.png")
    progress.say("fitting the projection")
    trainer.finish()
    trainer.save(done)
    unfinished.unlink(missing_ok=True)
    return done


def gather(job: TrainJob, material: MaterialConfig, progress: Progress) -> list[PlaceSet]:
    """Photographs and rendered places as sets to draw from; worlds are rendered by as many processes as the machine
    has cores."""
    from maslam.descriptors.training.augmentation import RENDERED
    from maslam.descriptors.training.trainer import PlaceSet

    sets = []
    if job.photos is not None and material.photo_weight > 0:
        photos = read_photos(job.photos)
        sets.append(PlaceSet("photos", photos[:, None], weight=material.photo_weight, strips=material.strips))
    counts = {"town": (material.towns, material.town_weight), "indoor": (material.indoors, material.indoor_weight)}
    wanted = [(kind, TRAINING_SEEDS + k) for kind in KINDS for k in range(counts[kind][0]) if counts[kind][1] > 0]
    rendered = render_worlds(wanted, material.places, job.cache, job.workers, progress)
    for (kind, seed), places in rendered.items():
        weight = counts[kind][1]
        views = np.stack([np.stack([visit.image for visit in visits]) for visits in places])
        sets.append(PlaceSet(f"{kind}_{seed}", views, conflicts(places, config_for(kind)), weight, kind, RENDERED))
    if not sets:
        raise ToolError("nothing to train on: neither photographs nor rendered worlds are wanted")
    return sets


def render_worlds(
    wanted: list[tuple[str, int]], places: int, cache: Path, workers: int, progress: Progress
) -> dict[tuple[str, int], list[list[Visit]]]:
    """The places of each (kind, seed), rendered into ``cache`` where they are not there yet."""
    jobs = {f"{kind} {seed}": ((kind, seed, places, cache), places) for kind, seed in wanted}
    for name, outcome in run_jobs(_render_job, jobs, workers or core_count(), progress).items():
        if outcome.error:
            raise ToolError(f"rendering {name}: {outcome.error}") from outcome.error
    return {(kind, seed): rendered_places(kind, seed, places, cache) for kind, seed in wanted}


def watcher(
    job: TrainJob, material: MaterialConfig, config: TrainingConfig, progress: Progress
) -> Callable[[NetVladNetwork], dict[str, float]] | None:
    """Recall@1 on held-out worlds, for the log; None where none are wanted."""
    from maslam.descriptors.calibration import retrieve
    from maslam.descriptors.inference import to_working_size
    from maslam.descriptors.training.initialisation import vlads_of

    kinds = [kind for kind in KINDS if (material.indoors if kind == "indoor" else material.towns)]
    if not material.held_out_places or not kinds:
        return None
    rendered = render_worlds(
        [(kind, HELD_OUT_SEEDS) for kind in kinds], material.held_out_places, job.cache, job.workers, progress
    )
    sets = [benchmark(kind, places, config_for(kind), absent=0.0) for (kind, _), places in rendered.items()]

    def vlads(network: NetVladNetwork, images: list[NDArray[np.uint8]]) -> NDArray[np.float32]:
        stack = np.stack([to_working_size(image, config.width * config.height) for image in images])
        return vlads_of(network, stack)

    def watch(network: NetVladNetwork) -> dict[str, float]:
        # The VLAD vector is what is trained; the projection is fitted when training is over.
        return {
            one.name: retrieve(vlads(network, one.queries), vlads(network, one.references), one.truth).recall_at(1)
            for one in sets
        }

    return watch


def export(checkpoint: Path, out: Path, name: str, input_pixels: int, training: str) -> Path:
    """Write ``out`` (``.onnx``) and its card. Thresholds are not known yet: 2.0 (every pair) until ``calibrate``
    sets them."""
    from maslam.descriptors.training.onnx_export import export_onnx
    from maslam.descriptors.training.trainer import load_network

    if out.suffix != ".onnx":
        raise ToolError(f"{out}: a model's file must end in .onnx")
    network = load_network(checkpoint)
    out.parent.mkdir(parents=True, exist_ok=True)
    export_onnx(network, out)
    card = ModelCard(
        name=name,
        sha256=file_sha256(out),
        dim=network.config.dim,
        input_pixels=input_pixels,
        threshold=2.0,
        candidate_threshold=2.0,
        min_std=MIN_STD,
        training=training,
    )
    write_card(out, card)
    return out


MIN_STD = 2.5
"""Grey levels of local contrast: above what sensor noise leaves after resizing, below any photograph
(docs/appendix/netvlad.md)."""


def _render_job(job: tuple[str, int, int, Path], advance: Callable[[int], None]) -> None:
    kind, seed, places, cache = job
    count = 0

    def tick() -> None:
        nonlocal count
        count += 1
        advance(count)

    rendered_places(kind, seed, places, cache, tick)
