"""NetVLAD from torch to one ONNX graph: pixels in, unit vector out, batch and size free.

The graph is put together node by node from the trained arrays: batch norms folded into the convolutions, the same
bytes on every export, and nothing in it that depends on a tracer's version.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from torch import nn

from descriptors.netvlad import STD_FLOOR, NetVladNetwork
from descriptors.onnx_graph import INPUT, OUTPUT, OnnxGraph


def export_onnx(network: NetVladNetwork, path: Path) -> None:
    """Write ``network`` (its evaluation mode) as ONNX: input ``images`` ``(N, 1, H, W)`` uint8, output ``vectors``
    ``(N, dim)`` float32."""
    graph = OnnxGraph()
    features = _local_features(graph, network)
    _aggregate(graph, network, features)
    graph.save(path, channels=1, dim=network.config.dim)


def _local_features(graph: OnnxGraph, network: NetVladNetwork) -> str:
    """Standardisation, backbone, reduction: the name of the unit local features ``(N, D, h, w)``."""
    x = graph.add("Cast", INPUT, to=1)
    centred = graph.add("Sub", x, graph.add("ReduceMean", x, axes=[1, 2, 3], keepdims=1))
    variance = graph.add("ReduceMean", graph.add("Mul", centred, centred), axes=[1, 2, 3], keepdims=1)
    deviation = graph.add("Sqrt", graph.add("Add", variance, graph.scalar(STD_FLOOR**2)))
    x = graph.add("Div", centred, deviation)
    layers = list(network.backbone)
    for convolution, norm in zip(layers[0::3], layers[1::3], strict=True):
        x = graph.add("Relu", _convolution(graph, x, convolution, norm))
    x = _convolution(graph, x, network.reduce[0], network.reduce[1])
    return graph.unit(x, axis=1)


def _convolution(graph: OnnxGraph, x: str, convolution: nn.Conv2d, norm: nn.BatchNorm2d) -> str:
    """A convolution with the batch norm after it folded in (in double precision)."""
    scale = _array(norm.weight) / np.sqrt(_array(norm.running_var) + norm.eps)
    weight = (_array(convolution.weight) * scale[:, None, None, None]).astype(np.float32)
    bias = (_array(norm.bias) - _array(norm.running_mean) * scale).astype(np.float32)
    side, pad = convolution.kernel_size[0], convolution.padding[0]
    return graph.add(
        "Conv", x, graph.constant(weight), graph.constant(bias),
        kernel_shape=[side, side], strides=list(convolution.stride), pads=[pad] * 4,
    )  # fmt: skip


def _aggregate(graph: OnnxGraph, network: NetVladNetwork, features: str) -> None:
    """The VLAD layer and the projection, up to the graph's output."""
    clusters, local_dim = network.config.clusters, network.config.local_dim
    weight, bias = _array(network.vlad.assign.weight), _array(network.vlad.assign.bias)
    scores = graph.add(
        "Conv",
        features,
        graph.constant(weight.astype(np.float32)),
        graph.constant(bias.astype(np.float32)),
        kernel_shape=[1, 1],
    )
    soft = graph.add("Softmax", scores, axis=1)
    flat = graph.add("Reshape", soft, graph.constant(np.array([0, clusters, -1], dtype=np.int64)))
    columns = graph.add("Reshape", features, graph.constant(np.array([0, local_dim, -1], dtype=np.int64)))
    sums = graph.add("MatMul", flat, graph.add("Transpose", columns, perm=[0, 2, 1]))
    masses = graph.add("ReduceSum", flat, graph.constant(np.array([2], dtype=np.int64)), keepdims=1)
    centres = graph.constant(_array(network.vlad.centres).astype(np.float32)[None])
    residuals = graph.unit(graph.add("Sub", sums, graph.add("Mul", masses, centres)), axis=2)
    vector = graph.unit(graph.add("Flatten", residuals, axis=1), axis=1)
    projected = graph.add(
        "Gemm", vector, graph.constant(_array(network.project.weight).astype(np.float32)),
        graph.constant(_array(network.project.bias).astype(np.float32)), transB=1,
    )  # fmt: skip
    graph.unit(projected, axis=1, output=OUTPUT)


def _array(parameter: Any) -> NDArray[np.float64]:
    return np.asarray(parameter.detach().double().cpu().numpy())
