"""The card of a model: what stands beside its ONNX file, read and checked before the model is used."""

from __future__ import annotations

import hashlib
from pathlib import Path

from pydantic import BaseModel, ConfigDict, Field, PositiveFloat, PositiveInt, ValidationError, model_validator

from maslam._atomic import write_atomically

from .errors import DescriptorError

MODELS = Path(__file__).parent / "models"


class OperatingPoint(BaseModel):
    """A distance threshold and what was measured there, over all pairs of the calibration set."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    distance: float = Field(gt=0)  # Euclidean distance between unit vectors, 0 to 2
    precision: float = Field(ge=0, le=1)  # share of the accepted nearest neighbours that show the query's place
    recall: float = Field(ge=0, le=1)  # share of the queries with a place to find that are accepted and right


class SetCurve(BaseModel):
    """One set of images (a rendered world, a sequence of the user's) out of those a calibration pools."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    name: str
    queries: int = Field(ge=0)
    findable: int = Field(ge=0)  # queries that have a place to find
    strict: OperatingPoint | None = None  # what this set alone would have given; None where it supports no threshold
    curve: tuple[OperatingPoint, ...] = ()


class Calibration(BaseModel):
    """Origin of the thresholds. ``curve``: rising through the distances, for plots and for other choices."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    data: str  # what was measured on, in words
    queries: int = Field(ge=0)
    strict: OperatingPoint  # a match on appearance alone
    candidate: OperatingPoint  # worth a geometric verification
    curve: tuple[OperatingPoint, ...] = ()
    sets: tuple[SetCurve, ...] = ()  # the same, set by set


class Figure(BaseModel):
    """Recognition of one set's places with one code of the vectors: a row of ``maslam netvlad eval``."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    dataset: str
    code: str
    bytes: int = Field(gt=0)  # of one transmitted vector
    queries: int = Field(ge=0)
    recall_at_1: float = Field(ge=0, le=1)
    recall_at_5: float = Field(ge=0, le=1)
    ap: float = Field(ge=0, le=1)  # average precision of "the nearest neighbour, if near enough"


class ModelCard(BaseModel):
    """The description that a model's user needs; ``default.json`` beside ``default.onnx``."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    name: str = Field(min_length=1)
    sha256: str = Field(pattern=r"^[0-9a-f]{64}$")  # of the ONNX file
    dim: int = Field(gt=0)
    input_pixels: int = Field(gt=0)  # an image is resized to about this many pixels, its shape kept
    input_size: tuple[PositiveInt, PositiveInt] | None = None  # (height, width): exactly this instead, for rigid graphs
    colour: bool = False  # the network takes (N, 3, H, W) in the order R, G, B; else (N, 1, H, W) grey
    mean: tuple[float, ...] = ()  # grey levels, one for each channel: graphs that take float32 get (level - mean) / std
    std: tuple[PositiveFloat, ...] = ()
    threshold: float = Field(gt=0)  # Euclidean distance: matches on appearance alone
    candidate_threshold: float = Field(gt=0)  # Euclidean distance: candidates for geometric verification
    min_std: float = Field(ge=0)  # grey levels: an image with less local contrast has no texture to recognise
    licence: str = "BSD-3-Clause"
    training: str = ""  # the commands that made the weights
    data: str = ""  # the images they were trained on, in words
    source: str = ""  # where foreign weights come from: file, paper
    calibration: Calibration | None = None
    figures: tuple[Figure, ...] = ()

    @property
    def channels(self) -> int:
        """Channels of the network's input: 3 with colour, else 1."""
        return 3 if self.colour else 1

    @model_validator(mode="after")
    def _fits_channels(self) -> ModelCard:
        for name, values in (("mean", self.mean), ("std", self.std)):
            if values and len(values) != self.channels:
                raise ValueError(f"{name} has {len(values)} values for {self.channels} channels")
        if self.candidate_threshold < self.threshold:
            raise ValueError(f"candidate_threshold {self.candidate_threshold} is under threshold {self.threshold}")
        return self


def model_path(model: str | Path) -> Path:
    """The ``.onnx`` file of a shipped model (by name) or of a user's (its path), whether it is there or not."""
    return MODELS / f"{model}.onnx" if isinstance(model, str) and not model.endswith(".onnx") else Path(model)


def read_card(model: str | Path) -> tuple[Path, ModelCard]:
    """The ONNX file and the checked card of a shipped model (by name) or of a user's (path of the ``.onnx`` file)."""
    onnx_path = model_path(model)
    card_path = onnx_path.with_suffix(".json")
    for path in (onnx_path, card_path):
        if not path.is_file():
            raise DescriptorError(f"{path}: not found (a model is an ONNX file and a card of the same name)")
    try:
        card = ModelCard.model_validate_json(card_path.read_text(encoding="utf-8"))
    except ValidationError as error:
        first = error.errors()[0]
        field = ".".join(str(part) for part in first["loc"])
        raise DescriptorError(f"{card_path}: {field or 'the card'}: {first['msg']}") from error
    if card.sha256 != file_sha256(onnx_path):
        raise DescriptorError(f"{onnx_path}: not the weights that {card_path.name} describes (SHA-256 differs)")
    return onnx_path, card


def write_card(path: Path, card: ModelCard) -> None:
    """Write ``card`` beside its model; ``path`` is the ``.onnx`` or the ``.json`` file."""
    write_atomically(path.with_suffix(".json"), card.model_dump_json(indent=1) + "\n")


def file_sha256(path: Path) -> str:
    """SHA-256 of a file, hexadecimal."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
