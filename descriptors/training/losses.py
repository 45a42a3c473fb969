"""Losses of the training of place vectors. Imports torch."""

from __future__ import annotations

import torch
import torch.nn.functional as F
from torch import Tensor


def info_nce(first: Tensor, second: Tensor, scale: Tensor) -> tuple[Tensor, Tensor]:
    """Symmetric InfoNCE of paired unit rows ``(n, d)``, and the share of rows whose own pair is the most similar."""
    logits = scale * first @ second.T
    labels = torch.arange(len(logits), device=logits.device)
    loss = 0.5 * (F.cross_entropy(logits, labels) + F.cross_entropy(logits.T, labels))
    return loss, (logits.argmax(dim=1) == labels).float().mean()
