"""Rendered worlds as training and test material of the place descriptor: the same places under other light, from
other poses.

Ground truth is exact: which two views show the same place follows from their poses, and how much they share from
their depth.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from dataclasses import astuple, dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field

from maslam._atomic import write_npz
from maslam._replaced import replaced
from maslam.backend.geometry import se3, so3_exp
from maslam.frontend.cameras.models import PinholeCamera

from .public_sets import PlaceBenchmark

if TYPE_CHECKING:
    from ..worlds.rendering.renderer import Renderer
    from ..worlds.scene.world import World

TRAINING_SEEDS = 9_000
"""First seed of the worlds that are trained on; nothing else in the project draws worlds from here on."""
HELD_OUT_SEEDS = 9_500
"""First seed of the worlds that thresholds and choices are made on."""
_CACHE_VERSION = 1
_GRID = (12, 9)
_DIRECTIONS = 24


class SamplerConfig(BaseModel):
    """Settings for visiting places. Outdoors; :data:`INDOORS` is tighter. Angles in degrees, lengths in metres."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    indoors: bool = False
    width: int = Field(216, ge=32)  # pixels
    height: int = Field(162, ge=32)
    places: int = Field(220, gt=0)
    views: int = Field(3, gt=1)
    clearance_m: float = Field(1.2, gt=0)  # free ground around the camera
    open_m: float = Field(12.0, gt=0)  # free space ahead of a camera that looks along the path
    along_m: float = Field(3.0, ge=0)  # how far another visit stands from the first, in either direction
    aside_m: float = Field(1.5, ge=0)
    turn_deg: float = Field(12.0, ge=0)
    height_m: float = Field(1.6, gt=0)
    min_overlap: float = Field(0.4, ge=0, le=1)  # shared points of the two visits of a pair
    conflict_overlap: float = Field(0.08, ge=0, le=1)  # from here on two places count as one
    fov_deg: tuple[float, float] = (60.0, 90.0)  # horizontal
    noise: float = Field(1.5, ge=0)  # grey levels


STREETS = SamplerConfig()
INDOORS = SamplerConfig(
    indoors=True, clearance_m=0.45, open_m=2.5, along_m=0.8, aside_m=0.5, turn_deg=15.0, height_m=1.3, min_overlap=0.35
)


@dataclass(frozen=True)
class Visit:
    """One view: ``image`` ``(h, w)`` uint8, ``T_W_C`` ``(4, 4)``, and points of the surface it sees, ``(g, 3)``
    world, NaN = sky."""

    image: NDArray[np.uint8]
    T_W_C: NDArray[np.float64]
    camera: PinholeCamera
    points_W: NDArray[np.float64]


def build_world(kind: str, seed: int) -> World:
    """A town or an indoor floor, with coarser ground than for driving: thumbnails do not show the difference.
    ``RenderError`` at once where it could not be rendered."""
    from ..worlds.rendering.renderer import load_open3d

    load_open3d()
    if kind == "town":
        from ..worlds.town.town import build_town

        return build_town(seed, ground_texel_m=0.1)[0]
    from ..worlds.indoor.floor import build_indoor

    return build_indoor(seed)[0]


def rendered_places(
    kind: str, seed: int, places: int, cache: Path | None, tick: Callable[[], None] = lambda: None
) -> list[list[Visit]]:
    """The places of one world, taken from ``cache`` (a folder) where they were rendered before with the same
    settings."""
    config = replaced(config_for(kind), places=places)
    path = cache_path(cache, kind, seed, config) if cache else None
    if path is not None and path.is_file():
        return load_places(path)
    made = visit_places(build_world(kind, seed), config, np.random.default_rng([seed, 77]), tick)
    if path is not None:
        path.parent.mkdir(parents=True, exist_ok=True)
        save_places(path, made)
    return made


def cache_path(cache: Path, kind: str, seed: int, config: SamplerConfig) -> Path:
    """File of the places of one world; another setting is another file."""
    digest = hashlib.sha256(f"{_CACHE_VERSION} {kind} {seed} {config.model_dump_json()}".encode()).hexdigest()[:12]
    return cache / f"{kind}_{seed}_{config.places}_{digest}.npz"


def config_for(kind: str) -> SamplerConfig:
    """Settings for visiting places of a kind of world ("town", "indoor")."""
    return STREETS if kind == "town" else INDOORS


def visit_places(
    world: World, config: SamplerConfig, rng: np.random.Generator, tick: Callable[[], None] = lambda: None
) -> list[list[Visit]]:
    """``config.places`` places, each seen ``config.views`` times, every time by another agent: light, exposure,
    pose and noise differ."""
    from ..worlds.rendering.light import random_light
    from ..worlds.rendering.renderer import Renderer

    renderer = Renderer(world)
    places: list[list[Visit]] = []
    while len(places) < config.places:
        base, camera = standpoint(world, config, rng), _camera(config, rng)
        visits = [_render(renderer, base, camera, random_light(rng, 1.0, config.indoors), config, rng)]
        if _dull(visits[0], config):
            continue
        for _ in range(4 * config.views):
            if len(visits) == config.views:
                break
            pose = _another_visit(world, base, config, rng)
            if pose is None:
                continue
            visit = _render(renderer, pose, camera, random_light(rng, 1.0, config.indoors), config, rng)
            if min(overlap([visits[0]], [visit])[0, 0], overlap([visit], [visits[0]])[0, 0]) >= config.min_overlap:
                visits.append(visit)
        if len(visits) == config.views:
            places.append(visits)
            tick()
    return places


