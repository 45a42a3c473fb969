"""Any ONNX place descriptor, with or without a card: what its file does not say, the user's options say."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from maslam.descriptors.card import ModelCard, file_sha256
from maslam.descriptors.inference import NetVlad
from maslam.descriptors.session import CPU, ModelSession, open_graph, run_graph

from ..common.errors import ToolError

_PIXELS = 76_800  # 320x240


@dataclass(frozen=True)
class InputForm:
    """Input of a network without a card. ``pixels``: images are resized to about so many, their shape kept;
    ``size`` (height, width): to exactly this instead; None where the file says all there is to say. ``mean`` and
    ``std``: grey levels, one number for each channel; a network that takes float32 gets (level - mean) / std."""

    pixels: int | None = None
    size: tuple[int, int] | None = None
    mean: tuple[float, ...] = ()
    std: tuple[float, ...] = ()


def load_model(model: str, form: InputForm | None = None) -> NetVlad:
    """A shipped model by name, a model with its card, or an ONNX file alone, used as ``form`` says.

    ``ToolError`` where the file is absent, or ``form`` is given for a model whose card says it all.
    """
    path, form = Path(model), form or InputForm()
    carded = path.suffix != ".onnx" or path.with_suffix(".json").is_file()
    if carded:
        if form != InputForm():
            raise ToolError(f"{model}: has a card that says what it takes, so options for its input change nothing")
        return NetVlad.load(model)
    if not path.is_file():
        raise ToolError(f"{path}: no such file")
    card = card_for(path, form)
    return NetVlad(ModelSession.open(path, card, 1, CPU), card)


def card_for(path: Path, form: InputForm) -> ModelCard:
    """A card for a bare file, from its input's shape and one blank image sent through it."""
    session = open_graph(path)
    given = session.get_inputs()[0]
    if len(given.shape) != 4:
        raise ToolError(f"{path}: takes an input of shape {given.shape}, images are (N, channels, H, W)")
    _, channels, height, width = given.shape
    if channels not in (1, 3):
        raise ToolError(f"{path}: takes {channels} channels, images have 1 (grey) or 3 (R, G, B) and come before H, W")
    size = form.size
    if isinstance(height, int) and isinstance(width, int):
        if size is not None and size != (height, width):
            raise ToolError(f"{path}: takes images of {width}x{height} alone, not {size[1]}x{size[0]}")
        size = (height, width)
    for name, values in (("mean", form.mean), ("std", form.std)):
        if values and len(values) != channels:
            raise ToolError(f"{path}: takes {channels} channels, but {len(values)} numbers for their {name} are given")
    return ModelCard(
        name=path.stem,
        sha256=file_sha256(path),
        dim=_dimension(session, path, channels, size or (240, 320)),
        input_pixels=form.pixels or _PIXELS,
        input_size=size,
        colour=channels == 3,
        mean=form.mean,
        std=form.std,
        threshold=2.0,
        candidate_threshold=2.0,
        min_std=0.0,
    )


def _dimension(session: Any, path: Path, channels: int, size: tuple[int, int]) -> int:
    kind = np.uint8 if session.get_inputs()[0].type == "tensor(uint8)" else np.float32
    made = run_graph(session, path, np.full((1, channels, *size), 128, dtype=kind))
    if made.ndim != 2:
        raise ToolError(f"{path}: makes {made.shape} of one image, a place descriptor makes (1, numbers)")
    return int(made.shape[1])
