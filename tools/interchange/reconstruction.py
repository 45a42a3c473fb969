"""One folder that COLMAP, hloc, nerfstudio and gsplat take as it is: undistorted images and the map that they show.

images/agent_00/…        the user's images, undistorted
images.csv               of each its agent, time stamp and source
sparse/0/…               COLMAP's cameras, images and points
points.ply               the points, in the model's coordinates
transforms.json          nerfstudio's cameras; sparse_pc.ply: the points in its axes
"""

from __future__ import annotations

import csv
from collections import Counter
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from maslam.backend.geometry import Array, se3_inverse
from maslam.mas.manifest import CameraEntry

from ..common.progress import Progress
from .colmap_tables import ModelParts, write_model
from .nerfstudio import write_transforms
from .point_cloud import write_points
from .source_images import AgentImages
from .team_model import TeamModel

IMAGES, SPARSE, POINTS, LIST = "images", Path("sparse", "0"), "points.ply", "images.csv"


def write_reconstruction(
    folder: Path,
    model: TeamModel,
    cameras: Mapping[int, CameraEntry],
    images: Mapping[int, AgentImages],
    tell: Progress,
) -> list[str]:
    """Write all of it into ``folder``; returns the images' names, in the model's order."""
    rows = np.zeros(len(model.agents), dtype=np.int64)
    for agent in np.unique(model.agents).tolist():
        mine = model.agents == agent
        rows[mine] = images[agent].rows(model.stamps_ns[mine])
    names = _names(model, rows, images)
    colours = _write_images(folder / IMAGES, model, names, rows, images, tell)
    used = sorted(np.unique(model.agents).tolist())
    parts = ModelParts(
        cameras=[cameras[a] for a in used],
        names=names,
        cameras_of=np.searchsorted(used, model.agents),
        T_C_W=se3_inverse(model.poses),
        image=model.image,
        uv=model.uv,
        point=model.point,
        points=model.points,
        colours=colours,
        errors=model.errors,
    )
    write_model(folder / SPARSE, parts)
    write_points(folder / POINTS, model.points, colours)
    write_transforms(folder, parts, IMAGES)
    sources = [str(images[a].sequence.left[row]) for a, row in zip(model.agents.tolist(), rows.tolist(), strict=True)]
    with open(folder / LIST, "w", newline="", encoding="utf-8", errors="surrogateescape") as file:
        table = csv.writer(file, lineterminator="\n")
        table.writerow(["name", "agent", "stamp_ns", "source"])
        table.writerows(zip(names, model.agents.tolist(), model.stamps_ns.tolist(), sources, strict=True))
    return names


def _names(model: TeamModel, rows: NDArray[np.int64], images: Mapping[int, AgentImages]) -> list[str]:
    """A name an image; files of one name from several folders, which the source's folder does not hold, get the
    frame's number in front."""
    frames = list(zip(model.agents.tolist(), rows.tolist(), strict=True))
    names = [images[a].name(row) for a, row in frames]
    often = {name for name, count in Counter(names).items() if count > 1}
    return [
        f"{images[a].entry.name}/{row:06d}_{Path(name).name}" if name in often else name
        for name, (a, row) in zip(names, frames, strict=True)
    ]


def _write_images(
    folder: Path,
    model: TeamModel,
    names: list[str],
    rows: NDArray[np.int64],
    images: Mapping[int, AgentImages],
    tell: Progress,
) -> NDArray[np.uint8]:
    """Write the images; returns the colour ``(P, 3)`` uint8 RGB of each point, the mean of its views'."""
    task = tell.start("images", len(names))
    bounds = np.searchsorted(model.image, np.arange(len(names) + 1))
    sums: Array = np.zeros((len(model.points), 3))
    for i, name in enumerate(names):
        data, bgr = images[int(model.agents[i])].encoded(int(rows[i]))
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(data)
        seen = slice(bounds[i], bounds[i + 1])
        x, y = (np.clip(np.rint(model.uv[seen, k]).astype(np.int64), 0, bgr.shape[1 - k] - 1) for k in (0, 1))
        np.add.at(sums, model.point[seen], bgr[y, x, ::-1].astype(np.float64))
        tell.advance(task, i + 1)
    views = np.bincount(model.point, minlength=len(model.points))
    return np.rint(sums / np.maximum(views, 1)[:, None]).astype(np.uint8)
