"""The shape of the network and how it is trained, as settings; no torch here."""

from __future__ import annotations

from pydantic import Field

from maslam._settings import Settings


class NetVladConfig(Settings):
    """The shape of the network."""

    channels: tuple[int, ...] = Field((32, 64, 96, 128, 128), description="of the 3x3 convolutions")
    strides: tuple[int, ...] = Field((2, 2, 2, 1, 1), description="of the 3x3 convolutions")
    context: tuple[int, ...] = Field(
        (192, 256), description="channels of further 3x3 convolutions at half that size, added back to the last of them"
    )
    gradient_levels: tuple[int, ...] = Field(
        (1, 2), description="shrink factors at which gradient histograms are taken; none: convolutions alone"
    )
    gradient_share: float = Field(0.65, gt=0, lt=1, description="of the squared length of the VLAD vector")
    local_dim: int = Field(64, gt=0, description="dimensions of a local feature, of either kind")
    clusters: int = Field(64, gt=1, description="VLAD centres, of either kind")
    dim: int = Field(256, gt=0, description="dimensions of the place vector")


class ProjectionConfig(Settings):
    """Fit of the projection, made when the rest is trained."""

    axes: int = Field(1024, gt=0, description="principal axes that are mixed down, where the views give as many")
    power: float = Field(0.5, ge=0, le=0.5, description="of an axis' variance that it is divided by")
    steps: int = Field(80, ge=0, description="steps")
    pairs: int = Field(768, gt=1, description="places in a batch")
    learning_rate: float = Field(1e-3, gt=0, description="at the start; falls to zero on a line")
    scale: float = Field(20.0, gt=0, description="inverse temperature")


class TrainingConfig(Settings):
    """Settings of a training run. The same configuration, images, seed and thread count give the same weights."""

    network: NetVladConfig = NetVladConfig()
    steps: int = Field(
        2500, ge=0, description="steps; 0: only batch norms and the projection are fitted, to given weights"
    )
    pairs: int = Field(48, gt=1, description="places in a batch, two views each")
    width: int = Field(160, ge=32, description="of a training image, pixels")
    height: int = Field(120, ge=32, description="of a training image, pixels")
    learning_rate: float = Field(2e-3, gt=0, description="at its peak; falls to zero on a half cosine")
    warmup_steps: int = Field(100, ge=0, description="steps in which the learning rate rises")
    gradient_thinning: int = Field(3, gt=0, description="every so many gradient histograms are learned from in a step")
    weight_decay: float = Field(1e-4, ge=0, description="of every weight, a share of the learning rate")
    start_scale: float = Field(12.0, gt=0, description="inverse temperature at the start; learned")
    projection: ProjectionConfig = ProjectionConfig()
    seed: int = Field(0, ge=0, description="seed of every random choice")
    threads: int = Field(1, gt=0, description="threads; another number gives other weights")
    initial_images: int = Field(1024, gt=0, description="images that centres and batch-norm statistics come from")
    checkpoint_every: int = Field(250, gt=0, description="steps")
