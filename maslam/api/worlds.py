"""Worlds with exact ground truth, rendered."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from maslam.frontend import datasets
from maslam.frontend.cameras.models import RigKind
from maslam.frontend.datasets import Dataset
from maslam.tools.common.compiling import COMPILING
from maslam.tools.common.progress import CallbackProgress, counter
from maslam.tools.worlds.config import RenderConfig
from maslam.tools.worlds.dataset import render_dataset

from .common import PathLike, ProgressCallback, Settings, changed, check_least, nested, on_one_thread


@on_one_thread
def render(
    out: PathLike,
    *,
    world: Literal["town", "indoor"] = "town",
    agents: int = 4,
    frames: int = 120,
    rig: RigKind | str = "stereo",
    size: tuple[int, int] = (640, 360),
    seed: int = 0,
    settings: Settings | None = None,
    workers: int = 1,
    progress: ProgressCallback | None = None,
) -> Dataset:
    """Render images of several agents with exact poses and depth, as ``maslam render`` does; needs the extra
    ``maslam[worlds]``. The same arguments give the same images.

    Args:
        out: a new folder, or one that was rendered with the same settings: it is left as it is, or gone on with.
        world: streets of a town, or an office floor.
        agents: agents, each with its own path and light.
        frames: frames of each agent.
        rig: ``"mono"``, ``"stereo"`` or ``"rgbd"``.
        size: width and height of the images, pixels.
        seed: of the world, the paths, the lights and the noise.
        settings: the others of ``maslam render --help-all``, ``{"light_change": 0.5, "poses_file": "00.txt"}``.
        workers: processes. More than one needs a script that calls this under ``if __name__ == "__main__":``.
        progress: called with title, steps done and all steps.

    Returns:
        What :func:`maslam.open_dataset` finds in ``out``, problems listed; its ``root`` goes into :func:`maslam.slam`.

    Raises:
        MaslamError: a library that is missing, a setting that is unknown or out of range, other files in ``out``.
    """
    check_least("workers", workers, 1)
    width, height = size
    named = {"world": world, "agents": agents, "frames": frames, "rig": str(rig), "width": width, "height": height}
    config = changed(RenderConfig(), {**named, "seed": seed, **nested(settings)})
    tasks = CallbackProgress(progress)
    render_dataset(config, Path(out), counter(tasks, "images"), workers, counter(tasks, COMPILING))
    return datasets.open_dataset(Path(out), strict=False)  # a single image can be rendered, though not tracked
