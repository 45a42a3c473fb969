"""``maslam render``: synthetic images, depth and ground truth of several agents, in the layout of
``docs/architecture.md``."""

from __future__ import annotations

import json
import logging
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from maslam._atomic import write_atomically
from maslam._bounded import Unreadable, load_json, read_text
from maslam._kernels import make_ready
from maslam.frontend.cameras.models import PinholeCamera, RigKind
from maslam.frontend.files.trajectory import write_kitti_poses

from ..common.digests import digest_of
from ..common.parallel import core_count, each_finished
from ..common.writing import writing
from .config import RenderConfig
from .errors import RenderError
from .rendering.kernels import RENDERING_KERNELS
from .rendering.light import Light
from .rendering.renderer import Renderer, View, load_open3d
from .rendering.sensor import DEPTH_UNIT_M, depth_map, develop
from .scenario import AgentPlan, Scenario, plan_scenario

log = logging.getLogger(__name__)
VERSION = 2
"""Of the layout and the pictures: another version's pictures are not mixed with these."""
RenderProgress = Callable[[int, int], None]
_WORTH_A_PROCESS = 30  # pictures: a further process takes some seconds to start


def render_dataset(
    config: RenderConfig,
    out: Path,
    progress: RenderProgress | None = None,
    workers: int | None = None,
    compiling: RenderProgress = lambda done, total: None,
) -> None:
    """Write the pictures of ``config`` under ``out``; ``progress(done, total)`` counts pictures, ``compiling`` kernels
    where some must be compiled.

    ``world.json`` is written last and marks the folder as complete: a folder that was finished with the same settings
    is left as it is, one that was interrupted is gone on with. Raises RenderError where ``out`` holds anything else,
    and where the path cannot be driven.
    """
    settings = {"version": VERSION, **config.model_dump(mode="json")}
    if config.poses_file is not None:
        settings["poses_file"] = config.poses_file.name
        if config.poses_file.is_file():  # the path itself: another one may have the same name
            settings["poses_sha256"] = digest_of([config.poses_file], config.poses_file.parent)
    if _finished(out, settings):
        log.info("%s: rendered already with these settings", out)
        return
    load_open3d()
    scenario = plan_scenario(config)  # a path that cannot be driven leaves nothing behind
    with writing(out):
        _mark_begun(out, settings)
        _write_all(scenario, config, out, settings, progress, workers, compiling)


def _write_all(
    scenario: Scenario,
    config: RenderConfig,
    out: Path,
    settings: dict[str, object],
    progress: RenderProgress | None,
    workers: int | None,
    compiling: RenderProgress,
) -> None:
    camera = config.camera()
    for k, plan in enumerate(scenario.agents):
        _write_agent(out / f"agent_{k:02d}", plan, config, camera)
    jobs = [
        _Job(out / f"agent_{k:02d}", k, f, right)
        for k, plan in enumerate(scenario.agents)
        for f in range(len(plan.poses))
        for right in ([False, True] if config.rig is RigKind.STEREO else [False])
    ]
    make_ready(RENDERING_KERNELS, compiling)
    _render_all(jobs, scenario, config, camera, progress, workers)
    described = {**settings, "lights": [plan.light.to_dict() for plan in scenario.agents]}
    write_atomically(out / "world.json", json.dumps(described, indent=2) + "\n")
    (out / "unfinished.json").unlink()


@dataclass(frozen=True)
class _Job:
    folder: Path
    agent: int
    frame: int
    right: bool

    def image(self) -> Path:
        return self.folder / ("image_1" if self.right else "image_0") / f"{self.frame:06d}.png"

    def depth(self) -> Path:
        return self.folder / "depth_0" / f"{self.frame:06d}.png"


def _finished(out: Path, settings: dict[str, object]) -> bool:
    """Whether ``out`` is complete; ``RenderError`` where it holds anything but this rendering, or a part of it."""
    done, begun = out / "world.json", out / "unfinished.json"
    if done.exists():
        found = _read_settings(done)
        found.pop("lights", None)
        if "poses_sha256" not in found:  # of an earlier version
            settings = {name: value for name, value in settings.items() if name != "poses_sha256"}
        if found != settings:
            changed = sorted(k for k in {*found, *settings} if found.get(k) != settings.get(k))
            raise RenderError(f"{out}: holds other settings ({', '.join(changed)}); delete it or choose another folder")
        return True
    if begun.exists():
        if _read_settings(begun) != settings:
            raise RenderError(
                f"{out}: holds an unfinished rendering with other settings; choose another folder or delete it"
            )
        return False
    if out.exists() and (not out.is_dir() or any(out.iterdir())):
        raise RenderError(f"{out}: exists and is not a rendering; choose an empty or new folder")
    return False