def overlap(first: list[Visit], second: list[Visit]) -> NDArray[np.float64]:
    """Share of the points seen by each of ``first`` (n) that each of ``second`` (m) has in its image and in front,
    ``(n, m)``.

    Points hidden behind something else in the second view are counted too where they lie within half again of its
    typical depth: a sparse test that errs towards "they see each other".
    """
    points = np.stack([v.points_W for v in first])
    known = ~np.isnan(points[..., 0])
    flat = np.nan_to_num(points).reshape(-1, 3)
    shares = np.zeros((len(first), len(second)))
    for j, visit in enumerate(second):
        local = (flat - visit.T_W_C[:3, 3]) @ visit.T_W_C[:3, :3]
        camera, z = visit.camera, np.maximum(local[:, 2], 1e-6)
        u, v = camera.fx * local[:, 0] / z + camera.cx, camera.fy * local[:, 1] / z + camera.cy
        inside = (local[:, 2] > 0.1) & (u >= 0) & (u <= camera.width - 1) & (v >= 0) & (v <= camera.height - 1)
        inside &= ~_hidden(visit, u, v, z, inside)
        seen = (inside.reshape(known.shape) & known).sum(axis=1)
        shares[:, j] = seen / np.maximum(known.sum(axis=1), 1)
    return shares


def conflicts(places: list[list[Visit]], config: SamplerConfig) -> NDArray[np.bool_]:
    """Pairs of places ``(P, P)`` whose first visits see some of the same surface."""
    first = [visits[0] for visits in places]
    shares = overlap(first, first)
    return np.asarray(np.maximum(shares, shares.T) >= config.conflict_overlap)


def benchmark(name: str, places: list[list[Visit]], config: SamplerConfig, absent: float = 0.3) -> PlaceBenchmark:
    """Held-out places as queries against references: first visits are references, the others queries.

    Same place: within 5 m (indoors 1.5 m) and 30 degrees. Views further apart that still share surface are
    undecided for thresholds. ``absent``: share of the places, the first ones, that have no reference, as an agent's
    places often have none with another agent.
    """
    kept = places[round(absent * len(places)) :]
    references, queries = [visits[0] for visits in kept], [visit for visits in places for visit in visits[1:]]
    radius = 1.5 if config.indoors else 5.0
    q, r = (np.stack([v.T_W_C for v in side]) for side in (queries, references))
    apart = np.linalg.norm(q[:, None, :3, 3] - r[None, :, :3, 3], axis=2)
    cosine = np.einsum("ik,jk->ij", q[:, :3, 2], r[:, :3, 2])
    truth = (apart <= radius) & (cosine >= np.cos(np.radians(30.0)))
    shares = np.maximum(overlap(queries, references), overlap(references, queries).T)
    undecided = ~truth & (shares >= config.conflict_overlap)
    asked, known = [v.image for v in queries], [v.image for v in references]
    return PlaceBenchmark(name, asked, known, truth, undecided, poses=(q, r))


def save_places(path: Path, places: list[list[Visit]]) -> None:
    """Keep rendered places: a cache of ``visit_places``, written whole or not at all."""
    flat = [visit for visits in places for visit in visits]
    cameras = np.array([astuple(v.camera) for v in flat])
    stacks = {"images": "image", "poses": "T_W_C", "points": "points_W"}
    arrays = {name: np.stack([getattr(v, field) for v in flat]) for name, field in stacks.items()}
    write_npz(path, {**arrays, "views": len(places[0]), "cameras": cameras})


def load_places(path: Path) -> list[list[Visit]]:
    """Read the places that :func:`save_places` wrote."""
    with np.load(path, allow_pickle=False) as file:
        data = {key: file[key] for key in file.files}
    flat = []
    for image, pose, camera, points in zip(data["images"], data["poses"], data["cameras"], data["points"], strict=True):
        w, h, fx, fy, cx, cy = (float(x) for x in camera)
        flat.append(Visit(image, pose, PinholeCamera(int(w), int(h), fx, fy, cx, cy), points))
    views = int(data["views"])
    return [flat[i : i + views] for i in range(0, len(flat), views)]


def _camera(config: SamplerConfig, rng: np.random.Generator) -> PinholeCamera:
    focal = 0.5 * config.width / np.tan(np.radians(rng.uniform(*config.fov_deg)) / 2)
    return PinholeCamera(config.width, config.height, focal, focal, (config.width - 1) / 2, (config.height - 1) / 2)


