"""Graphs from files and folders, and results to them: a file appears only when it is whole."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING

from maslam._atomic import write_atomically

from ..common.errors import ToolError, UsageError
from .report import PgoReport

if TYPE_CHECKING:
    from maslam.backend.pose_graph.graph import PoseGraph

SUMMARY = "summary.json"


def expand(paths: Sequence[Path]) -> list[Path]:
    """Files as given; a folder stands for its g2o files, by number. :class:`ToolError` for a folder without any."""
    out: list[Path] = []
    for path in paths:
        if path.is_dir():
            inside = sorted(path.glob("*.g2o"), key=lambda p: (len(p.stem), p.stem))
            if not inside:
                raise ToolError(f"{path}: no .g2o file in this folder")
            out += inside
        else:
            out.append(path)
    return out


def check_free(out: Path) -> None:
    """UsageError where ``write`` would replace graphs that are not its own earlier results.

    A result is known by the report beside it, which a single file does not have. Where ``OUT`` was left out on the
    command line, the last robot's file stands in its place.
    """
    kept = out.suffix == ".g2o" and out.exists()
    if out.is_dir() and any(out.glob("*.g2o")) and not (out / SUMMARY).exists():
        kept = True
    if kept:
        raise UsageError(f"{out}: is there already; name another OUT, or replace it with --overwrite")


def write(out: Path, graph: PoseGraph, report: PgoReport) -> None:
    """One file, or a folder with one file per robot and the report."""
    from maslam.backend.pose_graph.g2o import write_g2o

    alone = len(graph.robots) == 1
    if out.suffix == ".g2o":
        out.parent.mkdir(parents=True, exist_ok=True)
        parts = {out: graph}
    else:
        out.mkdir(parents=True, exist_ok=True)
        parts = {out / f"{r}.g2o": graph if alone else graph.of_robot(r) for r in graph.robots}
    for path, part in parts.items():
        write_g2o(path, part, plain_ids=alone)
    if out.suffix != ".g2o":
        write_atomically(out / SUMMARY, json.dumps(asdict(report), indent=2) + "\n")
