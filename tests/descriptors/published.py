"""A small VGG16-NetVLAD with random weights: evaluated in plain numpy, and written as the files that people have.

The evaluation follows each format's own conventions and shares nothing with the package.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tests.descriptors import matlab_file

Array = NDArray[np.float64]
BLOCKS = ((4, 2), (6, 2), (8, 3), (8, 3), (8, 3))
"""Width and number of convolutions; the real ones: 64, 128, 256, 512, 512."""
CENTRES, CHANNELS, DIM = 5, 8, 12
TORCH_INDICES = (0, 2, 5, 7, 10, 12, 14, 17, 19, 21, 24, 26, 28)
LAST_OF_BLOCK = (1, 3, 6, 9)


@dataclass(frozen=True)
class Network:
    """Filters ``(out, in, 3, 3)``; ``assign``, ``centres`` ``(K, D)``; ``whitening`` ``(dim, K, D)``."""

    filters: list[tuple[Array, Array]]
    assign: Array
    bias: Array
    centres: Array
    whitening: Array
    offset: Array


def random_network(seed: int) -> Network:
    rng = np.random.default_rng(seed)

    def draw(*shape: int, scale: float = 1.0) -> Array:
        return np.asarray((rng.normal(size=shape) * scale).astype(np.float32).astype(np.float64))

    filters, previous = [], 3
    for width, count in BLOCKS:
        for _ in range(count):
            filters.append((draw(width, previous, 3, 3, scale=(2 / (9 * previous)) ** 0.5), draw(width, scale=0.2)))
            previous = width
    centres = draw(CENTRES, CHANNELS, scale=0.4)
    return Network(
        filters,
        draw(CENTRES, CHANNELS, scale=3),
        draw(CENTRES),
        centres,
        draw(DIM, CENTRES, CHANNELS),
        draw(DIM, scale=0.1),
    )


def local_features(network: Network, pixels: Array) -> Array:
    """Outputs of conv5_3 ``(D, h, w)`` for standardised pixels ``(3, H, W)``."""
    x = pixels
    for k, (weight, bias) in enumerate(network.filters):
        height, width = x.shape[1:]
        padded = np.zeros((len(x), height + 2, width + 2))
        padded[:, 1:-1, 1:-1] = x
        y = np.zeros((len(weight), height, width)) + bias[:, None, None]
        for row in range(3):
            for column in range(3):
                y += np.einsum(
                    "oi,ihw->ohw", weight[:, :, row, column], padded[:, row : row + height, column : column + width]
                )
        if k == len(network.filters) - 1:
            return y
        x = np.maximum(y, 0)
        if k in LAST_OF_BLOCK:
            rows, columns = height // 2, width // 2
            x = x[:, : 2 * rows, : 2 * columns].reshape(len(x), rows, 2, columns, 2).max(axis=(2, 4))
    raise AssertionError


def residuals(network: Network, features: Array, bias: Array) -> Array:
    """``(K, D)``, a pixel at a time; rows divided by their length."""
    total = np.zeros_like(network.centres)
    for x in features.reshape(len(features), -1).T:
        x = x / np.sqrt((x * x).sum())
        scores = network.assign @ x + bias
        soft = np.exp(scores - scores.max())
        total += (soft / soft.sum())[:, None] * (x - network.centres)
    return np.asarray(total / np.sqrt((total * total).sum(axis=1, keepdims=True)))


def unit(vector: Array) -> Array:
    return np.asarray(vector / np.sqrt((vector * vector).sum()))


def describe(
    network: Network, image: NDArray[np.uint8], mean: Any, deviation: Any, bias: bool, dim: int | None
) -> Array:
    """The vector of an RGB image ``(3, H, W)``; ``dim`` 0: the VLAD vector, a centre's numbers together, unwhitened."""
    mean, deviation = (np.asarray(v, dtype=np.float64)[:, None, None] for v in (mean, deviation))
    features = local_features(network, (image.astype(np.float64) - mean) / deviation)
    vlad = residuals(network, features, network.bias if bias else 0 * network.bias)
    vlad /= np.sqrt((vlad * vlad).sum())
    if dim == 0:
        return vlad.ravel()
    return unit((np.einsum("okd,kd->o", network.whitening, vlad) + network.offset)[:dim])


def cells(values: list[Any]) -> NDArray[Any]:
    row = np.empty((1, len(values)), dtype=object)
    for k, value in enumerate(values):
        row[0, k] = value
    return row


def single(values: Any) -> NDArray[np.float32]:
    return np.asarray(values, dtype=np.float32)


MEAN = (123.68, 116.779, 103.939)


