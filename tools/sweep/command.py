"""``maslam sweep``: an experiment from images to tables and figures; taken up again where it was interrupted."""

from __future__ import annotations

import argparse
import csv
import json
import os
from pathlib import Path
from typing import TYPE_CHECKING, Any

from maslam._atomic import replacing, write_atomically

from ..common.earlier_settings import modernised
from ..common.errors import ToolError
from ..common.options import add_model_options, build, read_settings
from ..common.parser import add_ray, at_least_one
from ..common.progress import Progress, progress_on
from ..common.writing import writing

if TYPE_CHECKING:
    from .execute import Workshop
    from .plan import SweepPlan
    from .rows import Row

PLAN = "plan.yaml"  # in OUT
SETTINGS = "settings"  # in a plan: those of its runs


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """``OUT``, the plan, where things come from."""
    from .plan import SweepPlan

    parser.add_argument("out", metavar="OUT", type=Path, help="folder for images, sequences, runs, tables and figures")
    parser.add_argument(
        "--experiment",
        metavar="NAME",
        help="a plan to start from: thesis, scaling or quick (default: one run along the path of KITTI 00)",
    )
    parser.add_argument("--plan", type=Path, metavar="FILE", help="YAML with the plan's settings; a sweep's plan.yaml")
    parser.add_argument(
        "--poses",
        type=Path,
        metavar="DIR",
        help="KITTI pose files to render images along (default: $MASLAM_DATA/kitti_poses)",
    )
    parser.add_argument("--kitti", type=Path, metavar="DIR", help="your own KITTI images instead of rendered ones")
    parser.add_argument("--no-reference", action="store_true", help="without the omniscient reference")
    parser.add_argument(
        "--workers", type=at_least_one, default=0, metavar="N", help="processes (default: one per core)"
    )
    add_ray(parser, "runs and the front end")
    parser.add_argument("--json", action="store_true", help="print the rows as one JSON list")
    parser.add_argument("--quiet", action="store_true", help="no progress")
    add_model_options(parser, SweepPlan())


def main(arguments: argparse.Namespace) -> None:
    """The command."""
    from maslam.mas.policies.presets import preset

    from .execute import Workshop
    from .plan import SweepPlan, experiment

    base = experiment(arguments.experiment) if arguments.experiment else SweepPlan()
    plan = build(base, arguments, read_plan(arguments.plan), arguments.plan)
    for name in plan.presets:  # a wrong setting is reported now, not after the images are rendered
        build(preset(name), argparse.Namespace(), plan.settings, arguments.plan, SETTINGS)
    data = os.environ.get("MASLAM_DATA")
    poses = arguments.poses or (Path(data) / "kitti_poses" if data else None)
    out = arguments.out if arguments.ray is None else arguments.out.resolve()  # another machine begins elsewhere
    workshop = Workshop(out, poses, arguments.kitti, arguments.workers)
    with progress_on(quiet=arguments.quiet) as progress:
        rows, page = sweep(plan, workshop, progress, not arguments.no_reference, arguments.ray)
    if arguments.json:
        from .rows import as_record

        print(json.dumps([as_record(row) for row in rows], indent=1))
    else:
        print(page.read_text(encoding="utf-8"))
        print(page)


def read_plan(path: Path | None) -> dict[str, Any]:
    """The plan in a YAML file; none without a file."""
    content = read_settings(path)
    settings = content.get(SETTINGS)
    if path is not None and isinstance(settings, dict):
        content[SETTINGS] = modernised(settings, path)
    return content


def sweep(
    plan: SweepPlan, workshop: Workshop, progress: Progress, with_reference: bool = True, ray: str | None = None
) -> tuple[list[Row], Path]:
    """Everything; returns the rows and the page with the tables."""
    from .execute import check_sources

    _check_free(workshop.out)
    check_sources(plan, workshop)
    with writing(workshop.out):
        _write_plan(workshop.out, plan)
        return _swept(plan, workshop, progress, with_reference, ray)


def _swept(
    plan: SweepPlan, workshop: Workshop, progress: Progress, with_reference: bool, ray: str | None
) -> tuple[list[Row], Path]:
    from .execute import execute, prepare, references
    from .pictures import draw_all
    from .rows import grouped, row_of
    from .tables import report

    prepare(plan, workshop, progress, ray)
    known: dict[str, dict[str, Any]] = references(plan, workshop, progress) if with_reference else {}
    figures = execute(plan, workshop, progress, ray)
    rows = [row_of(cell, each, known.get(cell.material)) for cell, each in figures.items()]
    groups = grouped(rows)
    _write_rows(workshop.out, rows)
    page = workshop.out / "tables.md"
    write_atomically(page, report(groups))
    first = min(plan.seeds)
    runs = {(c.sequence, c.agents, c.preset): workshop.run(c) for c in figures if c.seed == first}
    for path in draw_all(groups, runs, workshop.out / "figures"):
        progress.say(f"wrote {path}")
    return rows, page


def _check_free(out: Path) -> None:
    """Refuse a folder that holds something else."""
    if out.exists() and not out.is_dir():
        raise ToolError(f"{out}: is a file, not a folder")
    if out.exists() and not (out / PLAN).is_file() and any(out.iterdir()):
        raise ToolError(f"{out}: exists and is no sweep; choose an empty or new folder")


def _write_plan(out: Path, plan: SweepPlan) -> None:
    import yaml

    write_atomically(out / PLAN, yaml.safe_dump(plan.model_dump(mode="json"), sort_keys=False))


def _write_rows(out: Path, rows: list[Row]) -> None:
    from .rows import as_record, columns

    write_atomically(out / "results.json", json.dumps([as_record(row) for row in rows], indent=1) + "\n")
    with replacing(out / "results.csv") as part, open(part, "w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, columns())
        writer.writeheader()
        writer.writerows(as_record(row) for row in rows)
