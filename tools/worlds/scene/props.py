"""Trees, cars, posts and small street furniture. Each function adds one thing, standing on the ground at height
``foot``."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .mesh import Mesh, MeshBuilder

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Stuff:
    """Materials of props: numbers of the world's material table."""

    leaves: tuple[int, ...]
    bark: int
    metal: int
    wood: int
    car_sides: tuple[int, ...]
    car_fronts: tuple[int, ...]
    paint: int
    rubber: int
    signs: tuple[int, ...]


def sphere(level: int) -> tuple[Floats, NDArray[np.int64]]:
    """Unit icosphere: vertices ``(v, 3)``, faces ``(f, 3)`` counter-clockwise seen from outside."""
    g = (1 + 5**0.5) / 2
    v = [
        (-1, g, 0),
        (1, g, 0),
        (-1, -g, 0),
        (1, -g, 0),
        (0, -1, g),
        (0, 1, g),
        (0, -1, -g),
        (0, 1, -g),
        (g, 0, -1),
        (g, 0, 1),
        (-g, 0, -1),
        (-g, 0, 1),
    ]
    f = [
        (0, 11, 5),
        (0, 5, 1),
        (0, 1, 7),
        (0, 7, 10),
        (0, 10, 11),
        (1, 5, 9),
        (5, 11, 4),
        (11, 10, 2),
        (10, 7, 6),
        (7, 1, 8),
        (3, 9, 4),
        (3, 4, 2),
        (3, 2, 6),
        (3, 6, 8),
        (3, 8, 9),
        (4, 9, 5),
        (2, 4, 11),
        (6, 2, 10),
        (8, 6, 7),
        (9, 8, 1),
    ]
    vertices, faces = np.array(v, np.float64), np.array(f, np.int64)
    vertices /= np.linalg.norm(vertices, axis=1, keepdims=True)
    for _ in range(level):
        ends = np.sort(faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
        unique, inverse = np.unique(ends, axis=0, return_inverse=True)
        mid = vertices[unique].mean(axis=1)
        mid /= np.linalg.norm(mid, axis=1, keepdims=True)
        ab, bc, ca = (len(vertices) + inverse.reshape(-1, 3)).T
        a, b, c = faces.T
        vertices = np.concatenate([vertices, mid])
        faces = np.concatenate([np.stack(t, axis=1) for t in ((a, ab, ca), (b, bc, ab), (c, ca, bc), (ab, bc, ca))])
    return vertices, faces


def tree_mesh(stuff: Stuff, height: float, rng: np.random.Generator) -> Mesh:
    """A trunk and a crown of lumps whose surface is bent at random, about the origin on the ground; placed by
    :func:`placed`."""
    mesh = MeshBuilder()
    trunk = 0.36 * height
    cylinder(mesh, np.zeros(2), -0.2, trunk * 1.3, 0.022 * height, stuff.bark)
    material, tone = (
        int(rng.choice(stuff.leaves)),
        rng.uniform(0.75, 1.2) * np.array([rng.uniform(0.85, 1.25), 1.0, rng.uniform(0.7, 1.0)]),
    )
    for k in range(int(rng.integers(4, 7))):
        unit, faces = sphere(2 if k < 2 else 1)
        radius = height * (0.24 if k == 0 else rng.uniform(0.13, 0.2))
        centre = np.zeros(3) if k == 0 else rng.normal(0, 0.13, 3) * height * np.array([1, 0.8, 1])
        waves = 0.05 * rng.uniform(0.4, 1.4, 6)
        bumps = sum(
            a * np.sin(unit @ rng.normal(0, f, 3) + rng.uniform(0, 6.28))
            for a, f in zip(waves, (3, 5, 8, 12, 12, 18), strict=True)
        )
        points = unit * radius * (1 + np.asarray(bumps)[:, None]) * np.array([1.0, 0.9, 1.0])
        middle = np.array([0, -(trunk + 0.28 * height), 0]) + centre
        # u on the angle would break at the seam: folded in the middle it has none.
        angle = np.abs(np.arctan2(unit[:, 2], unit[:, 0]))
        uv = np.stack([angle * radius * 1.1, unit[:, 1] * radius * 1.5], axis=1) + rng.uniform(0, 5, 2)
        mesh.surface(points + middle, faces, uv, material, tone * rng.uniform(0.85, 1.15))
    return mesh.build()


def cylinder(
    mesh: MeshBuilder,
    at: Floats,
    bottom: float,
    top: float,
    radius: float,
    material: int,
    tint: object = (1, 1, 1),
    sides: int = 7,
) -> None:
    """An upright post; ``at`` (x, z); heights above y = 0."""
    angle = 2 * np.pi * np.arange(sides + 1) / sides
    ring = np.stack([np.cos(angle), np.sin(angle)], axis=1) * radius + at
    u = angle * radius
    low = np.stack([ring[:, 0], np.full(sides + 1, -bottom), ring[:, 1]], axis=1)
    high = low.copy()
    high[:, 1] = -top
    k = np.arange(sides)
    a, b, c, d = k, k + 1, k + sides + 2, k + sides + 1
    faces = np.concatenate([np.stack([a, c, b], 1), np.stack([a, d, c], 1)])
    uv = np.concatenate([np.stack([u, np.zeros_like(u)], 1), np.stack([u, np.full_like(u, bottom - top)], 1)])
    mesh.surface(np.concatenate([low, high]), faces, uv, material, tint)


def lamp_post(
    mesh: MeshBuilder, at: Floats, towards: Floats, foot: float, stuff: Stuff, rng: np.random.Generator
) -> None:
    """A street lamp that leans over the road in direction ``towards`` (x, z), perhaps with a sign on it."""
    height = 6.2
    cylinder(mesh, at, foot - 0.2, foot + height, 0.075, stuff.metal, 0.8 * np.ones(3))
    arm = at + towards * 0.8
    axes = _axes(towards)
    mesh.box(
        np.array([(at[0] + arm[0]) / 2, -(foot + height), (at[1] + arm[1]) / 2]),
        axes,
        np.array([0.08, 0.08, 1.7]),
        stuff.metal,
        0.8 * np.ones(3),
        False,
    )
    mesh.box(
        np.array([arm[0], -(foot + height + 0.02), arm[1]]),
        axes,
        np.array([0.3, 0.12, 0.6]),
        stuff.metal,
        1.2 * np.ones(3),
        False,
    )
    if rng.random() < 0.5:
        sign_plate(
            mesh,
            at,
            towards,
            foot + float(rng.uniform(2.2, 2.8)),
            float(rng.uniform(0.5, 0.75)),
            int(rng.choice(stuff.signs)),
            stuff,
        )


def sign_post(
    mesh: MeshBuilder, at: Floats, towards: Floats, foot: float, stuff: Stuff, rng: np.random.Generator
) -> None:
    """A traffic sign or a street name on a post, square to the road whose direction is across ``towards``."""
    height = float(rng.uniform(2.2, 2.9))
    cylinder(mesh, at, foot - 0.2, foot + height, 0.035, stuff.metal)
    sign_plate(
        mesh, at, towards, foot + height - 0.75, float(rng.uniform(0.6, 0.85)), int(rng.choice(stuff.signs)), stuff
    )


def sign_plate(
    mesh: MeshBuilder, at: Floats, towards: Floats, bottom: float, width: float, material: int, stuff: Stuff
) -> None:
    """A thin plate that faces both directions along the road."""
    along = np.array([-towards[1], towards[0]])
    for way in (1.0, -1.0):
        centre = at + way * 0.09 * along
        a, b = centre + way * towards * width / 2, centre - way * towards * width / 2
        quad = [
            (a[0], -bottom, a[1]),
            (b[0], -bottom, b[1]),
            (b[0], -bottom - width * 0.8, b[1]),
            (a[0], -bottom - width * 0.8, a[1]),
        ]
        if (
            np.cross(np.subtract(quad[1], quad[0]), np.subtract(quad[2], quad[0]))
            @ np.array([along[0], 0, along[1]])
            * way
            < 0
        ):
            quad = [quad[1], quad[0], quad[3], quad[2]]
        mesh.quads(np.array([quad]), np.array([[(0, 1), (1, 1), (1, 0), (0, 0)]]), material)


def placed(thing: Mesh, at: Floats, heading: Floats, foot: float) -> Mesh:
    """``thing``, made about the origin, moved to ``at`` (x, z), its +Z along ``heading`` (x, z), onto ground of height
    ``foot``."""
    T = np.eye(4)
    T[:3, :3] = _axes(heading)
    T[:3, 3] = at[0], -foot, at[1]
    return thing.moved(T)


def bench(mesh: MeshBuilder, at: Floats, towards: Floats, foot: float, stuff: Stuff) -> None:
    """A bench of wood at ``at`` (x, z), its front ``towards`` a direction, ``foot`` metres above zero."""
    axes = _axes(towards)
    mesh.box(np.array([at[0], -(foot + 0.45), at[1]]), axes, np.array([1.7, 0.06, 0.45]), stuff.wood, open_bottom=False)
    back = at - towards * 0.22
    mesh.box(
        np.array([back[0], -(foot + 0.75), back[1]]), axes, np.array([1.7, 0.4, 0.05]), stuff.wood, open_bottom=False
    )
    for s in (-0.7, 0.7):
        leg = at + s * np.array([towards[1], -towards[0]])
        mesh.box(np.array([leg[0], -(foot + 0.22), leg[1]]), axes, np.array([0.07, 0.44, 0.4]), stuff.metal)


def bin_box(
    mesh: MeshBuilder, at: Floats, towards: Floats, foot: float, stuff: Stuff, rng: np.random.Generator
) -> None:
    """A bin, a cabinet or a letter box."""
    size = np.array([rng.uniform(0.4, 1.1), rng.uniform(0.8, 1.4), rng.uniform(0.35, 0.5)])
    mesh.box(
        np.array([at[0], -(foot + size[1] / 2), at[1]]),
        _axes(towards),
        size,
        int(rng.choice([stuff.metal, stuff.wood])),
        rng.uniform(0.35, 1.3, 3),
    )


def _axes(forward: Floats) -> Floats:
    """Columns: right, down, forward, for ``forward`` (x, z) of unit length."""
    return np.array([[forward[1], 0.0, forward[0]], [0.0, 1.0, 0.0], [-forward[0], 0.0, forward[1]]])
