"""PyTorch checkpoints of VGG16-NetVLAD in the common layout (pytorch-NetVlad, Patch-NetVLAD) to checked arrays.

The layout: ``{"state_dict": {...}}`` or the dictionary alone, with ``encoder.N.weight`` and ``.bias`` (N as in
torchvision's ``vgg16().features``), ``pool.conv.weight`` (``.bias`` in the second version of the layer),
``pool.centroids`` and, where principal axes were added, ``WPCA.0.weight`` and ``.bias``; ``module.`` anywhere in a
name, from training on several GPUs. Images are RGB, 0 to 1, standardised with ImageNet's mean and deviation.
Needs torch.
"""

from __future__ import annotations

import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import torch

from ..errors import DescriptorError
from .vgg_weights import VGG16_BLOCKS, Convolution, Floats, VggWeights, rows_to_keep

MAX_FILE_BYTES = 4_000_000_000
IMAGENET_MEAN = (0.485, 0.456, 0.406)
IMAGENET_DEVIATION = (0.229, 0.224, 0.225)
_ENCODER = [
    2 * sum(VGG16_BLOCKS[:block]) + block + 2 * k for block, count in enumerate(VGG16_BLOCKS) for k in range(count)
]
"""Where the convolutions stand in torchvision's list of layers: 0, 2, 5, ... 28."""


def read_torch(path: Path) -> dict[str, Any]:
    """Read a PyTorch file, a dictionary, without executing anything in it; tensors are mapped, not copied, where the
    file allows it."""
    size = path.stat().st_size
    if size > MAX_FILE_BYTES:
        raise DescriptorError(f"{path}: {size / 1e9:.1f} GB, a checkpoint of VGG16-NetVLAD has less than 4")
    try:
        with torch.serialization.safe_globals(_harmless()):
            found = torch.load(path, map_location="cpu", weights_only=True, mmap=zipfile.is_zipfile(path))
    except Exception as error:  # whatever the unpickler stumbles on
        raise DescriptorError(f"{path}: not a checkpoint: {' '.join(str(error).split())[:300]}") from error
    if not isinstance(found, dict):
        raise DescriptorError(f"{path}: not a checkpoint: holds a {type(found).__name__}, not a dictionary")
    return found


def common_state(found: Mapping[str, Any]) -> dict[str, torch.Tensor] | None:
    """The named tensors of a checkpoint in the common layout, names without ``module.``; None for another layout."""
    inner = found.get("state_dict", found)
    if not isinstance(inner, Mapping):
        return None
    state = {
        ".".join(part for part in name.split(".") if part != "module"): value
        for name, value in inner.items()
        if isinstance(name, str) and isinstance(value, torch.Tensor)
    }
    return state if any(name.startswith(("encoder.", "pool.")) for name in state) else None


def weights_from_state(state: Mapping[str, torch.Tensor], dim: int | None = None) -> VggWeights:
    """The weights among ``state``, of the whitening the first ``dim`` rows alone (None: all).

    ``mean``, ``deviation`` (0 to 255) and ``softening`` are read where the state has them, as that of
    :class:`maslam.descriptors.published.vgg16.Vgg16NetVlad` does.
    """
    needed = [f"encoder.{k}.{kind}" for k in _ENCODER for kind in ("weight", "bias")]
    needed += ["pool.conv.weight", "pool.centroids"]
    missing = [name for name in needed if name not in state]
    if missing:
        others = sorted(name for name in state if name not in needed)
        raise DescriptorError(
            f"{missing[0]} is missing (and {len(missing) - 1} more of VGG16-NetVLAD's {len(needed)} arrays); "
            f"it has {', '.join(others[:4]) or 'nothing else'}"
        )
    convolutions = tuple(
        Convolution(_array(state, f"encoder.{k}.weight"), _array(state, f"encoder.{k}.bias")) for k in _ENCODER
    )
    centres = _array(state, "pool.centroids")
    no_bias = np.zeros(len(centres), dtype=np.float32)
    whitening, whitening_bias = _whitening(state, dim)
    return VggWeights(
        convolutions=convolutions,
        mean=_array(state, "mean") if "mean" in state else _pixels(IMAGENET_MEAN),
        deviation=_array(state, "deviation") if "deviation" in state else _pixels(IMAGENET_DEVIATION),
        assign=_one_by_one(state, "pool.conv.weight", None),
        assign_bias=_array(state, "pool.conv.bias") if "pool.conv.bias" in state else no_bias,
        centres=centres,
        whitening=whitening,
        whitening_bias=whitening_bias,
        softening=float(state["softening"]) if "softening" in state else 0.0,
    )


def state_from_weights(weights: VggWeights) -> dict[str, torch.Tensor]:
    """The other way: all tensors of :class:`maslam.descriptors.published.vgg16.Vgg16NetVlad`."""
    arrays: dict[str, Any] = {"mean": weights.mean, "deviation": weights.deviation}
    for k, convolution in zip(_ENCODER, weights.convolutions, strict=True):
        arrays[f"encoder.{k}.weight"], arrays[f"encoder.{k}.bias"] = convolution.weight, convolution.bias
    arrays |= {"pool.conv.weight": weights.assign[:, :, None, None], "pool.conv.bias": weights.assign_bias}
    arrays["pool.centroids"] = weights.centres
    if weights.whitening is not None:
        arrays["WPCA.0.weight"], arrays["WPCA.0.bias"] = weights.whitening[:, :, None, None], weights.whitening_bias
    state = {name: torch.tensor(array) for name, array in arrays.items()}
    return state | {"softening": torch.tensor(weights.softening, dtype=torch.float64)}


def _whitening(state: Mapping[str, torch.Tensor], dim: int | None) -> tuple[Floats | None, Floats | None]:
    if "WPCA.0.weight" not in state:
        rows_to_keep(dim, None)
        return None, None
    if "WPCA.0.bias" not in state or not state["WPCA.0.weight"].ndim:
        raise DescriptorError("WPCA.0.bias is missing, or WPCA.0.weight a single number")
    rows = rows_to_keep(dim, len(state["WPCA.0.weight"]))
    return _one_by_one(state, "WPCA.0.weight", rows), _array(state, "WPCA.0.bias")[:rows].copy()


def _one_by_one(state: Mapping[str, torch.Tensor], name: str, rows: int | None) -> Floats:
    """A 1x1 convolution's first ``rows`` (None: all) as a matrix ``(out, in)``."""
    tensor = state[name]
    if tensor.shape[2:].numel() != 1 or tensor.ndim < 2:
        raise DescriptorError(f"{name}: expected OUTxINx1x1, found {'x'.join(map(str, tensor.shape))}")
    return np.array(tensor[:rows].flatten(1).to(torch.float32).numpy())  # a copy: the file may change under a map


def _array(state: Mapping[str, torch.Tensor], name: str) -> Floats:
    return np.array(state[name].detach().to(torch.float32).numpy())


def _pixels(values: tuple[float, ...]) -> Floats:
    return (255.0 * np.array(values)).astype(np.float32)


def _harmless() -> list[Any]:
    """Numbers of numpy, which training scripts leave among the figures of a checkpoint, by their old and new names."""
    scalar = np.float64(0).__reduce__()[0]
    scalars = [(scalar, f"numpy.{core}.multiarray.scalar") for core in ("core", "_core")]
    return [*scalars, np.dtype, *(type(np.dtype(kind)) for kind in ("f8", "f4", "i8", "i4", "?"))]
