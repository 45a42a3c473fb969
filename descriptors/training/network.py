"""NetVLAD in torch: a small grey-level CNN, the VLAD layer, a whitening projection (Arandjelovic et al., CVPR 2016;
thesis 2.1.4, 3.4).

Imports torch, so only training and export may import this module; agents run the exported graph (``inference.py``).
"""

from __future__ import annotations

import math

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from ..config import NetVladConfig
from .gradients import CHANNELS, GradientDescriptors

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
        """VLAD vectors ``(n, clusters * channels)`` of feature maps ``(n, channels, h, w)``."""
        weights = self.assign(features).softmax(dim=1).flatten(2)  # (N, K, h*w)
        sums = weights @ features.flatten(2).transpose(1, 2)  # (N, K, D)
        residuals = sums - weights.sum(dim=2, keepdim=True) * self.centres
        # Intra-normalisation: a repeated texture (bricks, leaves) fills one centre only and must not outweigh the rest.
        return F.normalize(F.normalize(residuals, dim=2).flatten(1), dim=1)


class NetVladNetwork(nn.Module):
    """Grey images ``(N, 1, H, W)``, 0 to 255, any type and size, to unit place vectors ``(N, dim)`` float32.

    Two kinds of local features, each with a VLAD layer of its own: what plain 3x3 convolutions learn, which hold up
    when light and viewpoint change, and gradient histograms (``gradients.py``), which tell look-alike places apart by
    their fine layout. A batch norm before the learned VLAD layer keeps its unit features spread out. The projection is
    fitted after the rest (``initialisation.fit_projection``), strongest axis first, so that a prefix is usable alone.
    """

    def __init__(self, config: NetVladConfig) -> None:
        super().__init__()
        if len(config.channels) != len(config.strides):
            raise ValueError(f"{len(config.channels)} channel counts but {len(config.strides)} strides")
        self.config = config
        last = config.channels[-1]
        self.backbone = nn.Sequential(*_convolutions((1, *config.channels), config.strides))
        if config.context:
            strides = (2, *(1 for _ in config.context[1:]))
            back = nn.BatchNorm2d(last)
            nn.init.zeros_(back.weight)  # adds nothing until it has learned something
            widen = nn.Conv2d(config.context[-1], last, 1, bias=False)
            self.context = nn.Sequential(*_convolutions((last, *config.context), strides), widen, back)
        self.reduce = nn.Sequential(nn.Conv2d(last, config.local_dim, 1, bias=False), nn.BatchNorm2d(config.local_dim))
        self.vlad = VladLayer(config.clusters, config.local_dim)
        if config.gradient_levels:
            self.gradients = GradientDescriptors(config.gradient_levels)
            self.gradient_reduce = nn.Conv2d(CHANNELS, config.local_dim, 1)
            self.gradient_vlad = VladLayer(config.clusters, config.local_dim)
        self.project = nn.Linear(self.vlad_dim, config.dim)

    @property
    def vlad_dim(self) -> int:
        """Length of the vector before the projection."""
        return (2 if self.config.gradient_levels else 1) * self.config.clusters * self.config.local_dim

    def local_features(self, images: Tensor) -> Tensor:
        """Unit learned features ``(N, D, h, w)``."""
        x = self.backbone(standardise(images).contiguous(memory_format=torch.channels_last))
        if self.config.context:
            x = F.relu(x + F.interpolate(self.context(x), size=x.shape[2:], mode="nearest"))
        return F.normalize(self.reduce(x), dim=1)

    def gradient_features(self, images: Tensor, thin: int = 1, offset: int = 0) -> Tensor:
        """Unit features from gradient histograms of all levels, ``(N, D, 1, n)``; ``thin`` as for the histograms."""
        return F.normalize(self.gradient_reduce(self.gradients(standardise(images), thin, offset)[:, :, None]), dim=1)

    def aggregate(self, images: Tensor, thin: int = 1, offset: int = 0) -> Tensor:
        """VLAD vectors before the projection, ``(N, vlad_dim)``, unit rows."""
        learned = self.vlad(self.local_features(images))
        if not self.config.gradient_levels:
            return learned
        share = self.config.gradient_share
        fixed = self.gradient_vlad(self.gradient_features(images, thin, offset))
        return torch.cat([math.sqrt(1.0 - share) * learned, math.sqrt(share) * fixed], dim=1)

    def forward(self, images: Tensor) -> Tensor:
        """Place vectors ``(n, dim)``, unit rows, of images ``(n, C, H, W)``."""
        return F.normalize(self.project(self.aggregate(images)), dim=1)


def standardise(images: Tensor) -> Tensor:
    """Mean 0 and deviation 1 for each image, float32."""
    x = images.float()
    centred = x - x.mean(dim=(1, 2, 3), keepdim=True)
    return centred / (centred.square().mean(dim=(1, 2, 3), keepdim=True) + STD_FLOOR**2).sqrt()


def _convolutions(channels: tuple[int, ...], strides: tuple[int, ...]) -> list[nn.Module]:
    """3x3 convolutions, each with batch norm and ReLU."""
    layers: list[nn.Module] = []
    for before, after, stride in zip(channels[:-1], channels[1:], strides, strict=True):
        layers += [nn.Conv2d(before, after, 3, stride, 1, bias=False), nn.BatchNorm2d(after), nn.ReLU(inplace=True)]
    return layers


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