def _read_settings(path: Path) -> dict[str, object]:
    """None of any rendering's where the file is damaged."""
    try:
        found = load_json(read_text(path))
    except Unreadable:
        return {}
    return found if isinstance(found, dict) else {}


def _mark_begun(out: Path, settings: dict[str, object]) -> None:
    out.mkdir(parents=True, exist_ok=True)
    write_atomically(out / "unfinished.json", json.dumps(settings, indent=2) + "\n")


def _write_agent(folder: Path, plan: AgentPlan, config: RenderConfig, camera: PinholeCamera) -> None:
    for name in {
        RigKind.MONO: ["image_0"],
        RigKind.STEREO: ["image_0", "image_1"],
        RigKind.RGBD: ["image_0", "depth_0"],
    }[config.rig]:
        (folder / name).mkdir(parents=True, exist_ok=True)
    lines = [f"width: {camera.width}", f"height: {camera.height}"]
    lines += [f"{name}: {getattr(camera, name)!r}" for name in ("fx", "fy", "cx", "cy")]
    if config.rig is RigKind.STEREO:
        lines.append(f"baseline_m: {config.baseline()!r}")
    if config.rig is RigKind.RGBD:
        lines.append(f"depth_unit_m: {DEPTH_UNIT_M!r}")
    write_atomically(folder / "camera.yaml", "\n".join([*lines, f"rate_hz: {config.rate_hz!r}"]) + "\n")
    write_atomically(folder / "times.txt", "".join(f"{k / config.rate_hz:.6f}\n" for k in range(len(plan.poses))))
    write_kitti_poses(folder / "poses.txt", plan.poses)


def _render_all(
    jobs: list[_Job],
    scenario: Scenario,
    config: RenderConfig,
    camera: PinholeCamera,
    progress: RenderProgress | None,
    workers: int | None,
) -> None:
    """All jobs whose files are missing. Processes, not threads: ray casting holds Python's lock."""
    todo = [j for j in jobs if not j.image().exists() or (config.rig is RigKind.RGBD and not j.depth().exists())]
    done = len(jobs) - len(todo)
    if progress is not None:
        progress(done, len(jobs))
    if not todo:
        return
    if workers is None:
        workers = max(1, min(core_count(), len(todo) // _WORTH_A_PROCESS))
    for _ in each_finished(_JobRenderer(scenario, config, camera), todo, workers):
        done += 1
        if progress is not None:
            progress(done, len(jobs))


class _JobRenderer:
    """Draws jobs; travels to a worker as settings and world, and prepares its renderer there once."""

    def __init__(self, scenario: Scenario, config: RenderConfig, camera: PinholeCamera) -> None:
        self.scenario, self.config, self.camera = scenario, config, camera
        self.renderer: Renderer | None = None

    def __call__(self, job: _Job) -> None:
        if self.renderer is None:
            self.renderer = Renderer(self.scenario.world)
        _render_one(job, self.renderer, self.scenario, self.config, self.camera)


def _render_one(job: _Job, renderer: Renderer, scenario: Scenario, config: RenderConfig, camera: PinholeCamera) -> None:
    plan = scenario.agents[job.agent]
    pose = plan.poses[job.frame]
    if job.right:
        pose = pose.copy()
        pose[:3, 3] += config.baseline() * pose[:3, 0]
    view: View = renderer.render(pose, camera, plan.light, scenario.moving(job.frame))
    rng = np.random.default_rng([config.seed, 7, job.agent, job.frame, int(job.right)])
    exposure = exposure_of(plan.light, plan.exposures[job.frame])
    image = develop(view.radiance, config.sensor, exposure, rng)
    _write_png(job.image(), image[:, :, ::-1])
    if config.rig is RigKind.RGBD:
        _write_png(job.depth(), depth_map(view.depth_m, config.sensor, rng))


def exposure_of(light: Light, drift: float) -> float:
    """Exposure that a meter would choose in this light, times the agent's own bias and the drift of this frame."""
    return light.metered() * light.exposure * drift


def _write_png(path: Path, image: NDArray) -> None:
    import cv2

    # Noise repeats nothing: entropy coding of differences along the row is as small as a search, at half its cost.
    how = [cv2.IMWRITE_PNG_COMPRESSION, 1, cv2.IMWRITE_PNG_STRATEGY, cv2.IMWRITE_PNG_STRATEGY_RLE]
    how += [cv2.IMWRITE_PNG_FILTER, cv2.IMWRITE_PNG_FILTER_SUB]
    _, encoded = cv2.imencode(".png", image, how)
    write_atomically(path, encoded.tobytes())
