"""NetVLAD in torch: a small grey-level CNN, the VLAD layer, a whitening projection (Arandjelovic et al., CVPR 2016;
thesis 2.1.4, 3.4).

Imports torch, so only training and export may import this module; agents run the exported graph (``inference.py``).
"""

from __future__ import annotations

import math

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from descriptors.config import NetVladConfig

STD_FLOOR = 1.0
"""Grey levels added (in quadrature) to an image's own deviation, so that a constant image divides by something."""
MAX_ALPHA = 30.0
"""Cap on the sharpness of the initial assignment: sharper, and no gradient reaches any but the nearest centre."""


class VladLayer(nn.Module):
    """Soft-assigned residuals of unit local features ``(N, D, h, w)`` to K centres: ``(N, K * D)``, rows of unit
    norm."""

    def __init__(self, clusters: int, local_dim: int) -> None:
        super().__init__()
        self.centres = nn.Parameter(F.normalize(torch.randn(clusters, local_dim), dim=1))
        self.assign = nn.Conv2d(local_dim, clusters, 1)
        self.set_centres(self.centres.detach().clone(), MAX_ALPHA)

    @torch.no_grad()
    def set_centres(self, centres: Tensor, alpha: float) -> None:
        """Start from ``centres`` ``(K, D)``; ``softmax(-alpha * |f - c|^2)`` written as a 1x1 convolution (eq. 3 of
        the paper)."""
        self.centres.copy_(centres)
        self.assign.weight.copy_((2.0 * alpha * centres)[:, :, None, None])
        self.assign.bias.copy_(-alpha * centres.square().sum(dim=1))

    def forward(self, features: Tensor) -> Tensor:
        weights = self.assign(features).softmax(dim=1).flatten(2)  # (N, K, h*w)
        sums = weights @ features.flatten(2).transpose(1, 2)  # (N, K, D)
        residuals = sums - weights.sum(dim=2, keepdim=True) * self.centres
        # Intra-normalisation: a repeated texture (bricks, leaves) fills one centre only and must not outweigh the rest.
        return F.normalize(F.normalize(residuals, dim=2).flatten(1), dim=1)


class NetVladNetwork(nn.Module):
    """Grey images ``(N, 1, H, W)``, 0 to 255, any type and size, to unit place vectors ``(N, dim)`` float32.

    Plain 3x3 convolutions; a batch norm before the VLAD layer keeps the unit features spread out. The projection is
    fitted after the rest (``initialisation.fit_projection``), strongest axis first, so that a prefix is usable alone.
    """

    def __init__(self, config: NetVladConfig) -> None:
        super().__init__()
        if len(config.channels) != len(config.strides):
            raise ValueError(f"{len(config.channels)} channel counts but {len(config.strides)} strides")
        self.config = config
        layers: list[nn.Module] = []
        previous = 1
        for width, stride in zip(config.channels, config.strides, strict=True):
            layers.append(nn.Conv2d(previous, width, 3, stride, 1, bias=False))
            layers.append(nn.BatchNorm2d(width))
            layers.append(nn.ReLU(inplace=True))
            previous = width
        self.backbone = nn.Sequential(*layers)
        self.reduce = nn.Sequential(
            nn.Conv2d(previous, config.local_dim, 1, bias=False), nn.BatchNorm2d(config.local_dim)
        )
        self.vlad = VladLayer(config.clusters, config.local_dim)
        self.project = nn.Linear(config.clusters * config.local_dim, config.dim)

    def local_features(self, images: Tensor) -> Tensor:
        """Unit local features ``(N, D, h, w)``."""
        x = images.float()
        centred = x - x.mean(dim=(1, 2, 3), keepdim=True)
        deviation = (centred.square().mean(dim=(1, 2, 3), keepdim=True) + STD_FLOOR**2).sqrt()
        x = (centred / deviation).contiguous(memory_format=torch.channels_last)
        return F.normalize(self.reduce(self.backbone(x)), dim=1)

    def aggregate(self, images: Tensor) -> Tensor:
        """VLAD vectors before the projection, ``(N, K * D)``."""
        return self.vlad(self.local_features(images))

    def forward(self, images: Tensor) -> Tensor:
        return F.normalize(self.project(self.aggregate(images)), dim=1)


def build_network(config: NetVladConfig, seed: int) -> NetVladNetwork:
    """A network with random weights drawn from ``seed``; torch's global generator is left as it was."""
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        network = NetVladNetwork(config)
    return network.to(memory_format=torch.channels_last)


def assignment_alpha(nearest: Tensor, second: Tensor) -> float:
    """Sharpness at which the nearest centre gets 100 times the weight of the second, on average, at most ``MAX_ALPHA``.

    ``nearest`` and ``second``: squared distances ``(n,)`` of features to their nearest and second nearest centres.
    """
    gap = float((second - nearest).mean())
    return min(MAX_ALPHA, math.log(100.0) / max(gap, 1e-6))
