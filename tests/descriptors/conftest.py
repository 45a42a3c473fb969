"""Images and small models that the descriptor tests share."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from maslam.descriptors.card import ModelCard, file_sha256


def textured_image(seed: int, height: int = 120, width: int = 160) -> NDArray[np.uint8]:
    """Blobs and edges at several scales, another picture for every seed."""
    import cv2

    rng = np.random.default_rng(seed)
    image = np.zeros((height, width), dtype=np.float32)
    for cells in (3, 6, 12, 24):
        coarse = rng.normal(size=(cells, cells + cells // 3)).astype(np.float32)
        image += cv2.resize(coarse, (width, height), interpolation=cv2.INTER_CUBIC)
    for _ in range(12):
        x, y, w, h = rng.integers([0, 0, 8, 8], [width, height, width // 3, height // 3])
        image[y : y + h, x : x + w] += rng.normal() * 1.5
    return np.asarray((127 + 45 * image / image.std()).clip(0, 255).astype(np.uint8))


@pytest.fixture
def images() -> list[NDArray[np.uint8]]:
    """Eight different pictures of 160x120."""
    return [textured_image(seed) for seed in range(8)]


def tiny_model(
    path: Path,
    *,
    channels: int = 1,
    floats: bool = False,
    inputs: int = 1,
    size: tuple[int | str, int | str] = ("h", "w"),
    scale: float = 1.0,
    card: dict[str, Any] | None = None,
) -> Path:
    """An ONNX file and its card: each channel's mean over the image times ``scale``, not brought to unit length.

    With it anyone can say what must come out. ``card``: what its card says otherwise.
    """
    onnx = pytest.importorskip("onnx")
    helper, kinds = onnx.helper, onnx.TensorProto
    kind = kinds.FLOAT if floats else kinds.UINT8
    names = ["images", *(f"more_{k}" for k in range(1, inputs))]
    nodes = [
        helper.make_node("Cast", ["images"], ["values"], to=kinds.FLOAT),
        helper.make_node("ReduceMean", ["values"], ["means"], axes=[2, 3], keepdims=0),
        helper.make_node("Mul", ["means", "scale"], ["vectors"]),
    ]
    graph = helper.make_graph(
        nodes,
        "means",
        [helper.make_tensor_value_info(name, kind, ["n", channels, *size]) for name in names],
        [helper.make_tensor_value_info("vectors", kinds.FLOAT, ["n", channels])],
        [onnx.numpy_helper.from_array(np.array(scale, dtype=np.float32), "scale")],
    )
    opset = [helper.make_opsetid("", 17)]
    path.write_bytes(helper.make_model(graph, opset_imports=opset, ir_version=8).SerializeToString())
    fields = {
        "name": path.stem,
        "sha256": file_sha256(path),
        "dim": channels,
        "input_pixels": 300,
        "threshold": 0.5,
        "candidate_threshold": 0.8,
        "min_std": 2.5,
        "colour": channels == 3,
    }
    path.with_suffix(".json").write_text(ModelCard.model_validate(fields | (card or {})).model_dump_json())
    return path
