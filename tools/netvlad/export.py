"""``maslam netvlad export``: any file of weights that is known, recognised by its content, to an ONNX graph and its
card."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from maslam.descriptors.card import ModelCard, file_sha256, write_card
from maslam.descriptors.errors import DescriptorError

from ..common.errors import ToolError
from ..common.progress import Progress
from .train import MIN_STD

if TYPE_CHECKING:
    from maslam.descriptors.published.vgg_weights import VggWeights

OUR_PIXELS, VGG_PIXELS = 19_200, 307_200
"""Working sizes: ours 160x120; VGG16-NetVLAD was trained and published on 640x480."""
_PAPER = "VGG16-NetVLAD (Arandjelovic et al., CVPR 2016)"
_LICENCE = "that of the imported weights: ask those who published them"


@dataclass(frozen=True)
class ExportJob:
    """``dim``: numbers of a vector, the first of the whitening (None: all); ``pixels``: working size (None: the usual
    one of the network); ``name`` and ``note`` for the card (empty: what the file is)."""

    checkpoint: Path
    out: Path
    name: str = ""
    dim: int | None = None
    pixels: int | None = None
    note: str = ""


def export_model(job: ExportJob, progress: Progress) -> Path:
    """Write ``job.out`` and its card. Thresholds are not known yet: 2.0 (every pair) until ``calibrate`` sets them."""
    if job.out.suffix != ".onnx":
        raise ToolError(f"{job.out}: a model's file must end in .onnx")
    if not job.checkpoint.is_file():
        raise ToolError(f"{job.checkpoint}: not found, or no file")
    if job.pixels is not None and job.pixels < 1:
        raise ToolError(f"--pixels must be at least 1, got {job.pixels}")
    size = job.checkpoint.stat().st_size
    reading = progress.start(f"reading {job.checkpoint.name}, {size / 1e6:.0f} MB", 1)
    published = _read_published(job)
    progress.advance(reading, 1)
    return _export_ours(job) if published is None else _export_vgg(job, *published, progress)


def _read_published(job: ExportJob) -> tuple[VggWeights, str] | None:
    """VGG16-NetVLAD and whose kind of file it is in; None for a checkpoint of our own training."""
    with job.checkpoint.open("rb") as file:
        matlab = file.read(6) == b"MATLAB"
    if matlab:
        from maslam.descriptors.published.matconvnet import read_matconvnet

        return read_matconvnet(job.checkpoint, job.dim), "MatConvNet"
    from maslam.descriptors.published.torch_checkpoint import common_state, read_torch, weights_from_state

    found = read_torch(job.checkpoint)
    if {"config", "step", "network"} <= found.keys():
        return None
    state = common_state(found)
    if state is None:
        names = ", ".join(sorted(map(str, found))[:6]) or "nothing"
        raise ToolError(
            f"{job.checkpoint}: a PyTorch file with {names} in it; expected a checkpoint of `maslam netvlad train`, or "
            "VGG16-NetVLAD's state_dict (encoder.0.weight, pool.centroids, ...)"
        )
    try:
        return weights_from_state(state, job.dim), "PyTorch"
    except DescriptorError as error:
        raise DescriptorError(f"{job.checkpoint}: {error}") from error


def _export_ours(job: ExportJob) -> Path:
    from .train import export

    if job.dim is not None:
        raise ToolError(f"--dim {job.dim}: is for published weights; agents cut our vectors themselves")
    return export(job.checkpoint, job.out, job.name or "maslam-netvlad", job.pixels or OUR_PIXELS, job.note)


def _export_vgg(job: ExportJob, weights: VggWeights, maker: str, progress: Progress) -> Path:
    from maslam.descriptors.published.onnx_export import export_vgg

    job.out.parent.mkdir(parents=True, exist_ok=True)
    clusters, channels = weights.centres.shape
    whitened = "whitening" if weights.whitening is not None else "no whitening"
    layer = f"{maker} VGG16-NetVLAD, {clusters} centres of {channels} numbers, {whitened}, {weights.dim} numbers out"
    writing = progress.start(f"{layer}: writing {weights.nbytes / 1e6:.0f} MB", 1)
    digest = file_sha256(job.checkpoint)
    export_vgg(weights, job.out)
    card = ModelCard(
        name=job.name or f"vgg16-netvlad-{weights.dim}",
        sha256=file_sha256(job.out),
        dim=weights.dim,
        input_pixels=job.pixels or VGG_PIXELS,
        colour=True,
        threshold=2.0,
        candidate_threshold=2.0,
        min_std=MIN_STD,
        licence=_LICENCE,
        training=job.note,
        source=f"{_PAPER}, {maker} file {job.checkpoint.name}, sha256 {digest}",
    )
    write_card(job.out, card)
    progress.advance(writing, 1)
    return job.out
