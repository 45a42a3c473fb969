"""The stages of a sweep: images, agent sequences, the omniscient reference, runs. Each is kept and taken again."""

from __future__ import annotations

import json
import logging
import shutil
from argparse import Namespace
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from maslam._atomic import write_atomically

from ..common.digests import code_digest, sequences_digest
from ..common.errors import ToolError
from ..common.progress import Progress, counter
from ..report.summary_table import SUMMARY, read_summary, read_timing
from .plan import TOWN, Cell, SweepPlan
from .rows import Figures

log = logging.getLogger(__name__)
STAMP = "cell.json"
"""In the folder of a run: what it was made from and how."""


@dataclass(frozen=True)
class Workshop:
    """Folders of a sweep under ``out``; ``poses``: KITTI pose files; ``kitti``: the user's own KITTI images, in their
    place (``sequences/NN`` or ``NN`` under it). A sweep of the town needs neither."""

    out: Path
    poses: Path | None
    kitti: Path | None = None
    workers: int = 0

    def images(self, cell: Cell) -> Path:
        """Folder of a cell's images."""
        if cell.sequence != TOWN and self.kitti is not None:
            found = [p for p in (self.kitti / "sequences" / cell.sequence, self.kitti / cell.sequence) if p.is_dir()]
            if not found:
                raise ToolError(f"{self.kitti}: no sequence {cell.sequence} (sequences/{cell.sequence}) in it")
            return found[0]
        return self.out / "images" / (cell.material if cell.sequence == TOWN else cell.sequence)

    def pose_file(self, cell: Cell) -> Path:
        """The KITTI pose file along which a cell's images are rendered."""
        if self.poses is None:
            raise ToolError(
                f"sequence {cell.sequence}: --poses names the folder of KITTI pose files to render along, "
                "--kitti that of your own KITTI images"
            )
        path = self.poses / f"{cell.sequence}.txt"
        if not path.is_file():
            raise ToolError(f"{path}: no such pose file; --poses names the folder of KITTI pose files")
        return path

    def sequences(self, cell: Cell) -> Path:
        """Folder of a cell's agent sequences."""
        return self.out / "sequences" / cell.material

    def run(self, cell: Cell) -> Path:
        """Folder of a cell's results."""
        return self.out / "runs" / cell.name


def check_sources(plan: SweepPlan, workshop: Workshop) -> None:
    """Refuse a plan whose images or pose files are missing."""
    for cell in plan.cells():
        if cell.sequence != TOWN:
            _ = workshop.images(cell) if workshop.kitti is not None else workshop.pose_file(cell)


def prepare(plan: SweepPlan, workshop: Workshop, progress: Progress, ray: str | None = None) -> None:
    """Images and agent sequences of all cells; the front end runs once for each sequence, however it is cut."""
    from maslam.frontend.config import OdometryConfig

    from ..common.compiling import COMPILING
    from ..pipeline.preprocess import preprocess
    from ..pipeline.preprocess_options import PreprocessSettings
    from ..pipeline.sequences_folder import FRONTEND
    from ..worlds.dataset import render_dataset

    for cell in _materials(plan):
        images = workshop.images(cell)
        if workshop.kitti is None or cell.sequence == TOWN:
            config = _rendering(plan, workshop, cell)
            count = counter(progress, f"rendering {images.name}")
            render_dataset(config, images, count, workshop.workers or None, counter(progress, COMPILING))
        split = None if cell.sequence == TOWN else cell.agents
        store = workshop.out / FRONTEND / images.name
        settings = PreprocessSettings(
            OdometryConfig(),
            agents=split,
            overlap=plan.overlap,
            workers=workshop.workers,
            store=store,
            overwrite=True,
            ray=ray,
        )
        preprocess(images, workshop.sequences(cell), settings, progress)


def references(plan: SweepPlan, workshop: Workshop, progress: Progress) -> dict[str, dict[str, Any]]:
    """The omniscient reference of each material, as records."""
    from dataclasses import asdict

    from .reference import reference_of

    return {
        cell.material: asdict(reference_of(workshop.sequences(cell), counter(progress, f"reference {cell.material}")))
        for cell in _materials(plan)
    }


