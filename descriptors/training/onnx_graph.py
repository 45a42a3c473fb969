"""ONNX graphs put together node by node from arrays: the same bytes on every export, and nothing in them that depends
on a tracer's version. Needs onnx (``maslam[train]``), not torch.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from maslam._atomic import write_atomically

Floats = NDArray[np.float32]

OPSET = 17
IR_VERSION = 8
INPUT, OUTPUT = "images", "vectors"
NORM_FLOOR = 1e-12
"""Least norm that anything is divided by, as in ``torch.nn.functional.normalize``."""


class OnnxGraph:
    """Nodes and constants of a graph under construction: ``images`` ``(N, channels, H, W)`` uint8 in, ``vectors``
    ``(N, dim)`` float32 out; N, H and W free."""

    def __init__(self) -> None:
        self.nodes: list[Any] = []
        self.constants: list[Any] = []

    def constant(self, value: NDArray[Any]) -> str:
        """The name of a constant array."""
        from onnx import numpy_helper

        name = f"c{len(self.constants)}"
        self.constants.append(numpy_helper.from_array(np.ascontiguousarray(value), name))
        return name

    def scalar(self, value: float) -> str:
        """The name of a float32 constant without axes."""
        return self.constant(np.array(value, dtype=np.float32))

    def add(self, operator: str, *inputs: str, output: str = "", **attributes: Any) -> str:
        """Append a node and return the name of its output."""
        from onnx import helper

        name = output or f"v{len(self.nodes)}"
        self.nodes.append(helper.make_node(operator, list(inputs), [name], **attributes))
        return name

    def unit(self, x: str, axis: int, output: str = "") -> str:
        """``x`` over its Euclidean norm along ``axis``, as ``torch.nn.functional.normalize`` does it."""
        norm = self.add("Max", self.add("ReduceL2", x, axes=[axis], keepdims=1), self.scalar(NORM_FLOOR))
        return self.add("Div", x, norm, output=output)

    def columns(self, maps: str) -> str:
        """``(N, C, ...)`` as ``(N, C, n)``."""
        return self.add("Reshape", maps, self.constant(np.array([0, 0, -1], dtype=np.int64)))

    def vlad(
        self, features: str, assign: tuple[Floats, Floats], centres: Floats, unit: Callable[[str, int], str]
    ) -> str:
        """Unit VLAD vectors ``(N, K * D)`` of local features ``(N, D, n)``: ``assign`` weight ``(K, D)`` and bias
        ``(K,)``, ``centres`` ``(K, D)``; ``unit`` makes the residuals of a centre one long."""
        weight, bias = assign
        scores = self.add("MatMul", self.constant(weight[None]), features)
        soft = self.add("Softmax", self.add("Add", scores, self.constant(bias[None, :, None])), axis=1)
        sums = self.add("MatMul", soft, self.add("Transpose", features, perm=[0, 2, 1]))
        masses = self.add("ReduceSum", soft, self.constant(np.array([2], dtype=np.int64)), keepdims=1)
        residuals = self.add("Sub", sums, self.add("Mul", masses, self.constant(centres[None])))
        return self.unit(self.add("Flatten", unit(residuals, 2), axis=1), axis=1)

    def save(self, path: Path, channels: int, dim: int, name: str = "netvlad") -> None:
        """Check the graph and write it, whole or not at all; equal graphs give equal bytes. Once: the graph is empty
        afterwards."""
        import onnx
        from onnx import TensorProto, helper

        built = helper.make_graph(
            self.nodes,
            name,
            [helper.make_tensor_value_info(INPUT, TensorProto.UINT8, ["batch", channels, "height", "width"])],
            [helper.make_tensor_value_info(OUTPUT, TensorProto.FLOAT, ["batch", dim])],
            self.constants,
        )
        self.constants.clear()  # they are in the graph now, and may be 500 MB
        model = helper.make_model(
            built, opset_imports=[helper.make_opsetid("", OPSET)], producer_name="maslam", ir_version=IR_VERSION
        )
        del built
        content = model.SerializeToString(deterministic=True)
        del model
        onnx.checker.check_model(content)
        write_atomically(path, content)
