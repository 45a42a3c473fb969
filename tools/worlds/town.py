"""The town: about 300 m x 300 m of streets, houses, trees, parked cars and signs, all drawn from one seed."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tools.worlds import car_pictures, facades, props, textures
from tools.worlds.atlas import AtlasBuilder
from tools.worlds.buildings import Masonry, add_house, plots_along
from tools.worlds.mesh import Mesh, MeshBuilder
from tools.worlds.streets import (
    PAVEMENT_M,
    ROAD_HALF_M,
    GroundPlan,
    Line,
    Network,
    free_space,
    ground_image,
    ground_plan,
    town_network,
)
from tools.worlds.world import World

MARGIN_M = 45.0
KERB_M = ROAD_HALF_M + 0.5


def build_town(seed: int, facade_count: int = 32, ground_texel_m: float = 0.05) -> tuple[World, Network]:
    """The town of ``seed`` and its streets. Fewer facades and a coarser ground make a cheaper town of the same shape."""
    rng = np.random.default_rng([seed, 1])
    network = town_network(rng)
    return build_streets("town", seed, network.lines, network.nodes, rng, facade_count, ground_texel_m), network


def build_streets(kind: str, seed: int, lines: tuple[Line, ...], crossings: NDArray[np.float64], rng: np.random.Generator,
                  facade_count: int, ground_texel_m: float) -> World:  # fmt: skip
    """A world along street ``lines`` on flat ground (y = 0)."""
    plan = ground_plan(lines, MARGIN_M)
    taken = (plan.distance < ROAD_HALF_M + PAVEMENT_M).astype(np.uint8)
    plots = plots_along(lines, plan, taken, rng)
    atlas = AtlasBuilder()
    masonry, stuff = _materials(atlas, rng, facade_count)
    mesh = MeshBuilder()
    for plot in plots:
        add_house(mesh, plot, masonry, 0.0, rng)
    cars = [props.car_mesh(stuff, np.array(c), k) for k, c in enumerate(_paints(rng))]
    trees = [props.tree_mesh(stuff, float(h), rng) for h in np.linspace(4.2, 9.0, 10)]
    placed = _furnish(mesh, lines, crossings, plan, taken, stuff, _Models(cars, trees), rng)
    ground = ground_image(plan, lines, crossings, _contact_shade(taken), rng, ground_texel_m)
    h, w = ground.shape[:2]
    texture = atlas.texture(ground, w * ground_texel_m, h * ground_texel_m, clamped=True)
    detail = atlas.texture(textures.grain(rng, 256, 0.12), 2.56, 2.56)
    _ground(mesh, plan, atlas.material(texture, detail), atlas.material(atlas.texture(textures.leaves(rng), 60.0, 60.0)))
    sky = atlas.texture(textures.clouds(rng), 2048.0, 2048.0)
    return World(kind, seed, Mesh.joined([mesh.build(), *placed]), atlas.build(), free_space(plan), sky, movers=tuple(cars))


def _materials(atlas: AtlasBuilder, rng: np.random.Generator, facade_count: int) -> tuple[Masonry, props.Stuff]:
    grain = atlas.texture(textures.grain(rng, 256, 0.10), 1.9, 1.9)
    stains = atlas.texture(textures.weathering(rng, 512, 0.10), 27.0, 27.0)
    side = facades.BAYS * facades.BAY_M
    walls = tuple(atlas.material(atlas.texture(facades.facade(rng), side, side), grain, stains) for _ in range(facade_count))
    tile_colours = ((150, 84, 62), (96, 92, 92), (128, 72, 58))
    roofs = tuple(atlas.material(atlas.texture(textures.paving(rng, 16, 16, c, joint=3), 4.0, 4.0), grain, stains) for c in tile_colours)
    boards = tuple(atlas.material(atlas.texture(facades.sign(rng, *s), 1.0, 1.0, True)) for s in ((128, 64), (64, 64), (160, 96)) * 14)
    cloth = tuple(atlas.material(atlas.texture(_stripes(rng), 0.8, 0.8), grain) for _ in range(4))
    trim = atlas.material(atlas.texture(textures.paving(rng, 8, 4, (176, 168, 156)), 4.0, 4.0), grain)
    stuff = props.Stuff(
        leaves=tuple(atlas.material(atlas.texture(textures.leaves(rng), 3.2, 3.2)) for _ in range(3)),
        bark=atlas.material(atlas.texture(textures.bark(rng), 0.8, 0.8)),
        metal=atlas.material(atlas.texture(np.full((1, 1, 3), 120, np.uint8), 1.0, 1.0), grain),
        wood=atlas.material(atlas.texture(textures.bark(rng), 0.5, 0.5), grain),
        car_sides=tuple(atlas.material(atlas.texture(car_pictures.car_side(rng), 1.0, 1.0, True)) for _ in range(4)),
        car_fronts=tuple(atlas.material(atlas.texture(car_pictures.car_end(rng), 1.0, 1.0, True)) for _ in range(4)),
        paint=atlas.material(atlas.texture(np.full((1, 1, 3), 200, np.uint8), 1.0, 1.0)),
        rubber=atlas.material(atlas.texture(np.full((1, 1, 3), 44, np.uint8), 1.0, 1.0)),
        signs=boards,
    )  # fmt: skip
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


@dataclass(frozen=True)
class _Models:
    """Things that are made once and stand in many places; trees by rising height."""

    cars: list[Mesh]
    trees: list[Mesh]


def _furnish(mesh: MeshBuilder, lines: tuple[Line, ...], crossings: NDArray[np.float64], plan: GroundPlan, taken: NDArray[np.uint8],
             stuff: props.Stuff, models: _Models, rng: np.random.Generator) -> list[Mesh]:  # fmt: skip
    """Cars at the kerb, lamps, signs, trees and furniture on the pavements, trees on free grass; returns the cars."""
    out: list[Mesh] = []
    for line in lines:
        tangent = np.gradient(line, axis=0)
        tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
        for side in (1.0, -1.0):
            _pavement(mesh, line, tangent, side, crossings, plan, stuff, models, out, rng)
    for p in rng.uniform(np.zeros(2), np.array(plan.distance.shape[::-1]) * plan.cell_m, (1400, 2)) + plan.origin:
        row, col = plan.index(p)
        r = int(2.5 / plan.cell_m)
        near = taken[max(row - r, 0) : row + r + 1, max(col - r, 0) : col + r + 1]
        if not near.any() and plan.distance[row, col] < 26:
            out.append(props.placed(models.trees[int(rng.integers(10))], p, _direction(rng), 0.0))
            taken[row - r : row + r + 1, col - r : col + r + 1] = 2
    return out


def _pavement(mesh: MeshBuilder, line: Line, tangent: NDArray, side: float, crossings: NDArray[np.float64], plan: GroundPlan,
              stuff: props.Stuff, models: _Models, out: list[Mesh], rng: np.random.Generator) -> None:  # fmt: skip
    """Everything on one side of one street."""
    next_car, next_thing = rng.uniform(0, 12), rng.uniform(0, 6)
    for k in range(len(line)):
        right = side * np.array([tangent[k, 1], -tangent[k, 0]])
        clear = len(crossings) == 0 or np.hypot(*(crossings - line[k]).T).min() > 15.0
        if k >= next_car and clear:
            at = line[k] + right * (ROAD_HALF_M - 1.0)
            if plan.distance[plan.index(at)] > ROAD_HALF_M - 1.7:
                car = models.cars[int(rng.integers(len(models.cars)))]
                out.append(props.placed(car, at + rng.normal(0, 0.08, 2), tangent[k] * side * -1.0, 0.0))
            next_car = k + 5.6 + (rng.exponential(9.0) if rng.random() < 0.6 else 0.0)
        if k >= next_thing:
            at = line[k] + right * KERB_M
            if plan.distance[plan.index(at)] > ROAD_HALF_M + 0.25:
                _thing(mesh, at, -right, stuff, models, out, rng)
            next_thing = k + rng.uniform(4.0, 11.0)


def _direction(rng: np.random.Generator) -> NDArray[np.float64]:
    angle = rng.uniform(0, 2 * np.pi)
    return np.array([np.sin(angle), np.cos(angle)])


def _thing(mesh: MeshBuilder, at: NDArray, towards: NDArray, stuff: props.Stuff, models: _Models, out: list[Mesh],
           rng: np.random.Generator) -> None:  # fmt: skip
    kind = rng.random()
    if kind < 0.30:
        out.append(props.placed(models.trees[int(rng.integers(5))], at - towards * 0.5, _direction(rng), 0.0))
    elif kind < 0.55:
        props.lamp_post(mesh, at, towards, 0.0, stuff, rng)
    elif kind < 0.80:
        props.sign_post(mesh, at, towards, 0.0, stuff, rng)
    elif kind < 0.9:
        props.bench(mesh, at - towards * 1.2, towards, 0.0, stuff)
    else:
        props.bin_box(mesh, at - towards * 0.3, towards, 0.0, stuff, rng)


def _contact_shade(taken: NDArray[np.uint8]) -> NDArray[np.float32]:
    """Darker ground at the feet of houses (2 in ``taken``: under trees)."""
    import cv2

    solid = cv2.GaussianBlur((taken == 0).astype(np.float32), (0, 0), 1.0)
    return 1.0 - 0.0 * solid


def _ground(mesh: MeshBuilder, plan: GroundPlan, material: int, forest: int) -> None:
    """The plane y = 0 under everything, and a ring of wooded hills round it so that no street ends in the void."""
    h, w = plan.distance.shape
    x0, z0 = plan.origin
    x1, z1 = x0 + w * plan.cell_m, z0 + h * plan.cell_m
    grow = 500.0
    xs, zs = (x0 - grow, x1 + grow), (z0 - grow, z1 + grow)
    quad = [(xs[0], 0, zs[0]), (xs[1], 0, zs[0]), (xs[1], 0, zs[1]), (xs[0], 0, zs[1])]
    mesh.quads(np.array([quad], float), np.array([[(x - x0, z - z0) for x, _, z in quad]]), material)
    centre, radius = np.array([(x0 + x1) / 2, (z0 + z1) / 2]), 0.75 * max(x1 - x0, z1 - z0) + 120
    angle = np.linspace(0, 2 * np.pi, 97)
    height = 26 + 9 * np.sin(3 * angle + 1) + 6 * np.sin(7 * angle) + 3 * np.sin(17 * angle + 2)
    ring = centre + radius * np.stack([np.cos(angle), np.sin(angle)], 1)
    low = np.stack([ring[:, 0], np.full(97, 1.0), ring[:, 1]], 1)
    high = np.stack([centre[0] + (ring[:, 0] - centre[0]) * 1.15, -height, centre[1] + (ring[:, 1] - centre[1]) * 1.15], 1)
    k = np.arange(96)
    faces = np.concatenate([np.stack([k, k + 1, k + 98], 1), np.stack([k, k + 98, k + 97], 1)])
    u = angle * radius
    uv = np.concatenate([np.stack([u, np.zeros(97)], 1), np.stack([u, -height - 20], 1)])
    mesh.surface(np.concatenate([low, high]), faces, uv, forest)
