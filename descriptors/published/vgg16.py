"""VGG16-NetVLAD in torch, as published (Arandjelovic et al., CVPR 2016): to evaluate, or to train further.

Its ``state_dict`` has the names of the common PyTorch checkpoints (``torch_checkpoint.py``), so that what is trained
here is exported like what is found elsewhere. Imports torch: agents run the exported graph.
"""

from __future__ import annotations

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from .torch_checkpoint import state_from_weights, weights_from_state
from .vgg_weights import NAMES, POOLED, VggWeights


class SoftAssignment(nn.Module):
    """The VLAD layer: unit local features ``(N, D, h, w)`` to residuals ``(N, K, D)``, not normalised."""

    def __init__(self, clusters: int, channels: int) -> None:
        super().__init__()
        self.conv = nn.Conv2d(channels, clusters, 1)
        self.centroids = nn.Parameter(torch.zeros(clusters, channels))

    def forward(self, features: Tensor) -> Tensor:
        soft = self.conv(features).softmax(dim=1).flatten(2)
        return soft @ features.flatten(2).transpose(1, 2) - soft.sum(dim=2, keepdim=True) * self.centroids


class Vgg16NetVlad(nn.Module):
    """Colour images ``(N, 3, H, W)``, red, green, blue, 0 to 255, any type, sides of 16 and more, to unit vectors ``(N,
    dim)`` float32."""

    mean: Tensor
    deviation: Tensor
    softening: Tensor

    def __init__(self, weights: VggWeights) -> None:
        super().__init__()
        layers: list[nn.Module] = []
        for name, convolution in zip(NAMES, weights.convolutions, strict=True):
            out, channels = convolution.weight.shape[:2]
            layers += [nn.Conv2d(channels, out, 3, padding=1), nn.ReLU(inplace=True)]
            layers += [nn.MaxPool2d(2)] if name in POOLED else []
        self.encoder = nn.Sequential(*layers[:-1])
        self.pool = SoftAssignment(*weights.centres.shape)
        if weights.whitening is not None:
            self.WPCA = nn.Sequential(nn.Conv2d(weights.centres.size, weights.dim, 1))
        self.register_buffer("mean", torch.zeros(3))
        self.register_buffer("deviation", torch.ones(3))
        self.register_buffer("softening", torch.zeros((), dtype=torch.float64))
        self.load_state_dict(state_from_weights(weights))

    def weights(self) -> VggWeights:
        """A copy of the present weights, to be exported."""
        return weights_from_state(self.state_dict())

    def local_features(self, images: Tensor) -> Tensor:
        """Unit local features ``(N, D, H / 16, W / 16)``."""
        x = (images.float() - self.mean[:, None, None]) / self.deviation[:, None, None]
        return self._unit(self.encoder(x), 1)

    def aggregate(self, images: Tensor) -> Tensor:
        """Unit VLAD vectors before the whitening, ``(N, K * D)``."""
        return F.normalize(self._unit(self.pool(self.local_features(images)), 2).flatten(1), dim=1)

    def forward(self, images: Tensor) -> Tensor:
        vlads = self.aggregate(images)
        return F.normalize(self.WPCA(vlads[:, :, None, None]).flatten(1), dim=1) if hasattr(self, "WPCA") else vlads

    def _unit(self, x: Tensor, dim: int) -> Tensor:
        softening = float(self.softening)
        return x / (softening + x.square().sum(dim, keepdim=True)).sqrt() if softening else F.normalize(x, dim=dim)
