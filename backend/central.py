"""Central optimisation of a whole graph: chordal start, then Levenberg-Marquardt by gtsam. The one file that knows
gtsam.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from backend.chordal import first_of_parts, two_stage_poses
from backend.config import CentralConfig
from backend.costs import cost
from backend.geometry import Array
from backend.graph import PoseGraph
from backend.linear import isotropic_weights

# A tight prior makes Levenberg-Marquardt stop at its start; the gauge needs no more than this.
_PRIOR_SIGMA = 1e-3
# gtsam puts rotation first in tangents.
_ROTATION_FIRST = np.array([3, 4, 5, 0, 1, 2])
# Entries of a 4x4 matrix, column by column.
_ROTATION_ENTRIES, _TRANSLATION_ENTRIES = [0, 1, 2, 4, 5, 6, 8, 9, 10], [12, 13, 14]


@dataclass(frozen=True, eq=False)
class OptimisationResult:
    """The optimised graph; costs in the convention that was asked for; ``iterations`` of the non-linear solver.

    Where nothing better was found, ``graph`` is the one that came in and ``improved`` is False.
    """

    graph: PoseGraph
    cost_before: float
    cost_after: float
    iterations: int
    improved: bool


def optimise(graph: PoseGraph, config: CentralConfig) -> OptimisationResult:
    """Optimise all poses; in each connected part the first node stays where it is. Never ends higher than it began."""
    before = cost(graph, config.cost)
    if not graph.edges:
        return OptimisationResult(graph, before, before, 0, False)
    unit = config.cost == "U"
    start = two_stage(graph, unit) if config.start == "chordal" else graph
    solved, iterations = _levenberg_marquardt(start, config)
    if config.start == "chordal" and cost(solved, config.cost) > before:
        solved, iterations = _levenberg_marquardt(graph, config)
    after = cost(solved, config.cost)
    if after > before:
        return OptimisationResult(graph, before, before, iterations, False)
    return OptimisationResult(solved, before, after, iterations, True)


def two_stage(graph: PoseGraph, unit_weights: bool = False, newton_steps: int = 1) -> PoseGraph:
    """Chordal rotations, then Gauss-Newton steps of F (U with ``unit_weights``): needs no initial guess (Carlone et
    al., ICRA 2015).

    One step is what distributed Gauss-Seidel converges to.
    """
    a = graph.arrays()
    kappa, tau = isotropic_weights(a.information, graph.dimension)
    if unit_weights:
        kappa, tau = np.ones_like(kappa), np.ones_like(tau)
    poses = two_stage_poses(a.ends, a.measured, (kappa, tau), a.poses, newton_steps)
    return graph.with_poses(dict(zip(a.nodes, poses, strict=True)))


def _levenberg_marquardt(graph: PoseGraph, config: CentralConfig) -> tuple[PoseGraph, int]:
    import gtsam

    a = graph.arrays()
    factors, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    for k, T in enumerate(a.poses):
        values.insert(k, gtsam.Pose3(T))
    tight = gtsam.noiseModel.Isotropic.Sigma(6, _PRIOR_SIGMA)
    for k in first_of_parts(a.ends, len(a.nodes)):
        factors.add(gtsam.PriorFactorPose3(k, gtsam.Pose3(a.poses[k]), tight))
    kappa, tau = isotropic_weights(a.information, graph.dimension)
    if config.cost == "U":
        kappa, tau = np.full_like(kappa, 0.5), np.full_like(tau, 0.5)
    for k, edge in enumerate(graph.edges):
        if config.cost == "E":
            model = gtsam.noiseModel.Gaussian.Information(
                _positive(a.information[k])[np.ix_(_ROTATION_FIRST, _ROTATION_FIRST)]
            )
        else:
            model = _frobenius_model(float(kappa[k]), float(tau[k]))
        if edge.is_separator or edge.kind != "odometry":
            model = _with_loss(model, config)
        factor = gtsam.BetweenFactorPose3 if config.cost == "E" else gtsam.FrobeniusBetweenFactorPose3
        factors.add(factor(int(a.ends[k, 0]), int(a.ends[k, 1]), gtsam.Pose3(a.measured[k]), model))
    parameters = gtsam.LevenbergMarquardtParams()
    parameters.setMaxIterations(config.iterations)
    parameters.setRelativeErrorTol(config.tolerance)
    parameters.setAbsoluteErrorTol(0.0)
    parameters.setlambdaInitial(1e-4)
    optimiser = gtsam.LevenbergMarquardtOptimizer(factors, values, parameters)
    solved = optimiser.optimize()
    poses = {node: solved.atPose3(k).matrix() for k, node in enumerate(a.nodes)}
    return graph.with_poses(poses), optimiser.iterations()


def _positive(information: Array) -> Array:
    """The nearest positive definite matrix: some public files hold indefinite ones, which no least-squares solver can
    use.
    """
    values, vectors = np.linalg.eigh(0.5 * (information + information.T))
    if values[0] > 0:
        return information
    return (vectors * np.maximum(values, 1e-9 * max(values[-1], 1e-9))) @ vectors.T


def _frobenius_model(kappa: float, tau: float) -> Any:
    """Noise of the 16 entries of a pose matrix such that half the squared norm is F's share."""
    import gtsam

    precisions = np.ones(16)
    precisions[_ROTATION_ENTRIES], precisions[_TRANSLATION_ENTRIES] = 2.0 * kappa, 2.0 * tau
    return gtsam.noiseModel.Diagonal.Precisions(np.maximum(precisions, 1e-12))


def _with_loss(model: Any, config: CentralConfig) -> Any:
    import gtsam

    if config.loss == "none":
        return model
    estimators = gtsam.noiseModel.mEstimator
    estimator = (estimators.Huber if config.loss == "huber" else estimators.Cauchy).Create(config.loss_scale)
    return gtsam.noiseModel.Robust.Create(estimator, model)
