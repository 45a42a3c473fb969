"""Cars: a profile drawn out to the width, covered with the pictures of ``car_pictures``."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..scene.mesh import Mesh, MeshBuilder
from ..scene.props import Stuff

Floats = NDArray[np.float64]

PROFILE = np.array(
    [
        (-2.15, 0.28),
        (-2.2, 0.55),
        (-2.15, 0.88),
        (-1.75, 0.95),
        (-1.25, 1.42),
        (0.35, 1.45),
        (1.05, 0.98),
        (1.95, 0.82),
        (2.18, 0.6),
        (2.15, 0.28),
    ]
)
"""Side of a car from behind to its nose: metres along it, metres above the ground."""


def car_mesh(stuff: Stuff, tint: Floats, look: int) -> Mesh:
    """A parked or driving car about the origin on the ground, nose to +Z."""
    mesh = MeshBuilder()
    half_low, half_high = 0.86, 0.66
    half = np.where(PROFILE[:, 1] > 1.1, half_high, half_low)
    left = np.stack([-half, -PROFILE[:, 1], PROFILE[:, 0]], axis=1)
    right = left * (-1, 1, 1)
    side = stuff.car_sides[look % len(stuff.car_sides)]
    uv = np.stack([(PROFILE[:, 0] + 2.25) / 4.5, 1.0 - PROFILE[:, 1] / 1.5], axis=1)
    centre = np.array([0.0, 0.7])
    fan = [(i, (i + 1) % len(PROFILE)) for i in range(len(PROFILE))]
    for points, order in ((left, (0, 2, 1)), (right, (0, 1, 2))):
        hub = np.array([np.sign(points[0, 0]) * half_low, -centre[1], centre[0]])
        triangles = np.array([[hub, points[i], points[j]] for i, j in fan])[:, list(order)]
        uvs = np.array([[((0 + 2.25) / 4.5, 1 - 0.7 / 1.5), uv[i], uv[j]] for i, j in fan])[:, list(order)]
        quads, quad_uv = triangles[:, [0, 1, 2, 2]], uvs[:, [0, 1, 2, 2]]
        mesh.quads(quads, quad_uv, side, tint)
    front = stuff.car_fronts[look % len(stuff.car_fronts)]
    for k in range(len(PROFILE) - 1):
        a, b, c, d = left[k], left[k + 1], right[k + 1], right[k]
        length = float(np.linalg.norm(b - a))
        glass = k in (3, 5)
        if k in (0, 1, 7, 8):
            v0, v1 = 1 + a[1], 1 + b[1]  # the picture shows the lowest metre
            mesh.quads(
                np.array([[a, d, c, b]])[:, ::-1],
                np.array([[(0, v0), (1, v0), (1, v1), (0, v1)]])[:, ::-1],
                front,
                tint,
            )
        else:
            uv_k = np.array([[(0, 0), (1.7, 0), (1.7, -length), (0, -length)]])
            mesh.quads(
                np.array([[a, d, c, b]])[:, ::-1],
                uv_k[:, ::-1],
                stuff.rubber if glass else stuff.paint,
                (1.6, 1.8, 2.1) if glass else tint,
            )
    return mesh.build()