def matconvnet_net(network: Network, version: int = 1) -> dict[str, Any]:
    """The variable ``net`` of the authors' file, objects as structs; maxima before ReLUs, as they have it."""
    layers: list[dict[str, Any]] = []
    names = [f"conv{b + 1}_{k + 1}" for b, (_, count) in enumerate(BLOCKS) for k in range(count)]
    for k, (name, (weight, bias)) in enumerate(zip(names, network.filters, strict=True)):
        stored = cells([single(weight.transpose(2, 3, 1, 0)), single(bias[None])])
        layers.append(
            {"type": "conv", "name": name, "weights": stored, "pad": single([[1, 1, 1, 1]]), "stride": single([[1, 1]])}
        )
        if k in LAST_OF_BLOCK:
            layers.append(
                {
                    "type": "pool",
                    "name": f"pool{name[4]}",
                    "method": "max",
                    "pool": np.array([[2.0, 2.0]]),
                    "stride": np.array([[2.0, 2.0]]),
                    "pad": np.zeros((1, 4)),
                }
            )
        if k < len(names) - 1:
            layers.append({"type": "relu", "name": f"relu{name[4:]}", "leak": 0.0})
    norm = {"type": "normalize", "param": np.array([[2.0 * CHANNELS, 1e-12, 1.0, 0.5]]), "precious": False}
    # A VLAD vector is 1 x K x D in MATLAB, whose first axis runs fastest: all centres of one channel together.
    whitening = single(network.whitening.transpose(2, 1, 0).reshape(1, 1, CENTRES * CHANNELS, DIM))
    white = cells([whitening, single(network.offset[:, None])])
    layers += [
        {**norm, "name": "preL2"},
        {"type": "custom", "name": "vlad:core", "weights": cells(vlad_arrays(network, version))},
        {**norm, "name": "vlad:intranorm"},
        {"type": "custom", "name": "postL2", "precious": False},
        {"type": "conv", "name": "WPCA", "weights": white, "stride": 1.0, "pad": 0.0},
        {"type": "custom", "name": "finalL2", "precious": False},
    ]
    meta = {"normalization": {"averageImage": single([[MEAN]]), "imageSize": np.array([[224.0, 224.0, 3.0]])}}
    return {"layers": cells(layers), "meta": {**meta, "sessionID": "vd16_pitts30k", "epoch": 30.0}}


def vlad_arrays(network: Network, version: int) -> list[NDArray[np.float32]]:
    """Assignment and negated centres as ``(1, 1, D, K)``; the second version has a bias between."""
    assign, stored = single(network.assign.T[None, None]), single(-network.centres.T[None, None])
    return [assign, stored] if version == 1 else [assign, single(network.bias[None]), stored]


def save_matconvnet(path: Path, net: dict[str, Any], compress: bool = True) -> Path:
    from scipy.io import savemat

    savemat(path, {"net": net}, do_compression=compress)
    return path


def save_with_objects(
    path: Path, network: Network, has_saveobj: bool, version: int = 1, described: bool = True
) -> Path:
    """The same network as the authors saved it: VLAD and L2 layers are objects of classes."""
    net = matconvnet_net(network, version)
    name = "layerVLAD" if version == 1 else "layerVLADv2"
    l2 = {"type": "custom", "name": "wholeL2", "precious": False}
    vlad = {"type": "custom", "name": "VLAD", "K": np.zeros((0, 0)), "weights": np.zeros((0, 0)), "precious": False}
    classes = [(name, vlad), ("layerWholeL2Normalize", l2)]
    arrays = vlad_arrays(network, version)
    own = {"type": "custom", "name": "vlad:core", "K": np.array([[5.0]]), "weights": arrays}
    objects = [(1, own, has_saveobj), (2, {"name": "postL2"}, False), (2, {"name": "finalL2"}, False)]
    layers = net["layers"]
    layers[0, 30] = matlab_file.Object(name, 1, 1)
    layers[0, 32] = matlab_file.Object("layerWholeL2Normalize", 2, 2)
    layers[0, 34] = matlab_file.Object("layerWholeL2Normalize", 3, 2)
    return matlab_file.save(path, "net", net, matlab_file.workspace(classes, objects) if described else None)


def torch_state(network: Network, version: int = 1, whitened: bool = True, module: str = "") -> dict[str, Any]:
    """The named arrays of the common PyTorch layout; ``module``: what training on several GPUs puts into names."""
    state: dict[str, Any] = {}
    for k, (weight, bias) in zip(TORCH_INDICES, network.filters, strict=True):
        state |= {f"encoder.{module}{k}.weight": weight, f"encoder.{module}{k}.bias": bias}
    state[f"pool.{module}conv.weight"] = network.assign[:, :, None, None]
    if version == 2:
        state[f"pool.{module}conv.bias"] = network.bias
    state[f"pool.{module}centroids"] = network.centres
    if whitened:
        state["WPCA.0.weight"] = network.whitening.reshape(DIM, -1)[:, :, None, None]
        state["WPCA.0.bias"] = network.offset
    return {name: single(array) for name, array in state.items()}
