"""Places for measuring RelPose: rendered stereo pairs of one spot under two lights, and of its look-alikes elsewhere.

Ground truth is exact: poses are known, and how much two views share follows from their depth.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field

from maslam._atomic import write_npz
from maslam.backend.geometry import Array, se3, se3_inverse, so3_exp
from maslam.frontend.cameras.models import PinholeCamera, Rig, RigKind

from ...place_benchmarks.rendered import INDOORS, STREETS, SamplerConfig, build_world, standpoint

if TYPE_CHECKING:
    from ...worlds.indoor.floor import Door
    from ...worlds.rendering.light import Light
    from ...worlds.rendering.renderer import Renderer
    from ...worlds.scene.world import World

_CACHE_VERSION = 1
_SUBSAMPLED = 4  # pixels between two depths that are kept
_EVERY = 5  # of those depths is a point to test
# Something is hidden where it lies this share of the depth, plus this much, behind what the camera sees there.
_HIDDEN_SHARE, _HIDDEN_M = 0.1, 0.1


class RelPosePlacesConfig(BaseModel):
    """Settings for drawing and visiting places. Lengths in metres, angles in degrees."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    width: int = Field(480, ge=64)  # pixels
    height: int = Field(360, ge=64)
    fov_deg: float = Field(80.0, gt=20, lt=140)  # horizontal
    places: int = Field(100, gt=0)  # each visited twice
    twins: int = Field(0, ge=0)  # of these, the first ones, also have their look-alike at another door, indoors
    turn_deg: float = Field(35.0, ge=0)  # between the visits, in either direction
    min_overlap: float = Field(0.2, ge=0, le=1)  # of the visits


@dataclass(frozen=True)
class StereoVisit:
    """One view: ``left``, ``right`` ``(h, w)`` uint8; ``depth_m`` ``(h / 4, w / 4)`` of every fourth pixel, 0 = sky;
    ``place``: visits of one place share it, a look-alike has none (-1)."""

    left: NDArray[np.uint8]
    right: NDArray[np.uint8]
    depth_m: NDArray[np.float32]
    T_W_C: Array
    place: int
    rig: Rig

    def points_W(self) -> Array:
        """Surface points that it sees, ``(n, 3)``."""
        camera, (h, w) = self.rig.camera, self.depth_m.shape
        v, u = np.mgrid[:h, :w] * _SUBSAMPLED
        z = self.depth_m.astype(np.float64)
        local = np.stack([(u - camera.cx) / camera.fx * z, (v - camera.cy) / camera.fy * z, z], axis=-1)
        return np.asarray(local[z > 0] @ self.T_W_C[:3, :3].T + self.T_W_C[:3, 3])


def shared_view(first: StereoVisit, second: StereoVisit) -> float:
    """Share of the surface in view that the other sees as well, not hidden: the smaller one of both directions."""
    return min(seen_share(first, second), seen_share(second, first))


def seen_share(source: StereoVisit, target: StereoVisit) -> float:
    """Share of the surface that ``source`` sees which ``target`` sees as well."""
    points = source.points_W()[::_EVERY]
    if not len(points):
        return 0.0
    local = (points - target.T_W_C[:3, 3]) @ target.T_W_C[:3, :3]
    camera, z = target.rig.camera, np.maximum(local[:, 2], 1e-6)
    column = np.rint((camera.fx * local[:, 0] / z + camera.cx) / _SUBSAMPLED)
    row = np.rint((camera.fy * local[:, 1] / z + camera.cy) / _SUBSAMPLED)
    h, w = target.depth_m.shape
    inside = (local[:, 2] > 0.1) & (row >= 0) & (column >= 0) & (row < h) & (column < w)
    there = target.depth_m[row[inside].astype(int), column[inside].astype(int)]
    seen = z[inside] <= (1.0 + _HIDDEN_SHARE) * np.where(there > 0, there, np.inf) + _HIDDEN_M
    return float(seen.sum() / len(points))


