"""Graphs from files and folders, and results to them: a file appears only when it is whole."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

from maslam._atomic import write_atomically

from ..common.changed_settings import refuse_changed
from ..common.errors import ToolError, UsageError
from ..common.writing import writing
from .report import PgoReport

if TYPE_CHECKING:
    from maslam.backend.pose_graph.graph import NodeId, PoseGraph

SUMMARY = "summary.json"
UNITS = "units.csv"
_OURS = re.compile(r"(\d+|[a-zA-Z]{2})\.g2o")


def expand(paths: Sequence[Path]) -> list[Path]:
    """Files as given; a folder stands for its g2o files, by number. :class:`ToolError` for a folder without any."""
    out: list[Path] = []
    for path in paths:
        if path.is_dir():
            inside = [*path.glob("*.g2o"), *path.glob("*.g2o.gz")]
            inside.sort(key=lambda p: (len(p.name.partition(".g2o")[0]), p.name))
            if not inside:
                raise ToolError(f"{path}: no .g2o file in this folder")
            out += inside
        else:
            out.append(path)
    return out


def check_free(out: Path, inputs: Sequence[Path], settings: Mapping[str, Any], overwrite: bool) -> None:
    """UsageError where ``write`` would replace graphs that are not its own earlier results, or those of other files;
    :class:`EarlierResultError` where they are of other ``settings``.

    A result is known by the report beside it, which a single file does not have. Where OUT was left out on the command
    line, the last robot's file stands in its place: a file that is named like those that are read is never replaced.
    """
    single = out.suffix == ".g2o"
    if out.suffix == ".gz":
        raise UsageError(f"{out}: OUT is written without compression: name a .g2o file, or a folder")
    if not single and out.is_file():
        raise UsageError(f"{out}: OUT is a .g2o file, or a folder")
    there = out.exists() if single else out.is_dir() and any(out.glob("*.g2o"))
    like_inputs = {(path.parent.resolve(), _without_number(path) if single else "") for path in inputs}
    if there and ((out.parent if single else out).resolve(), _without_number(out) if single else "") in like_inputs:
        raise UsageError(f"{out}: is among the graphs that are read; the last path is OUT, and must be another")
    if there and not overwrite:
        earlier = None if single else _report(out)
        if earlier is None:
            raise UsageError(f"{out}: is there already; name another OUT, or replace it with --overwrite")
        files = earlier.get("files")
        if isinstance(files, list) and files and files != names_of(inputs):
            raise UsageError(f"{out}: holds a result of {files[0]}; name another OUT, or replace it with --overwrite")
        made_with = earlier.get("settings")
        refuse_changed(out, "a result", made_with if isinstance(made_with, dict) else {}, settings)


def names_of(inputs: Sequence[Path]) -> list[str]:
    """The files that are read, as the report names them."""
    return [str(path.resolve()) for path in inputs]


def _report(out: Path) -> dict[str, Any] | None:
    """The report of an earlier result in ``out``; None where there is none."""
    try:
        summary = json.loads((out / SUMMARY).read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError):
        return None
    return summary if isinstance(summary, dict) else None


def _without_number(path: Path) -> str:
    return re.sub(r"\d+", "#", path.stem)


def write(out: Path, graph: PoseGraph, report: PgoReport, units: Mapping[NodeId, float]) -> None:
    """One file, or a folder with one file per robot, the report, and the ``units`` of poses where they were found."""
    from maslam.backend.pose_graph.g2o import write_g2o

    alone = len(graph.robots) == 1
    if out.suffix == ".g2o":
        out.parent.mkdir(parents=True, exist_ok=True)
        write_g2o(out, graph, plain_ids=alone and not graph.symbols)
        return
    with writing(out):
        _write_folder(out, graph, report, units)


def _write_folder(out: Path, graph: PoseGraph, report: PgoReport, units: Mapping[NodeId, float]) -> None:
    """The summary is written last; files of robots that an earlier result had and this one lacks are removed."""
    from maslam.backend.pose_graph.g2o import write_g2o
    from maslam.backend.pose_graph.node import robot_name

    alone = len(graph.robots) == 1
    parts = {out / f"{robot_name(r)}.g2o": graph if alone else graph.of_robot(r) for r in graph.robots}
    if (out / SUMMARY).exists():
        for path in out.glob("*.g2o"):
            if path not in parts and _OURS.fullmatch(path.name):
                path.unlink()
    for path, part in parts.items():
        write_g2o(path, part, plain_ids=alone and not graph.symbols)
    if units:
        rows = "".join(f"{robot_name(n.robot)},{n.index},{unit:.12g}\n" for n, unit in sorted(units.items()))
        write_atomically(out / UNITS, "robot,index,unit\n" + rows)
    else:
        (out / UNITS).unlink(missing_ok=True)
    write_atomically(out / SUMMARY, json.dumps(asdict(report), indent=2) + "\n")
