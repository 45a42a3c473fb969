"""Conditions on a relative pose for two key-frames to count as views of one place."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..config import RelPoseConfig
from ..geometry import Array
from .alignment import Alignment
from .evidence import Evidence

# Less than this width over length and the rotation about the points' line is guesswork.
_MIN_WIDTH = 0.01
# Chance inliers fill the bound's disc evenly, which gives 0.71 of its radius; right ones crowd at its centre.
_MAX_RMSE_SHARE = 0.6


@dataclass(frozen=True, eq=False)
class FoundPose:
    """A pose found by verification, refined; ``tentative`` ``(k, 3)``: the match's points of tentative matches that
    fit it; ``guided_M``, ``guided_Q`` ``(g, 3)``: points matched again under it; ``similar``: share of all pairs of
    descriptors of the two views that are similar enough to be one point's."""

    alignment: Alignment
    tentative: Array
    guided_M: Array
    guided_Q: Array
    evidence: Evidence
    similar: float
    by_words: bool

    @property
    def rmse_deg(self) -> float:
        """Bearing error of the guided matches in the match camera, degrees; NaN without any."""
        if not len(self.guided_M):
            return float("nan")
        predicted = self.alignment.T_M_Q @ self.guided_Q
        cross = np.linalg.norm(np.cross(predicted, self.guided_M), axis=1)
        angles = np.arctan2(cross, np.einsum("kc,kc->k", predicted, self.guided_M))
        return float(np.degrees(np.sqrt(np.mean(angles**2))))

    @property
    def distance_ratio(self) -> float:
        """How far the query's camera is from the guided matches, over how far the match's is, in one unit: what a scale
        amounts to, whatever unit either view has. NaN without any."""
        if not len(self.guided_M):
            return float("nan")
        ratios = np.linalg.norm(self.guided_Q, axis=1) / np.linalg.norm(self.guided_M, axis=1)
        return float(self.alignment.T_M_Q.scale * np.median(ratios))


def problem_of(found: FoundPose, config: RelPoseConfig) -> tuple[str | None, float | None]:
    """The first condition that fails, with its figures, or None; and the log odds, where they are weighed."""
    n = len(found.tentative)
    shapes = [shape(points) for points in (found.tentative, found.guided_M)]
    width, thickness = min(s[0] for s in shapes), min(s[1] for s in shapes)
    sigma = position_sigma(found.alignment.information)
    depth = float(np.median(np.linalg.norm(found.guided_M, axis=1))) if len(found.guided_M) else 1.0
    least = config.min_word_inliers if found.by_words else config.min_inliers
    flattest = config.min_word_thickness if found.by_words else config.min_thickness
    weighed = config.min_evidence is not None and not found.by_words
    odds = log_odds(found, thickness) if weighed else None
    floating, deserted = found.evidence.floating, found.evidence.deserted
    rmse_limit = _MAX_RMSE_SHARE * config.inlier_angle_deg
    problem = None
    if n < least:
        # Of the tentative matches: under a wrong pose, textures that repeat supply as many guided ones as are wanted.
        problem = f"too few inliers: {n} < {least}"
    elif width < _MIN_WIDTH:
        problem = f"degenerate: points on a line, width over length {width:.4f} < {_MIN_WIDTH:g}"
    elif thickness < flattest:
        problem = f"ambiguous: points on one flat surface, thickness {thickness:.3f} < {flattest:g}"
    elif not 1.0 / config.max_distance_ratio < found.distance_ratio < config.max_distance_ratio:
        problem = (
            f"implausible scale: the query's camera {found.distance_ratio:.3g} times as far from the points as the "
            f"match's, outside {1 / config.max_distance_ratio:.3g} to {config.max_distance_ratio:.3g}"
        )
    elif found.rmse_deg > rmse_limit:
        problem = f"residual too large: {found.rmse_deg:.3f} deg > {rmse_limit:.3f} deg"
    elif sigma > config.max_sigma * depth:
        problem = f"too uncertain: position sigma {sigma:.3g} > {config.max_sigma:g} of the median depth {depth:.3g}"
    elif floating > config.max_floating:
        problem = f"contradicted: {floating:.0%} of the points float in front of a surface > {config.max_floating:.0%}"
    elif weighed and found.evidence.common < config.min_common:
        problem = f"little in common: {found.evidence.common:.0%} of a view < {config.min_common:.0%}"
    elif weighed and deserted > config.max_deserted:
        problem = f"contradicted: {deserted:.0%} of the common view has no point alike > {config.max_deserted:.0%}"
    elif odds is not None and config.min_evidence is not None and odds < config.min_evidence:
        problem = f"contradicted: {shares_text(found.evidence)}: evidence {odds:.1f} < {config.min_evidence:g}"
    return problem, odds


def log_odds(found: FoundPose, thickness: float) -> float:
    """Log odds that this is one place, beyond those of the bound: a logistic model of what was found."""
    return float(WEIGHTS @ features(found, thickness))


WEIGHTS = np.array([1.3, -0.5, -2.4, 3.6, 1.9, 4.2, -9.3])
"""Of :func:`features`: fitted on right and look-alike pairs of two rendered towns and three office floors, the signs
given; the first was then lowered until 3 of the 1650 hardest look-alikes were left above 0."""
# Share of descriptors of two views that are similar: the median, and how far its logarithm varies.
_CHANCE, _CHANCE_RANGE = 0.011, 0.35


def features(found: FoundPose, thickness: float) -> Array:
    """``(7,)``: one; share of floating points, of deserted ones; log of the share of repeated ones, of the thickness,
    of the guided matches among the visible points; and of the descriptors that are similar by chance: where texture
    is monotonous, more is asked for."""
    evidence = found.evidence
    visible = max(min(evidence.query.visible, evidence.match.visible), 1)
    return np.array(
        [
            1.0,
            min(evidence.floating, 0.3) / 0.05,
            evidence.deserted / 0.3,
            np.log(max(evidence.repeated, 0.02) / 0.2),
            np.log(np.clip(thickness, 0.01, 0.3) / 0.1),
            np.log(max(len(found.guided_M), 1) / visible / 0.2),
            # Not beyond what was seen when the weights were fitted.
            np.clip(np.log(max(found.similar, 1e-9) / _CHANCE), -_CHANCE_RANGE, _CHANCE_RANGE),
        ]
    )


def shares_text(evidence: Evidence) -> str:
    """The shares of repeated, deserted and floating points as a sentence."""
    e = evidence
    return f"{e.repeated:.0%} of the points repeated, {e.deserted:.0%} of the view deserted, {e.floating:.0%} floating"


def shape(points: Array) -> tuple[float, float]:
    """Second over first singular value of the points' scatter (0 for a line), and third over second (0 for a plane)."""
    if len(points) < 4:
        return 0.0, 0.0
    length, width, thickness = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
    return float(width / max(length, 1e-12)), float(thickness / max(width, 1e-12))


def position_sigma(information: Array) -> float:
    """One standard deviation of the position in its worst direction; infinite where the information is singular."""
    values, vectors = np.linalg.eigh(information)
    if values[0] <= 1e-12 * values[-1]:
        return float("inf")
    covariance = (vectors / values) @ vectors.T
    return float(np.sqrt(np.linalg.eigvalsh(covariance[:3, :3])[-1]))
