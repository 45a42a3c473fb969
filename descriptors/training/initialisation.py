"""Start of NetVLAD's training: settled batch norms, k-means centres, principal axes as the first projection."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from ..clusters import fix_signs, k_means, whitening
from .network import NetVladNetwork, VladLayer, assignment_alpha, standardise
from .projection import set_projection

_BATCH = 32
_FEATURES_PER_IMAGE = 60
_KMEANS_ROUNDS = 25
WHITENING = 0.375
"""Power of an axis' variance that it is divided by: 0 leaves a few axes to drown the rest, 0.5 lifts the noise of the
last to the strength of the first."""


@torch.no_grad()
def initialise(network: NetVladNetwork, images: NDArray[np.uint8], rng: np.random.Generator) -> None:
    """Set batch-norm statistics, principal axes of gradient histograms and all VLAD centres from ``images`` ``(n, H,
    W)``. The projection is set by :func:`fit_projection`."""
    settle_batch_norms(network, images)
    _start_vlad(network.vlad, _sample_features(network, network.local_features, images, rng), rng)
    initialise_gradients(network, images, rng)


@torch.no_grad()
def initialise_gradients(network: NetVladNetwork, images: NDArray[np.uint8], rng: np.random.Generator) -> None:
    """Set what follows the gradient histograms: their principal axes, and VLAD centres among the reduced ones."""
    if not network.config.gradient_levels:
        return

    def histograms(batch: Tensor) -> Tensor:
        return network.gradients(standardise(batch))

    sample = _sample_features(network, histograms, images, rng).astype(np.float64)
    mean = sample.mean(axis=0)
    _, axes = np.linalg.eigh((sample - mean).T @ (sample - mean) / len(sample))
    weight = fix_signs(axes[:, ::-1].T[: network.config.local_dim])
    network.gradient_reduce.weight.copy_(torch.from_numpy(weight)[:, :, None, None])
    network.gradient_reduce.bias.copy_(torch.from_numpy(-weight @ mean))
    _start_vlad(network.gradient_vlad, _sample_features(network, network.gradient_features, images, rng), rng)


@torch.no_grad()
def fit_projection(network: NetVladNetwork, images: NDArray[np.uint8]) -> NDArray[np.float64]:
    """Set the projection to the principal axes of the VLAD vectors of ``images`` ``(n, H, W)``, partly whitened,
    strongest first; n at least the output dimension. What an untrained network has; training ends with a learned one
    (``projection.py``).

    Returns the share of the variance along each kept axis, ``(dim,)``.
    """
    if len(images) < network.config.dim:
        raise ValueError(f"the projection needs at least {network.config.dim} images, got {len(images)}")
    mean, weight, shares = whitening(vlads_of(network, images), network.config.dim, WHITENING)
    set_projection(network, weight, -weight @ mean)
    return shares


@torch.no_grad()
def vlads_of(network: NetVladNetwork, images: NDArray[np.uint8]) -> NDArray[np.float32]:
    """VLAD vectors ``(n, vlad_dim)`` of ``images`` ``(n, H, W)``."""
    network.eval()
    device = device_of(network)
    return np.concatenate([network.aggregate(batch.to(device)).cpu().numpy() for batch in batches(images)])


def _start_vlad(layer: VladLayer, features: NDArray[np.float32], rng: np.random.Generator) -> None:
    centres = torch.from_numpy(k_means(features, len(layer.centres), _KMEANS_ROUNDS, rng))
    nearest = torch.topk(torch.cdist(torch.from_numpy(features), centres).square(), 2, dim=1, largest=False).values
    layer.set_centres(centres, assignment_alpha(nearest[:, 0], nearest[:, 1]))


@torch.no_grad()
def settle_batch_norms(network: NetVladNetwork, images: NDArray[np.uint8]) -> None:
    """Replace the running statistics of every batch norm by the plain average over ``images``."""
    norms = [m for m in network.modules() if isinstance(m, nn.BatchNorm2d)]
    usual = [norm.momentum for norm in norms]
    for norm in norms:
        norm.reset_running_stats()
        norm.momentum = None  # torch's word for a cumulative average
    network.train()
    for batch in batches(images):
        network.local_features(batch.to(device_of(network)))
    network.eval()
    for norm, momentum in zip(norms, usual, strict=True):
        norm.momentum = momentum


def device_of(network: NetVladNetwork) -> torch.device:
    """Device of the network's weights."""
    return network.project.weight.device


def batches(images: NDArray[np.uint8]) -> list[Tensor]:
    """``images`` ``(n, H, W)`` as a list of tensors ``(<= 32, 1, H, W)`` on the same memory."""
    return [torch.from_numpy(images[i : i + _BATCH])[:, None] for i in range(0, len(images), _BATCH)]


def _sample_features(
    network: NetVladNetwork, describe: Callable[[Tensor], Tensor], images: NDArray[np.uint8], rng: np.random.Generator
) -> NDArray[np.float32]:
    """Up to 60 of the local features ``(N, D, ...)`` that ``describe`` finds in each image, ``(n, D)``."""
    samples = []
    for batch in batches(images):
        for one in describe(batch.to(device_of(network))).flatten(2).transpose(1, 2).cpu().numpy():
            chosen = rng.choice(len(one), min(_FEATURES_PER_IMAGE, len(one)), replace=False)
            samples.append(one[chosen])
    return np.ascontiguousarray(np.concatenate(samples))
