"""Priors of a member in its contribution: bytes. A position takes 16 to 33, a whole pose 24 more."""

from __future__ import annotations

import numpy as np

from ..central.origin import NO_PRIORS, OriginPriors
from ..errors import BackendError
from ..geometry import se3
from ..pose_graph.graph import NodeId
from .compact import CompactReader, CompactWriter, numbers_of, poses_of

_TURNS, _LEVER, _BOUND, _WEIGHT = 1, 2, 4, 8
"""What a prior has: weight on rotation, a lever, a bound, other weights than the one before it."""


def write_priors(out: CompactWriter, priors: OriginPriors) -> None:
    """Node indices as differences, positions in single precision from the first one."""
    out.count(len(priors))
    if not len(priors):
        return
    corner = priors.measured[0, :3, 3]
    for value in corner.tolist():
        out.number(value)
    before, weights = 0, (0.0, 0.0)
    for k, node in enumerate(priors.nodes):
        mine = (float(np.float32(priors.kappa[k])), float(np.float32(priors.tau[k])))
        has = (_TURNS * (mine[0] > 0)) | (_LEVER * bool(priors.lever[k].any()))
        has |= (_BOUND * bool(np.isfinite(priors.bound[k]))) | (_WEIGHT * (mine != weights))
        out.signed(node.index - before)
        out.count(int(has))
        if has & _WEIGHT:
            out.weights(*mine)
        if has & _TURNS:
            out.rough_pose(numbers_of(priors.measured[k]).tolist())
        out.weights(*(priors.measured[k, :3, 3] - corner).tolist())
        if has & _LEVER:
            out.weights(*priors.lever[k].tolist())
        if has & _BOUND:
            out.rough(float(priors.bound[k]))
        before, weights = node.index, mine


def read_priors(source: CompactReader, robot: int) -> OriginPriors:
    """Inverse of :func:`write_priors`."""
    count = source.count()
    if not count:
        return NO_PRIORS
    corner = np.array([source.number() for _ in range(3)])
    index, weights = 0, (0.0, 0.0)
    nodes, poses, kappa, tau, lever, bound = [], [], [], [], [], []
    for _ in range(count):
        index += source.signed()
        has = source.count()
        if index < 0:
            raise BackendError(f"robot {robot} sent a prior on node {index}")
        if has & _WEIGHT:
            first, second = source.weights(2)
            weights = first, second
        T = np.eye(4)
        if has & _TURNS:
            T = poses_of(source.rough_pose())
        T = se3(T[:3, :3], corner + source.weights(3))
        nodes.append(NodeId(robot, index))
        poses.append(T)
        kappa.append(weights[0])
        tau.append(weights[1])
        lever.append(source.weights(3) if has & _LEVER else (0.0, 0.0, 0.0))
        bound.append(source.rough() if has & _BOUND else np.inf)
    arrays = (np.array(poses), np.array(kappa), np.array(tau), np.array(lever), np.array(bound))
    if not all(np.isfinite(a).all() for a in arrays[:4]) or (arrays[1] < 0).any() or (arrays[2] < 0).any():
        raise BackendError(f"robot {robot} sent priors that are no numbers")
    return OriginPriors(tuple(nodes), *arrays)
