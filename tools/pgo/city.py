"""Pose graphs of any size with a known truth: robots that drive through the streets of one city and meet."""

from __future__ import annotations

import numpy as np

from maslam.backend.geometry import Array, se3, se3_exp, se3_inverse, so3_exp
from maslam.backend.pose_graph.graph import Edge, EdgeKind, NodeId, PoseGraph, spread_poses

BLOCK = 8
"""Steps of a metre from crossing to crossing."""
_ROOM = 1.5
"""Square metres of city for each pose: the same density at any size."""
_SIGMA = np.array([0.02, 0.02, 0.02, 0.002, 0.002, 0.002])
_INFORMATION = np.diag(1.0 / _SIGMA**2)
"""One for all edges: of large cities copies are much of the memory."""
_HEADINGS = ((0, 1), (1, 0), (0, -1), (-1, 0))


def city(robots: int, poses: int, seed: int = 0, meetings: int = 6) -> tuple[PoseGraph, dict[NodeId, Array]]:
    """``robots`` that drive ``poses`` metres each; returns the graph, each robot's poses by odometry from its own
    start, and the true poses.

    A key-frame that comes by a place where another robot, or the same one much earlier, looked the same way is matched
    with it, at most ``meetings`` times for each pair of robots.
    """
    rng = np.random.default_rng(seed)
    side = max(2, round(float(np.sqrt(robots * poses * _ROOM)) / BLOCK))
    truth: dict[NodeId, Array] = {}
    at: dict[tuple[int, int, int], list[NodeId]] = {}
    edges: list[Edge] = []
    matched: dict[tuple[int, int], int] = {}
    for robot in range(robots):
        for index, (x, y, heading) in enumerate(_drive(rng, side, poses)):
            node = NodeId(robot, index)
            truth[node] = se3(so3_exp([0.0, 0.0, -0.5 * np.pi * heading]), [x, y, 0.0])
            if index:
                edges.append(_measured(truth, NodeId(robot, index - 1), node, EdgeKind.ODOMETRY, rng))
            earlier = at.setdefault((x, y, heading), [])
            for other in earlier[-3:]:
                pair = (other.robot, robot)
                recent = other.robot == robot and index - other.index < 4 * BLOCK
                if recent or matched.get(pair, 0) >= meetings:
                    continue
                matched[pair] = matched.get(pair, 0) + 1
                kind = EdgeKind.LOOP if other.robot == robot else EdgeKind.SEPARATOR
                edges.append(_measured(truth, other, node, kind, rng))
            earlier.append(node)
    start: dict[NodeId, Array] = {}
    for robot in range(robots):
        own = [e for e in edges if e.kind is EdgeKind.ODOMETRY and e.i.robot == robot]
        start |= spread_poses({NodeId(robot, 0): np.eye(4)}, own)
    return PoseGraph(start, tuple(edges)), truth


def _drive(rng: np.random.Generator, side: int, steps: int) -> list[tuple[int, int, int]]:
    """Positions and headings, metre by metre; at each crossing left, right or straight on."""
    x, y = (int(v) * BLOCK for v in rng.integers(0, side + 1, 2))
    heading = int(rng.integers(4))
    path: list[tuple[int, int, int]] = []
    while len(path) < steps:
        if x % BLOCK == 0 and y % BLOCK == 0:
            options = [h for h in ((heading + turn) % 4 for turn in (0, 0, 1, 3)) if _inside(x, y, h, side)]
            heading = int(rng.choice(options)) if options else (heading + 2) % 4
        x, y = x + _HEADINGS[heading][0], y + _HEADINGS[heading][1]
        path.append((x, y, heading))
    return path


def _inside(x: int, y: int, heading: int, side: int) -> bool:
    dx, dy = _HEADINGS[heading]
    return 0 <= x + BLOCK * dx <= side * BLOCK and 0 <= y + BLOCK * dy <= side * BLOCK


def _measured(truth: dict[NodeId, Array], i: NodeId, j: NodeId, kind: EdgeKind, rng: np.random.Generator) -> Edge:
    T = se3_inverse(truth[i]) @ truth[j] @ se3_exp(_SIGMA * rng.standard_normal(6))
    return Edge(i, j, T, _INFORMATION, kind)
