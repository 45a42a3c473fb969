"""Routes of the agents: own start points, and by design stretches that others drive in the same direction at
another time."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..motion.paths import Line, resample
from .streets import LANE_OFFSET_M, Network

BIN_M = 4.0
CANDIDATES = 400
CORNER_M = 9.5
"""Where a turn begins and ends, metres from the crossing."""

Stretch = tuple[int, int, int]
"""From node, to node, number of the piece of ``BIN_M`` on that street."""


@dataclass(frozen=True)
class Route:
    """``nodes`` passed in turn; the route begins ``start_m`` after the first; ``stretches``: pieces of lane driven, in
    order."""

    nodes: tuple[int, ...]
    start_m: float
    stretches: tuple[Stretch, ...]


def plan_routes(
    network: Network, agents: int, length_m: float, rng: np.random.Generator, candidates: int = CANDIDATES
) -> list[Route]:
    """A route of at least ``length_m`` for each agent. Each is the best of many random ones: it shares about half its
    path with the agents before it, with several of them if it can, comes back on its own tracks if it is long enough,
    and starts at a place of its own."""
    lengths = {e: _length(network, *e) for a, b in network.edges for e in ((a, b), (b, a))}
    routes: list[Route] = []
    for _ in range(agents):
        driven = [set(r.stretches) for r in routes]
        best, best_score = None, -np.inf
        for _ in range(candidates):
            candidate = _random_route(network, lengths, length_m, routes, rng)
            score = _score(candidate, driven, [r.stretches[0] for r in routes])
            if score > best_score:
                best, best_score = candidate, score
        assert best is not None
        routes.append(best)
    return routes


def _score(route: Route, driven: list[set[Stretch]], starts: list[Stretch]) -> float:
    pieces = list(route.stretches)
    own = set(pieces)
    revisited = 1.0 - len(own) / len(pieces)
    score = 2.0 * min(revisited, 0.25)
    if not driven:
        return score
    shared = np.array([len(own & other) / len(own) for other in driven])
    union = len(own & set().union(*driven)) / len(own)
    score += (
        2.0 * min(union, 0.6)
        - 4.0 * max(union - 0.75, 0.0)
        + 0.25 * int(min((shared * len(own) * BIN_M > 24.0).sum(), 3))
    )
    near = any(a[:2] == pieces[0][:2] and abs(a[2] - pieces[0][2]) * BIN_M < 16.0 for a in starts)
    return score - 1.0 * near


def _random_route(
    network: Network,
    lengths: dict[tuple[int, int], float],
    length_m: float,
    others: list[Route],
    rng: np.random.Generator,
) -> Route:
    ways = sorted(lengths)
    if others and rng.random() < 0.8:  # begin where somebody drives, or on a street that leads there
        other = others[int(rng.integers(len(others)))]
        a, b, _ = other.stretches[int(rng.integers(len(other.stretches)))]
        before = [n for n in network.neighbours(a) if n != b]
        if rng.random() < 0.5 and before:
            a, b = before[int(rng.integers(len(before)))], a
    else:
        a, b = ways[int(rng.integers(len(ways)))]
    start = float(rng.uniform(CORNER_M + 1, max(0.6 * lengths[a, b], CORNER_M + 2)))
    nodes, stretches, at = [a, b], [], start
    habit = int(rng.integers(-1, 2))
    while True:
        while at < lengths[nodes[-2], nodes[-1]]:
            stretches.append((nodes[-2], nodes[-1], int(at / BIN_M)))
            at += BIN_M
            if len(stretches) * BIN_M >= length_m:
                return Route(tuple(nodes), start, tuple(stretches))
        at -= lengths[nodes[-2], nodes[-1]]
        onward = [n for n in network.neighbours(nodes[-1]) if n != nodes[-2]]
        nodes.append(_next(network, nodes, onward, habit, rng))


def _next(network: Network, nodes: list[int], onward: list[int], habit: int, rng: np.random.Generator) -> int:
    """Where to go at a crossing: anywhere (``habit`` 0), or always the sharpest left (-1) or right (1), which goes
    round a block."""
    if habit == 0:
        return onward[int(rng.integers(len(onward)))]
    here = network.nodes[nodes[-1]]
    came, ways = here - network.nodes[nodes[-2]], network.nodes[onward] - here
    turns = np.arctan2(came[1] * ways[:, 0] - came[0] * ways[:, 1], ways @ came)  # positive to the right
    return onward[int(np.argmax(habit * turns))]


def lane_line(network: Network, route: Route, extra_m: float) -> Line:
    """The middle of the right lane along ``route``, turns rounded, gone on for ``extra_m`` after its last node, points
    0.5 m apart."""
    nodes = list(route.nodes)
    reach = 0.0
    while reach < extra_m:
        onward = [n for n in network.neighbours(nodes[-1]) if n != nodes[-2]]
        nodes.append(onward[0])
        reach += _length(network, *nodes[-2:])
    parts: list[Line] = []
    for k in range(len(nodes) - 1):
        lane = _lane(network.line(nodes[k], nodes[k + 1]))
        s = np.arange(len(lane)) * 0.5
        begin = route.start_m if k == 0 else CORNER_M
        piece = lane[(s >= begin) & (s <= s[-1] - CORNER_M)]
        if not len(piece):
            continue
        if parts:
            parts.append(_turn(parts[-1], piece))
        parts.append(piece)
    return np.concatenate(parts)


def _lane(centre: Line) -> Line:
    points = resample(centre, 0.5)
    tangent = np.gradient(points, axis=0)
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    return points + LANE_OFFSET_M * np.stack([tangent[:, 1], -tangent[:, 0]], axis=1)


def _turn(before: Line, after: Line) -> Line:
    """A cubic Bezier curve that leaves ``before`` and enters ``after`` along their directions."""
    p, q = before[-1], after[0]
    out, into = _unit(before[-1] - before[-2]), _unit(after[1] - after[0])
    handle = 0.46 * np.linalg.norm(q - p)
    t = np.linspace(0, 1, max(int(np.linalg.norm(q - p) * 2.4), 3))[1:-1, None]
    return (
        (1 - t) ** 3 * p
        + 3 * t * (1 - t) ** 2 * (p + handle * out)
        + 3 * t**2 * (1 - t) * (q - handle * into)
        + t**3 * q
    )


def _unit(v: NDArray[np.float64]) -> NDArray[np.float64]:
    return v / np.linalg.norm(v)


def _length(network: Network, a: int, b: int) -> float:
    return float(np.linalg.norm(np.diff(network.line(a, b), axis=0), axis=1).sum())
