"""Dense RootSIFT as a handful of convolutions, so that it can stand inside the network and its ONNX graph.

Gradients in eight directions, pooled over cells of 4x4 pixels by a triangular window; sixteen neighbouring cells make a
descriptor (Lowe, IJCV 2004), cut off at 0.2 and brought to RootSIFT (Arandjelovic and Zisserman, CVPR 2012). Nothing
here is learned: it is what the learned layers behind it start from. Imports torch.
"""

from __future__ import annotations

import math

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from ..errors import DescriptorError

DIRECTIONS = 8
CELLS = 4
"""Cells along a side of a descriptor."""
CELL_PX = 4
CHANNELS = DIRECTIONS * CELLS * CELLS
CLIP = 0.2
NORM_FLOOR = 1e-3
ENERGY_FLOOR = 1e-6


class GradientDescriptors(nn.Module):
    """Standardised images ``(N, 1, H, W)`` to unit RootSIFT descriptors ``(N, 128, n)``.

    ``levels``: by how much the image is shrunk first; every level samples its descriptors 4 pixels of the full image
    apart, those of the first level a cell apart.
    """

    def __init__(self, levels: tuple[int, ...]) -> None:
        super().__init__()
        bad = [level for level in levels if level < 1 or CELL_PX % level]
        if bad:
            raise ValueError(f"gradient levels must divide {CELL_PX}, got {bad[0]}")
        self.levels = levels
        angles = torch.arange(DIRECTIONS) * (2.0 * math.pi / DIRECTIONS)
        along_x = torch.tensor([[0.0, 0.0, 0.0], [-0.5, 0.0, 0.5], [0.0, 0.0, 0.0]])
        kernels = torch.cos(angles)[:, None, None] * along_x + torch.sin(angles)[:, None, None] * along_x.T
        self.register_buffer("derivative", kernels[:, None].contiguous(), persistent=False)
        ramp = 1.0 - torch.arange(-CELL_PX + 1, CELL_PX).abs() / CELL_PX
        self.register_buffer("window", torch.outer(ramp, ramp).expand(DIRECTIONS, 1, -1, -1).clone(), persistent=False)

    @torch.no_grad()
    def forward(self, x: Tensor, thin: int = 1, offset: int = 0) -> Tensor:
        """All levels' descriptors, ``(N, 128, n)``; ``thin``: every so many of them only, from ``offset`` on."""
        height, width = x.shape[2:]
        if min(height, width) < smallest_side(self.levels):
            raise DescriptorError(
                f"an image of {width}x{height} px is too small for gradient histograms: {smallest_side(self.levels)} px"
            )
        maps = [self._cells(x, level).flatten(2)[:, :, offset % thin :: thin] for level in self.levels]
        stacked = torch.cat(maps, dim=2)
        cut = (stacked / (stacked.norm(dim=1, keepdim=True) + NORM_FLOOR)).clamp_(max=CLIP)
        return cut.div_(cut.sum(dim=1, keepdim=True) + ENERGY_FLOOR).sqrt_()

    def _cells(self, x: Tensor, level: int) -> Tensor:
        """Sixteen cells of eight directions for each descriptor, ``(N, 128, h, w)``."""
        shrunk = F.avg_pool2d(x, level) if level > 1 else x
        gradients = F.conv2d(F.pad(shrunk, (1, 1, 1, 1), mode="replicate"), self.derivative)
        energy = gradients[:, :1].square() + gradients[:, 2:3].square() + ENERGY_FLOOR
        # Strength times the fourth power of the cosine to each direction: a smooth share among neighbouring directions.
        shared = gradients.relu_().square_().square_().mul_(energy.pow_(-1.5))
        step = CELL_PX // level
        pooled = F.conv2d(shared, self.window, stride=step, groups=DIRECTIONS)
        apart = CELL_PX // step
        height, width = (side - (CELLS - 1) * apart for side in pooled.shape[2:])
        corners = [(i * apart, j * apart) for i in range(CELLS) for j in range(CELLS)]
        return torch.cat([pooled[:, :, i : i + height, j : j + width] for i, j in corners], dim=1)


def smallest_side(levels: tuple[int, ...]) -> int:
    """Pixels that a side of an image needs for every level to have at least one descriptor."""
    return max(level * (2 * CELL_PX - 1 + (CELLS - 1) * CELL_PX) for level in levels) if levels else 1
