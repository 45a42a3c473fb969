"""Settings of the odometry, each with its unit. Defaults serve cars, rooms and rendered worlds alike."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from maslam._settings import Settings


class FeatureConfig(Settings):
    """Key-points: corners spread over a grid on each level of a scale pyramid."""

    tracks: int = Field(default=400, ge=50, description="points followed from frame to frame, at most")
    landmarks: int = Field(
        default=600, ge=0, description="ORB key-points detected per key-frame, excluding the followed points"
    )
    fast_threshold: int = Field(
        default=6,
        ge=2,
        le=100,
        description="lowest FAST corner threshold, grey levels; tiles with much texture use higher ones",
    )
    levels: int = Field(default=4, ge=1, le=8, description="levels of the scale pyramid")
    scale_factor: float = Field(
        default=1.4, gt=1.0, le=2.0, description="ratio of the sizes of two neighbouring levels of the scale pyramid"
    )


class FlowConfig(Settings):
    """Search for known points: patch alignment where the pose predicts them, pyramidal Lucas-Kanade elsewhere."""

    min_correlation: float = Field(
        default=0.8,
        gt=0.0,
        lt=1.0,
        description="lowest correlation of a patch with the same patch in its key-frame (0 to 1)",
    )
    reach_px: float = Field(
        default=16.0, gt=0.0, description="search radius of a patch around its predicted position, pixels"
    )
    align_levels: int = Field(default=1, ge=0, le=3, description="patch alignment: times that the image is halved")
    window_px: int = Field(default=13, ge=7, le=41, description="Lucas-Kanade: side of the window, pixels, odd")
    levels: int = Field(default=4, ge=0, le=6, description="Lucas-Kanade: times that the image is halved")
    max_error: float = Field(
        default=25.0, gt=0.0, description="Lucas-Kanade: largest mean absolute difference of a match, grey levels"
    )
    round_trip_px: float = Field(
        default=0.5,
        gt=0.0,
        description="Lucas-Kanade: largest distance between a point and itself tracked forward and back, pixels",
    )


class StereoConfig(Settings):
    """Disparity or depth at key-points."""

    max_disparity_px: float = Field(
        default=192.0,
        gt=8.0,
        description="largest disparity searched, pixels; the nearest depth is fx * baseline over it",
    )
    max_vertical_px: float = Field(
        default=3.0,
        gt=0.0,
        description="largest row difference within a pair after the common offset is removed, pixels",
    )
    disparity_sigma_px: float = Field(default=0.3, gt=0.0, description="standard deviation of a disparity, pixels")
    min_disparity_sigmas: float = Field(
        default=8.0, gt=0.0, description="smallest disparity that gives a map point from one pair, standard deviations"
    )
    estimate_calibration: bool = Field(
        default=True, description="estimate the calibration error that rectification has left, during the run"
    )
    residual_prior_px: float = Field(
        default=2.0,
        gt=0.0,
        description="prior standard deviation of the image displacement caused by the residual calibration, pixels",
    )
    lens_prior_px: float = Field(
        default=0.5,
        gt=0.0,
        description="mono, RGB-D: prior standard deviation of the displacement by residual radial distortion, pixels",
    )
    calibrate_every: int = Field(
        default=4,
        ge=1,
        description="key-frames between two estimates of the residual calibration, after the first ones",
    )
    row_sigma_px: float = Field(
        default=0.3, gt=0.0, description="standard deviation of a row difference within a pair, pixels"
    )
    depth_sigma_m: float = Field(
        default=0.0015, gt=0.0, description="RGB-D: depth noise at 1 m, metres; it grows with the square of depth"
    )
    align_depth: bool = Field(
        default=True, description="RGB-D: align whole depth images in the window's bundle adjustment"
    )
    align_columns: int = Field(default=80, ge=20, le=640, description="RGB-D: depth alignment, blocks across the image")
    align_lags: tuple[int, ...] = Field(
        default=(1, 2, 4, 8), description="RGB-D: depth alignment, with the key-frames this many before"
    )
    align_correlated: float = Field(
        default=2.0,
        gt=0.0,
        description="RGB-D: depth alignment, number of neighbouring blocks whose errors count as one",
    )
    max_align_depth_m: float = Field(default=4.5, gt=0.0, description="RGB-D: largest depth that is aligned, metres")
    max_depth_m: float = Field(default=8.0, gt=0.0, description="RGB-D: largest depth that is used, metres")


class PoseConfig(Settings):
    """Pose of a frame from map points."""

    pixel_sigma_px: float = Field(
        default=0.5, gt=0.0, description="standard deviation of a followed point's position, pixels"
    )
    outlier_sigmas: float = Field(
        default=2.45,
        gt=0.0,
        description="largest residual of an inlier, standard deviations (2.45: chi-square 95 %, 2 degrees of freedom)",
    )
    min_inliers: int = Field(default=15, ge=6, description="fewest matches that must agree for a frame to have a pose")
    trusted_share: float = Field(
        default=0.4,
        ge=0.0,
        le=1.0,
        description="share of followed points (0 to 1) below which the frame is tracked again without prediction",
    )
    max_frame_gap_s: float = Field(
        default=1.0, gt=0.0, description="longest time between frames over which motion is predicted, seconds"
    )


class KeyframeConfig(Settings):
    """Conditions for a frame to become a key-frame, and for a key-frame to stay."""

    policy: Literal["motion", "thesis"] = Field(
        default="motion",
        description="rule for key-frames: motion (displacement) or thesis (section 2.1.3: 20 frames, 50 points, 90 %)",
    )
    min_frames: int = Field(default=20, ge=1, description="policy thesis: fewest frames since the last key-frame")
    min_points: int = Field(default=50, ge=10, description="policy thesis: fewest points tracked")
    max_overlap: float = Field(
        default=0.9,
        gt=0.0,
        le=1.0,
        description="policy thesis: largest share of the reference's points still seen (0 to 1)",
    )
    startup_keyframes: int = Field(
        default=6, ge=1, description="policy motion: number of first frames that all become key-frames (metric rigs)"
    )
    min_flow: float = Field(
        default=0.03,
        gt=0.0,
        description="policy motion: median displacement that makes a key-frame, share of the image width",
    )
    still_flow: float = Field(
        default=0.003,
        ge=0.0,
        description="policy motion: displacement below which the camera stands still, share of the width",
    )
    refill_share: float = Field(
        default=0.6,
        gt=0.0,
        le=1.0,
        description="policy motion: share of the reference's points (0 to 1) below which a key-frame is made",
    )
    max_frames: int = Field(
        default=10, ge=1, description="policy motion: most frames between key-frames of a moving camera"
    )
    keep_distance: float = Field(
        default=0.08,
        ge=0.0,
        description="policy motion: distance between key-frames that stay, share of the median depth (others go)",
    )
    keep_angle_deg: float = Field(
        default=8.0, ge=0.0, description="policy motion: angle between key-frames that stay, degrees (others go)"
    )


class MappingConfig(Settings):
    """Window bundle adjustment and maintenance of the map."""

    window: int = Field(default=12, ge=3, description="key-frames in the window of the bundle adjustment")
    fixed: int = Field(default=3, ge=1, description="oldest key-frames of the window, held fixed")
    covisible: int = Field(default=4, ge=0, description="older covisible key-frames that join the window, held fixed")
    iterations: int = Field(default=6, ge=1, description="Levenberg-Marquardt steps per bundle adjustment, at most")
    min_observations: int = Field(default=20, ge=10, description="fewest observations in a window that is adjusted")
    outlier_factor: float = Field(
        default=1.5,
        ge=1.0,
        description="residual at which an observation is dropped from the map, multiples of the pose's outlier bound",
    )
    min_parallax_deg: float = Field(
        default=1.0, gt=0.0, description="smallest angle between rays that make a map point, degrees"
    )
    min_found_ratio: float = Field(
        default=0.25,
        ge=0.0,
        lt=1.0,
        description="share of the key-frames expected to see a point (0 to 1) below which it is not written",
    )
    view_neighbours: int = Field(
        default=5,
        ge=0,
        le=20,
        description="key-frames before and after one that sees a point in which further views of it are looked for, "
        "for the files alone (0: none)",
    )
    match_radius_px: float = Field(
        default=8.0, gt=0.0, description="radius of guided search around a projection at level 0, pixels"
    )
    fuse_radius_px: float = Field(
        default=3.0, gt=0.0, description="largest distance of two points in a key-frame that may be merged, pixels"
    )
    fuse_depth_share: float = Field(
        default=0.1,
        gt=0.0,
        description="largest difference in depth of two points that may be merged, share of the depth",
    )
    match_distance: int = Field(
        default=50, ge=1, le=256, description="largest Hamming distance of a match, bits of 256"
    )
    match_ratio: float = Field(
        default=0.8, gt=0.0, le=1.0, description="largest ratio of the best to the second best descriptor distance"
    )


class MonoConfig(Settings):
    """Two-view initialisation (thesis section 2.1.3)."""

    min_matches: int = Field(
        default=80, ge=20, description="one camera: fewest points followed from the first view of a start"
    )
    min_flow_px: float = Field(
        default=12.0,
        gt=0.0,
        description="one camera: smallest median displacement of a start, pixels at 640 pixels of width",
    )
    min_parallax_deg: float = Field(
        default=0.8,
        gt=0.0,
        description="one camera: smallest median angle between the rays of a start's points, degrees",
    )
    homography_share: float = Field(
        default=0.45,
        gt=0.0,
        lt=1.0,
        description="one camera: score share (0 to 1) above which a homography explains the pair",
    )
    min_points: int = Field(default=60, ge=20, description="one camera: fewest map points of a start")
    max_frames: int = Field(
        default=20, ge=1, description="one camera: most frames for which the first view stays the reference"
    )
    several_views: float = Field(
        default=0.5,
        gt=0.0,
        le=1.0,
        description="one camera: share (0 to 1) of the points, displacement and parallax of a start by two views that "
        "is enough where more views agree on one motion",
    )


class LostConfig(Settings):
    """Relocalisation after tracking has failed."""

    relocalise_frames: int = Field(
        default=10, ge=0, description="textured frames searched for the lost map before a new track may start"
    )
    similar_keyframes: int = Field(
        default=20, ge=1, description="most similar key-frames (by vocabulary words) that are grouped into candidates"
    )
    candidates: int = Field(default=4, ge=1, description="groups of key-frames tried per frame, one pose each")
    group_keyframes: int = Field(default=10, ge=0, description="neighbours of a key-frame whose points verify a pose")
    min_matches: int = Field(default=30, ge=10, description="fewest map points that must agree with a pose")
    min_spread: float = Field(
        default=0.4,
        ge=0.0,
        lt=1.0,
        description="smallest share of the textured image (0 to 1) filled by agreeing points; rejects repeated objects",
    )


class OdometryConfig(Settings):
    """Settings of :class:`maslam.frontend.odometry.Odometry`."""

    features: FeatureConfig = FeatureConfig()
    flow: FlowConfig = FlowConfig()
    stereo: StereoConfig = StereoConfig()
    pose: PoseConfig = PoseConfig()
    keyframes: KeyframeConfig = KeyframeConfig()
    mapping: MappingConfig = MappingConfig()
    mono: MonoConfig = MonoConfig()
    lost: LostConfig = LostConfig()
    min_track_keyframes: int = Field(default=2, ge=1, description="fewest key-frames of a track that is written")
