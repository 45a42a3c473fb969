"""``maslam netvlad info``: a model's card for people, and what it costs on this machine."""

from __future__ import annotations

import statistics
import time
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from maslam.descriptors.card import ModelCard, read_card
from maslam.descriptors.codebooks import codebooks_path
from maslam.descriptors.session import find_provider

from ..common.text_table import aligned

_SIZE = (320, 240)  # width, height of the images timed
_IMAGES = 32
_LONGEST_S = 4.0


@dataclass(frozen=True)
class Speed:
    """``load_s``: from a fresh process's import of onnxruntime to a model ready to use, wall clock, and ``load_cpu_s``
    processor time. ``image_ms`` for one image of 320x240, wall clock, and ``image_cpu_ms`` of all threads: the median
    over ``images`` of them."""

    provider: str
    threads: int
    batch: int
    load_s: float
    load_cpu_s: float
    image_ms: float
    image_cpu_ms: float
    images: int


def measure(model: str, threads: int = 1, provider: str = "CPU", batch: int = 1) -> Speed:
    """Load ``model`` and describe a few pictures made of noise at several scales; at most some seconds."""
    wall, cpu = time.perf_counter(), time.process_time()
    from maslam.descriptors.inference import NetVlad

    net = NetVlad.load(model, threads, provider, batch)
    load_s, load_cpu_s = time.perf_counter() - wall, time.process_time() - cpu
    rng = np.random.default_rng(0)
    pictures = [_picture(rng) for _ in range(batch)]
    net.look(pictures)  # the first run reserves memory
    walls: list[float] = []
    cpus: list[float] = []
    end = time.perf_counter() + _LONGEST_S
    while not walls or (len(walls) * batch < _IMAGES and time.perf_counter() < end):
        wall, cpu = time.perf_counter(), time.process_time()
        net.look(pictures)
        walls.append((time.perf_counter() - wall) / batch)
        cpus.append((time.process_time() - cpu) / batch)
    ms = 1e3 * statistics.median(walls), 1e3 * statistics.median(cpus)
    return Speed(find_provider(provider), threads, batch, load_s, load_cpu_s, *ms, len(walls) * batch)


def as_record(model: str, speed: Speed) -> dict[str, Any]:
    """For ``--json``: the card, the file, the speed."""
    path, card = read_card(model)
    return {
        "file": str(path),
        "file_bytes": path.stat().st_size,
        "card": card.model_dump(mode="json"),
        "speed": asdict(speed),
    }


def as_text(model: str, speed: Speed) -> str:
    """The same for people."""
    path, card = read_card(model)
    shape = f"{card.input_size[1]}x{card.input_size[0]}" if card.input_size else f"about {card.input_pixels} pixels"
    facts = {
        "name": card.name,
        "file": f"{path} ({path.stat().st_size / 1e6:.1f} MB)",
        "codebooks": _codebooks(path),
        "SHA-256": card.sha256,
        "vector": f"{card.dim} numbers of unit length, {4 * card.dim} bytes as float32",
        "input": f"{'colour' if card.colour else 'grey'}, {shape}",
        "texture gate": f"local contrast of {card.min_std:g} grey levels",
        "licence": card.licence,
        "training": card.training,
        "trained on": card.data,
        "source": card.source,
        "calibrated on": card.calibration.data if card.calibration else "nothing: thresholds as they were set",
    }
    width = max(len(name) for name in facts)
    lines = [f"{name:<{width}}  {value}" for name, value in facts.items() if value]
    lines += ["", *aligned(_thresholds(card))]
    if card.figures:
        lines += ["", *aligned(_figures(card))]
    return "\n".join([*lines, "", _speed_line(speed)])


def _codebooks(model: Path) -> str:
    """The file of product codes, or how to come by it."""
    books = codebooks_path(model)
    if books.is_file():
        return f"{books} ({books.stat().st_size / 1e6:.1f} MB)"
    return "none: its vectors cannot be transmitted in product codes"


def _thresholds(card: ModelCard) -> list[list[str]]:
    rows = [["threshold", "distance", "precision", "recall"]]
    found = card.calibration
    for name, distance, point in (
        ("strict: on appearance alone", card.threshold, found.strict if found else None),
        ("candidate: geometry decides", card.candidate_threshold, found.candidate if found else None),
    ):
        measured = point is not None and abs(point.distance - distance) < 1e-6
        figures = [f"{point.precision:.3f}", f"{point.recall:.3f}"] if point is not None and measured else ["-", "-"]
        rows.append([name, f"{distance:.3f}", *figures])
    return rows


def _figures(card: ModelCard) -> list[list[str]]:
    rows = [["set", "code", "bytes", "queries", "recall@1", "recall@5", "AP"]]
    for one in card.figures:
        numbers = [f"{x:.3f}" for x in (one.recall_at_1, one.recall_at_5, one.ap)]
        rows.append([one.dataset, one.code, str(one.bytes), str(one.queries), *numbers])
    return rows


def _speed_line(speed: Speed) -> str:
    return (
        f"here: loads in {speed.load_s:.2f} s ({speed.load_cpu_s:.2f} s of processor time), "
        f"{speed.image_ms:.1f} ms an image of {_SIZE[0]}x{_SIZE[1]} ({speed.image_cpu_ms:.1f} ms of processor time; "
        f"median of {speed.images}; {speed.provider}, threads {speed.threads}, batch {speed.batch})"
    )


def _picture(rng: np.random.Generator) -> NDArray[np.uint8]:
    width, height = _SIZE
    layers = [
        cv2.resize(rng.normal(size=(cells * 3, cells * 4)), (width, height), interpolation=cv2.INTER_CUBIC)
        for cells in (2, 8, 32)
    ]
    return np.asarray((127 + 30 * np.sum(layers, axis=0)).clip(0, 255), dtype=np.uint8)