def angle_between_deg(first: StereoVisit, second: StereoVisit) -> float:
    """Between the two directions of view."""
    cosine = float(first.T_W_C[:3, 2] @ second.T_W_C[:3, 2])
    return float(np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0))))


def rendered_visits(
    kind: Literal["town", "indoor"],
    seed: int,
    config: RelPosePlacesConfig,
    cache: Path | None,
    tick: Callable[[], None] = lambda: None,
) -> list[StereoVisit]:
    """The visits of one world, taken from ``cache`` (a folder) where they were rendered before with the same
    settings. ``tick`` is called once a place."""
    path = None
    if cache is not None:
        digest = hashlib.sha256(f"{_CACHE_VERSION} {config.model_dump_json()}".encode()).hexdigest()[:12]
        path = cache / f"relpose_{kind}_{seed}_{digest}.npz"
        if path.is_file():
            return _load(path)
    made = _visit(kind, seed, config, tick)
    if path is not None:
        path.parent.mkdir(parents=True, exist_ok=True)
        _save(path, made)
    return made


def _visit(
    kind: Literal["town", "indoor"], seed: int, config: RelPosePlacesConfig, tick: Callable[[], None]
) -> list[StereoVisit]:
    from ...worlds.rendering.light import random_light
    from ...worlds.rendering.renderer import Renderer

    rng = np.random.default_rng([seed, 91])
    world, sampler = build_world(kind, seed), STREETS if kind == "town" else INDOORS
    doors = _doors(kind, seed)
    draw = _PairRenderer(Renderer(world), _rig(kind, config), rng, sampler.indoors)
    out: list[StereoVisit] = []
    place = 0
    while place < config.places:
        base = standpoint(world, sampler, rng)
        first = draw(base, random_light(rng, 1.0, sampler.indoors), place)
        if _dull(first, sampler):
            continue
        second = _revisit(first, world, sampler, config, draw, rng)
        if second is None:
            continue
        out += [first, second]
        if doors and place < config.twins:
            twin = _twin(base, world, doors, sampler, rng)
            if twin is not None:
                out.append(draw(twin, random_light(rng, 1.0, True), -1))
        place += 1
        tick()
    return out


def _revisit(
    first: StereoVisit,
    world: World,
    sampler: SamplerConfig,
    config: RelPosePlacesConfig,
    draw: _PairRenderer,
    rng: np.random.Generator,
) -> StereoVisit | None:
    """Another view that shares enough with the first, under another light; None where some draws found none."""
    from ...worlds.rendering.light import random_light

    base = first.T_W_C
    for _ in range(6):
        offset = rng.uniform(-1, 1, 2) * (1.5 * sampler.aside_m, 1.5 * sampler.along_m)
        at = base[:3, 3] + offset[1] * base[:3, 2] + offset[0] * base[:3, 0]
        if world.free.at(np.array([[at[0], at[2]]]))[0] < 0.5 * sampler.clearance_m:
            continue
        turn = [rng.normal(0, np.radians(1.5)), np.radians(rng.uniform(-1, 1) * config.turn_deg), 0.0]
        roll = [0.0, 0.0, rng.normal(0, np.radians(1.0))]
        at[1] *= float(rng.uniform(0.9, 1.1))
        pose = se3(base[:3, :3] @ so3_exp(turn) @ so3_exp(roll), at)
        visit = draw(pose, random_light(rng, 1.0, sampler.indoors), first.place)
        if shared_view(first, visit) >= config.min_overlap:
            return visit
    return None


def _doors(kind: str, seed: int) -> Sequence[Door]:
    if kind == "town":
        return ()
    from ...worlds.indoor.floor import build_indoor

    return build_indoor(seed)[1].doors


