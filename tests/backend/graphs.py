"""Synthetic pose graphs of which the truth is known: a grid, a circle, robots on crossing loops."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.spatial import cKDTree

from maslam.backend.geometry import se3, se3_exp, se3_inverse, so3_exp
from maslam.backend.pose_graph.graph import Edge, EdgeKind, NodeId, PoseGraph, spread_poses


def loops(rng, robots=4, length=100, separators=8, sigma_t=0.02, sigma_deg=0.1, step=1.0):
    """Robots on overlapping circles, noisy odometry, ``separators`` matches between neighbours in a ring.

    Returns the graph, each robot's poses spread from its own first pose in its own frame, and the true poses.
    """
    radius = length * step / (2 * np.pi)
    truth = {}
    for r in range(robots):
        centre = 1.2 * radius * np.array([np.cos(2 * np.pi * r / robots), 0.0, np.sin(2 * np.pi * r / robots)])
        for k in range(length):
            angle = 2 * np.pi * k / length
            position = centre + radius * np.array([np.sin(angle), 0.02 * np.sin(3 * angle), np.cos(angle)])
            truth[NodeId(r, k)] = se3(so3_exp([0.0, angle + np.pi / 2, 0.0]), position)
    sigma = np.array([sigma_t] * 3 + [np.radians(sigma_deg)] * 3)
    information = np.diag(1.0 / np.maximum(sigma, 1e-3) ** 2)
    edges = [
        measured(truth, NodeId(r, k), NodeId(r, k + 1), EdgeKind.ODOMETRY, sigma, information, rng)
        for r in range(robots)
        for k in range(length - 1)
    ]
    for r in range(robots):
        other = (r + 1) % robots
        if other == r:
            continue
        i, j = sorted([r, other])
        near = sorted(
            (
                (np.linalg.norm(truth[NodeId(i, a)][:3, 3] - truth[NodeId(j, b)][:3, 3]), a, b)
                for a in range(length)
                for b in range(length)
            ),
        )[: separators * 3 : 3]
        edges += [
            measured(truth, NodeId(i, a), NodeId(j, b), EdgeKind.SEPARATOR, sigma, information, rng) for _, a, b in near
        ]
    poses = {}
    for r in range(robots):
        own = [e for e in edges if e.i.robot == e.j.robot == r]
        poses |= spread_poses({NodeId(r, 0): np.eye(4)}, own)
    return PoseGraph(poses, tuple(edges)), truth


def constant_units(graph):
    """The same graph, whose edges' scales are exact: units do not drift."""
    return replace(graph, edges=tuple(replace(e, scale_sigma=1e-4) for e in graph.edges))


def drifting(graph, truth, units):
    """Exact edges of ``truth`` as nodes with these ``units`` measure them, scale included; poses as they are."""
    edges = []
    for e in graph.edges:
        T = se3_inverse(truth[e.i]) @ truth[e.j]
        T[:3, 3] /= units[e.i]
        edges.append(replace(e, T_i_j=T, scale=units[e.j] / units[e.i]))
    return replace(graph, edges=tuple(edges))


