"""Everything that can be set in the odometry, with its unit beside it. Defaults serve cars, rooms and rendered worlds
alike."""

from __future__ import annotations

from typing import Literal

from pydantic import BaseModel, ConfigDict, Field


class _Frozen(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")


class FeatureConfig(_Frozen):
    """Key-points: corners spread over a grid on each level of a scale pyramid."""

    tracks: int = Field(400, ge=50, description="points followed from frame to frame")
    landmarks: int = Field(600, ge=0, description="ORB key-points looked for in a key-frame, beside the followed ones")
    fast_threshold: int = Field(
        6, ge=2, le=100, description="grey levels: the lowest threshold; tiles with much texture take higher ones"
    )
    levels: int = Field(4, ge=1, le=8, description="levels of the scale pyramid")
    scale_factor: float = Field(1.4, gt=1.0, le=2.0, description="ratio of two levels")


class FlowConfig(_Frozen):
    """Finding points again: patch alignment where the pose predicts them, pyramidal Lucas-Kanade where nothing does."""

    min_correlation: float = Field(0.8, gt=0.0, lt=1.0, description="of a patch with its key-frame's")
    reach_px: float = Field(16.0, gt=0.0, description="patches are searched this far from their prediction")
    align_levels: int = Field(1, ge=0, le=3, description="halvings of the image for patches")
    window_px: int = Field(13, ge=7, le=41, description="Lucas-Kanade: side of the window, odd")
    levels: int = Field(4, ge=0, le=6, description="Lucas-Kanade: halvings of the image")
    max_error: float = Field(25.0, gt=0.0, description="Lucas-Kanade: mean absolute grey-level difference of a match")
    round_trip_px: float = Field(0.5, gt=0.0, description="Lucas-Kanade: forward and backward may differ by this much")


class StereoConfig(_Frozen):
    """Disparity or depth at key-points."""

    max_disparity_px: float = Field(192.0, gt=8.0, description="nothing nearer than fx * baseline / this")
    max_vertical_px: float = Field(
        3.0, gt=0.0, description="rows of a pair may differ by this after their common offset is removed"
    )
    disparity_sigma_px: float = Field(0.3, gt=0.0, description="standard deviation of a disparity")
    min_disparity_sigmas: float = Field(
        8.0, gt=0.0, description="a disparity below this many standard deviations gives no map point alone"
    )
    estimate_calibration: bool = Field(
        True, description="estimate on line what rectification has left of the rig's calibration error"
    )
    residual_prior_px: float = Field(
        2.0, gt=0.0, description="prior standard deviation of the displacements it makes, over the image"
    )
    lens_prior_px: float = Field(
        0.5, gt=0.0, description="mono, RGB-D: the same for the radial distortion of the one lens"
    )
    calibrate_every: int = Field(4, ge=1, description="key-frames between two estimates, after the first ones")
    row_sigma_px: float = Field(0.3, gt=0.0, description="standard deviation of a row difference within a pair")
    depth_sigma_m: float = Field(
        0.0015, gt=0.0, description="RGB-D: depth noise at 1 m; it grows with the square of depth"
    )
    align_depth: bool = Field(True, description="RGB-D: align whole depth images in the window's bundle adjustment")
    align_columns: int = Field(80, ge=20, le=640, description="RGB-D: blocks across a depth image that are aligned")
    align_lags: tuple[int, ...] = Field((1, 2, 4, 8), description="RGB-D: with the key-frames so many before")
    align_correlated: float = Field(
        2.0, gt=0.0, description="RGB-D: so many places err alike; their information counts as that of one"
    )
    max_align_depth_m: float = Field(4.5, gt=0.0, description="RGB-D: depths beyond this are not aligned")
    max_depth_m: float = Field(8.0, gt=0.0, description="RGB-D: depths beyond this are not used")


class PoseConfig(_Frozen):
    """Pose of a frame from map points."""

    pixel_sigma_px: float = Field(0.5, gt=0.0, description="standard deviation of a followed position")
    outlier_sigmas: float = Field(
        2.45, gt=0.0, description="residual beyond which a match is an outlier (chi-square 95 %, 2 d.o.f.)"
    )
    min_inliers: int = Field(15, ge=6, description="fewer matches that agree: the frame has no pose")
    trusted_share: float = Field(
        0.4, ge=0.0, le=1.0, description="fewer of the followed points found: try without prediction"
    )
    max_frame_gap_s: float = Field(1.0, gt=0.0, description="a longer gap in time breaks the motion prediction")


class KeyframeConfig(_Frozen):
    """When a frame becomes a key-frame, and which key-frames stay."""

    policy: Literal["motion", "thesis"] = Field(
        "motion",
        description="motion: ours; thesis: section 2.1.3 (20 frames, 50 points, 90 %)",
    )
    min_frames: int = Field(20, ge=1, description="thesis: frames since the last key-frame")
    min_points: int = Field(50, ge=10, description="thesis: points that must be tracked")
    max_overlap: float = Field(0.9, gt=0.0, le=1.0, description="thesis: share of the reference's points still seen")
    startup_keyframes: int = Field(6, ge=1, description="motion: so many first frames are all key-frames (metric rigs)")
    min_flow: float = Field(
        0.03, gt=0.0, description="motion: median displacement since the last key-frame, share of the image width"
    )
    still_flow: float = Field(
        0.003, ge=0.0, description="motion: less displacement than this share of the width is standing still"
    )
    refill_share: float = Field(
        0.6, gt=0.0, le=1.0, description="motion: fewer points than this share of the reference's"
    )
    max_frames: int = Field(10, ge=1, description="motion: at the latest after so many frames, if anything moved")
    keep_distance: float = Field(
        0.08, ge=0.0, description="motion: key-frames this share of the median depth apart stay for good ..."
    )
    keep_angle_deg: float = Field(
        8.0, ge=0.0, description="... or turned by this; those between support the window, then go"
    )


class MappingConfig(_Frozen):
    """Window bundle adjustment and care for the map."""

    window: int = Field(12, ge=3, description="key-frames in the bundle adjustment")
    fixed: int = Field(3, ge=1, description="of these, the oldest that are held fixed")
    covisible: int = Field(4, ge=0, description="older key-frames of the same place that join, held fixed")
    iterations: int = Field(6, ge=1, description="Levenberg-Marquardt steps")
    min_observations: int = Field(20, ge=10, description="fewer in the window: it is left as it is")
    outlier_factor: float = Field(
        1.5, ge=1.0, description="of the pose's outlier bound: an observation is dropped from the map"
    )
    min_parallax_deg: float = Field(1.0, gt=0.0, description="between rays that make a map point")
    min_found_ratio: float = Field(
        0.25, ge=0.0, lt=1.0, description="points found in fewer of the key-frames that should see them are not written"
    )
    match_radius_px: float = Field(8.0, gt=0.0, description="guided search around a projection, at level 0")
    fuse_radius_px: float = Field(3.0, gt=0.0, description="two points this near in a key-frame may be one ...")
    fuse_depth_share: float = Field(0.1, gt=0.0, description="... if their depths differ by less than this share")
    match_distance: int = Field(50, ge=1, le=256, description="Hamming distance of a match")
    match_ratio: float = Field(0.8, gt=0.0, le=1.0, description="best to second best distance")


class MonoConfig(_Frozen):
    """Two-view initialisation (thesis section 2.1.3)."""

    min_matches: int = Field(80, ge=20, description="points followed from the first view")
    min_flow_px: float = Field(12.0, gt=0.0, description="median displacement, at 640 pixels of width")
    min_parallax_deg: float = Field(0.8, gt=0.0, description="median angle between the rays of triangulated points")
    homography_share: float = Field(
        0.45, gt=0.0, lt=1.0, description="score share above which the homography explains the pair"
    )
    min_points: int = Field(60, ge=20, description="map points of a good start")
    max_frames: int = Field(20, ge=1, description="frames the first view is kept as reference")


class LostConfig(_Frozen):
    """What happens when tracking fails."""

    relocalise_frames: int = Field(
        10, ge=0, description="frames with texture searched for the map before a new track may start"
    )
    similar_keyframes: int = Field(20, ge=1, description="key-frames most alike by their words that are grouped")
    candidates: int = Field(4, ge=1, description="groups tried, a pose each")
    group_keyframes: int = Field(10, ge=0, description="neighbours of a key-frame whose points must bear a pose out")
    min_matches: int = Field(30, ge=10, description="points of the map that must agree with a pose ...")
    min_spread: float = Field(
        0.4,
        ge=0.0,
        lt=1.0,
        description="... and the share of the textured image they must fill: a thing that stands twice fills less",
    )


class OdometryConfig(_Frozen):
    """Settings of :class:`maslam.frontend.odometry.Odometry`."""

    features: FeatureConfig = FeatureConfig()
    flow: FlowConfig = FlowConfig()
    stereo: StereoConfig = StereoConfig()
    pose: PoseConfig = PoseConfig()
    keyframes: KeyframeConfig = KeyframeConfig()
    mapping: MappingConfig = MappingConfig()
    mono: MonoConfig = MonoConfig()
    lost: LostConfig = LostConfig()
    min_track_keyframes: int = Field(2, ge=1, description="shorter tracks are not written")
