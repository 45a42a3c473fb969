"""Settings of the back end. Every default states its unit; an unknown key is an error."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from maslam._settings import Settings


class RelPoseConfig(Settings):
    """Geometric verification of a place match (thesis section 3.5). Bits are of 256; shorter descriptors scale them."""

    solver: Literal["points", "pnp"] = Field(
        default="points",
        description="points: 3-D points of both views; pnp: of the match, with mere directions of the query",
    )
    max_hamming: int = Field(
        default=60, ge=0, le=256, description="largest descriptor distance of a tentative match, bits of 256"
    )
    ratio: float = Field(
        default=0.9,
        gt=0,
        le=1,
        description="largest ratio of the best to the second best descriptor distance; 1: not tested",
    )
    min_matches: int = Field(default=8, ge=3, description="fewest tentative matches for which a pose is searched")
    min_inliers: int = Field(default=8, ge=3, description="fewest tentative matches that a pose must explain")
    min_word_inliers: int = Field(
        default=20,
        ge=3,
        description="fewest matches that a pose must explain where views are compared by vocabulary words",
    )
    search_angle_deg: float = Field(
        default=3.0, gt=0, le=20, description="largest bearing error of an inlier in the search, degrees"
    )
    inlier_angle_deg: float = Field(
        default=0.5, gt=0, le=20, description="largest bearing error of an inlier under the refined pose, degrees"
    )
    inlier_px: float = Field(
        default=2.75,
        ge=0,
        description="and at least so many pixels of the verifying agent's camera: small images are less exact",
    )
    depth_ratio: float = Field(default=1.5, gt=1, description="largest ratio of an inlier's two depths in one camera")
    samples: int = Field(
        default=20_000, ge=1, description="minimal sets drawn; those whose side lengths disagree are dropped unsolved"
    )
    hypotheses: int = Field(default=400, ge=1, description="most hypotheses that are scored")
    refined: int = Field(default=5, ge=1, description="best hypotheses that are refined")
    guided_hamming: int = Field(
        default=80, ge=0, le=256, description="largest descriptor distance once the pose is known, bits of 256"
    )
    loss_scale: float = Field(
        default=3.0, gt=0, description="scale of the Cauchy loss in refinement, standard deviations"
    )
    min_evidence: float | None = Field(
        default=0.0, description="smallest log odds for a place match by all that both views see; null: not weighed"
    )
    min_common: float = Field(
        default=0.25,
        ge=0,
        le=1,
        description="smallest share of a view's points (0 to 1) that the other view must have in view",
    )
    max_floating: float = Field(
        default=0.15,
        ge=0,
        le=1,
        description="largest share of points (0 to 1) in front of a surface that the other camera sees",
    )
    max_deserted: float = Field(
        default=0.3,
        ge=0,
        le=1,
        description="largest share of the common view (0 to 1) without a similar point; 5 % by chance",
    )
    min_thickness: float = Field(
        default=0.1,
        ge=0,
        description="smallest extent of the inliers across their main plane over that within it; rejects flat walls",
    )
    min_word_thickness: float = Field(
        default=0.12,
        ge=0,
        description="smallest extent, as min_thickness, where views are compared by vocabulary words",
    )
    max_distance_ratio: float = Field(
        default=5.0,
        gt=1,
        description="largest ratio of the two cameras' distances from the points that both see, and largest inverse of "
        "it; units of length, which one camera chooses itself, do not count",
    )
    max_sigma: float = Field(
        default=0.1,
        gt=0,
        description="largest standard deviation of the position in its worst direction, over the median depth",
    )


class SolverConfig(Settings):
    """Pose-graph optimisation, central and distributed (thesis section 3.6)."""

    method: Literal["dgs", "jor", "sor", "rbcd", "rbcd-async", "multifrontal", "two-level", "elected"] = Field(
        default="sor",
        description="two-stage sweeps (Gauss-Seidel, Jacobi, over-relaxed), block-coordinate descent to the optimum, "
        "exact elimination along an agreed order (multifrontal), sweeps with a coarse level (two-level), or one "
        "elected robot that solves for all",
    )
    relaxation: float = Field(
        default=1.75,
        gt=0,
        lt=2,
        description="over-relaxation of sor; at most 1 in jor and where units are variables",
    )
    start: Literal["flagged", "warm"] = Field(
        default="flagged",
        description="initial guess: flagged (none needed) or warm (the present poses, which share a frame already)",
    )
    rotation_sweeps: int = Field(default=50, ge=1, description="rotation sweeps at most")
    pose_sweeps: int = Field(default=50, ge=1, description="pose sweeps of one Gauss-Newton step, at most")
    scale_sweeps: int = Field(
        default=100, ge=1, description="sweeps over the nodes' units of length, at most (monocular members only)"
    )
    rotation_threshold: float = Field(
        default=0.01, ge=0, description="change of a robot's rotation entries below which it is quiet, 2-norm"
    )
    pose_threshold: float = Field(
        default=0.01, ge=0, description="change of a robot's poses below which it is quiet, 2-norm of m and rad"
    )
    scale_threshold: float = Field(
        default=1e-5, ge=0, description="change of a robot's log units below which it is quiet, 2-norm"
    )
    newton_steps: int = Field(
        default=1,
        ge=1,
        description="Gauss-Newton steps; 1 is the published two-stage method; three at least where units are variables",
    )
    change: Literal["norm", "rms"] = Field(
        default="norm",
        description="change that sweep thresholds compare: norm over a robot's poses (published), or rms per pose",
    )

    descent_sweeps: int = Field(default=200, ge=1, description="sweeps of block descent at most")
    descent_relaxation: float = Field(default=1.4, gt=0, lt=2, description="over-relaxation of block descent")
    cost_tolerance: float = Field(
        default=1e-6,
        ge=0,
        description="share of the cost by which it must fall within cost_window sweeps for block descent to go on",
    )
    cost_window: int = Field(
        default=5,
        ge=1,
        description="block descent: sweeps over which the fall of the cost is compared with cost_tolerance",
    )
    free_threshold: float = Field(
        default=0.05,
        gt=0,
        description="rbcd-async: smallest move of a separator that is sent to neighbours, standard deviations",
    )
    mixed_sweeps: int = Field(
        default=4, ge=0, le=20, description="earlier sweeps mixed (Anderson acceleration); 0: plain"
    )
    robust: Literal["none", "gnc"] = Field(
        default="none", description="graduated non-convexity on loops and separators (rbcd, elected)"
    )
    gnc_confidence: float = Field(
        default=0.99, gt=0, lt=1, description="share of right edges that a residual's bound keeps"
    )
    gnc_noise: float = Field(
        default=1.0,
        gt=0,
        description="true standard deviations over those that the information states; above 1: it is over-confident",
    )
    gnc_sweeps: int = Field(default=3, ge=1, description="sweeps between two changes of weights")
    gnc_steps: int = Field(default=60, ge=1, description="changes of weights at most")

    multifrontal_most_mb: float = Field(
        default=64.0,
        gt=0,
        description="multifrontal: most that one pass may send, MB as estimated; above it the robots do not begin",
    )
    two_level_spacing: int = Field(
        default=4, ge=1, description="two-level: shared poses for each knot of the coarse level"
    )
    two_level_tolerance: float = Field(
        default=8e-4, gt=0, description="two-level: share of the cost that is expected to be left at the end"
    )
    two_level_sweeps: int = Field(default=60, ge=1, description="two-level: sweeps at most")
    length_sigma: float = Field(
        default=0.0,
        ge=0,
        le=0.2,
        description="elected: 1 sigma of the factor by which all odometry of a metric robot is too long or too short "
        "(a wrong baseline); found where loops call for one; 0: lengths are taken as they are",
    )
    heading_sigma_deg: float = Field(
        default=0.0, ge=0, le=0.1, description="beside length_sigma: 1 sigma of an even turn of odometry, degrees/m"
    )
    elected_longest: int = Field(default=1, ge=1, description="elected: most odometry edges that are sent as one")
    elected_fineness: float = Field(
        default=256.0,
        gt=0,
        description="elected: resolution of transmitted numbers, steps per standard deviation of the residuals",
    )
    elected_rounding: float = Field(
        default=5e-5,
        gt=0,
        description="elected: share of the cost that rounding may add; above it what was rounded off is sent",
    )
    elected_patience: int = Field(
        default=10, ge=1, description="elected: ticks in silence after which a robot counts as lost"
    )

    update_tolerance: float = Field(
        default=5e-5,
        gt=0,
        le=0.1,
        description="updates of an elected group: share of the cost that may be left for robots that are not corrected",
    )

    @classmethod
    def quick(cls) -> SolverConfig:
        """Two-stage over-relaxed sweeps that end within 1 % of the optimum on the published sets of 2 to 25 robots,
        in no more bytes than the published stop takes: the stop looks at a pose's change, not at a whole robot's.
        """
        return cls(method="sor", relaxation=1.3, rotation_sweeps=2, pose_threshold=0.044, change="rms")


class LinkModel(Settings):
    """Links in logical time, where a run with matches one by one is measured; solving anew beside it."""

    delay_s: float = Field(default=0.5, ge=0, le=60, description="logical time that every message takes, seconds")
    rate_kbit: float = Field(
        default=9.6, gt=0, description="rate of each robot's radio, which sends one message after another, kbit/s"
    )
    solved_anew: int = Field(
        default=10, ge=0, description="matches, evenly spread, with which the group is also solved anew, for comparison"
    )


class CentralConfig(Settings):
    """Central optimisation by Levenberg-Marquardt: the reference for the distributed solvers, and for single graphs."""

    cost: Literal["F", "U", "E"] = Field(
        default="F", description="cost convention: SE-Sync, unit weights, or geodesic (gtsam)"
    )
    start: Literal["chordal", "given"] = Field(
        default="chordal", description="two-stage chordal solution, or the graph's poses"
    )
    loss: Literal["none", "huber", "cauchy"] = Field(default="none", description="robust loss on loops and separators")
    loss_scale: float = Field(default=3.0, gt=0, description="scale of the robust loss, standard deviations")
    iterations: int = Field(default=100, ge=1, description="iterations at most")
    tolerance: float = Field(
        default=1e-10, gt=0, description="share of the cost by which an iteration must lower it to go on"
    )
    length_sigma: float = Field(
        default=0.0,
        ge=0,
        le=0.2,
        description="1 sigma of the factor by which all of a robot's odometry is too long or too short, as a wrong "
        "baseline makes it; found where loops call for one; 0: lengths are taken as they are",
    )
    heading_sigma_deg: float = Field(
        default=0.0, ge=0, le=0.1, description="beside length_sigma: 1 sigma of an even turn of odometry, degrees/m"
    )


class RobustConfig(Settings):
    """Selection of loops and separators: pairwise consistency (PCM) and graduated non-convexity (GNC)."""

    confidence: float = Field(
        default=0.999,
        gt=0,
        lt=1,
        description="share of right edges that pass the chi-square tests, if the noise is Gaussian",
    )
    noise: Literal["estimated", "stated"] = Field(
        default="estimated",
        description="stated: trust the edges' information; estimated: one factor for all by which it is over-confident",
    )
    max_noise: float = Field(default=10.0, ge=1, description="largest factor of true over stated standard deviations")
    clique_work: int = Field(default=5_000_000, ge=1, description="most nodes searched for the largest consistent set")
    iterations: int = Field(default=100, ge=1, description="GNC steps at most")
    newton_steps: int = Field(default=10, ge=1, description="steps of the optimiser in each GNC step, at most")


class SimilarityConfig(Settings):
    """Central optimisation in which every node has a scale: monocular tracks, whose unit of length drifts."""

    drift_sigma: float = Field(default=0.01, gt=0, description="1 sigma of the log scale's drift over an odometry edge")
    match_sigma: float = Field(
        default=0.02, gt=0, description="1 sigma of the log scale that a loop or separator measures"
    )
    iterations: int = Field(default=50, ge=1, description="Gauss-Newton steps at most")
    tolerance: float = Field(
        default=1e-10, ge=0, description="share of the cost by which an iteration must lower it to go on"
    )