def town(rng, robots=10, length=200, separators=4, sigma_t=0.02, sigma_deg=0.2):
    """Robots on a lattice of blocks, each driving round its own (closed by two loops), metre by metre; crossings with
    the next blocks give ``separators`` matches each. Returns the graph, poses by odometry in own frames, and the truth.
    """
    across = int(np.ceil(np.sqrt(robots)))
    radius = length / (2 * np.pi)
    truth = {}
    for r in range(robots):
        centre = 1.7 * radius * np.array([r % across, 0.0, r // across])
        for k in range(length):
            angle = 2 * np.pi * k / length + r
            position = centre + radius * np.array([np.sin(angle), 0.02 * np.sin(3 * angle), np.cos(angle)])
            truth[NodeId(r, k)] = se3(so3_exp([0.0, angle + np.pi / 2, 0.0]), position)
    sigma = np.array([sigma_t] * 3 + [np.radians(sigma_deg)] * 3)
    information = np.diag(1.0 / sigma**2)
    pairs = [(NodeId(r, k), NodeId(r, k + 1), EdgeKind.ODOMETRY) for r in range(robots) for k in range(length - 1)]
    pairs += [(NodeId(r, k), NodeId(r, length - 1 - k), EdgeKind.LOOP) for r in range(robots) for k in range(2)]
    for r in range(robots):
        for other in (r + 1, r + across):
            if other >= robots or (other == r + 1 and other % across == 0):
                continue
            ours, theirs = (np.array([truth[NodeId(x, k)][:3, 3] for k in range(length)]) for x in (r, other))
            distance, nearest = cKDTree(theirs).query(ours)
            best = np.argsort(distance, kind="stable")[: 3 * separators : 3]
            pairs += [(NodeId(r, int(k)), NodeId(other, int(nearest[k])), EdgeKind.SEPARATOR) for k in best]
    edges = [measured(truth, i, j, kind, sigma, information, rng) for i, j, kind in pairs]
    poses = {}
    for r in range(robots):
        own = [e for e in edges if e.i.robot == e.j.robot == r and e.kind is EdgeKind.ODOMETRY]
        poses |= spread_poses({NodeId(r, 0): np.eye(4)}, own)
    return PoseGraph(poses, tuple(edges)), truth


def with_wrong_edges(graph, rng, count, reach=6.0):
    """The graph and ``count`` matches more that are wrong: between any two nodes, up to ``reach`` metres off. Returns
    it with the set of their (i, j).
    """
    taken, nodes, wrong = {(e.i, e.j) for e in graph.edges}, graph.nodes, []
    information = next(e.information for e in graph.edges if e.is_separator)
    while len(wrong) < count:
        i, j = sorted(nodes[k] for k in rng.choice(len(nodes), 2, replace=False))
        if (i, j) in taken or (i.robot == j.robot and j.index - i.index < 5):
            continue
        taken.add((i, j))
        T = se3(so3_exp(rng.normal(size=3)), rng.uniform(-reach, reach, 3))
        kind = EdgeKind.SEPARATOR if i.robot != j.robot else EdgeKind.LOOP
        wrong.append(Edge(i, j, T, information, kind))
    return replace(graph, edges=(*graph.edges, *wrong)), {(e.i, e.j) for e in wrong}


def with_look_alikes(graph, truth, rng, share, agreeing=0.5):
    """The graph and so many wrong matches between robots that they are this ``share`` of all; ``agreeing`` of them in
    groups of 3 to 8 that agree with each other: a street of one robot taken for one of another. Returns it and the set
    of the wrong ones' (i, j); right and wrong ones stand in random order.
    """
    right = [e for e in graph.edges if e.is_separator]
    count = round(len(right) * share / (1.0 - share))
    taken, wrong, information = {(e.i, e.j) for e in graph.edges}, [], right[0].information
    sigma, own = 1.0 / np.sqrt(np.diag(information)), {}
    for n in sorted(truth):
        own.setdefault(n.robot, []).append(n)

    def add(i, j, T):
        if (i, j) not in taken and len(wrong) < count:
            taken.add((i, j))
            wrong.append(Edge(i, j, T @ se3_exp(sigma * rng.normal(size=6)), information, EdgeKind.SEPARATOR))

    while len(wrong) < count * agreeing:
        a, b = sorted(rng.choice(sorted(own), 2, replace=False).tolist())
        size = int(rng.integers(3, 9))
        i, j = int(rng.integers(len(own[a]) - 2 * size)), int(rng.integers(len(own[b]) - 2 * size))
        # Where robot b would be if the two places were one.
        move = truth[own[a][i]] @ se3_exp(0.3 * rng.normal(size=6)) @ se3_inverse(truth[own[b][j]])
        if np.linalg.norm((move @ truth[own[b][j]] - truth[own[b][j]])[:3, 3]) < 4.0:
            continue
        for k in range(0, 2 * size, 2):
            ends = own[a][i + k], own[b][j + k]
            add(*ends, se3_inverse(truth[ends[0]]) @ move @ truth[ends[1]])
    while len(wrong) < count:
        a, b = sorted(rng.choice(sorted(own), 2, replace=False).tolist())
        ends = own[a][int(rng.integers(len(own[a])))], own[b][int(rng.integers(len(own[b])))]
        add(*ends, se3(so3_exp(rng.normal(size=3)), rng.uniform(-6.0, 6.0, 3)))
    odometry = [e for e in graph.edges if not e.is_separator]
    both = [*right, *wrong]
    shuffled = [both[k] for k in rng.permutation(len(both))]
    return replace(graph, edges=(*odometry, *shuffled)), {(e.i, e.j) for e in wrong}


def measured(truth, i, j, kind, sigma, information, rng, scale=1.0):
    """The true relative pose with noise of ``sigma`` ``(6,)``."""
    T = se3_inverse(truth[i]) @ truth[j] @ se3_exp(sigma * rng.normal(size=6))
    return Edge(i, j, T, information, kind, scale)


def grid(rng, robots_across=2, side=3, sigma=0.05):
    """A planar lattice of robots, each a lattice of nodes: odometry along rows, loops and separators between
    neighbours.
    """
    truth, cell = {}, {}
    for rx in range(robots_across):
        for ry in range(robots_across):
            for k in range(side * side):
                x, y = rx * side + k % side, ry * side + k // side
                node = NodeId(rx * robots_across + ry, k)
                truth[node] = se3(so3_exp(0.5 * rng.normal(size=3)), [x, y, 0.3 * rng.normal()])
                cell[x, y] = node
    edges = []
    for (x, y), a in sorted(cell.items()):
        for neighbour in ((x + 1, y), (x, y + 1)):
            if neighbour in cell:
                i, j = sorted([a, cell[neighbour]])
                kind = EdgeKind.SEPARATOR if i.robot != j.robot else EdgeKind.LOOP
                edges.append(measured(truth, i, j, kind, np.full(6, sigma), np.eye(6), rng))
    start = {n: T @ se3_exp(0.3 * rng.normal(size=6)) for n, T in truth.items()}
    return PoseGraph(start, tuple(edges)), truth


def spoiled(rng, wrong=10, **kwargs):
    """Robots on loops with ``wrong`` separators of random poses; the graph, which edges are right, and the truth."""
    graph, truth = loops(rng, **kwargs)
    nodes, edges = graph.nodes, list(graph.edges)
    information = edges[0].information
    while len(edges) < len(graph.edges) + wrong:
        i, j = sorted(nodes[k] for k in rng.choice(len(nodes), 2, replace=False))
        if i.robot != j.robot or j.index - i.index > 5:
            T = se3(so3_exp(np.pi * rng.uniform(-0.5, 0.5, 3)), rng.uniform(-8, 8, 3))
            kind = EdgeKind.SEPARATOR if i.robot != j.robot else EdgeKind.LOOP
            edges.append(Edge(i, j, T, information, kind))
    right = np.arange(len(edges)) < len(graph.edges)
    order = rng.permutation(len(edges))
    return replace(graph, edges=tuple(edges[k] for k in order)), right[order], truth


def ring(robots, poses, seed, backwards=False):
    """Robots one after the other on a circle, a metre a step; each meets the next once, and the last the first."""
    rng = np.random.default_rng(seed)
    total = robots * poses
    radius = total / (2 * np.pi)
    turns = 2 * np.pi * np.arange(total) / total
    truth = {
        NodeId(*divmod(k, poses)): se3(so3_exp([0, 0, a]), [radius * np.sin(a), radius * (1 - np.cos(a)), 0])
        for k, a in enumerate(turns)
    }

    sigma = np.array([0.02, 0.02, 0.02, 0.002, 0.002, 0.002])

    def edge(i, j, kind):
        return measured(truth, i, j, kind, sigma, np.diag(sigma**-2.0), rng)

    edges = [edge(NodeId(r, k), NodeId(r, k + 1), EdgeKind.ODOMETRY) for r in range(robots) for k in range(poses - 1)]
    ends = [(NodeId(r, poses - 1), NodeId((r + 1) % robots, 0)) for r in range(robots)]
    edges += [edge(*(pair[::-1] if backwards else pair), EdgeKind.SEPARATOR) for pair in ends]
    start = {}
    for r in range(robots):
        own = [e for e in edges if e.kind is EdgeKind.ODOMETRY and e.i.robot == r]
        start |= spread_poses({NodeId(r, 0): np.eye(4)}, own)
    return PoseGraph(start, tuple(edges))
