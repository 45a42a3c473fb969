"""Where training of NetVLAD starts: settled batch norms, k-means centres, principal axes as the first projection."""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from descriptors.netvlad import NetVladNetwork, assignment_alpha

_BATCH = 32
_FEATURES_PER_IMAGE = 60
_KMEANS_ROUNDS = 25
_WHITENING = 0.375
"""Power of an axis' variance that it is divided by: 0 is plain PCA, 0.5 full whitening; chosen on held-out worlds."""


def kmeans(features: NDArray[np.float32], clusters: int, rng: np.random.Generator) -> NDArray[np.float32]:
    """Centres ``(clusters, D)`` of ``(n, D)`` features by Lloyd's rounds; a centre that loses all its features is
    drawn anew."""
    centres = features[np.sort(rng.choice(len(features), clusters, replace=False))].copy()
    for _ in range(_KMEANS_ROUNDS):
        labels = np.argmax(features @ centres.T - 0.5 * np.square(centres).sum(axis=1), axis=1)
        counts = np.bincount(labels, minlength=clusters)
        for dimension in range(features.shape[1]):
            sums = np.bincount(labels, weights=features[:, dimension], minlength=clusters)
            centres[:, dimension] = sums / np.maximum(counts, 1)
        empty = np.flatnonzero(counts == 0)
        centres[empty] = features[rng.choice(len(features), len(empty), replace=False)]
    return centres


@torch.no_grad()
def initialise(network: NetVladNetwork, images: NDArray[np.uint8], rng: np.random.Generator) -> None:
    """Set batch-norm statistics, VLAD centres and projection from ``images`` ``(n, H, W)``; n at least the output
    dimension."""
    if len(images) < network.config.dim:
        raise ValueError(f"initialisation needs at least {network.config.dim} images, got {len(images)}")
    settle_batch_norms(network, images)
    features = _sample_features(network, images, rng)
    centres = torch.from_numpy(kmeans(features, network.config.clusters, rng))
    nearest = torch.topk(torch.cdist(torch.from_numpy(features), centres).square(), 2, dim=1, largest=False).values
    network.vlad.set_centres(centres, assignment_alpha(nearest[:, 0], nearest[:, 1]))
    fit_projection(network, images)


@torch.no_grad()
def fit_projection(network: NetVladNetwork, images: NDArray[np.uint8]) -> NDArray[np.float64]:
    """Set the projection to the principal axes of the VLAD vectors of ``images``, partly whitened, strongest first.

    Returns the share of the variance along each kept axis, ``(dim,)``. Partial whitening lies between plain PCA, where
    a few axes drown the rest, and full whitening, which lifts the noise of the last axes to the strength of the
    first; docs/netvlad.md has the figures.
    """
    network.eval()
    vlads = torch.cat([network.aggregate(batch) for batch in batches(images)]).double()
    mean = vlads.mean(dim=0)
    variances, axes = torch.linalg.eigh((vlads - mean).T @ (vlads - mean) / len(vlads))
    variances, axes = variances.flip(0).clamp(min=0.0), axes.flip(1).T
    kept, shares = axes[: network.config.dim], variances / variances.sum()
    # An axis' sign is free: fix it, so that the same training gives the same file on every machine.
    kept = kept * kept.gather(1, kept.abs().argmax(dim=1, keepdim=True)).sign()
    scale = (variances[: network.config.dim] / variances[0]).clamp(min=1e-6) ** -_WHITENING
    weight = kept * scale[:, None]
    network.project.weight.copy_(weight.float())
    network.project.bias.copy_((-weight @ mean).float())
    return np.asarray(shares[: network.config.dim].numpy())


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
        network.local_features(batch)
    network.eval()
    for norm, momentum in zip(norms, usual, strict=True):
        norm.momentum = momentum


def batches(images: NDArray[np.uint8]) -> list[Tensor]:
    """``images`` ``(n, H, W)`` as a list of tensors ``(<= 32, 1, H, W)`` on the same memory."""
    return [torch.from_numpy(images[i : i + _BATCH])[:, None] for i in range(0, len(images), _BATCH)]


def _sample_features(
    network: NetVladNetwork, images: NDArray[np.uint8], rng: np.random.Generator
) -> NDArray[np.float32]:
    samples = []
    for batch in batches(images):
        features = network.local_features(batch).flatten(2).transpose(1, 2).numpy()
        for one in features:
            chosen = rng.choice(len(one), min(_FEATURES_PER_IMAGE, len(one)), replace=False)
            samples.append(one[chosen])
    return np.ascontiguousarray(np.concatenate(samples))
