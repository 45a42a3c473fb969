"""Paths through an office floor: round the corridors, now and then through a door into a room and out again."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from ..motion.paths import Line, resample, smoothed
from ..scene.world import FreeSpace
from .floor import CORRIDOR_M, Door, Floor

VISIT = 0.25
"""Share of the doors on the path that are gone through."""
ROUND_M = 0.6
"""Distance from a wall or a desk that a turn in a room must keep at least: the half of it."""


def tour(floor: Floor, free: FreeSpace, rng: np.random.Generator) -> Line:
    """A closed path ``(k, 2)``: an eight through all corridors, the middle one twice in the same direction, with visits
    to rooms."""
    (x0, x1), (za, zb, zc) = floor.xs, floor.zs
    corners = [(x0, za), (x1, za), (x1, zb), (x0, zb), (x0, zc), (x1, zc), (x1, zb), (x0, zb), (x0, za)]
    parts: list[Line] = []
    for a, b in pairwise(corners):
        leg = [np.array(a)]
        if a[1] == b[1]:
            beside = [d for d in floor.doors if abs(d.at[1] - a[1]) < CORRIDOR_M]
            for door in sorted(beside, key=lambda d: abs(float(d.at[0]) - a[0])):
                clear_of_corners = min(abs(door.at[0] - x0), abs(door.at[0] - x1)) > 2.2
                if rng.random() < VISIT and clear_of_corners and np.linalg.norm(door.at - leg[-1]) > 2.5:
                    leg.extend(_visit(door, a[1], free))
        parts.append(np.array(leg))
    return np.concatenate([*parts, np.array([corners[-1]])])


def _visit(door: Door, corridor_z: float, free: FreeSpace) -> list[NDArray[np.float64]]:
    """Through the door, round a circle inside, and out; nothing where the room leaves no place for it."""
    turn = 2 * np.pi * np.arange(1, 12) / 12
    for radius in (0.85, 0.7, 0.55):
        for side in (1.0, -1.0):
            centre = door.at + door.into * (1.15 + radius) + np.array([side * radius, 0.0])
            start = np.array([-side, 0.0])
            circle = [centre + radius * (np.cos(t) * start + np.sin(t) * door.into) for t in turn]
            inside = door.at + door.into * (1.0 + radius)
            loop = [
                np.array([door.at[0], corridor_z]),
                door.at + 0.6 * door.into,
                inside,
                *circle,
                inside,
                door.at + 0.6 * door.into,
                np.array([door.at[0], corridor_z]),
            ]
            if free.at(smoothed(resample(np.array(loop), 0.1), 3.5)).min() > ROUND_M / 2:
                return loop
    return []


def walk(path: Line, first: float, metres: float, length_m: float) -> Line:
    """``length_m`` of the closed ``path``: from ``metres`` after the part ``first`` (0 to 1) of it, gone round as often
    as it takes."""
    points = resample(path, 0.1)
    start = int(first * len(points) + metres / 0.1)
    return points[(start + np.arange(int(length_m / 0.1) + 1)) % len(points)]