def standpoint(world: World, config: SamplerConfig, rng: np.random.Generator) -> NDArray[np.float64]:
    """A pose on free ground; outdoors along the path, indoors towards anything that is not too near."""
    free = world.free
    rows, cols = np.nonzero(free.clearance >= config.clearance_m)
    while True:
        k = int(rng.integers(len(rows)))
        x, z = free.origin[0] + cols[k] * free.cell_m, free.origin[1] + rows[k] * free.cell_m
        headings = np.radians(rng.uniform(0, 360) + np.arange(_DIRECTIONS) * 360 / _DIRECTIONS)
        steps = np.arange(1, 1 + int(40 / free.cell_m)) * free.cell_m
        line = np.array([x, z]) + steps[:, None, None] * np.stack([np.sin(headings), np.cos(headings)], axis=-1)
        run = (np.cumprod(free.at(line) > 0, axis=0).sum(axis=0)) * free.cell_m
        good = np.flatnonzero(run >= (config.open_m if config.indoors else max(config.open_m, 0.8 * run.max())))
        if len(good):
            heading = float(headings[rng.choice(good)]) + np.radians(rng.uniform(-8, 8))
            return _pose(x, z, config.height_m * float(rng.uniform(0.9, 1.1)), heading)


def _another_visit(
    world: World, base: NDArray[np.float64], config: SamplerConfig, rng: np.random.Generator
) -> NDArray[np.float64] | None:
    """A pose near ``base`` on free ground, or None where this draw was none."""
    offset = rng.uniform(-1, 1, 2) * (config.aside_m, config.along_m)
    forward, right = base[:3, 2], base[:3, 0]
    at = base[:3, 3] + offset[1] * forward + offset[0] * right
    if world.free.at(np.array([[at[0], at[2]]]))[0] < 0.5 * config.clearance_m:
        return None
    heading = float(np.arctan2(forward[0], forward[2])) + np.radians(rng.uniform(-1, 1) * config.turn_deg)
    pose = _pose(at[0], at[2], config.height_m * float(rng.uniform(0.9, 1.1)), heading)
    tilt = np.radians(rng.normal(0, [1.5, 0.0, 1.0]))
    return pose @ se3(so3_exp(tilt), np.zeros(3))


def _pose(x: float, z: float, height_m: float, heading_rad: float) -> NDArray[np.float64]:
    """``T_W_C`` of a level camera; heading from +Z towards +X."""
    return se3(so3_exp([0.0, heading_rad, 0.0]), [x, -height_m, z])


def _render(
    renderer: Renderer,
    pose: NDArray,
    camera: PinholeCamera,
    light: object,
    config: SamplerConfig,
    rng: np.random.Generator,
) -> Visit:
    view = renderer.render(pose, camera, light)  # type: ignore[arg-type]
    grey = view.radiance @ np.array([0.2126, 0.7152, 0.0722], dtype=np.float32)
    # Exposure as a camera would set it, off by up to half a stop.
    grey = grey * (0.25 / max(float(np.median(grey)), 1e-4)) ** 0.7 * float(np.exp(rng.uniform(-0.35, 0.35)))
    levels = 255.0 * np.clip(grey, 0, 1) ** (1 / 2.2) + config.noise * rng.standard_normal(grey.shape, dtype=np.float32)
    u, v = (
        np.linspace(0, n - 1, count).round().astype(int)
        for n, count in zip((camera.width, camera.height), _GRID, strict=True)
    )
    uu, vv = np.meshgrid(u, v)
    z = view.depth_m[vv, uu].ravel()
    rays = np.stack(
        [(uu.ravel() - camera.cx) / camera.fx, (vv.ravel() - camera.cy) / camera.fy, np.ones(uu.size)], axis=1
    )
    points = rays * np.where(z > 0, z, np.nan)[:, None] @ pose[:3, :3].T + pose[:3, 3]
    return Visit(levels.round().clip(0, 255).astype(np.uint8), pose, camera, points)


def _hidden(visit: Visit, u: NDArray, v: NDArray, z: NDArray, inside: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Whether points at pixels (u, v), depth z, lie well behind what ``visit`` sees there, by its coarse grid."""
    cols, rows = _GRID
    i = np.rint(v / (visit.camera.height - 1) * (rows - 1)).clip(0, rows - 1).astype(int)
    j = np.rint(u / (visit.camera.width - 1) * (cols - 1)).clip(0, cols - 1).astype(int)
    depth = np.nan_to_num((visit.points_W - visit.T_W_C[:3, 3]) @ visit.T_W_C[:3, 2], nan=np.inf)
    return np.asarray(inside & (z > 1.5 * depth.reshape(rows, cols)[i, j] + 0.3))


def _dull(visit: Visit, config: SamplerConfig) -> bool:
    """Whether a view is filled by something close in front of the camera."""
    depth = (visit.points_W - visit.T_W_C[:3, 3]) @ visit.T_W_C[:3, 2]
    return bool(np.nanmedian(depth) < (0.8 if config.indoors else 2.5)) if not np.isnan(depth).all() else True
