"""A model's ONNX graph opened with onnxruntime and checked against its card: what goes in, what comes out, where it
runs."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from maslam._suggestions import hint

from .card import ModelCard
from .errors import DescriptorError

CPU = "CPUExecutionProvider"
_SUFFIX = "ExecutionProvider"
_TYPES = {"tensor(uint8)": np.uint8, "tensor(float)": np.float32}
_UNIT = 1e-3  # a vector off unit length by more than this is scaled to it


def load_onnxruntime() -> Any:
    """The library that runs models, with its telemetry off: the one place where it is imported.

    By default its builds write an identifier of this machine below the home directory and report to their maker. The
    variable must stand before the first import; a value that the user has set stays.
    """
    os.environ.setdefault("ORT_DISABLE_TELEMETRY", "1")
    import onnxruntime

    return onnxruntime


def available_providers() -> tuple[str, ...]:
    """Execution providers of this installation of onnxruntime, the default first: ``CPUExecutionProvider``, ..."""
    return tuple(sorted(load_onnxruntime().get_available_providers(), key=lambda name: (name != CPU, name)))


def find_provider(wanted: str) -> str:
    """The full name of a provider given in full or in short (``cuda``, ``CUDAExecutionProvider``), in any case."""
    known = available_providers()
    for name in known:
        if wanted.lower() in (name.lower(), name.removesuffix(_SUFFIX).lower()):
            return name
    names = [name.removesuffix(_SUFFIX) for name in known]
    near = hint(wanted.lower(), [name.lower() for name in names])  # in any case
    raise DescriptorError(f"onnxruntime has no provider '{wanted}' here, only: {', '.join(names)}{near}")


class ModelSession:
    """One opened graph. ``run`` may be called from several threads at a time."""

    def __init__(self, session: Any, path: Path, card: ModelCard) -> None:
        self._session, self.path, self._card = session, path, card
        (given,) = session.get_inputs()
        self._type = _TYPES[given.type]

    @classmethod
    def open(cls, path: Path, card: ModelCard, threads: int, provider: str) -> ModelSession:
        """``threads``: that share one image's work on a CPU. ``DescriptorError`` where the graph cannot be loaded, or
        is not what ``card`` says."""
        session = open_graph(path, threads, provider)
        _check(session, path, card)
        return cls(session, path, card)

    def run(self, images: NDArray[np.uint8]) -> NDArray[np.float32]:
        """Unit vectors ``(N, dim)`` float32 of images ``(N, C, H, W)`` uint8, all of one size."""
        values: NDArray[Any] = images
        if self._type is np.float32:
            values = images.astype(np.float32)
            if self._card.mean:
                values -= np.array(self._card.mean, dtype=np.float32)[:, None, None]
            if self._card.std:
                values /= np.array(self._card.std, dtype=np.float32)[:, None, None]
        vectors = run_graph(self._session, self.path, values)
        if vectors.shape != (len(images), self._card.dim):
            raise DescriptorError(
                f"{self.path}: makes {vectors.shape} of {len(images)} images, "
                f"but its card says {self._card.dim} numbers each"
            )
        norms = np.linalg.norm(vectors, axis=1, keepdims=True)
        if not np.isfinite(norms).all():
            raise DescriptorError(f"{self.path}: makes vectors that are not finite")
        if np.abs(norms - 1.0).max(initial=0.0) > _UNIT:
            vectors = vectors / np.maximum(norms, 1e-12)
        return np.asarray(vectors, dtype=np.float32)


def open_graph(path: Path, threads: int = 1, provider: str = CPU) -> Any:
    """An onnxruntime session of any graph; ``DescriptorError`` where it cannot be loaded, or ``provider`` not start."""
    onnxruntime = load_onnxruntime()
    name = find_provider(provider)
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads, options.inter_op_num_threads = threads, 1
    options.log_severity_level = 4  # what goes wrong is raised, and said once
    try:
        session = onnxruntime.InferenceSession(str(path), options, providers=[name] if name == CPU else [name, CPU])
    except Exception as error:
        raise DescriptorError(f"{path}: onnxruntime cannot load it: {_line(error)}") from error
    if session.get_providers()[0] != name:  # onnxruntime falls back on its own where a driver is missing
        raise DescriptorError(f"{path}: {name} does not start on this machine (driver or libraries missing?)")
    return session


def run_graph(session: Any, path: Path, values: NDArray[Any]) -> NDArray[Any]:
    """The first output for the first input; ``path``: of the graph, for the ``DescriptorError`` that says why not."""
    try:
        made = session.run([session.get_outputs()[0].name], {session.get_inputs()[0].name: values})[0]
    except Exception as error:
        size = "x".join(map(str, values.shape[:1:-1]))
        raise DescriptorError(f"{path}: onnxruntime cannot run it on images of {size}: {_line(error)}") from error
    return np.asarray(made)


def _check(session: Any, path: Path, card: ModelCard) -> None:
    """Everything that can be said before an image is there."""
    inputs, output = session.get_inputs(), session.get_outputs()[0]
    if len(inputs) != 1:
        names = ", ".join(one.name for one in inputs)
        raise DescriptorError(f"{path}: takes {len(inputs)} inputs ({names}), a place descriptor takes one: images")
    given = inputs[0]
    if given.type not in _TYPES:
        raise DescriptorError(f"{path}: takes {given.type}, a place descriptor takes uint8 or float32 images")
    if len(given.shape) != 4:
        raise DescriptorError(f"{path}: takes an input of shape {given.shape}, images are (N, channels, H, W)")
    batch, channels, *size = given.shape
    if isinstance(channels, int) and channels != card.channels:
        kind = "colour" if card.colour else "grey"
        raise DescriptorError(f"{path}: takes {channels} channels, its card says {kind} ({card.channels})")
    if isinstance(batch, int) and batch != 1:
        raise DescriptorError(f"{path}: takes exactly {batch} images at a time; the number must be free, or 1")
    wanted = card.input_size or (None, None)
    for side, fixed, said in zip(("height", "width"), size, wanted, strict=True):
        if isinstance(fixed, int) and fixed != said:
            raise DescriptorError(
                f"{path}: takes images of {side} {fixed} alone; its card's input_size says {said or 'nothing'}"
            )
    dim = output.shape[-1] if len(output.shape) == 2 else None
    if len(output.shape) != 2 or (isinstance(dim, int) and dim != card.dim):
        raise DescriptorError(f"{path}: makes an output of shape {output.shape}, its card says (N, {card.dim})")


def _line(error: Exception) -> str:
    """onnxruntime's error message as one line."""
    return " ".join(str(error).split())
