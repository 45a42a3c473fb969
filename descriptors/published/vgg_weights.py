"""The numbers of a VGG16-NetVLAD, wherever they come from, checked: what is exported and what torch starts from.

Arandjelovic et al., "NetVLAD: CNN architecture for weakly supervised place recognition", CVPR 2016: VGG16 up to conv5_3
without the ReLU and the pooling after it, unit local features, the VLAD layer with intra-normalisation, PCA-whitening.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..errors import DescriptorError

Floats = NDArray[np.float32]

VGG16_BLOCKS = (2, 2, 3, 3, 3)
"""Convolutions of each block; a 2x2 maximum halves the grid after every block but the last."""
NAMES = tuple(f"conv{b + 1}_{k + 1}" for b, count in enumerate(VGG16_BLOCKS) for k in range(count))
POOLED = tuple(f"conv{b + 1}_{count}" for b, count in enumerate(VGG16_BLOCKS[:-1]))
MAX_WIDTH = 4096
"""Most channels, centres or output numbers that are believed; published: 512, 64, 4096."""


@dataclass(frozen=True)
class Convolution:
    """``weight`` ``(out, in, 3, 3)`` and ``bias`` ``(out,)`` of a convolution with a border of one zero."""

    weight: Floats
    bias: Floats


@dataclass(frozen=True)
class VggWeights:
    """Weights of VGG16-NetVLAD; D channels of a local feature, K centres.

    ``mean``, ``deviation`` ``(3,)``: red, green, blue, 0 to 255; the network sees ``(pixel - mean) / deviation``.
    ``assign`` ``(K, D)`` and ``assign_bias`` ``(K,)``: the soft assignment (zeros for the bias that the first version
    of the layer lacks). ``centres`` ``(K, D)``. ``whitening`` ``(dim, K * D)``, a centre's D numbers together, and
    ``whitening_bias`` ``(dim,)``; None: the whole VLAD vector comes out. ``softening``: what is added to a squared
    length before local features and residuals are divided by its root (MatConvNet: 1e-12; torch: 0, a floor instead).
    """

    convolutions: tuple[Convolution, ...]
    mean: Floats
    deviation: Floats
    assign: Floats
    assign_bias: Floats
    centres: Floats
    whitening: Floats | None
    whitening_bias: Floats | None
    softening: float = 0.0

    def __post_init__(self) -> None:
        if len(self.convolutions) != len(NAMES):
            raise DescriptorError(f"{len(self.convolutions)} convolutions of 3x3, but VGG16 has {len(NAMES)}")
        channels = 3
        for name, convolution in zip(NAMES, self.convolutions, strict=True):
            out = len(convolution.bias)
            _require(f"weight of {name}", convolution.weight, (out, channels, 3, 3))
            _require(f"bias of {name}", convolution.bias, (out,))
            channels = out
        clusters = len(self.centres)
        _require("mean of the pixels", self.mean, (3,))
        _require("deviation of the pixels", self.deviation, (3,))
        _require("centres", self.centres, (clusters, channels))
        _require("assignment", self.assign, (clusters, channels))
        _require("bias of the assignment", self.assign_bias, (clusters,))
        if (self.whitening is None) != (self.whitening_bias is None):
            raise DescriptorError("the whitening has a weight or a bias, but not both")
        if self.whitening is not None and self.whitening_bias is not None:
            dim = len(self.whitening_bias)
            _require("weight of the whitening", self.whitening, (dim, clusters * channels))
            _require("bias of the whitening", self.whitening_bias, (dim,))
        if not (self.deviation > 0).all():
            raise DescriptorError("the deviation of the pixels must be above 0")

    @property
    def dim(self) -> int:
        """Numbers that come out."""
        return self.centres.size if self.whitening_bias is None else len(self.whitening_bias)

    @property
    def nbytes(self) -> int:
        """Of all of them."""
        arrays = [self.assign, self.centres] + [one.weight for one in self.convolutions]
        return sum(array.nbytes for array in arrays) + (0 if self.whitening is None else self.whitening.nbytes)


def rows_to_keep(wanted: int | None, found: int | None) -> int | None:
    """Number of the ``found`` numbers of a file's whitening (None: it has none) to read: the first ones hold most of
    the variance. ``DescriptorError`` where more than that are ``wanted``."""
    if wanted is None:
        return found
    if found is None:
        raise DescriptorError(f"--dim {wanted}: the file has no whitening, and its numbers no order to cut them by")
    if not 0 < wanted <= found:
        raise DescriptorError(f"--dim {wanted}: the whitening of the file gives {found} numbers")
    return wanted


def _require(what: str, values: Floats, shape: tuple[int, ...]) -> None:
    """An error unless ``values`` are finite float32 of ``shape``, none of whose sides is beyond belief."""
    if values.shape != shape:
        raise DescriptorError(f"{what}: expected {_text(shape)}, found {_text(values.shape)}")
    if values.dtype != np.float32:
        raise DescriptorError(f"{what}: expected float32, found {values.dtype}")
    if not values.size or shape[0] > MAX_WIDTH or (len(shape) > 1 and shape[1] > MAX_WIDTH * 64):
        raise DescriptorError(f"{what}: {_text(shape)} is no size of such a layer")
    # Row by row: a mask over the whole whitening would be 134 MB.
    if not all(np.isfinite(row).all() for row in values):
        raise DescriptorError(f"{what}: holds numbers that are not finite")


def _text(shape: tuple[int, ...]) -> str:
    return "x".join(map(str, shape)) or "one number"
