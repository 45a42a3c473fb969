"""NetVLAD from torch to one ONNX graph: pixels in, unit vector out, batch and size free.

The graph is put together node by node from the trained arrays: batch norms folded into the convolutions, the same
bytes on every export, and nothing in it that depends on a tracer's version.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from torch import nn

from .gradients import CELL_PX, CELLS, CHANNELS, CLIP, ENERGY_FLOOR, NORM_FLOOR
from .network import STD_FLOOR, NetVladNetwork, VladLayer
from .onnx_graph import INPUT, OUTPUT, OnnxGraph
from .onnx_graph import NORM_FLOOR as UNIT_FLOOR

_TO_END = np.iinfo(np.int64).max


def export_onnx(network: NetVladNetwork, path: Path) -> None:
    """Write ``network`` (its evaluation mode) as ONNX: input ``images`` ``(N, 1, H, W)`` uint8, output ``vectors``
    ``(N, dim)`` float32."""
    graph = OnnxGraph()
    image = _standardise(graph)
    vector = _vlad(graph, network.vlad, _learned_features(graph, network, image))
    if network.config.gradient_levels:
        share = network.config.gradient_share
        fixed = _vlad(graph, network.gradient_vlad, _gradient_features(graph, network, image))
        vector = graph.add("Mul", vector, graph.scalar(math.sqrt(1.0 - share)))
        fixed = graph.add("Mul", fixed, graph.scalar(math.sqrt(share)))
        vector = graph.add("Concat", vector, fixed, axis=1)
    # The largest array by far: set_projection leaves nothing in it that half precision does not hold.
    weight = graph.add("Cast", graph.constant(_array(network.project.weight).T.astype(np.float16)), to=1)
    bias = graph.constant(_array(network.project.bias).astype(np.float32))
    graph.unit(graph.add("Add", graph.add("MatMul", vector, weight), bias), axis=1, output=OUTPUT)
    graph.save(path, channels=1, dim=network.config.dim)


def _standardise(graph: OnnxGraph) -> str:
    x = graph.add("Cast", INPUT, to=1)
    centred = graph.add("Sub", x, graph.add("ReduceMean", x, axes=[1, 2, 3], keepdims=1))
    variance = graph.add("ReduceMean", graph.add("Mul", centred, centred), axes=[1, 2, 3], keepdims=1)
    deviation = graph.add("Sqrt", graph.add("Add", variance, graph.scalar(STD_FLOOR**2)))
    return graph.add("Div", centred, deviation)


def _learned_features(graph: OnnxGraph, network: NetVladNetwork, x: str) -> str:
    """Backbone, context, reduction: the name of the unit local features ``(N, D, n)``."""
    x = _convolutions(graph, x, list(network.backbone))
    if network.config.context:
        layers = list(network.context)
        deep = _convolution(graph, _convolutions(graph, x, layers[:-2]), layers[-2], layers[-1])
        none = graph.constant(np.zeros(0, dtype=np.float32))
        grown = graph.add(
            "Resize",
            deep,
            none,
            none,
            graph.add("Shape", x),
            mode="nearest",
            nearest_mode="floor",
            coordinate_transformation_mode="asymmetric",
        )
        x = graph.add("Relu", graph.add("Add", x, grown))
    x = _convolution(graph, x, network.reduce[0], network.reduce[1])
    return _unit(graph, graph.columns(x), network.config.local_dim)


def _gradient_features(graph: OnnxGraph, network: NetVladNetwork, x: str) -> str:
    """Gradient histograms of all levels, reduced: the name of the unit local features ``(N, D, n)``."""
    maps = []
    for level in network.gradients.levels:
        shrunk = x if level == 1 else graph.add("AveragePool", x, kernel_shape=[level] * 2, strides=[level] * 2)
        cells = _cells(graph, network, shrunk, CELL_PX // level)
        maps.append(graph.columns(cells))
    stacked = maps[0] if len(maps) == 1 else graph.add("Concat", *maps, axis=2)
    # RootSIFT forgets the length of what it is given: it need not be divided out before the cut, and the sum after it
    # only behind the reduction, where there is half as much to divide.
    squares = _channel_sum(graph, graph.add("Mul", stacked, stacked), CHANNELS)
    norm = graph.add("Add", graph.add("Sqrt", squares), graph.scalar(NORM_FLOOR))
    cut = graph.add("Min", stacked, graph.add("Mul", norm, graph.scalar(CLIP)))
    floor = graph.add("Mul", norm, graph.scalar(ENERGY_FLOOR))
    total = graph.add("Add", _channel_sum(graph, cut, CHANNELS), floor)
    weight = _array(network.gradient_reduce.weight)[None, :, :, 0, 0].astype(np.float32)
    bias = _array(network.gradient_reduce.bias)[None, :, None].astype(np.float32)
    reduced = graph.add("MatMul", graph.constant(weight), graph.add("Sqrt", cut))
    reduced = graph.add("Add", graph.add("Div", reduced, graph.add("Sqrt", total)), graph.constant(bias))
    return _unit(graph, reduced, network.config.local_dim)


def _cells(graph: OnnxGraph, network: NetVladNetwork, x: str, step: int) -> str:
    """Sixteen cells of eight directions for each descriptor, ``(N, 128, h, w)``, as ``GradientDescriptors`` does it."""
    edges = graph.constant(np.array([0, 0, 1, 1, 0, 0, 1, 1], dtype=np.int64))
    padded = graph.add("Pad", x, edges, mode="edge")
    along = []  # to the right, and down: differences, as a convolution of so few channels costs several times as much
    for ahead, behind in (([1, 2], [1, 0]), ([2, 1], [0, 1])):
        shifted = [
            _slice(graph, padded, start, [(k - 2) or _TO_END for k in start], [2, 3]) for start in (ahead, behind)
        ]
        along.append(graph.add("Mul", graph.add("Sub", *shifted), graph.scalar(0.5)))
    energy = graph.add("Add", *(graph.add("Mul", one, one) for one in along))
    energy = graph.add("Add", energy, graph.scalar(ENERGY_FLOOR))
    root = graph.scalar(math.sqrt(0.5))
    diagonal = [graph.add("Mul", graph.add(how, along[1], along[0]), root) for how in ("Add", "Sub")]
    half = graph.add("Concat", along[0], diagonal[0], along[1], diagonal[1], axis=1)
    positive = graph.add("Relu", graph.add("Concat", half, graph.add("Neg", half), axis=1))
    second = graph.add("Mul", positive, positive)
    fourth = graph.add("Mul", second, second)
    shared = graph.add("Div", fourth, graph.add("Mul", energy, graph.add("Sqrt", energy)))
    window = _array(network.gradients.window).astype(np.float32)
    pooled = graph.add(
        "Conv",
        shared,
        graph.constant(window),
        group=len(window),
        strides=[step] * 2,
        kernel_shape=list(window.shape[2:]),
    )
    apart = CELL_PX // step
    for axis in (3, 2):
        ends = [(k - CELLS + 1) * apart or _TO_END for k in range(CELLS)]
        parts = [_slice(graph, pooled, [k * apart], [ends[k]], [axis]) for k in range(CELLS)]
        pooled = graph.add("Concat", *parts, axis=1)
    return pooled


def _slice(graph: OnnxGraph, x: str, starts: list[int], ends: list[int], axes: list[int]) -> str:
    return graph.add("Slice", x, *(graph.constant(np.array(values, dtype=np.int64)) for values in (starts, ends, axes)))


def _vlad(graph: OnnxGraph, layer: VladLayer, features: str) -> str:
    weight, bias, centres = (
        _array(one).astype(np.float32) for one in (layer.assign.weight[:, :, 0, 0], layer.assign.bias, layer.centres)
    )
    return graph.vlad(features, (weight, bias), centres, graph.unit)


def _unit(graph: OnnxGraph, features: str, channels: int) -> str:
    """Features ``(N, channels, n)`` of unit length."""
    squares = _channel_sum(graph, graph.add("Mul", features, features), channels)
    return graph.add("Div", features, graph.add("Max", graph.add("Sqrt", squares), graph.scalar(UNIT_FLOOR)))


def _channel_sum(graph: OnnxGraph, features: str, channels: int) -> str:
    """Sum of ``(N, channels, n)`` over the channels, as a product: the reduction is several times slower there."""
    return graph.add("MatMul", graph.constant(np.ones((1, 1, channels), dtype=np.float32)), features)


def _convolutions(graph: OnnxGraph, x: str, layers: list[nn.Module]) -> str:
    for convolution, norm in zip(layers[0::3], layers[1::3], strict=True):
        x = graph.add("Relu", _convolution(graph, x, convolution, norm))
    return x


def _convolution(graph: OnnxGraph, x: str, convolution: Any, norm: Any) -> str:
    """A convolution with the batch norm after it folded in (in double precision)."""
    scale = _array(norm.weight) / np.sqrt(_array(norm.running_var) + norm.eps)
    weight = (_array(convolution.weight) * scale[:, None, None, None]).astype(np.float32)
    bias = (_array(norm.bias) - _array(norm.running_mean) * scale).astype(np.float32)
    side, pad = convolution.kernel_size[0], convolution.padding[0]
    return graph.add(
        "Conv",
        x,
        graph.constant(weight),
        graph.constant(bias),
        kernel_shape=[side, side],
        strides=list(convolution.stride),
        pads=[pad] * 4,
    )


def _array(parameter: Any) -> NDArray[np.float64]:
    return np.asarray(parameter.detach().double().cpu().numpy())
