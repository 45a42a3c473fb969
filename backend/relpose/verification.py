"""RelPose: verification that two key-frames view one place, and the relative pose of their cameras (thesis section
3.5)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..config import RelPoseConfig
from ..errors import BackendError
from ..geometry import Array, Sim3
from .acceptance import FoundPose, problem_of
from .alignment import ITERATIONS, Alignment, rigid_information, scale_sigma
from .evidence import Evidence, weigh
from .matching import (
    FAR,
    Distances,
    PointCandidates,
    hamming_distances,
    mutual_candidates,
    mutual_matches,
    unique_word_matches,
)
from .pose_solvers import PoseSolver, fitting, solver_for

# Gauss-Newton steps that are enough to compare hypotheses.
_QUICK = 5
_BITS = 256
# Matches under a pose that make it worth to look at more points.
_PROMISE = 6
DESCRIPTOR_BYTES = (8, 16, 32)
"""Bytes that a descriptor may have: whole ORB, or its first half or quarter."""


@dataclass(frozen=True, eq=False)
class PlaceView:
    """A key-frame's map points as its own camera sees them.

    ``points_C`` ``(n, 3)`` in the camera's frame; ``descriptors`` ``(n, w)`` uint8, ORB's first w = 32, 16 or 8 bytes,
    or None; ``words`` ``(n,)`` vocabulary ids, or None (one of both must be there); ``metric`` False: the unit of
    length is the robot's own (monocular). ``depth_known`` ``(n,)``: rows that are points; the others are mere
    directions of unit length, for the solver "pnp" (None: all are points).
    """

    points_C: Array
    descriptors: NDArray[np.uint8] | None = None
    words: NDArray[np.int32] | None = None
    metric: bool = True
    depth_known: NDArray[np.bool_] | None = None

    def __post_init__(self) -> None:
        n = len(self.points_C)
        if self.points_C.shape != (n, 3) or not np.isfinite(self.points_C).all():
            raise BackendError(f"a place view needs (n, 3) finite points, got shape {self.points_C.shape}")
        if self.descriptors is None and self.words is None:
            raise BackendError("a place view needs descriptors or words")
        d = self.descriptors
        if d is not None and (d.ndim != 2 or len(d) != n or d.shape[1] not in DESCRIPTOR_BYTES or d.dtype != np.uint8):
            raise BackendError(f"{n} points need ({n}, 32) uint8 descriptors, or 16 or 8, got {d.shape} {d.dtype}")
        if self.words is not None and self.words.shape != (n,):
            raise BackendError(f"{n} points need ({n},) words, got shape {self.words.shape}")
        if self.depth_known is not None and (self.depth_known.shape != (n,) or self.depth_known.dtype != np.bool_):
            raise BackendError(f"{n} points need ({n},) flags for known depths, got shape {self.depth_known.shape}")

    @property
    def known(self) -> NDArray[np.bool_]:
        """:attr:`depth_known` as a mask ``(n,)``, also where it is None."""
        return np.ones(len(self.points_C), dtype=np.bool_) if self.depth_known is None else self.depth_known

    def with_depth(self) -> PlaceView:
        """The rows whose depth is known."""
        if self.depth_known is None:
            return self
        rows = self.depth_known
        return PlaceView(
            self.points_C[rows],
            descriptors=None if self.descriptors is None else self.descriptors[rows],
            words=None if self.words is None else self.words[rows],
            metric=self.metric,
        )


def joined(first: PlaceView, rest: PlaceView) -> PlaceView:
    """One view with the points of ``first``, then those of ``rest``."""
    both = (first, rest)
    descriptors, words = [v.descriptors for v in both], [v.words for v in both]
    return PlaceView(
        np.concatenate([v.points_C for v in both]),
        descriptors=np.concatenate([d for d in descriptors if d is not None])
        if all(d is not None for d in descriptors)
        else None,
        words=np.concatenate([w for w in words if w is not None]) if all(w is not None for w in words) else None,
        metric=first.metric,
        depth_known=None
        if first.depth_known is None and rest.depth_known is None
        else np.concatenate([v.known for v in both]),
    )


@dataclass(frozen=True, eq=False)
class Verdict:
    """Verdict on a candidate match, its reason, and the relative pose.

    ``reason`` is "accepted" or names the figure that was too small, and by how much; ``T_M_Q`` maps the query camera to
    the match camera (scale 1 when both are metric); ``matches`` tentative, of which ``inliers`` fit the refined pose;
    ``rmse``: bearing error of the ``guided`` matches made again under the pose, degrees (NaN without a pose);
    ``full_information`` ``(7, 7)`` of translation (match's unit), rotation and log scale, the last 0 when both are
    metric; ``evidence`` for and against the pose, ``log_odds`` its sum (None where it is not weighed). ``T_M_Q`` and
    the information may be there without acceptance, for the record.
    """

    accepted: bool
    reason: str
    T_M_Q: Sim3 | None
    matches: int
    inliers: int
    rmse: float
    full_information: Array | None
    guided: int = 0
    evidence: Evidence | None = None
    log_odds: float | None = None

    @property
    def kind(self) -> str:
        """The reason without its figures, to count by: "too few inliers"."""
        return self.reason.partition(":")[0]

    @property
    def information(self) -> Array | None:
        """``(6, 6)`` of the rigid part, translation first, in the match's unit; the scale is marginalised."""
        return None if self.full_information is None else rigid_information(self.full_information)

    @property
    def scale_sigma(self) -> float:
        """Standard deviation of the log scale; 0 where none was estimated, infinite where nothing determines it."""
        return 0.0 if self.full_information is None else scale_sigma(self.full_information)


@dataclass(frozen=True, eq=False)
class _Hypothesis:
    """A settled pose, and the rows ``(g, 2)`` of the query and the match that are matched under it."""

    alignment: Alignment
    guided: NDArray[np.intp]


def relative_pose(query: PlaceView, match: PlaceView, config: RelPoseConfig, rng: np.random.Generator) -> Verdict:
    """Match, search, refine, match again under the found pose, refine again, judge.

    ``query``, ``match``: points in their own cameras' frames. Same inputs and the same state of ``rng``: same verdict,
    bit for bit. Too few matches are a verdict, not an error.
    """
    match = match.with_depth()
    query = query if config.solver == "pnp" else query.with_depth()
    pairs, distances, bits = _tentative(query, match, config)
    if len(pairs) < config.min_matches:
        return _rejected(f"too few matches: {len(pairs)} < {config.min_matches}", len(pairs))
    solver = solver_for(not (query.metric and match.metric), config)
    alike = config.guided_hamming * bits // _BITS
    points_Q, points_M = query.points_C[pairs[:, 0]], match.points_C[pairs[:, 1]]
    candidates = PointCandidates.within(distances, alike)
    best: _Hypothesis | None = None
    for start in solver.search(points_M, points_Q, rng):
        settled = _settle(solver, points_M, points_Q, start, config, _QUICK)
        if settled is not None:
            guided = _guided(solver, query, match, candidates, settled.T_M_Q, config)
            if best is None or len(guided) > len(best.guided):
                best = _Hypothesis(settled, guided)
    if best is None:
        return _rejected("too few inliers: no pose explains four matches", len(pairs))
    best = _again(solver, best, query, match, candidates, config)
    guided_Q, guided_M = query.points_C[best.guided[:, 0]], match.points_C[best.guided[:, 1]]
    inside = _inliers(solver, best.alignment.T_M_Q, points_M, points_Q, config)
    pose = solver.finish(best.alignment, guided_M, guided_Q, query.known[best.guided[:, 0]])
    if isinstance(pose, str):
        return _rejected(pose, len(pairs), int(inside.sum()))
    T = pose.T_M_Q
    surface = solver.surface(T, match.points_C, query.points_C, query.known, best.guided)
    found = FoundPose(
        alignment=pose,
        tentative=points_M[inside],
        guided_M=guided_M,
        guided_Q=solver.placed(T, guided_M, guided_Q),
        evidence=weigh(match.points_C, surface, distances, T, config.inlier_angle_deg, alike, pose.depth_sigma),
        similar=len(candidates.rows) / max(distances.size, 1),
        by_words=bits == 0,
    )
    problem, log_odds = problem_of(found, config)
    return Verdict(
        problem is None,
        problem or "accepted",
        T,
        len(pairs),
        int(inside.sum()),
        found.rmse_deg,
        pose.full_information,
        len(best.guided),
        found.evidence,
        log_odds,
    )


def promising(verdict: Verdict) -> bool:
    """Whether more points might turn a refusal into acceptance: some matches agree, and little contradicts them."""
    return not verdict.accepted and verdict.guided >= _PROMISE


def _tentative(query: PlaceView, match: PlaceView, config: RelPoseConfig) -> tuple[NDArray[np.intp], Distances, int]:
    """Pairs ``(k, 2)`` of query and match rows, all distances ``(n_Q, n_M)`` for matching again later, and how many
    bits they count.

    By descriptors where both views have them, as many bits as both have; else by words that occur once in either view
    (0 bits; equal words count as distance 0).
    """
    if query.descriptors is not None and match.descriptors is not None:
        width = min(query.descriptors.shape[1], match.descriptors.shape[1])
        distances = hamming_distances(query.descriptors[:, :width], match.descriptors[:, :width])
        bits = 8 * width
        return mutual_matches(distances, config.max_hamming * bits // _BITS, config.ratio), distances, bits
    if query.words is None or match.words is None:
        raise BackendError("the two views have neither descriptors nor words in common")
    distances = np.where(query.words[:, None] == match.words[None, :], np.int16(0), FAR)
    return unique_word_matches(query.words, match.words), distances, 0


def _settle(
    solver: PoseSolver,
    points_M: Array,
    points_Q: Array,
    start: Sim3,
    config: RelPoseConfig,
    iterations: int = ITERATIONS,
) -> Alignment | None:
    """Refine on the inliers of the wide bound, then on those of the narrow one; None with too few to go on."""
    T, result = start, None
    for angle_deg in (config.search_angle_deg, config.inlier_angle_deg):
        inside = fitting(solver, T, points_M, points_Q, angle_deg, config.depth_ratio)
        if inside.sum() < 4:
            return None
        result = solver.refine(points_M[inside], points_Q[inside], T, iterations)
        T = result.T_M_Q
    return result


def _again(
    solver: PoseSolver,
    best: _Hypothesis,
    query: PlaceView,
    match: PlaceView,
    candidates: PointCandidates,
    config: RelPoseConfig,
) -> _Hypothesis:
    """Refine on the guided matches, and match again with what that gives."""
    for _ in range(2):
        points_Q, points_M = query.points_C[best.guided[:, 0]], match.points_C[best.guided[:, 1]]
        settled = _settle(solver, points_M, points_Q, best.alignment.T_M_Q, config)
        if settled is None:
            break
        best = _Hypothesis(settled, _guided(solver, query, match, candidates, settled.T_M_Q, config))
    return best


def _inliers(
    solver: PoseSolver, T_M_Q: Sim3, points_M: Array, points_Q: Array, config: RelPoseConfig
) -> NDArray[np.bool_]:
    return fitting(solver, T_M_Q, points_M, points_Q, config.inlier_angle_deg, config.depth_ratio)


def _guided(
    solver: PoseSolver,
    query: PlaceView,
    match: PlaceView,
    candidates: PointCandidates,
    T_M_Q: Sim3,
    config: RelPoseConfig,
) -> NDArray[np.intp]:
    """Match again, everything that the pose allows: no second-best test, and a wider descriptor bound."""
    near = _inliers(solver, T_M_Q, match.points_C[candidates.columns], query.points_C[candidates.rows], config)
    return mutual_candidates(candidates, near)


def _rejected(reason: str, matches: int, inliers: int = 0) -> Verdict:
    return Verdict(False, reason, None, matches, inliers, float("nan"), None)
