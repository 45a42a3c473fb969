"""``maslam netvlad card``: the card of an ONNX file from elsewhere, and what evaluation found, written on a card."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from maslam.descriptors.card import Figure, ModelCard, read_card, write_card
from maslam.descriptors.session import CPU, ModelSession

from ..common.errors import ToolError
from .foreign_model import InputForm, card_for

_MIN_STD = 2.5  # the gate of the shipped model: it looks at images, not at networks


def complete_card(model: Path, form: InputForm, words: Mapping[str, str], figures: Path | None) -> str:
    """Write the card beside ``model``; a line that says so.

    Without one, ``form`` says what the network is given, and its thresholds let everything through until it is
    calibrated. One that exists gets ``words`` (card fields) and ``figures`` (a file of ``maslam netvlad eval --json``).
    """
    if model.with_suffix(".json").is_file():
        if form != InputForm():
            raise ToolError(f"{model}: has a card that says what it takes; delete {model.with_suffix('.json')} first")
        _, card = read_card(model)
    elif not model.is_file():
        raise ToolError(f"{model}: no such file")
    else:
        made = card_for(model, form).model_dump() | {"min_std": _MIN_STD, "licence": "not stated"}
        card = ModelCard.model_validate(made)
    changes: dict[str, Any] = dict(words)
    if figures is not None:
        changes["figures"] = _figures(figures, changes.get("name", card.name))
    card = ModelCard.model_validate(card.model_dump() | changes)
    ModelSession.open(model, card, 1, CPU)  # a card of something that cannot be used is none
    write_card(model, card)
    uncalibrated = "" if card.calibration else "; thresholds not calibrated: maslam netvlad calibrate"
    return f"{model.with_suffix('.json')}: {card.name}, {card.dim} numbers{uncalibrated}"


def _figures(path: Path, name: str) -> list[Figure]:
    """The rows about the model called ``name``."""
    try:
        rows = json.loads(path.read_text(encoding="utf-8"))
        mine = [row for row in rows if row["method"] == f"netvlad:{name}"]
        figures = [Figure.model_validate({key: row[key] for key in Figure.model_fields}) for row in mine]
    except OSError as error:
        raise ToolError(f"{path}: {error.strerror}") from error
    except (ValueError, TypeError, KeyError, ValidationError) as error:
        raise ToolError(f"{path}: not what `maslam netvlad eval --json` prints") from error
    if not figures:
        raise ToolError(f"{path}: no row about netvlad:{name}")
    return figures
