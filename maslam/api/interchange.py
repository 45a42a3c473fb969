"""Results for other programs."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import get_args

from maslam.frontend.datasets.readers import ReaderLike
from maslam.tools.common.errors import ToolError
from maslam.tools.common.progress import CallbackProgress
from maslam.tools.interchange.export_folder import export_run
from maslam.tools.interchange.export_request import Exported, ExportRequest, Frames, Groups, Program

from .common import PathLike, ProgressCallback, on_one_thread
from .results import Run


@on_one_thread
def export(
    run: Run | PathLike,
    out: PathLike,
    to: Program,
    *,
    agent: int | None = None,
    frames: Frames = "keyframes",
    groups: Groups = "largest",
    images: PathLike | None = None,
    with_images: bool = False,
    readers: Sequence[ReaderLike] = (),
    overwrite: bool = False,
    progress: ProgressCallback | None = None,
) -> Exported:
    """Write a run for another program, into a new folder, whole or not at all. The same files as of ``maslam export``.

    Args:
        run: what :func:`maslam.run` or :func:`maslam.slam` gave, or its folder.
        out: the new folder.
        to: ``"colmap"``, ``"hloc"``, ``"nerfstudio"``, ``"gsplat"``: one and the same folder of undistorted images,
            COLMAP model, ``transforms.json`` and points; ``"evo"``: TUM and KITTI trajectories; ``"mcap"``: a ROS 2 bag
            for Foxglove; ``"tf"``: transforms without ROS; ``"csv"``: all that the report plots.
        agent: this one alone; None takes the whole team.
        frames: images of key-frames, or of all frames that have a place.
        groups: of agents that no match joins the largest group, or all, a folder each.
        images: where the images are now, if their folder has moved since the run.
        with_images: put them into the recording (``"mcap"``).
        readers: your own, if the run was made with one.
        overwrite: replace an earlier export in ``out``.
        progress: called with title, steps done and all steps.

    Returns:
        The folder, lines about it, and the content of its ``export.json``: agents, units, counts.

    Raises:
        MaslamError: no finished run, images that are not found, files in ``out``, a package that is not installed.
    """
    for name, value, known in (("to", to, Program), ("frames", frames, Frames), ("groups", groups, Groups)):
        if value not in get_args(known):
            raise ToolError(f"{name}: {value!r}: one of {', '.join(get_args(known))} is meant")
    request = ExportRequest(
        program=to,
        agent=agent,
        frames=frames,
        groups=groups,
        images=None if images is None else Path(images),
        with_images=with_images,
        overwrite=overwrite,
        readers=tuple(readers),
    )
    folder = run.folder if isinstance(run, Run) else Path(run)
    return export_run(folder, Path(out), request, CallbackProgress(progress))
