"""The last step of training: from VLAD vectors of thousands of numbers to a few hundred, fitted when the rest is done.

Principal axes alone lose too much at 256 numbers: of the 1024 strongest, each scaled to like strength, almost
everything is recognised, of the first 256 a tenth less (docs/appendix/netvlad.md). So the 1024 are mixed down by a
matrix that is learned from pairs of views: each finds its partner (InfoNCE), and each keeps the neighbours that it has
in the long vector (distillation), which needs no pairs and keeps the matrix from learning the training places by heart.
"""

from __future__ import annotations

import numpy as np
import torch
import torch.nn.functional as F
from numpy.typing import NDArray
from torch import Tensor

from ..clusters import fix_signs, whitening
from ..config import ProjectionConfig
from ..errors import DescriptorError
from .losses import info_nce
from .network import NetVladNetwork

Array = NDArray[np.float32]
_SELF = 1e4


@torch.no_grad()
def set_projection(network: NetVladNetwork, weight: NDArray[np.float64], bias: NDArray[np.float64]) -> None:
    """Give the network its projection, rounded to half precision: that is how export keeps it."""
    network.project.weight.copy_(torch.from_numpy(weight).half())
    network.project.bias.copy_(torch.from_numpy(bias))


def learn_projection(
    first: Array, second: Array, dim: int, config: ProjectionConfig, seed: int
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Weight ``(dim, D)`` and bias ``(dim,)`` from VLAD vectors ``(P, D)`` of two views of each of P places."""
    both = np.concatenate([first, second])
    if len(both) <= dim:
        raise DescriptorError(f"a projection to {dim} numbers needs more than {dim} images, got {len(both)}")
    kept = max(dim, min(config.axes, len(both) - 1, both.shape[1]))
    mean, axes, _ = whitening(both, kept, config.power)
    long = (both - mean.astype(np.float32)) @ axes.T.astype(np.float32)
    mix = _learn_mix(long[: len(first)], long[len(first) :], dim, config, seed)
    # Strongest first, so that the first numbers can be used alone; a turn changes no distance.
    spread, turn = np.linalg.eigh(np.cov((long @ mix).T.astype(np.float64)))
    turned = fix_signs((mix.astype(np.float64) @ turn[:, np.argsort(-spread, kind="stable")]).T)
    weight = turned @ axes
    return weight, -weight @ mean


def _learn_mix(first: Array, second: Array, dim: int, config: ProjectionConfig, seed: int) -> Array:
    """The matrix ``(d, dim)`` that takes whitened vectors ``(P, d)`` to short ones; starts as their first axes."""
    rng = np.random.default_rng([seed, 2])
    a, b = (torch.from_numpy(np.ascontiguousarray(side)) for side in (first, second))
    mix = torch.eye(a.shape[1])[:, :dim].clone().requires_grad_()
    optimiser = torch.optim.Adam([mix], lr=config.learning_rate)
    for step in range(config.steps):
        rows = torch.from_numpy(np.sort(rng.choice(len(a), min(config.pairs, len(a)), replace=False)))
        loss = _mix_loss(torch.cat([a[rows], b[rows]]), mix, config)
        optimiser.zero_grad(set_to_none=True)
        loss.backward()
        optimiser.step()
        for group in optimiser.param_groups:
            group["lr"] = config.learning_rate * (1.0 - (step + 1) / config.steps)
    return np.asarray(mix.detach().numpy())


def _mix_loss(long: Tensor, mix: Tensor, config: ProjectionConfig) -> Tensor:
    """InfoNCE of the two halves of ``long`` ``(2 n, d)``, and the cross-entropy of everybody's neighbours before and
    after."""
    count = len(long) // 2
    short = F.normalize(long @ mix, dim=1)
    likeness = config.scale * short @ short.T
    pairs, _ = info_nce(short[:count], short[count:], torch.tensor(config.scale))
    whole = F.normalize(long, dim=1)
    oneself = _SELF * torch.eye(len(long))
    wanted = (config.scale * whole @ whole.T - oneself).softmax(dim=1)
    kept = -(wanted * (likeness - oneself).log_softmax(dim=1)).sum(dim=1).mean()
    return pairs + kept
