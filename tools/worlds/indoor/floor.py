"""An office floor: corridors round blocks of rooms that look alike on purpose. Same doors, same desks; a poster here,
a plant there."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..scene.mesh import MeshBuilder
from ..scene.texture_atlas import AtlasBuilder
from ..scene.world import FreeSpace, World
from .furniture import (
    HEIGHT_M,
    Paint,
    Rect,
    cabinet,
    desk,
    hang,
    horizontal,
    lamp,
    paint_office,
    picture,
    shelf,
    wall,
)

CORRIDOR_M = 2.4
ROOM_M = 4.8
DOOR_M = 1.1
HALF_WALL_M = 0.06
DOOR_HEIGHT_M = 2.15
CELL_M = 0.05


@dataclass(frozen=True)
class Door:
    """An opening in the wall between corridor and room: its middle ``at`` (x, z) and the unit vector ``into`` the
    room."""

    at: NDArray[np.float64]
    into: NDArray[np.float64]


@dataclass(frozen=True)
class Floor:
    """The plan: corridors run along ``xs`` and ``zs`` (their middles); ``rooms`` with their ``doors``, one each."""

    xs: tuple[float, ...]
    zs: tuple[float, ...]
    rooms: tuple[Rect, ...]
    doors: tuple[Door, ...]


def build_indoor(seed: int) -> tuple[World, Floor]:
    """The floor of ``seed``, about 30 m x 25 m, and its plan."""
    rng = np.random.default_rng([seed, 11])
    floor = _plan(rng)
    atlas, mesh = AtlasBuilder(), MeshBuilder()
    paint = paint_office(atlas, rng)
    lamps: list[list[tuple[float, float, float, float]]] = []
    blocked: list[Rect] = []
    mesh.zone = 0
    lamps.append(_corridors(mesh, floor, paint, rng))
    for k, (room, door) in enumerate(zip(floor.rooms, floor.doors, strict=True)):
        mesh.zone = k + 1
        lamps.append(_room(mesh, room, door, paint, blocked, rng))
    starts = np.cumsum([0] + [len(zone) for zone in lamps]).astype(np.int64)
    flat = np.array([lamp for zone in lamps for lamp in zone], np.float64).reshape(-1, 4)
    return World("indoor", seed, mesh.build(), atlas.build(), _free(floor, blocked), -1, flat, starts), floor


def _plan(rng: np.random.Generator) -> Floor:
    """A ring of corridors with one across; rooms in rows between and outside, doors on the corridors."""
    columns, half = 4, CORRIDOR_M / 2
    inner = columns * ROOM_M
    xs = (0.0, inner + CORRIDOR_M)
    depth = ROOM_M + float(rng.uniform(-0.3, 0.6))
    zs = (0.0, 2 * depth + CORRIDOR_M, 4 * depth + 2 * CORRIDOR_M)
    rooms: list[Rect] = []
    doors: list[Door] = []

    def add(rect: Rect, wall_z: float, into: float) -> None:
        offset = float(rng.choice([-1.2, 1.2])) if rng.random() < 0.3 else -1.2
        rooms.append(rect)
        doors.append(Door(np.array([(rect[0] + rect[2]) / 2 + offset, wall_z]), np.array([0.0, into])))

    for k in range(columns):
        x0 = half + k * ROOM_M
        for row, z in enumerate(zs):
            if row < 2:  # two rows of rooms back to back between this corridor and the next
                add((x0, z + half, x0 + ROOM_M, z + half + depth), z + half, 1.0)
                add((x0, zs[row + 1] - half - depth, x0 + ROOM_M, zs[row + 1] - half), zs[row + 1] - half, -1.0)
        add((x0, -half - depth, x0 + ROOM_M, -half), -half, -1.0)
        add((x0, zs[2] + half, x0 + ROOM_M, zs[2] + half + depth), zs[2] + half, 1.0)
    return Floor(xs, zs, tuple(rooms), tuple(doors))


def _corridors(
    mesh: MeshBuilder, floor: Floor, p: Paint, rng: np.random.Generator
) -> list[tuple[float, float, float, float]]:
    half = CORRIDOR_M / 2
    x0, x1, z0, z1 = floor.xs[0] - half, floor.xs[-1] + half, floor.zs[0] - half, floor.zs[-1] + half
    strips = [(x, z0, x + CORRIDOR_M, z1) for x in (x0, floor.xs[-1] - half)]
    strips += [(floor.xs[0] + half, z - half, floor.xs[-1] - half, z + half) for z in floor.zs]
    lamps = []
    for strip in strips:
        horizontal(mesh, strip, 0.0, p.tiles, up=True)
        horizontal(mesh, strip, HEIGHT_M, p.ceiling, up=False)
        long_x = strip[2] - strip[0] > strip[3] - strip[1]
        n = int(max(strip[2] - strip[0], strip[3] - strip[1]) / 3.6)
        for k in range(n):
            f = (k + 0.5) / n
            x = strip[0] + f * (strip[2] - strip[0]) if long_x else (strip[0] + strip[2]) / 2
            z = (strip[1] + strip[3]) / 2 if long_x else strip[1] + f * (strip[3] - strip[1])
            lamps.append((x, -(HEIGHT_M - 0.15), z, 0.55 if rng.random() < 0.9 else 0.25))
            lamp(mesh, x, z, p)
    for z, inward in ((z0, 1.0), (z1, -1.0)):
        for a, b in ((x0, x0 + CORRIDOR_M), (x1 - CORRIDOR_M, x1)):
            _wall_strip(mesh, np.array([a, z]), np.array([b, z]), inward, p, rng)
    for x, inward in ((x0, 1.0), (x1, -1.0)):
        _wall_strip(mesh, np.array([x, z0]), np.array([x, z1]), inward, p, rng)
    for low, high in ((floor.zs[0] + half, floor.zs[1] - half), (floor.zs[1] + half, floor.zs[2] - half)):
        for x, inward in ((floor.xs[0] + half, -1.0), (floor.xs[-1] - half, 1.0)):
            _wall_strip(mesh, np.array([x, low]), np.array([x, high]), inward, p, rng)
    for room, door in zip(floor.rooms, floor.doors, strict=True):
        _wall_with_door(mesh, room, door, -door.into, p, rng, posters=0.45)
    return lamps


def _wall_strip(mesh: MeshBuilder, a: NDArray, b: NDArray, inward: float, p: Paint, rng: np.random.Generator) -> None:
    """A whole wall with skirting, and posters here and there."""
    d = b - a
    across = np.array([0.0, inward]) if abs(d[0]) > abs(d[1]) else np.array([inward, 0.0])
    wall(mesh, a, b, across, 0.0, HEIGHT_M, p.wall)
    wall(mesh, a + 0.012 * across, b + 0.012 * across, across, 0.0, 0.09, p.metal)
    length = float(np.linalg.norm(d))
    at = rng.uniform(0.8, 3.0)
    while at < length - 0.8:
        hang(mesh, a + d / length * at, across, p, rng)
        at += rng.uniform(1.6, 5.0)


def _wall_with_door(
    mesh: MeshBuilder, room: Rect, door: Door, front: NDArray, p: Paint, rng: np.random.Generator, posters: float
) -> None:
    """One face of the wall between a room and its corridor: two pieces, a lintel, the frame, the leaf (open, against
    the wall inside)."""
    z = float(door.at[1])
    left, right = float(door.at[0]) - DOOR_M / 2, float(door.at[0]) + DOOR_M / 2
    thick = HALF_WALL_M * front
    for a, b, low in ((room[0], left, 0.0), (right, room[2], 0.0), (left, right, DOOR_HEIGHT_M)):
        wall(mesh, np.array([a, z]) + thick, np.array([b, z]) + thick, front, low, HEIGHT_M, p.wall)
        if low == 0.0:
            wall(mesh, np.array([a, z]) + 1.2 * thick, np.array([b, z]) + 1.2 * thick, front, 0.0, 0.09, p.metal)
    for x, side in ((left, 1.0), (right, -1.0)):
        wall(mesh, np.array([x, z - 0.06]), np.array([x, z + 0.06]), np.array([side, 0.0]), 0.0, DOOR_HEIGHT_M, p.wood)
        edge = np.array([x - side * 0.05, z]) + 1.15 * thick
        picture(mesh, edge, front, 0.10, 0.0, DOOR_HEIGHT_M + 0.05, p.wood)
    number = np.array([right + 0.35, z]) + thick
    if front @ door.into < 0:
        picture(mesh, number, front, 0.22, 1.5, 1.62, int(rng.choice(p.posters)))
    if rng.random() < posters:
        at = (
            float(rng.uniform(room[0] + 0.6, left - 0.6))
            if left - room[0] > 1.6 and rng.random() < 0.5
            else right + 1.1
        )
        if at < room[2] - 0.4:
            hang(mesh, np.array([at, z]) + thick, front, p, rng)


def _room(
    mesh: MeshBuilder, room: Rect, door: Door, p: Paint, blocked: list[Rect], rng: np.random.Generator
) -> list[tuple[float, float, float, float]]:
    """Floor, ceiling, walls, a window opposite the door, and nearly the same furniture in every room."""
    x0, z0, x1, z1 = room[0] + HALF_WALL_M, room[1] + HALF_WALL_M, room[2] - HALF_WALL_M, room[3] - HALF_WALL_M
    horizontal(mesh, room, 0.0, p.carpet, up=True)
    horizontal(mesh, room, HEIGHT_M, p.ceiling, up=False)
    _wall_with_door(mesh, room, door, door.into, p, rng, posters=0.3)
    far = z1 if door.into[1] > 0 else z0
    hinge = float(door.at[0]) - DOOR_M / 2 - 0.03
    leaf = np.array([hinge, float(door.at[1])]) + door.into * (HALF_WALL_M + 0.5)
    for side in (1.0, -1.0):
        across = np.array([side, 0.0])
        picture(mesh, leaf + 0.015 * across, across, 1.0, 0.02, DOOR_HEIGHT_M, p.door)
    blocked.append((hinge - 0.03, float(leaf[1]) - 0.5, hinge + 0.03, float(leaf[1]) + 0.5))
    wall(mesh, np.array([x0, far]), np.array([x1, far]), -door.into, 0.0, HEIGHT_M, p.wall)
    for k in range(2):
        picture(mesh, np.array([x0 + (k + 0.5) * (x1 - x0) / 2, far]), -door.into, 1.7, 0.95, 2.35, p.window)
    for x, inward in ((x0, 1.0), (x1, -1.0)):
        _wall_strip(mesh, np.array([x, z0]), np.array([x, z1]), inward, p, rng)
    back = np.array([(x0 + x1) / 2, far]) - door.into * 0.55
    for aside in (-1.2, 1.2):
        desk(mesh, back + np.array([aside, 0.0]), -door.into, p, blocked, rng)
    beside = np.array([x1 - 0.22, (z0 + z1) / 2 + rng.uniform(-0.5, 0.5)])
    shelf(mesh, beside, np.array([-1.0, 0.0]), p, blocked, rng)
    if rng.random() < 0.5:
        cabinet(mesh, np.array([x0 + 0.3, (z0 + z1) / 2 + rng.uniform(-0.8, 0.8)]), p, blocked, rng)
    centre = ((x0 + x1) / 2, (z0 + z1) / 2)
    lamp(mesh, *centre, p)
    return [
        (centre[0], -(HEIGHT_M - 0.15), centre[1], 1.1),
        (centre[0], -1.7, far - door.into[1] * 0.5, float(rng.uniform(0.1, 0.45))),
    ]


def _free(floor: Floor, blocked: list[Rect]) -> FreeSpace:
    """Where one may walk: corridors, rooms and doorways less the furniture, with the distance to what is in the way."""
    import cv2

    half = CORRIDOR_M / 2
    xs = [r[k] for r in floor.rooms for k in (0, 2)] + [floor.xs[0] - half, floor.xs[-1] + half]
    zs = [r[k] for r in floor.rooms for k in (1, 3)]
    origin = (min(xs) - 0.5, min(zs) - 0.5)
    w, h = int((max(xs) + 0.5 - origin[0]) / CELL_M), int((max(zs) + 0.5 - origin[1]) / CELL_M)
    free = np.zeros((h, w), np.uint8)

    def fill(r: Rect, value: int) -> None:
        c = [round((r[k] - origin[k % 2]) / CELL_M) for k in range(4)]
        free[max(c[1], 0) : c[3], max(c[0], 0) : c[2]] = value

    z0, z1 = floor.zs[0] - half, floor.zs[-1] + half
    for x in floor.xs:
        fill((x - half, z0, x + half, z1), 1)
    for z in floor.zs:
        fill((floor.xs[0] - half, z - half, floor.xs[-1] + half, z + half), 1)
    for r in floor.rooms:
        fill((r[0] + 0.06, r[1] + 0.06, r[2] - 0.06, r[3] - 0.06), 1)
    for d in floor.doors:
        fill((d.at[0] - DOOR_M / 2, d.at[1] - 0.12, d.at[0] + DOOR_M / 2, d.at[1] + 0.12), 1)
    for r in blocked:
        fill(r, 0)
    return FreeSpace(cv2.distanceTransform(free, cv2.DIST_L2, 5) * np.float32(CELL_M), origin, CELL_M)
