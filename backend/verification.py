"""RelPose: are two key-frames views of one place, and how do their cameras stand to each other? (thesis section 3.5)"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from backend.alignment import ITERATIONS, Alignment, refine
from backend.config import RelPoseConfig
from backend.consensus import Transforms, agreeing, search
from backend.errors import BackendError
from backend.geometry import Array, Sim3
from backend.matching import FAR, Distances, hamming_distances, mutual_matches, unique_word_matches

# Gauss-Newton steps that are enough to compare hypotheses.
_QUICK = 5
# Less than this width over length and the rotation about the points' line is guesswork.
_MIN_WIDTH = 0.01


@dataclass(frozen=True, eq=False)
class PlaceView:
    """A key-frame's map points as its own camera sees them.

    ``points_C`` ``(n, 3)`` in the camera's frame; ``descriptors`` ``(n, 32)`` uint8 ORB, or None; ``words`` ``(n,)``
    vocabulary ids, or None (one of both must be there); ``metric`` False: the unit of length is the robot's own
    (monocular).
    """

    points_C: Array
    descriptors: NDArray[np.uint8] | None = None
    words: NDArray[np.int32] | None = None
    metric: bool = True

    def __post_init__(self) -> None:
        n = len(self.points_C)
        if self.points_C.shape != (n, 3) or not np.isfinite(self.points_C).all():
            raise BackendError(f"a place view needs (n, 3) finite points, got shape {self.points_C.shape}")
        if self.descriptors is None and self.words is None:
            raise BackendError("a place view needs descriptors or words")
        if self.descriptors is not None and (self.descriptors.shape != (n, 32) or self.descriptors.dtype != np.uint8):
            raise BackendError(
                f"{n} points need ({n}, 32) uint8 descriptors, got {self.descriptors.shape} {self.descriptors.dtype}"
            )
        if self.words is not None and self.words.shape != (n,):
            raise BackendError(f"{n} points need ({n},) words, got shape {self.words.shape}")


@dataclass(frozen=True, eq=False)
class Verdict:
    """Whether the match holds, why, and how the cameras stand.

    ``reason`` is "accepted" or says what was too little and by how much; ``T_M_Q`` maps the query camera to the match
    camera (scale 1 when both are metric); ``matches`` tentative, of which ``inliers`` fit the refined pose; ``rmse``:
    bearing error of the inliers in the match camera, degrees (NaN without a pose); ``information`` ``(6, 6)`` of the
    rigid part, translation first, in the match's unit; ``guided``: matches made again under the pose, which refined it.
    ``T_M_Q`` and ``information`` may be there without acceptance, for the record.
    """

    accepted: bool
    reason: str
    T_M_Q: Sim3 | None
    matches: int
    inliers: int
    rmse: float
    information: Array | None
    guided: int = 0

    @property
    def kind(self) -> str:
        """The reason without its figures, to count by: "too few inliers"."""
        return self.reason.partition(":")[0]


def relative_pose(query: PlaceView, match: PlaceView, config: RelPoseConfig, rng: np.random.Generator) -> Verdict:
    """Match, search, refine, match again under the found pose, refine again, judge.

    Same inputs and the same state of ``rng``: same verdict, bit for bit.
    """
    pairs, distances = _tentative(query, match, config)
    if len(pairs) < config.min_matches:
        return _rejected(f"too few matches: {len(pairs)} < {config.min_matches}", len(pairs))
    with_scale = not (query.metric and match.metric)
    points_Q, points_M = query.points_C[pairs[:, 0]], match.points_C[pairs[:, 1]]
    inliers, found = 0, None
    for start in search(points_M, points_Q, with_scale, config, rng):
        settled = _settle(points_M, points_Q, start, with_scale, config, _QUICK)
        if settled is not None and settled[0] > inliers:
            inliers, found = settled
    if found is None or inliers < config.min_inliers:
        # Before matching again: under a wrong pose, textures that repeat would supply as many matches as are wanted.
        return _rejected(f"too few inliers: {inliers} < {config.min_inliers}", len(pairs), inliers)
    guided = _guided(query, match, distances, found.T_M_Q, config)
    guided_Q, guided_M = query.points_C[guided[:, 0]], match.points_C[guided[:, 1]]
    settled = _settle(guided_M, guided_Q, found.T_M_Q, with_scale, config)
    guided_count, found = settled if settled is not None else (0, found)
    inside = _inliers(found.T_M_Q, points_M, points_Q, config)
    return _judge(found, points_M[inside], points_Q[inside], len(pairs), guided_count, config)


def _tentative(query: PlaceView, match: PlaceView, config: RelPoseConfig) -> tuple[NDArray[np.intp], Distances]:
    """Pairs ``(k, 2)`` of query and match rows, and all distances ``(n_Q, n_M)`` for matching again later.

    By descriptors where both views have them, else by words that occur once in either view; equal words count as
    distance 0.
    """
    if query.descriptors is not None and match.descriptors is not None:
        distances = hamming_distances(query.descriptors, match.descriptors)
        return mutual_matches(distances, config.max_hamming, config.ratio), distances
    if query.words is None or match.words is None:
        raise BackendError("the two views have neither descriptors nor words in common")
    distances = np.where(query.words[:, None] == match.words[None, :], np.int16(0), FAR)
    return unique_word_matches(query.words, match.words), distances


def _settle(
    points_M: Array, points_Q: Array, start: Sim3, with_scale: bool, config: RelPoseConfig, iterations: int = ITERATIONS
) -> tuple[int, Alignment] | None:
    """Refine on the inliers of the wide bound, then on those of the narrow one; None with too few to go on."""
    T, result = start, None
    for angle_deg in (config.search_angle_deg, config.inlier_angle_deg):
        inside = agreeing(Transforms.of(T), points_M, points_Q, angle_deg, config.depth_ratio)[0]
        if inside.sum() < 4:
            return None
        result = refine(points_M[inside], points_Q[inside], T, with_scale, config.loss_scale, iterations)
        T = result.T_M_Q
    assert result is not None
    return int(_inliers(T, points_M, points_Q, config).sum()), result


def _inliers(T_M_Q: Sim3, points_M: Array, points_Q: Array, config: RelPoseConfig) -> NDArray[np.bool_]:
    return agreeing(Transforms.of(T_M_Q), points_M, points_Q, config.inlier_angle_deg, config.depth_ratio)[0]


def _guided(
    query: PlaceView, match: PlaceView, distances: Distances, T_M_Q: Sim3, config: RelPoseConfig
) -> NDArray[np.intp]:
    """Match again, everything that the pose allows: no second-best test, and a wider descriptor bound."""
    rows, columns = np.nonzero(distances <= config.guided_hamming)
    near = _inliers(T_M_Q, match.points_C[columns], query.points_C[rows], config)
    allowed = np.full_like(distances, FAR)
    allowed[rows[near], columns[near]] = distances[rows[near], columns[near]]
    return mutual_matches(allowed, config.guided_hamming)


def _judge(
    found: Alignment, points_M: Array, points_Q: Array, matches: int, guided: int, config: RelPoseConfig
) -> Verdict:
    """Everything that must hold of the refined pose and of those tentative matches that are its inliers."""
    T, n = found.T_M_Q, len(points_M)
    rmse_deg = _bearing_rmse_deg(T @ points_Q, points_M) if n else float("nan")
    width, thickness = _shape(points_M)
    sigma = _position_sigma(found.information)
    depth = float(np.median(np.linalg.norm(points_M, axis=1))) if n else 1.0
    # Chance inliers fill the bound's disc evenly, which gives 0.71 of its radius; right ones crowd at its centre.
    rmse_limit = 0.6 * config.inlier_angle_deg
    problem = None
    if n < config.min_inliers:
        problem = f"too few inliers: {n} < {config.min_inliers}"
    elif width < _MIN_WIDTH:
        problem = f"degenerate: points on a line, width over length {width:.4f} < {_MIN_WIDTH:g}"
    elif thickness < config.min_thickness:
        problem = f"ambiguous: points on one flat surface, thickness {thickness:.3f} < {config.min_thickness:g}"
    elif not 1.0 / config.max_scale < T.scale < config.max_scale:
        problem = f"implausible scale: {T.scale:.3g} outside {1 / config.max_scale:.3g} to {config.max_scale:.3g}"
    elif rmse_deg > rmse_limit:
        problem = f"residual too large: {rmse_deg:.3f} deg > {rmse_limit:.3f} deg"
    elif n < config.min_support * matches:
        problem = f"too little support: {n} inliers of {matches} matches < {config.min_support:.0%}"
    elif sigma > config.max_sigma * depth:
        problem = f"too uncertain: position sigma {sigma:.3g} > {config.max_sigma:g} of the median depth {depth:.3g}"
    return Verdict(problem is None, problem or "accepted", T, matches, n, rmse_deg, found.information, guided)


def _bearing_rmse_deg(predicted: Array, observed: Array) -> float:
    cross = np.linalg.norm(np.cross(predicted, observed), axis=1)
    angles = np.arctan2(cross, np.einsum("kc,kc->k", predicted, observed))
    return float(np.degrees(np.sqrt(np.mean(angles**2))))


def _shape(points: Array) -> tuple[float, float]:
    """Second over first singular value of the points' scatter (0 for a line), and third over second (0 for a plane)."""
    if len(points) < 4:
        return 0.0, 0.0
    length, width, thickness = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
    return float(width / max(length, 1e-12)), float(thickness / max(width, 1e-12))


def _position_sigma(information: Array) -> float:
    """One standard deviation of the position in its worst direction; infinite where the information is singular."""
    values, vectors = np.linalg.eigh(information)
    if values[0] <= 1e-12 * values[-1]:
        return float("inf")
    covariance = (vectors / values) @ vectors.T
    return float(np.sqrt(np.linalg.eigvalsh(covariance[:3, :3])[-1]))


def _rejected(reason: str, matches: int, inliers: int = 0) -> Verdict:
    return Verdict(False, reason, None, matches, inliers, float("nan"), None)
