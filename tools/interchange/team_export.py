"""The map of the team, or of one agent, with its images: for COLMAP, hloc, nerfstudio and gsplat."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from maslam.frontend.files.trajectory import Trajectory
from maslam.mas.sequence import STAMP_TOLERANCE_NS

from ..common.errors import ToolError
from ..common.progress import Progress
from ..common.text_table import counted
from ..report.run_data import RunData
from .export_request import ExportRequest
from .reconstruction import write_reconstruction
from .source_images import find_images
from .team_model import TeamModel, team_model
from .units import METRES, agent_records, unit_of

_NEXT = {
    "colmap": "colmap model_analyzer --path {out}/sparse/0",
    "hloc": "hloc.triangulation.main(sfm, '{out}/sparse/0', '{out}/images', pairs, features, matches)",
    "nerfstudio": "ns-train splatfacto --data {out}",
    "gsplat": "python simple_trainer.py default --data_dir {out} --data_factor 1",
}


def write_team(
    folder: Path, data: RunData, members: Sequence[int], request: ExportRequest, tell: Progress
) -> tuple[list[str], dict[str, Any]]:
    """Write the reconstruction of the largest group of agents that share a frame, or of each."""
    groups = [group for group in _largest_first(data) if set(group) & set(members)]
    placed = [group for group in groups if any(len(data.agents[a].estimate) for a in group if a in members)]
    if not placed:
        raise ToolError(f"{data.folder}: no frame of {_names(data, members)} has a place, so there is no map to export")
    every = request.groups == "all" and len(placed) > 1
    chosen = placed if every else placed[:1]
    images = find_images(data.manifest, request.images, request.readers, [a for g in chosen for a in g if a in members])
    lines, records = [], []
    for number, group in enumerate(chosen):
        inside = f"group_{number:02d}" if every else ""
        mine = [a for a in group if a in members]
        model = _model(data, group, mine, request)
        (folder / inside).mkdir(exist_ok=True)
        cameras = {a: data.manifest.agents[a].camera for a in mine}
        write_reconstruction(folder / inside, model, cameras, images, tell)
        records.append(_record(data, mine, model, inside))
        lines.append(_line(records[-1]))
        lines += [f"  {_NEXT[request.program]}".replace("{out}", "/".join(["{out}", *filter(None, [inside])]))]
    left = [a for group in groups if group not in chosen for a in group if a in members]
    if left and not every:
        why = "no match joins them to the others" if len(placed) > 1 else "no frame of theirs has a place"
        lines.append(
            f"left out: {_names(data, left)}: {why}" + ("; --groups all exports each group" if len(placed) > 1 else "")
        )
    return lines, {"models": records, "left_out": [data.agents[a].name for a in left]}


def _model(data: RunData, group: Sequence[int], mine: Sequence[int], request: ExportRequest) -> TeamModel:
    model = team_model(data, group)
    if len(mine) == 1:
        model = model.of_agent(mine[0])
    for a in mine if request.frames == "all" else []:
        every, own = data.agents[a].estimate, model.agents == a
        keyframes = Trajectory(model.stamps_ns[own], model.poses[own])
        fresh = keyframes.nearest(every.stamps_ns, STAMP_TOLERANCE_NS) < 0
        model = model.with_frames(a, every.stamps_ns[fresh], every.poses[fresh])
    if not len(model.agents):
        raise ToolError(f"{data.folder}: {_names(data, mine)}: no key-frame has a place, so there is no map to export")
    return model


def _largest_first(data: RunData) -> list[list[int]]:
    """Groups by the number of frames that have a place."""
    return sorted(data.groups, key=lambda group: (-sum(len(data.agents[a].estimate) for a in group), group))


def _record(data: RunData, mine: Sequence[int], model: TeamModel, inside: str) -> dict[str, Any]:
    median = float(np.median(model.errors)) if len(model.errors) else None
    return {
        "folder": inside or ".",
        "unit": unit_of(data, mine[0]),
        "agents": agent_records(data, mine),
        "images": len(model.agents),
        "points": len(model.points),
        "views": len(model.uv),
        "median_reprojection_px": None if median is None else round(median, 4),
    }


def _line(record: dict[str, Any]) -> str:
    at = "{out}" if record["folder"] == "." else f"{{out}}/{record['folder']}"
    unit = "metres" if record["unit"] == METRES else "an arbitrary unit of length: one camera has no scale"
    median = record["median_reprojection_px"]
    error = "no points" if median is None else f"median reprojection error {median:.2f} px"
    counts = f"{counted(len(record['agents']), 'agent')}, {counted(record['images'], 'image')}"
    return f"{at}: {counts}, {counted(record['points'], 'point')}, {error}, in {unit}"


def _names(data: RunData, agents: Sequence[int]) -> str:
    return ", ".join(data.agents[a].name for a in agents)