def execute(plan: SweepPlan, workshop: Workshop, progress: Progress, ray: str | None = None) -> dict[Cell, Figures]:
    """Run every cell that has not been run with these settings; returns the figures of all.

    A run that fails does not stop the others; the first failure is raised at the end.
    """
    jobs = {
        cell.name: (SweepJob(workshop.sequences(cell), workshop.run(cell), cell, plan.settings), 100)
        for cell in plan.cells()
    }
    todo = {name: job for name, job in jobs.items() if not job[0].done()}
    log.info("%d of %d runs to do", len(todo), len(jobs))
    if ray is not None:
        from ..common.cluster import run_on_cluster

        outcomes = run_on_cluster(run_cell, todo, ray, progress)
    else:
        from maslam.mas.kernels import agent_kernels

        from ..common.compiling import compile_for
        from ..common.parallel import core_count, run_jobs

        compile_for(agent_kernels(max((job.cell.agents for job, _ in todo.values()), default=0)), progress)
        outcomes = run_jobs(run_cell, todo, workshop.workers or core_count(), progress)
    errors = {name: outcome.error for name, outcome in outcomes.items() if outcome.error is not None}
    for name, error in errors.items():
        progress.say(f"{name}: {error}")
    if errors:
        raise ToolError(f"{len(errors)} of {len(jobs)} runs failed; the same command tries them again")
    return {job.cell: Figures(read_summary(job.out), read_timing(job.out)) for job, _ in jobs.values()}


@dataclass(frozen=True)
class SweepJob:
    """One run, for a worker."""

    sequences: Path
    out: Path
    cell: Cell
    settings: dict[str, Any]

    def stamp(self) -> dict[str, Any]:
        """Fingerprint of code, sequence and settings; the run is repeated where it differs."""
        return {
            "sequences": sequences_digest(self.sequences),
            "code": code_digest("mas", "backend", "descriptors"),
            "settings": self.settings,
        }

    def done(self) -> bool:
        """Whether the run is there, made from the same."""
        stamp = self.out / STAMP
        return (
            (self.out / SUMMARY).is_file()
            and stamp.is_file()
            and json.loads(stamp.read_text(encoding="utf-8")) == self.stamp()
        )


def run_cell(job: SweepJob, advance: Callable[[int], None]) -> None:
    """Do it, in whatever process."""
    from maslam.mas.policies.presets import preset
    from maslam.mas.sequence import load_sequences
    from maslam.mas.simulation import run

    from ..common.options import build

    config = build(preset(job.cell.preset), Namespace(), {**job.settings, "seed": job.cell.seed})
    manifest, sequences = load_sequences(job.sequences)
    (job.out / STAMP).unlink(missing_ok=True)
    run(manifest, sequences, config, job.out, lambda done, total: advance(100 * done // max(total, 1)))
    _without_maps(job.out)
    write_atomically(job.out / STAMP, json.dumps(job.stamp()) + "\n")


def _without_maps(run: Path) -> None:
    """Figures and trajectories are kept, point clouds are not: in the thesis's form those of 20 agents take a gigabyte
    a run."""
    for agent in run.glob("agent_*"):
        (agent / "map.ply").unlink(missing_ok=True)
        shutil.rmtree(agent / "maps", ignore_errors=True)


def _materials(plan: SweepPlan) -> list[Cell]:
    """One cell for each material."""
    return list({cell.material: cell for cell in plan.cells()}.values())


def _rendering(plan: SweepPlan, workshop: Workshop, cell: Cell) -> Any:
    from ..worlds.config import RenderConfig

    size = {"width": plan.width, "height": plan.height, "seed": plan.world_seed}
    if cell.sequence == TOWN:
        return RenderConfig(world="town", agents=cell.agents, frames=plan.frames or 300, **size)
    poses = workshop.pose_file(cell)
    frames = plan.frames or 1_000_000
    return RenderConfig(
        world="town", agents=1, frames=frames, poses_file=poses, poses_step=plan.step, rate_hz=10.0 / plan.step, **size
    )
