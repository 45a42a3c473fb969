"""A robot's odometry as chains: dead-reckoned poses and how their uncertainty grows."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np

from ..geometry import Array, se3_inverse, skew
from ..pose_graph.graph import Edge, EdgeKind, NodeId


@dataclass(frozen=True, eq=False)
class Chain:
    """Nodes that odometry joins one after the other.

    ``row`` of each node; ``poses`` ``(n, 4, 4)`` in the chain's own frame, whose origin is the middle of the nodes
    (far from it, small turns are large shifts, and covariances lose digits); ``covariance`` ``(n, 6, 6)`` of a pose
    against the first, in tangents of that frame. The relative pose of two nodes has the difference of theirs.
    """

    robot: int
    row: Mapping[NodeId, int]
    poses: Array
    covariance: Array


def chains(nodes: Iterable[NodeId], edges: Iterable[Edge]) -> list[Chain]:
    """The odometry chains of all robots, in order of nodes; a node that no odometry joins to the one before begins a
    new one.
    """
    step = {(min(e.i, e.j), max(e.i, e.j)): e for e in edges if e.kind is EdgeKind.ODOMETRY}
    runs: list[list[NodeId]] = []
    previous: NodeId | None = None
    for node in sorted(nodes):
        if previous is not None and (previous, node) in step:
            runs[-1].append(node)
        else:
            runs.append([node])
        previous = node
    return [_chain(run, step) for run in runs]


def covariances(edges: Iterable[Edge]) -> Array:
    """``(m, 6, 6)`` inverses of the edges' information; directions without any are next to unbounded."""
    information = np.array([e.information for e in edges]).reshape(-1, 6, 6)
    values, vectors = np.linalg.eigh(0.5 * (information + np.swapaxes(information, 1, 2)))
    floor = np.maximum(1e-12 * values[:, -1:], 1e-12)
    return (vectors / np.maximum(values, floor)[:, None, :]) @ np.swapaxes(vectors, 1, 2)


def adjoint(T: Array) -> Array:
    """``(..., 6, 6)``: tangents of B, translation first, in A, for ``T_A_B``."""
    R, t = T[..., :3, :3], T[..., :3, 3]
    out = np.zeros((*T.shape[:-2], 6, 6))
    out[..., :3, :3] = out[..., 3:, 3:] = R
    out[..., :3, 3:] = skew(t) @ R
    return out


def _chain(run: list[NodeId], step: Mapping[tuple[NodeId, NodeId], Edge]) -> Chain:
    edges = [step[pair] for pair in itertools.pairwise(run)]
    # An edge against the order is turned round: its error is then one of the earlier node's tangent.
    forward = [e.i < e.j for e in edges]
    poses = [np.eye(4)]
    for e, along in zip(edges, forward, strict=True):
        poses.append(poses[-1] @ (e.T_i_j if along else se3_inverse(e.T_i_j)))
    stacked = np.array(poses)
    stacked[:, :3, 3] -= stacked[:, :3, 3].mean(axis=0)
    covariance = np.zeros((len(run), 6, 6))
    if edges:
        at = np.array([k + 1 if along else k for k, along in enumerate(forward)])
        A = adjoint(stacked[at])
        covariance[1:] = np.cumsum(A @ covariances(edges) @ np.swapaxes(A, 1, 2), axis=0)
    return Chain(run[0].robot, {n: k for k, n in enumerate(run)}, stacked, covariance)
