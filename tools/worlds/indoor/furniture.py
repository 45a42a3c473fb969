"""What stands and hangs in an office, and the materials of it. Each function adds one thing."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..scene import textures
from ..scene.mesh import MeshBuilder
from ..scene.texture_atlas import AtlasBuilder
from . import textures as office

HEIGHT_M = 2.8
Rect = tuple[float, float, float, float]
"""x0, z0, x1, z1."""


@dataclass(frozen=True)
class Paint:
    """Materials: numbers of the world's material table."""

    wall: int
    carpet: int
    tiles: int
    ceiling: int
    door: int
    window: int
    wood: int
    metal: int
    white: int
    cloth: tuple[int, ...]
    posters: tuple[int, ...]
    books: tuple[int, ...]
    screens: tuple[int, ...]


def paint_office(atlas: AtlasBuilder, rng: np.random.Generator) -> Paint:
    """Materials of an office, tinted by ``rng``: no two floors have the same walls and posters."""
    grain = atlas.texture(textures.grain(rng, 256, 0.05), 0.9, 0.9)
    stains = atlas.texture(textures.weathering(rng, 512, 0.045), 4.3, 4.3)

    def tinted(colour: tuple[float, float, float], detail: int = grain) -> int:
        return atlas.material(atlas.texture(np.full((1, 1, 3), colour, np.uint8), 1.0, 1.0), detail, stains)

    base = rng.uniform(0.92, 1.06, 3)
    wall = (float(206 * base[0]), float(203 * base[1]), float(194 * base[2]))
    coarse = atlas.texture(textures.grain(rng, 256, 0.2), 0.6, 0.6)
    pictures = tuple(office.poster(rng) for _ in range(18))
    return Paint(
        wall=atlas.material(atlas.texture(office.wall_picture(rng, wall), 3.2, 3.2), grain, stains),
        carpet=atlas.material(
            atlas.texture(textures.paving(rng, 8, 8, (96, 102, 116), 512, 1, False), 4.0, 4.0), coarse, stains
        ),
        tiles=atlas.material(
            atlas.texture(textures.paving(rng, 8, 8, (164, 158, 148), 512, 2, False), 4.8, 4.8), grain, stains
        ),
        ceiling=atlas.material(
            atlas.texture(textures.paving(rng, 8, 8, (214, 214, 210), 512, 2, False), 4.8, 4.8), grain
        ),
        door=atlas.material(atlas.texture(office.door_picture(rng), 1.0, 1.0, True), grain),
        window=atlas.material(atlas.texture(office.window_picture(rng), 1.0, 1.0, True)),
        wood=atlas.material(atlas.texture(textures.bark(rng), 0.9, 0.9), grain),
        metal=tinted((112, 114, 118)),
        white=tinted((226, 226, 224)),
        cloth=tuple(tinted(tuple(rng.uniform(50, 150, 3)), coarse) for _ in range(3)),
        posters=tuple(atlas.material(atlas.texture(p, 1.0, 1.0, True)) for p in pictures),
        books=tuple(atlas.material(atlas.texture(office.book_picture(rng), 1.0, 1.0, True)) for _ in range(5)),
        screens=tuple(atlas.material(atlas.texture(office.screen_picture(rng), 1.0, 1.0, True)) for _ in range(4)),
    )


def horizontal(mesh: MeshBuilder, r: Rect, height: float, material: int, up: bool) -> None:
    """A floor or a ceiling, textured by its place so that neighbours join."""
    corners = [(r[0], -height, r[1]), (r[2], -height, r[1]), (r[2], -height, r[3]), (r[0], -height, r[3])]
    if not up:
        corners = corners[::-1]
    mesh.quads(np.array([corners]), np.array([[(x, z) for x, _, z in corners]]), material)


def wall(mesh: MeshBuilder, a: NDArray, b: NDArray, facing: NDArray, bottom: float, top: float, material: int) -> None:
    """A wall from ``a`` to ``b`` whose front is on the side of ``facing``, whichever way round they come."""
    d = b - a
    if d[1] * facing[0] - d[0] * facing[1] < 0:
        a, b = b, a
    anchor = float(a @ np.array([0.7, 1.3])) % 6.0
    mesh.wall(a, b, bottom, top, material, uv_start=(anchor, -bottom))


def hang(mesh: MeshBuilder, at: NDArray, across: NDArray, p: Paint, rng: np.random.Generator) -> None:
    """A poster, a notice board or a small switch on a wall."""
    kind = rng.random()
    if kind < 0.7:
        w, h, y = float(rng.uniform(0.4, 1.0)), float(rng.uniform(0.45, 0.8)), float(rng.uniform(1.1, 1.45))
        picture(mesh, at, across, w, y, y + h, int(rng.choice(p.posters)))
    else:
        picture(mesh, at, across, 0.09, 1.05, 1.16, p.white)
        picture(mesh, at + across * 0.002, across, 0.04, 1.08, 1.13, p.metal)