def _twin(
    pose: Array, world: World, doors: Sequence[Door], sampler: SamplerConfig, rng: np.random.Generator
) -> Array | None:
    """The same pose, but seen from another door as this one is from its nearest: what looks most alike."""
    here = min(range(len(doors)), key=lambda k: float(np.hypot(*(doors[k].at - pose[[0, 2], 3]))))
    for k in rng.permutation(len(doors)):
        moved = _door_frame(doors[k]) @ se3_inverse(_door_frame(doors[here])) @ pose
        if k != here and world.free.at(moved[None, [0, 2], 3])[0] >= 0.5 * sampler.clearance_m:
            return moved
    return None


def _door_frame(door: Door) -> Array:
    """``T_W_D`` of a door: +Z into its room."""
    yaw = float(np.arctan2(door.into[0], door.into[1]))
    return se3(so3_exp([0.0, yaw, 0.0]), [door.at[0], 0.0, door.at[1]])


def _rig(kind: str, config: RelPosePlacesConfig) -> Rig:
    focal = 0.5 * config.width / np.tan(np.radians(config.fov_deg) / 2)
    camera = PinholeCamera(config.width, config.height, focal, focal, (config.width - 1) / 2, (config.height - 1) / 2)
    return Rig(RigKind.STEREO, camera, 0.54 if kind == "town" else 0.12)


class _PairRenderer:
    """Stereo pairs as a real camera would store them."""

    def __init__(self, renderer: Renderer, rig: Rig, rng: np.random.Generator, indoors: bool) -> None:
        self.renderer, self.rig, self.rng, self.indoors = renderer, rig, rng, indoors

    def __call__(self, pose: Array, light: Light, place: int) -> StereoVisit:
        from ...worlds.dataset import exposure_of
        from ...worlds.rendering.sensor import SensorConfig, develop

        exposure = exposure_of(light, float(np.exp(self.rng.normal(0.0, 0.1))))
        aside = pose.copy()
        aside[:3, 3] += (self.rig.baseline_m or 0.0) * pose[:3, 0]
        images = []
        for T_W_C in (aside, pose):
            view = self.renderer.render(T_W_C, self.rig.camera, light)
            rgb = develop(view.radiance, SensorConfig(), exposure, self.rng)
            images.append(np.rint(rgb @ np.array([0.299, 0.587, 0.114])).astype(np.uint8))
        depth = view.depth_m[::_SUBSAMPLED, ::_SUBSAMPLED].astype(np.float32)
        return StereoVisit(images[1], images[0], depth, pose, place, self.rig)


def _dull(visit: StereoVisit, sampler: SamplerConfig) -> bool:
    """Whether a view is filled by something close in front of the camera, or by the sky."""
    known = visit.depth_m[visit.depth_m > 0]
    return len(known) < 0.2 * visit.depth_m.size or bool(np.median(known) < (0.8 if sampler.indoors else 2.5))


def _save(path: Path, visits: list[StereoVisit]) -> None:
    """Written whole or not at all."""
    camera, baseline = visits[0].rig.camera, visits[0].rig.baseline_m
    stacks = {"left": "left", "right": "right", "depth": "depth_m", "poses": "T_W_C", "places": "place"}
    arrays = {name: np.stack([getattr(v, field) for v in visits]) for name, field in stacks.items()}
    write_npz(path, {**arrays, "focal": camera.fx, "baseline": float(baseline or 0)})


def _load(path: Path) -> list[StereoVisit]:
    with np.load(path, allow_pickle=False) as file:
        data = {key: file[key] for key in file.files}
    h, w = data["left"].shape[1:]
    focal = float(data["focal"])
    camera = PinholeCamera(w, h, focal, focal, (w - 1) / 2, (h - 1) / 2)
    rig = Rig(RigKind.STEREO, camera, float(data["baseline"]))
    rows = zip(data["left"], data["right"], data["depth"], data["poses"], data["places"], strict=True)
    return [StereoVisit(left, right, depth, pose, int(place), rig) for left, right, depth, pose, place in rows]
