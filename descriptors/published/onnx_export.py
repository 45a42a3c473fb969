"""VGG16-NetVLAD from arrays to one ONNX graph: pixels in, unit vector out, batch and size free. No torch."""

from __future__ import annotations

from pathlib import Path

from ..errors import DescriptorError
from ..training.onnx_graph import INPUT, OUTPUT, OnnxGraph
from .vgg_weights import NAMES, POOLED, VggWeights

MAX_BYTES = 2_000_000_000
"""Protocol buffers end at 2 GiB."""


def export_vgg(weights: VggWeights, path: Path) -> None:
    """Write the network: input ``images`` ``(N, 3, H, W)`` uint8 red, green, blue, sides of 16 and more; output
    ``vectors`` ``(N, dim)`` float32, unit rows."""
    if weights.nbytes > MAX_BYTES:
        raise DescriptorError(
            f"{path}: {weights.nbytes / 1e9:.1f} GB of weights do not fit into one ONNX file; keep fewer with --dim"
        )
    graph = OnnxGraph()
    x = graph.add("Cast", INPUT, to=1)
    x = graph.add("Sub", x, graph.constant(weights.mean[None, :, None, None]))
    if (weights.deviation != 1).any():
        x = graph.add("Div", x, graph.constant(weights.deviation[None, :, None, None]))
    for name, convolution in zip(NAMES, weights.convolutions, strict=True):
        x = graph.add(
            "Conv",
            x,
            graph.constant(convolution.weight),
            graph.constant(convolution.bias),
            kernel_shape=[3, 3],
            pads=[1] * 4,
        )
        if name != NAMES[-1]:
            x = graph.add("Relu", x)
        if name in POOLED:
            x = graph.add("MaxPool", x, kernel_shape=[2, 2], strides=[2, 2])
    features = graph.columns(_unit(graph, x, 1, weights.softening))
    assign = (weights.assign, weights.assign_bias)
    vlad = graph.vlad(features, assign, weights.centres, lambda y, axis: _unit(graph, y, axis, weights.softening))
    if weights.whitening is not None and weights.whitening_bias is not None:
        whitening, bias = graph.constant(weights.whitening), graph.constant(weights.whitening_bias)
        vlad = graph.add("Gemm", vlad, whitening, bias, transB=1)
    graph.unit(vlad, axis=1, output=OUTPUT)
    graph.save(path, channels=3, dim=weights.dim, name="vgg16_netvlad")


def _unit(graph: OnnxGraph, x: str, axis: int, softening: float) -> str:
    """``x`` over ``sqrt(softening + |x|^2)``: an empty centre's residual shrinks instead of being blown up to length
    one."""
    if softening == 0:
        return graph.unit(x, axis)
    squares = graph.add("ReduceSumSquare", x, axes=[axis], keepdims=1)
    return graph.add("Div", x, graph.add("Sqrt", graph.add("Add", squares, graph.scalar(softening))))
