"""What stands along the streets: cars at the kerb, lamps, signs, benches and trees; trees on the grass behind."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..scene import props
from ..scene.mesh import Mesh, MeshBuilder
from .buildings import SOLID
from .streets import ROAD_HALF_M, GroundPlan, Line
from .terrain import Terrain

KERB_M = ROAD_HALF_M + 0.5


@dataclass(frozen=True)
class Street:
    """What furnishing needs to know; ``cars`` and ``trees`` (by rising height) are made once and stand in many
    places."""

    plan: GroundPlan
    terrain: Terrain
    crossings: NDArray[np.float64]
    stuff: props.Stuff
    cars: list[Mesh]
    trees: list[Mesh]

    def foot(self, at: NDArray[np.float64]) -> float:
        """Height of the ground at (x, z)."""
        return float(self.terrain.height(at))


def furnish(
    mesh: MeshBuilder, lines: tuple[Line, ...], street: Street, taken: NDArray[np.uint8], rng: np.random.Generator
) -> list[Mesh]:
    """Cars at the kerb, lamps, signs, trees and furniture on the pavements, trees on free grass; returns the cars."""
    out: list[Mesh] = []
    for line in lines:
        tangent = np.gradient(line, axis=0)
        tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
        for side in (1.0, -1.0):
            _pavement(mesh, line, tangent, side, street, out, rng)
    plan = street.plan
    for p in (
        rng.uniform(np.zeros(2), np.array(plan.distance.shape[::-1]) * plan.cell_m, (int(plan.distance.size / 300), 2))
        + plan.origin
    ):
        row, col = plan.index(p)
        r = int(2.5 / plan.cell_m)
        near = taken[max(row - r, 0) : row + r + 1, max(col - r, 0) : col + r + 1]
        if not near.any() and plan.distance[row, col] < 26:
            out.append(props.placed(street.trees[int(rng.integers(10))], p, _direction(rng), street.foot(p)))
            taken[row - r : row + r + 1, col - r : col + r + 1] = 2
    return out


def _pavement(
    mesh: MeshBuilder,
    line: Line,
    tangent: NDArray,
    side: float,
    street: Street,
    out: list[Mesh],
    rng: np.random.Generator,
) -> None:
    """Everything on one side of one street."""
    plan, crossings = street.plan, street.crossings
    next_car, next_thing = rng.uniform(0, 12), rng.uniform(0, 6)
    for k in range(len(line)):
        right = side * np.array([tangent[k, 1], -tangent[k, 0]])
        clear = len(crossings) == 0 or np.hypot(*(crossings - line[k]).T).min() > 15.0
        if k >= next_car and clear:
            at = line[k] + right * (ROAD_HALF_M - 1.0)
            if plan.distance[plan.index(at)] > ROAD_HALF_M - 1.7:
                car = street.cars[int(rng.integers(len(street.cars)))]
                out.append(props.placed(car, at + rng.normal(0, 0.08, 2), tangent[k] * side, street.foot(at)))
            next_car = k + 5.6 + (rng.exponential(9.0) if rng.random() < 0.6 else 0.0)
        if k >= next_thing:
            at = line[k] + right * KERB_M
            if plan.distance[plan.index(at)] > ROAD_HALF_M + 0.25:
                _thing(mesh, at, -right, street, out, rng)
            next_thing = k + rng.uniform(4.0, 11.0)


def _direction(rng: np.random.Generator) -> NDArray[np.float64]:
    angle = rng.uniform(0, 2 * np.pi)
    return np.array([np.sin(angle), np.cos(angle)])


def _thing(
    mesh: MeshBuilder, at: NDArray, towards: NDArray, street: Street, out: list[Mesh], rng: np.random.Generator
) -> None:
    foot, stuff = street.foot(at), street.stuff
    kind = rng.random()
    if kind < 0.30:
        out.append(props.placed(street.trees[int(rng.integers(5))], at - towards * 0.5, _direction(rng), foot))
    elif kind < 0.55:
        props.lamp_post(mesh, at, towards, foot, stuff, rng)
    elif kind < 0.80:
        props.sign_post(mesh, at, towards, foot, stuff, rng)
    elif kind < 0.9:
        props.bench(mesh, at - towards * 1.2, towards, foot, stuff)
    else:
        props.bin_box(mesh, at - towards * 0.3, towards, foot, stuff, rng)


def contact_shade(taken: NDArray[np.uint8]) -> NDArray[np.float32]:
    """Darker ground at the feet of houses (2 in ``taken``: under trees)."""
    import cv2

    footprint = cv2.GaussianBlur((taken == SOLID).astype(np.float32), (0, 0), 1.6)
    return 1.0 - 0.45 * footprint
