"""Settings of the back end. Every default states its unit; an unknown key is an error."""

from __future__ import annotations

from typing import Literal

from pydantic import BaseModel, ConfigDict, Field


class RelPoseConfig(BaseModel):
    """Geometric verification of a place match (thesis section 3.5; the predecessor's values where not said otherwise)."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    max_hamming: int = Field(50, ge=0, le=256, description="descriptor matches farther apart than this are not made, bits of 256")
    ratio: float = Field(0.8, gt=0, le=1, description="best over second best descriptor distance, at most; 1 switches it off")
    min_matches: int = Field(20, ge=3, description="fewer tentative matches are not worth a search")
    min_inliers: int = Field(20, ge=3, description="accepted with at least this many inliers")
    search_angle_deg: float = Field(3.0, gt=0, le=20, description="bearing error of an inlier, both ways, while searching, degrees")
    inlier_angle_deg: float = Field(0.75, gt=0, le=20, description="bearing error of an inlier, both ways, of the refined pose, degrees")
    depth_ratio: float = Field(1.5, gt=1, description="depths of an inlier in one camera agree within this factor")
    samples: int = Field(20_000, ge=1, description="minimal sets drawn; those whose side lengths disagree are dropped unsolved")
    hypotheses: int = Field(400, ge=1, description="transforms scored at most")
    guided_hamming: int = Field(64, ge=0, le=256, description="descriptor distance allowed once the pose is known, bits of 256")
    loss_scale: float = Field(3.0, gt=0, description="scale of the Cauchy loss in refinement, standard deviations")
    min_support: float = Field(0.25, ge=0, le=1, description="least share of inliers among the tentative matches that both views can see")
    max_scale: float = Field(20.0, gt=1, description="a similarity's scale lies within 1/this and this")
    max_sigma: float = Field(0.1, gt=0, description="position uncertainty (1 sigma, worst direction) over median inlier depth, at most")


class SolverConfig(BaseModel):
    """Pose-graph optimisation, central and distributed (thesis section 3.6)."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    method: Literal["dgs", "jor", "sor"] = Field("dgs", description="order and relaxation of the distributed sweeps")
    relaxation: float = Field(1.75, gt=0, lt=2, description="over-relaxation of sor (jor uses at most 1 of it)")
    rotation_sweeps: int = Field(50, ge=1, description="rotation sweeps at most")
    pose_sweeps: int = Field(50, ge=1, description="pose sweeps of one Gauss-Newton step at most")
    rotation_threshold: float = Field(1e-1, ge=0, description="a robot is quiet when its rotation entries change by less (2-norm over its poses)")
    pose_threshold: float = Field(1e-1, ge=0, description="likewise for poses: metres and radians")
    newton_steps: int = Field(1, ge=1, description="Gauss-Newton steps of the pose stage; 1 is the published two-stage method")
