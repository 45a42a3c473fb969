"""Two views of one place for training: how an image may change between visits (view, light, focus, noise,
occlusion).

Random numbers come from numpy generators and are turned into tensors, so that a step repeats whatever torch's own
state is.
"""

from __future__ import annotations

import cv2
import numpy as np
import torch
import torch.nn.functional as F
from numpy.typing import NDArray
from pydantic import Field
from torch import Tensor

from maslam._settings import Settings


class Augmentation(Settings):
    """Strengths of the changes; every range is symmetric about "no change" unless said otherwise."""

    min_crop: float = Field(0.6, gt=0, le=1)  # smallest side of a crop as a share of the image's
    rotation_deg: float = Field(6.0, ge=0)
    perspective: float = Field(0.12, ge=0)  # how far a corner moves, share of the crop's side
    log_gamma: float = Field(0.45, ge=0)
    log_gain: float = Field(0.35, ge=0)
    shading: float = Field(0.5, ge=0)  # log strength of smooth light and shadow across the image
    blur_px: float = Field(1.0, ge=0)  # largest standard deviation
    noise: float = Field(0.02, ge=0)  # largest standard deviation, share of full scale
    occlusion: float = Field(0.35, ge=0, le=1)  # largest side of an occluding rectangle, share of the image's
    occluded: float = Field(0.4, ge=0, le=1)  # share of the images that have one
    mirror: bool = True  # both views alike: a mirrored place is another place


PHOTOS = Augmentation()
"""For two views of one photograph: all of the change must be made here."""
RENDERED = Augmentation(
    min_crop=0.85, rotation_deg=3.0, perspective=0.04, log_gamma=0.3, log_gain=0.3, shading=0.35, occlusion=0.3
)
"""For two renderings of one place, which differ by pose, light and cars already."""


def augment_pair(
    first: NDArray[np.uint8],
    second: NDArray[np.uint8],
    size: tuple[int, int],
    kind: Augmentation,
    rng: np.random.Generator,
) -> tuple[Tensor, Tensor]:
    """Two augmented batches ``(n, 1, H, W)`` float32, 0 to 255, of paired images ``(n, h, w)``; ``size`` is (H, W)."""
    mirrored = rng.random(len(first)) < (0.5 if kind.mirror else 0.0)
    views = []
    for images in (first, second):
        source = np.where(mirrored[:, None, None], images[:, :, ::-1], images)
        views.append(_relight(_reframe(source, size, kind, rng), kind, rng))
    return views[0], views[1]


def share_strips(images: NDArray[np.uint8], share: float, rng: np.random.Generator) -> NDArray[np.uint8]:
    """Collages as hard negatives: neighbours 2m and 2m+1 of ``(n, h, w)`` get the same upright strip of a third image.

    ``share``: probability for each pair of neighbours. Two images then look alike in part and are different places
    all the same.
    """
    out = images.copy()
    count, _, width = images.shape
    for i in range(0, count - 1, 2):
        donor, strip = images[rng.integers(count)], int(width * rng.uniform(0.2, 0.4))
        source, targets = int(rng.integers(width - strip + 1)), rng.integers(width - strip + 1, size=2)
        if rng.random() < share:
            for k in (0, 1):
                out[i + k, :, targets[k] : targets[k] + strip] = donor[:, source : source + strip]
    return out


def _reframe(images: NDArray[np.uint8], size: tuple[int, int], kind: Augmentation, rng: np.random.Generator) -> Tensor:
    """Crops seen through a small homography, ``(n, 1, H, W)`` in 0 to 1."""
    from kornia.geometry.transform import warp_perspective

    count, h, w = images.shape
    height, width = size
    target = np.array([[0, 0], [width - 1, 0], [width - 1, height - 1], [0, height - 1]], dtype=np.float32)
    corners = np.array([[-0.5, -0.5], [0.5, -0.5], [0.5, 0.5], [-0.5, 0.5]])
    homographies = np.empty((count, 3, 3), dtype=np.float32)
    for i in range(count):
        side = np.array([w, h]) * rng.uniform(kind.min_crop, 1.0)
        centre = np.array([w, h]) / 2 + rng.uniform(-0.5, 0.5, 2) * (np.array([w, h]) - side)
        angle = np.radians(rng.uniform(-kind.rotation_deg, kind.rotation_deg))
        moved = (corners + rng.uniform(-kind.perspective, kind.perspective, (4, 2)) / 2) * side
        turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
        homographies[i] = cv2.getPerspectiveTransform((moved @ turn.T + centre).astype(np.float32), target)
    tensor = torch.from_numpy(images.astype(np.float32) / 255.0)[:, None]
    return warp_perspective(tensor, torch.from_numpy(homographies), size, padding_mode="border", align_corners=True)


def _relight(x: Tensor, kind: Augmentation, rng: np.random.Generator) -> Tensor:
    """Light, shadow, occlusion, focus, noise: ``(n, 1, H, W)`` in 0 to 1 to the same in 0 to 255, whole
    levels."""
    from kornia.filters import gaussian_blur2d

    count, _, height, width = x.shape
    x = x.clamp(1e-3, 1.0) ** torch.exp(_uniform(rng, count, kind.log_gamma))
    field = torch.from_numpy(rng.uniform(-kind.shading, kind.shading, (count, 1, 3, 4)).astype(np.float32))
    light = F.interpolate(field, size=(height, width), mode="bicubic", align_corners=True)
    x = x * torch.exp(light + _uniform(rng, count, kind.log_gain))
    for i in np.flatnonzero(rng.random(count) < kind.occluded):
        h, w = (int(side * rng.uniform(0.1, kind.occlusion)) for side in (height, width))
        top, left = int(rng.integers(height - h + 1)), int(rng.integers(width - w + 1))
        other = int(rng.integers(count))
        # The occluder is a piece of another image, so that it looks like something.
        x[i, :, top : top + h, left : left + w] = x[
            other, :, height - h - top : height - top, width - w - left : width - left
        ].clone()
    sigma = torch.from_numpy(rng.uniform(0.05, max(kind.blur_px, 0.06), (count, 1)).astype(np.float32)).expand(-1, 2)
    x = gaussian_blur2d(x, (7, 7), sigma.contiguous())
    level = torch.from_numpy((rng.uniform(0, kind.noise, (count, 1, 1, 1))).astype(np.float32))
    x = x + level * torch.from_numpy(rng.standard_normal((count, 1, height, width), dtype=np.float32))
    return (x * 255.0).round().clamp(0.0, 255.0)


def _uniform(rng: np.random.Generator, count: int, bound: float) -> Tensor:
    return torch.from_numpy(rng.uniform(-bound, bound, (count, 1, 1, 1)).astype(np.float32))
