"""The folder of an export: refused or replaced, written aside and moved into place whole."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from ..common.errors import EarlierResultError, ToolError, UsageError
from ..common.progress import Progress
from ..common.text_table import counted
from ..common.writing import writing_whole
from ..report.run_data import RunData, read_run
from .evo_files import write_evo
from .export_request import RECONSTRUCTIONS, Exported, ExportRequest
from .plot_tables import write_tables
from .ros_bag import write_bag
from .team_export import write_team
from .tf_files import write_tf

RECORD = "export.json"
Writer = Callable[[Path, RunData, Sequence[int], ExportRequest, Progress], tuple[list[str], dict[str, Any]]]
"""Writes into a new folder, of these agents; returns lines for people and entries of ``export.json``."""

_WRITERS: dict[str, Writer] = {
    **dict.fromkeys(RECONSTRUCTIONS, write_team),
    "evo": write_evo,
    "mcap": write_bag,
    "tf": write_tf,
    "csv": write_tables,
}


def export_run(run: Path, out: Path, request: ExportRequest, progress: Progress) -> Exported:
    """Write the run for the program that the request names, into a new folder ``out``.

    ``ToolError`` where ``run`` is no finished run, its images are not found, or ``out`` holds files; an earlier export
    is replaced where the request says so.
    """
    _check_request(request)
    data = read_run(run)
    _check_out(out, run, Path(data.manifest.source), request)
    members = _members(data, request.agent)
    with writing_whole(out) as part:
        _check_out(out, run, Path(data.manifest.source), request)  # another export may have been first
        lines, entries = _WRITERS[request.program](part, data, members, request, progress)
        record = {
            "version": data.summary.get("version"),
            "for": request.program,
            "run": str(run.resolve()),
            "source": data.manifest.source,
            **entries,
        }
        (part / RECORD).write_text(json.dumps(record, indent=1) + "\n", encoding="utf-8")
    return Exported(out, tuple(line.replace("{out}", str(out)) for line in lines), record)


def _check_request(request: ExportRequest) -> None:
    """Refuse what the program has no use for, so that nobody waits for it."""
    program, several = request.program, ", ".join(RECONSTRUCTIONS)
    if request.with_images and program != "mcap":
        raise UsageError(f"--with-images is for --for mcap; --for {program} decides by itself")
    if program in RECONSTRUCTIONS:
        return
    for name, used in (("frames", request.frames != "keyframes"), ("groups", request.groups != "largest")):
        if used:
            raise UsageError(f"--{name} is for {several}; --for {program} has no use for it")
    if request.images is not None and not request.with_images:
        raise UsageError(f"--images is for {several}, and mcap --with-images; --for {program} reads no images")


def _members(data: RunData, agent: int | None) -> list[int]:
    if agent is None:
        return [one.index for one in data.agents]
    if not 0 <= agent < len(data.agents):
        last = len(data.agents) - 1
        raise UsageError(f"--agent {agent}: {data.folder} has the {counted(last + 1, 'agent')} 0 to {last}")
    return [agent]


def _check_out(out: Path, run: Path, source: Path, request: ExportRequest) -> None:
    place = out.resolve()
    for other, what in ((run, "the run itself"), (source, "the folder of the images")):
        if place == other.resolve() or place in other.resolve().parents:
            raise ToolError(f"{out}: is {what}, or holds it; choose another folder for the export")
    if not out.exists():
        return
    if not out.is_dir():
        raise ToolError(f"{out}: is a file, not a folder")
    if not any(out.iterdir()):
        return
    if not (out / RECORD).is_file():
        raise ToolError(f"{out}: holds other files; choose a new folder")
    if not request.overwrite:
        raise EarlierResultError(f"{out}: holds an earlier export; --overwrite replaces it")