def picture(
    mesh: MeshBuilder, at: NDArray, across: NDArray, width: float, bottom: float, top: float, material: int
) -> None:
    """A whole texture (uv 0..1) on a wall at ``at`` whose front is towards ``across``."""
    left = np.array([-across[1], across[0]])  # as seen by one who looks at the wall
    a, b = at + left * width / 2 + across * 0.008, at - left * width / 2 + across * 0.008
    quad = np.array([[(a[0], -bottom, a[1]), (b[0], -bottom, b[1]), (b[0], -top, b[1]), (a[0], -top, a[1])]])
    normal = np.cross(quad[0, 1] - quad[0, 0], quad[0, 2] - quad[0, 0])
    if normal[0] * across[0] + normal[2] * across[1] < 0:
        quad = quad[:, [1, 0, 3, 2]]
    mesh.quads(quad, np.array([[(0, 1), (1, 1), (1, 0), (0, 0)]]), material)


def lamp(mesh: MeshBuilder, x: float, z: float, p: Paint) -> None:
    """A ceiling panel at ``x``, ``z`` that shines: brighter than white."""
    mesh.box(
        np.array([x, -(HEIGHT_M - 0.03), z]),
        np.eye(3),
        np.array([0.6, 0.06, 0.6]),
        p.white,
        (1.5, 1.5, 1.45),
        open_bottom=False,
    )


def desk(
    mesh: MeshBuilder, at: NDArray, front: NDArray, p: Paint, blocked: list[Rect], rng: np.random.Generator
) -> None:
    """A table with a screen, a chair, papers; ``front``: where the chair stands."""
    at = at + rng.uniform(-0.1, 0.1, 2)
    mesh.box(np.array([at[0], -0.73, at[1]]), np.eye(3), np.array([1.6, 0.04, 0.75]), p.wood, open_bottom=False)
    for dx in (-0.72, 0.72):
        mesh.box(np.array([at[0] + dx, -0.355, at[1]]), np.eye(3), np.array([0.05, 0.71, 0.6]), p.metal)
    screen = at - front * 0.15 + np.array([rng.uniform(-0.3, 0.3), 0])
    mesh.box(
        np.array([screen[0], -1.03, screen[1]]),
        np.eye(3),
        np.array([0.56, 0.34, 0.05]),
        p.metal,
        0.4 * np.ones(3),
        open_bottom=False,
    )
    picture(mesh, screen + front * 0.022, front, 0.53, 0.88, 1.18, int(rng.choice(p.screens)))
    mesh.box(np.array([screen[0], -0.8, screen[1]]), np.eye(3), np.array([0.2, 0.14, 0.1]), p.metal, 0.4 * np.ones(3))
    for _ in range(int(rng.integers(1, 4))):
        item = at + rng.uniform((-0.7, -0.25), (0.7, 0.25))
        size = rng.uniform((0.08, 0.02, 0.08), (0.3, 0.22, 0.3))
        mesh.box(
            np.array([item[0], -0.75 - size[1] / 2, item[1]]),
            np.eye(3),
            size,
            int(rng.choice([p.white, *p.cloth])),
            rng.uniform(0.5, 1.5, 3),
        )
    chair = at + front * 0.62 + rng.uniform(-0.12, 0.12, 2)
    cloth = p.cloth[0]
    mesh.box(np.array([chair[0], -0.45, chair[1]]), np.eye(3), np.array([0.46, 0.08, 0.46]), cloth, open_bottom=False)
    mesh.box(
        np.array([chair[0], -0.8, chair[1] + front[1] * 0.2]),
        np.eye(3),
        np.array([0.44, 0.5, 0.06]),
        cloth,
        open_bottom=False,
    )
    mesh.box(np.array([chair[0], -0.2, chair[1]]), np.eye(3), np.array([0.08, 0.42, 0.08]), p.metal)
    blocked.append((at[0] - 0.8, min(at[1] - 0.38, chair[1] - 0.25), at[0] + 0.8, max(at[1] + 0.38, chair[1] + 0.25)))


def shelf(
    mesh: MeshBuilder, at: NDArray, front: NDArray, p: Paint, blocked: list[Rect], rng: np.random.Generator
) -> None:
    """Boards with rows of books."""
    width, depth = 1.6, 0.36
    mesh.box(
        np.array([at[0] - front[0] * 0.1, -0.95, at[1]]),
        np.eye(3),
        np.array([0.06, 1.9, width]),
        p.wood,
        open_bottom=False,
    )
    for k in range(5):
        y = 0.1 + 0.42 * k
        mesh.box(np.array([at[0], -y, at[1]]), np.eye(3), np.array([depth, 0.03, width]), p.wood, open_bottom=False)
        if k < 4 and rng.random() < 0.85:
            w = float(rng.uniform(0.6, width))
            picture(mesh, at + front * 0.1, front, w, y + 0.015, y + 0.33, int(rng.choice(p.books)))
    blocked.append((at[0] - depth / 2, at[1] - width / 2, at[0] + depth / 2, at[1] + width / 2))


def cabinet(mesh: MeshBuilder, at: NDArray, p: Paint, blocked: list[Rect], rng: np.random.Generator) -> None:
    """A metal cabinet at ``at`` (x, z), one of three heights; its floor is added to ``blocked``."""
    size = np.array([0.5, float(rng.choice([0.75, 1.2, 1.8])), 0.8])
    mesh.box(np.array([at[0], -size[1] / 2, at[1]]), np.eye(3), size, p.metal, rng.uniform(0.6, 1.4))
    blocked.append((at[0] - 0.25, at[1] - 0.4, at[0] + 0.25, at[1] + 0.4))
