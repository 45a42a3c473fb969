"""The town: about 300 m x 300 m of streets, houses, trees, parked cars and signs, all drawn from one seed."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..motion.paths import resample, smoothed
from ..scene import props, textures
from ..scene.mesh import Mesh, MeshBuilder
from ..scene.texture_atlas import AtlasBuilder
from ..scene.world import World
from . import car_textures, facades
from .buildings import Masonry, add_house, plots_along
from .cars import car_mesh
from .street_furniture import Street, contact_shade, furnish
from .streets import (
    PAVEMENT_M,
    ROAD_HALF_M,
    Line,
    Network,
    first_passes,
    free_space,
    ground_image,
    ground_plan,
    town_network,
)
from .terrain import FLAT, Terrain, add_ground, terrain_along

MARGIN_M = 45.0
_SHORTEST = 28
"""Of a street, metres: houses and markings need some."""
MOST_GROUND_TEXELS = 48e6
"""Of the ground's picture: bounds the memory of a large world, 4 bytes each."""


def build_town(seed: int, facade_count: int = 32, ground_texel_m: float = 0.05) -> tuple[World, Network]:
    """The town of ``seed`` and its streets, on flat ground. Fewer facades and a coarser ground make a cheaper town of
    the same shape."""
    rng = np.random.default_rng([seed, 1])
    network = town_network(rng)
    world = build_streets(
        "town", seed, network.lines, network.lines, network.nodes, FLAT, rng, facade_count, ground_texel_m
    )
    return world, network


def build_along(seed: int, poses: NDArray[np.float64], facade_count: int = 32, ground_texel_m: float = 0.05) -> World:
    """A town grown round a driven path: ``poses`` ``(n, 4, 4)`` T_W_C of a camera about 1.65 m above the road, up and
    down hill.

    The path is the middle of a street; where it comes by again, the street is drawn once; no house stands on any part
    of it.
    """
    rng = np.random.default_rng([seed, 1])
    path = resample(poses[:, :3, 3][:, [0, 2]], 1.0)
    if len(path) < 4:
        path = poses[0, :3, 3][[0, 2]] + np.arange(-4.0, 24.0)[:, None] * poses[0, :3, 2][[0, 2]]
    elif len(path) < _SHORTEST:  # a street goes on where the camera stops
        ahead = path[-1] - path[-3]
        onward = np.arange(1.0, _SHORTEST - len(path) + 1.0)[:, None] * ahead / np.linalg.norm(ahead)
        path = np.concatenate([path, path[-1] + onward])
    path = smoothed(path, 2.0)
    terrain = terrain_along(poses[:, :3, 3], MARGIN_M + 4)
    plan = ground_plan((path,), MARGIN_M)
    area = plan.distance.size * plan.cell_m**2
    texel = max(ground_texel_m, round(float(np.sqrt(area / MOST_GROUND_TEXELS)), 3))
    return build_streets(
        "along", seed, (path,), first_passes(path), np.zeros((0, 2)), terrain, rng, facade_count, texel
    )


def build_streets(
    kind: str,
    seed: int,
    lines: tuple[Line, ...],
    fresh: tuple[Line, ...],
    crossings: NDArray[np.float64],
    terrain: Terrain,
    rng: np.random.Generator,
    facade_count: int,
    ground_texel_m: float,
) -> World:
    """A world along street ``lines``; ``fresh``: the lines less what lies on another line already: these get markings
    and houses."""
    plan = ground_plan(lines, MARGIN_M)
    taken = (plan.distance < ROAD_HALF_M + PAVEMENT_M).astype(np.uint8)
    plots = plots_along(fresh, plan, taken, rng)
    atlas = AtlasBuilder()
    masonry, stuff = _materials(atlas, rng, facade_count)
    mesh = MeshBuilder()
    for plot in plots:
        add_house(mesh, plot, masonry, float(terrain.height(plot.outline()).max()), rng)
    cars = [car_mesh(stuff, np.array(c), k) for k, c in enumerate(_paints(rng))]
    trees = [props.tree_mesh(stuff, float(h), rng) for h in np.linspace(4.2, 9.0, 10)]
    street = Street(plan, terrain, crossings, stuff, cars, trees)
    placed = furnish(mesh, fresh, street, taken, rng)
    ground = ground_image(plan, fresh, crossings, contact_shade(taken), rng, ground_texel_m)
    h, w = ground.shape[:2]
    texture = atlas.texture(ground, w * ground_texel_m, h * ground_texel_m, clamped=True)
    detail = atlas.texture(textures.grain(rng, 256, 0.12), 2.56, 2.56)
    add_ground(
        mesh,
        plan,
        terrain,
        atlas.material(texture, detail),
        atlas.material(atlas.texture(textures.leaves(rng), 60.0, 60.0)),
    )
    sky = atlas.texture(textures.clouds(rng), 2048.0, 2048.0)
    return World(
        kind, seed, Mesh.joined([mesh.build(), *placed]), atlas.build(), free_space(plan), sky, movers=tuple(cars)
    )


