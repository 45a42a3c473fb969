"""Streets as centre lines, and the map of the ground that they draw: carriageway, markings, kerbs, pavements, grass."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from maslam._kernels import kernel

from ..scene import textures
from ..scene.world import FreeSpace

Line = NDArray[np.float64]
ROAD_HALF_M = 5.2
"""Half the carriageway: a lane of 3.2 m and 2 m to park."""
PAVEMENT_M = 2.4
LANE_OFFSET_M = 1.6
"""The middle of the right lane from the centre line."""


@dataclass(frozen=True)
class Network:
    """``nodes`` ``(n, 2)`` crossings (x, z), metres; ``edges`` pairs of nodes; ``lines`` a centre line ``(k, 2)`` for
    each edge, from its first node to its second, points about a metre apart."""

    nodes: NDArray[np.float64]
    edges: tuple[tuple[int, int], ...]
    lines: tuple[Line, ...]

    def line(self, a: int, b: int) -> Line:
        """The centre line driven from node ``a`` to node ``b``."""
        if (a, b) in self.edges:
            return self.lines[self.edges.index((a, b))]
        return self.lines[self.edges.index((b, a))][::-1]

    def neighbours(self, node: int) -> list[int]:
        """Crossings that a street leads to from this one, sorted."""
        return sorted([b for a, b in self.edges if a == node] + [a for a, b in self.edges if b == node])


def town_network(rng: np.random.Generator) -> Network:
    """About 300 m x 300 m: a bent grid with a small square in the middle, some streets missing, most of them curved."""
    xs = np.array([-133.0, -76.0, -16.0, 15.0, 74.0, 133.0])
    zs = np.array([-133.0, -74.0, -15.0, 16.0, 76.0, 133.0])
    n = len(xs)
    nodes = np.stack(np.meshgrid(xs, zs, indexing="ij"), axis=-1).reshape(-1, 2)
    middle = {2 * n + 2, 2 * n + 3, 3 * n + 2, 3 * n + 3}
    jitter = rng.uniform(-6, 6, nodes.shape)
    jitter[sorted(middle)] *= 0.15
    nodes = nodes + jitter
    edges = [(i * n + j, i * n + j + 1) for i in range(n) for j in range(n - 1)]
    edges += [(i * n + j, (i + 1) * n + j) for i in range(n - 1) for j in range(n)]
    edges.sort()
    for k in rng.permutation(len(edges)).tolist():
        if len(edges) <= 2 * n * (n - 1) - 9:
            break
        a, b = edges[k % len(edges)]
        rest = [e for e in edges if e != (a, b)]
        degree = np.bincount(np.array(rest).ravel(), minlength=n * n)
        if {a, b} & middle or degree[a] < 3 or degree[b] < 3:
            continue
        edges = rest
    lines = tuple(_bent(nodes[a], nodes[b], rng) for a, b in edges)
    return Network(nodes, tuple(edges), lines)


def _bent(p: NDArray, q: NDArray, rng: np.random.Generator) -> Line:
    length = float(np.linalg.norm(q - p))
    bulge = 0.0 if length < 45 else float(rng.uniform(-0.09, 0.09)) * length
    t = np.linspace(0, 1, max(int(length), 2) + 1)
    across = np.array([-(q - p)[1], (q - p)[0]]) / length
    return p + t[:, None] * (q - p) + (bulge * np.sin(np.pi * t) ** 2)[:, None] * across


def first_passes(path: Line, apart_m: float = 9.0) -> tuple[Line, ...]:
    """The pieces of a path (points a metre apart) where it does not run along an earlier part of itself."""
    from scipy.spatial import cKDTree

    tree = cKDTree(path)
    again = np.array([any(j < k - 40 for j in near) for k, near in enumerate(tree.query_ball_point(path, apart_m))])
    cuts = np.flatnonzero(np.diff(again.astype(np.int8))) + 1
    pieces = [p for p, a in zip(np.split(path, cuts), np.split(again, cuts), strict=True) if not a[0]]
    return tuple(p for p in pieces if len(p) > 12)


@dataclass(frozen=True)
class GroundPlan:
    """A raster of the ground: ``origin`` (x, z) of its corner, ``cell_m``; ``distance`` ``(h, w)`` metres to the
    nearest centre line."""

    origin: tuple[float, float]
    cell_m: float
    distance: NDArray[np.float32]

    def index(self, xz: NDArray[np.float64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """(rows, columns) of points, clipped to the raster."""
        cell = np.rint((np.asarray(xz) - self.origin) / self.cell_m).astype(np.int64)
        h, w = self.distance.shape
        return np.clip(cell[..., 1], 0, h - 1), np.clip(cell[..., 0], 0, w - 1)


def ground_plan(lines: tuple[Line, ...], margin_m: float, cell_m: float = 0.5) -> GroundPlan:
    """Distances to the street lines over their bounding box grown by ``margin_m``."""
    import cv2

    points = np.concatenate(lines)
    low = np.floor(points.min(axis=0) - margin_m)
    size = np.ceil(points.max(axis=0) + margin_m) - low
    w, h = (int(s / cell_m) + 1 for s in size)
    mask = np.full((h, w), 255, np.uint8)
    cv2.polylines(mask, [_fixed(line, low, cell_m) for line in lines], False, 0, 1, cv2.LINE_8, 4)
    return GroundPlan(
        (float(low[0]), float(low[1])), cell_m, cv2.distanceTransform(mask, cv2.DIST_L2, 5) * np.float32(cell_m)
    )


def free_space(plan: GroundPlan, half_m: float = ROAD_HALF_M) -> FreeSpace:
    """The carriageway: clearance to its kerb."""
    return FreeSpace(np.maximum(half_m - plan.distance, 0), plan.origin, plan.cell_m)


def ground_image(
    plan: GroundPlan,
    lines: tuple[Line, ...],
    crossings: NDArray[np.float64],
    shade: NDArray[np.float32],
    rng: np.random.Generator,
    texel_m: float,
) -> NDArray[np.uint8]:
    """The ground seen from above, ``(h, w, 3)`` at ``texel_m``, rows along z; ``shade`` on the plan's raster darkens
    (contact shadows)."""
    import cv2

    h, w = (int(s * plan.cell_m / texel_m) // 64 * 64 for s in plan.distance.shape)
    marks = np.zeros((h, w), np.uint8)
    away = np.array(
        [[np.hypot(*(crossings - p).T).min() if len(crossings) else 99.0 for p in line] for line in lines], dtype=object
    )
    for line, distance in zip(lines, away, strict=True):
        _draw_markings(marks, line, np.asarray(distance, float), np.array(plan.origin), texel_m)
    for p in np.concatenate(lines)[rng.permutation(sum(map(len, lines)))[: sum(map(len, lines)) // 9]]:
        centre = tuple(int(v) for v in np.rint((p + rng.uniform(-4.5, 4.5, 2) - plan.origin) / texel_m * 8))
        if rng.random() < 0.35:  # manholes, repaired strips
            cv2.circle(marks, centre, int(0.33 / texel_m * 8), 70, -1, cv2.LINE_AA, 3)
        else:
            box = cv2.boxPoints(
                ((centre[0] / 8, centre[1] / 8), tuple(rng.uniform(0.5, 3.0, 2) / texel_m), float(rng.uniform(0, 90)))
            )
            cv2.fillPoly(marks, [np.rint(box * 8).astype(np.int32)], float(rng.uniform(30, 64)), cv2.LINE_AA, 3)
    tiles = np.stack(
        [
            textures.asphalt(rng),
            textures.paving(rng, 16, 16, (162, 156, 148)),
            textures.grass(rng),
            textures.weathering(rng),
        ]
    )
    out = np.empty((h, w, 3), np.uint8)
    _compose(
        plan.distance,
        np.float32(texel_m / plan.cell_m),
        shade,
        marks,
        tiles,
        np.float32(ROAD_HALF_M),
        np.float32(PAVEMENT_M),
        out,
    )
    return out


def _draw_markings(
    marks: NDArray[np.uint8], line: Line, away: NDArray[np.float64], origin: NDArray, texel_m: float
) -> None:
    """Centre dashes, edge lines, stop lines and zebra crossings; grey 255 is paint."""
    import cv2

    tangent = np.gradient(line, axis=0)
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    normal = np.stack([-tangent[:, 1], tangent[:, 0]], axis=1)

    def stroke(points: NDArray, width_m: float) -> None:
        cv2.polylines(
            marks, [_fixed(points, origin, texel_m)], False, 235, max(round(width_m / texel_m), 1), cv2.LINE_AA, 4
        )

    open_road = away > 13.0
    for k in range(0, len(line) - 3, 6):
        if open_road[k : k + 4].all():
            stroke(line[k : k + 4], 0.14)
    for side in (-1.0, 1.0):
        for k in range(0, len(line) - 1):
            if open_road[k] and open_road[k + 1]:
                stroke(line[k : k + 2] + side * 3.25 * normal[k : k + 2], 0.10)
    for k in range(1, len(line) - 1):
        if (away[k] >= 10.0) != (away[k - 1] >= 10.0):
            step = tangent[k] * (1.0 if away[k] > away[k - 1] else -1.0)
            for offset in np.arange(-4.6, 4.7, 1.0):
                stroke(np.stack([line[k] + offset * normal[k], line[k] + offset * normal[k] - 2.8 * step]), 0.5)
            side = 1.0 if step @ tangent[k] > 0 else -1.0
            stroke(
                np.stack(
                    [line[k] + 1.2 * step + side * 0.2 * normal[k], line[k] + 1.2 * step + side * 3.2 * normal[k]]
                ),
                0.35,
            )


def _fixed(points: NDArray, origin: object, cell_m: float) -> NDArray[np.int32]:
    """Sub-pixel integer coordinates with four fractional bits, as OpenCV draws them."""
    return np.rint((np.asarray(points) - np.asarray(origin)) / cell_m * 16).astype(np.int32)


@kernel
def _compose(
    distance: NDArray,
    ratio: np.float32,
    shade: NDArray,
    marks: NDArray,
    tiles: NDArray,
    half: np.float32,
    pavement: np.float32,
    out: NDArray,
) -> None:
    h, w = marks.shape
    size = tiles.shape[1] - 1
    for y in range(h):
        fy = min(y * ratio, distance.shape[0] - 1.001)
        y0 = int(fy)
        fy -= y0
        for x in range(w):
            fx = min(x * ratio, distance.shape[1] - 1.001)
            x0 = int(fx)
            fx -= x0
            w00, w01, w10, w11 = (1 - fx) * (1 - fy), fx * (1 - fy), (1 - fx) * fy, fx * fy
            d = (
                distance[y0, x0] * w00
                + distance[y0, x0 + 1] * w01
                + distance[y0 + 1, x0] * w10
                + distance[y0 + 1, x0 + 1] * w11
            )
            a = shade[y0, x0] * w00 + shade[y0, x0 + 1] * w01 + shade[y0 + 1, x0] * w10 + shade[y0 + 1, x0 + 1] * w11
            layer = 0 if d < half else (1 if d < half + pavement else 2)
            macro = tiles[3, (y // 7) & size, (x // 7) & size, 0] / 128.0
            a *= macro
            kerb = d >= half and d < half + 0.22
            gutter = d < half and d > half - 0.12
            paint = float(marks[y, x])
            for c in range(3):
                v = float(tiles[layer, y & size, x & size, c])
                if kerb:
                    v = 172.0 + 0.3 * (v - 128.0)
                elif gutter:
                    v *= 0.6
                if layer == 0 and paint > 0:
                    if paint <= 70:  # repairs: darker or lighter asphalt
                        v *= 0.55 + paint / 110.0
                    else:
                        v += (paint - v) * min(paint / 235.0, 1.0) * 0.85
                out[y, x, c] = np.uint8(min(max(v * a, 0.0), 255.0))
