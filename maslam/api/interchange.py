"""Other programs' results in, and results for other programs."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Literal, get_args

import numpy as np
from numpy.typing import ArrayLike

from maslam.descriptors.choice import DescriptorLike
from maslam.frontend.cameras.models import RigKind
from maslam.frontend.datasets.readers import ReaderLike
from maslam.tools.common.errors import ToolError
from maslam.tools.common.found_positions import DEFAULT_SIGMA_M
from maslam.tools.common.progress import CallbackProgress
from maslam.tools.interchange.export_folder import export_run
from maslam.tools.interchange.export_request import Exported, ExportRequest, Frames, Groups, Program
from maslam.tools.interchange.given import ImportSettings, import_given
from maslam.tools.pipeline.predecessor import import_folder

from .common import (
    PathLike,
    ProgressCallback,
    Settings,
    nested,
    on_one_thread,
    positions_of,
    preprocess_settings,
)
from .results import Run, Sequences


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


@on_one_thread
def import_sequence(
    poses: PathLike,
    images: PathLike | None,
    out: PathLike,
    *,
    scale: Literal["metric", "arbitrary"] = "metric",
    T_body_camera: ArrayLike | PathLike | None = None,
    times: PathLike | None = None,
    clock_offset_s: float = 0.0,
    bridge_s: float = 0.5,
    gap_s: float = 5.0,
    topic: str | None = None,
    points: PathLike | None = None,
    gps: PathLike | None = None,
    gps_offset_s: float = 0.0,
    gps_sigma_m: float = DEFAULT_SIGMA_M,
    gps_antenna_m: tuple[float, float, float] | None = None,
    add: bool = False,
    agents: int | None = None,
    overlap: int = 0,
    rig: RigKind | str | None = None,
    dataset: str | None = None,
    readers: Sequence[ReaderLike] = (),
    descriptor: DescriptorLike | str | Path = "default",
    provider: str = "CPU",
    vocabulary: PathLike | None = None,
    settings: Settings | None = None,
    workers: int = 1,
    overwrite: bool = False,
    progress: ProgressCallback | None = None,
) -> Sequences:
    """Turn another system's trajectory and its images into agent sequences; the poses stay as they are.

    Args:
        poses: TUM, KITTI, EuRoC csv, matrices, arrays, JSON, a COLMAP model, a bag; for several agents a folder with
            one named after each. With ``images`` None: a folder of the predecessor's five files with
            ``netvlad_feats.bin``.
        images: a folder of images, as :func:`maslam.open_dataset` reads it.
        out: folder for the agent sequences.
        scale: ``"arbitrary"`` where the poses have a unit of their own (one camera).
        T_body_camera: ``(4, 4)`` or a file: the camera's pose on the body whose poses are given.
        times: a file with a time for each pose, where ``poses`` has none.
        clock_offset_s: seconds to add to the trajectory's times to get the images'.
        bridge_s: longest time between two poses that an image's is interpolated over.
        gap_s: a longer time without a pose begins a new track.
        topic: of the poses in a bag.
        points: 3-D points that measure depth for one camera: a cloud or a table with the images that see each, in the
            poses' frame, a COLMAP text model, or a folder of scans in the body's axes.
        gps, gps_offset_s, gps_sigma_m, gps_antenna_m: a file of positions (or a folder with one for each agent), what
            to add to its times, its noise where the file has none, and the antenna's place in the camera's frame.
        add: keep the agents that ``out`` holds.
        agents, overlap, rig, dataset, readers, descriptor, provider, vocabulary, settings, workers, overwrite,
            progress: as in :func:`maslam.preprocess`.

    Raises:
        MaslamError: nothing that can be used, images that contradict the poses, a folder with other files in it or
            with agents of something else.
    """
    if scale not in ("metric", "arbitrary"):
        raise ToolError(f"scale: {scale!r}: metric or arbitrary is meant")
    positions = positions_of(gps, gps_offset_s, gps_sigma_m, gps_antenna_m)
    own = preprocess_settings(
        nested(settings),
        agents,
        overlap,
        rig,
        dataset,
        readers,
        descriptor,
        provider,
        vocabulary,
        workers,
        overwrite,
        positions,
    )
    shown = CallbackProgress(progress)
    if images is None:
        import_folder(Path(poses), Path(out), shown, scale, agents, overlap, overwrite)
        return Sequences.load(out)
    on_body = T_body_camera
    told = ImportSettings(
        images=own,
        scale=scale,
        T_body_camera=str(on_body) if isinstance(on_body, str | Path) else _numbers(on_body),
        times=None if times is None else Path(times),
        clock_offset_s=clock_offset_s,
        bridge_s=bridge_s,
        gap_s=gap_s,
        topic=topic,
        points=None if points is None else Path(points),
        add=add,
    )
    import_given(Path(poses), Path(images), Path(out), told, shown)
    return Sequences.load(out)


def _numbers(matrix: ArrayLike | None) -> str | None:
    """As on the command line, where they are checked."""
    return None if matrix is None else ",".join(map(repr, np.asarray(matrix, dtype=np.float64).ravel().tolist()))