def _materials(atlas: AtlasBuilder, rng: np.random.Generator, facade_count: int) -> tuple[Masonry, props.Stuff]:
    grain = atlas.texture(textures.grain(rng, 256, 0.10), 1.9, 1.9)
    stains = atlas.texture(textures.weathering(rng, 512, 0.10), 27.0, 27.0)
    side = facades.BAYS * facades.BAY_M
    walls = tuple(
        atlas.material(atlas.texture(facades.facade(rng), side, side), grain, stains) for _ in range(facade_count)
    )
    tile_colours = ((150, 84, 62), (96, 92, 92), (128, 72, 58))
    roofs = tuple(
        atlas.material(atlas.texture(textures.paving(rng, 16, 16, c, joint=3), 4.0, 4.0), grain, stains)
        for c in tile_colours
    )
    boards = tuple(
        atlas.material(atlas.texture(facades.sign(rng, *s), 1.0, 1.0, True))
        for s in ((128, 64), (64, 64), (160, 96)) * 14
    )
    cloth = tuple(atlas.material(atlas.texture(_stripes(rng), 0.8, 0.8), grain) for _ in range(4))
    trim = atlas.material(atlas.texture(textures.paving(rng, 8, 4, (176, 168, 156)), 4.0, 4.0), grain)
    stuff = props.Stuff(
        leaves=tuple(atlas.material(atlas.texture(textures.leaves(rng), 3.2, 3.2)) for _ in range(3)),
        bark=atlas.material(atlas.texture(textures.bark(rng), 0.8, 0.8)),
        metal=atlas.material(atlas.texture(np.full((1, 1, 3), 120, np.uint8), 1.0, 1.0), grain),
        wood=atlas.material(atlas.texture(textures.bark(rng), 0.5, 0.5), grain),
        car_sides=tuple(atlas.material(atlas.texture(car_textures.car_side(rng), 1.0, 1.0, True)) for _ in range(4)),
        car_fronts=tuple(atlas.material(atlas.texture(car_textures.car_end(rng), 1.0, 1.0, True)) for _ in range(4)),
        paint=atlas.material(atlas.texture(np.full((1, 1, 3), 200, np.uint8), 1.0, 1.0)),
        rubber=atlas.material(atlas.texture(np.full((1, 1, 3), 44, np.uint8), 1.0, 1.0)),
        signs=boards,
    )
    return Masonry(walls, roofs, trim, boards, cloth), stuff


def _stripes(rng: np.random.Generator) -> textures.Image:
    out = np.empty((32, 32, 3), np.uint8)
    out[:, :16], out[:, 16:] = rng.integers(60, 220, 3), 225
    return out


def _paints(rng: np.random.Generator) -> NDArray[np.float64]:
    """Tints of cars: white, greys, black, and some colours."""
    grey = np.array([1.15, 0.8, 0.45, 0.12, 0.6])[:, None] * np.ones(3)
    colour = np.array([(0.7, 0.08, 0.07), (0.1, 0.22, 0.6), (0.12, 0.4, 0.2), (0.75, 0.6, 0.2), (0.35, 0.6, 0.75)])
    return np.concatenate([grey, colour]) * rng.uniform(0.85, 1.15, (10, 3))
