"""Levenberg-Marquardt by gtsam: the one file that knows it."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..config import CentralConfig
from ..errors import BackendError
from ..geometry import Array, se3_inverse
from ..pose_graph.edge_arrays import EdgeArrays
from ..pose_graph.graph import EdgeKind, PoseGraph
from .costs import frobenius_weights
from .trust_region import anchors

# A tight prior makes Levenberg-Marquardt stop at its start; the gauge needs no more than this.
_PRIOR_SIGMA = 1e-3
# gtsam puts rotation first in tangents.
_ROTATION_FIRST = np.array([3, 4, 5, 0, 1, 2])
# Entries of a 4x4 matrix, column by column.
_ROTATION_ENTRIES, _TRANSLATION_ENTRIES = [0, 1, 2, 4, 5, 6, 8, 9, 10], [12, 13, 14]


def _gtsam() -> Any:
    """The library, or ``BackendError`` where there is none for this system."""
    try:
        import gtsam
    except ModuleNotFoundError as error:
        raise BackendError(
            "Levenberg-Marquardt needs gtsam, which is not installed (there is none for Windows): take cost F or U, "
            "without a robust loss"
        ) from error
    return gtsam


def levenberg_marquardt(graph: PoseGraph, config: CentralConfig) -> tuple[PoseGraph, int]:
    """Return ``graph`` at the nearest local optimum of ``config.cost``, and the number of iterations."""
    gtsam = _gtsam()
    a = graph.arrays()
    values = gtsam.Values()
    for k, T in enumerate(a.poses):
        values.insert(k, gtsam.Pose3(T))
    parameters = gtsam.LevenbergMarquardtParams()
    parameters.setMaxIterations(config.iterations)
    parameters.setRelativeErrorTol(config.tolerance)
    parameters.setAbsoluteErrorTol(0.0)
    parameters.setlambdaInitial(1e-4)
    # In units of each unknown: weights of some files span ten powers of ten, and one damping for all is none for most.
    parameters.setDiagonalDamping(True)
    optimiser = gtsam.LevenbergMarquardtOptimizer(_factors(graph, a, config), values, parameters)
    solved = optimiser.optimize()
    moved = np.array([solved.atPose3(k).matrix() for k in range(len(a.poses))]).reshape(-1, 4, 4)
    if a.origin is not None:
        # The origin stood fixed but for rounding; put it back exactly.
        moved = se3_inverse(moved[a.origin]) @ moved
    moved[list(a.fixed)] = a.poses[list(a.fixed)]
    return graph.with_poses(a.named(moved)), optimiser.iterations()


def _factors(graph: PoseGraph, a: EdgeArrays, config: CentralConfig) -> Any:
    gtsam = _gtsam()
    factors = gtsam.NonlinearFactorGraph()
    tight = gtsam.noiseModel.Isotropic.Sigma(6, _PRIOR_SIGMA)
    for k in a.fixed:
        factors.add(gtsam.NonlinearEqualityPose3(k, gtsam.Pose3(a.poses[k])))
    for k in sorted(set(anchors(a)) - set(a.fixed)):
        factors.add(gtsam.PriorFactorPose3(k, gtsam.Pose3(a.poses[k]), tight))
    kappa, tau = frobenius_weights(a, config.cost, graph.dimension)
    geodesic = config.cost == "E"
    factor = gtsam.BetweenFactorPose3 if geodesic else gtsam.FrobeniusBetweenFactorPose3
    for k in range(len(a.ends)):
        if geodesic:
            information = _definite(a.information[k])[np.ix_(_ROTATION_FIRST, _ROTATION_FIRST)]
            model = gtsam.noiseModel.Gaussian.Information(information)
        else:
            model = _frobenius_model(float(kappa[k]), float(tau[k]))
        if k < len(graph.edges) and (graph.edges[k].is_separator or graph.edges[k].kind != EdgeKind.ODOMETRY):
            model = _with_loss(model, config)
        factors.add(factor(int(a.ends[k, 0]), int(a.ends[k, 1]), gtsam.Pose3(a.measured[k]), model))
    return factors


def _definite(information: Array) -> Array:
    """Directions of no information get next to none: gtsam takes the matrix's root and cannot do without."""
    values, vectors = np.linalg.eigh(0.5 * (information + information.T))
    floor = 1e-9 * max(values[-1], 1e-9)
    return information if values[0] > 0 else (vectors * np.maximum(values, floor)) @ vectors.T


def _frobenius_model(kappa: float, tau: float) -> Any:
    """Noise of the 16 entries of a pose matrix such that half the squared norm is F's share."""
    gtsam = _gtsam()
    precisions = np.ones(16)
    precisions[_ROTATION_ENTRIES], precisions[_TRANSLATION_ENTRIES] = 2.0 * kappa, 2.0 * tau
    return gtsam.noiseModel.Diagonal.Precisions(np.maximum(precisions, 1e-12))


def _with_loss(model: Any, config: CentralConfig) -> Any:
    gtsam = _gtsam()
    if config.loss == "none":
        return model
    estimators = gtsam.noiseModel.mEstimator
    estimator = (estimators.Huber if config.loss == "huber" else estimators.Cauchy).Create(config.loss_scale)
    return gtsam.noiseModel.Robust.Create(estimator, model)
