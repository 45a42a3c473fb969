"""Finding a lost camera in the recent map by its ORB descriptors."""

from __future__ import annotations

import numpy as np

from frontend.colmap import absolute_pose
from frontend.config import OdometryConfig
from frontend.features import Detector, Pyramid, describe
from frontend.frames import Frame
from frontend.matching import guided_match
from frontend.pose import refine_pose
from frontend.segment import Segment
from frontend.stereo import Ranging
from frontend.tracker import Tracked


def relocalise(frame: Frame, segment: Segment, ranging: Ranging, config: OdometryConfig) -> Tracked:
    """Match the frame's ORB key-points to the points of each recent key-frame, newest first; a pose needs
    ``min_inliers`` that agree.

    On success the tracker follows the matched points from here.
    """
    features = config.features
    pyramid = Pyramid(frame.image, features.levels, features.scale_factor)
    uv, level, _ = Detector(features).detect(pyramid, features.landmarks + features.tracks, np.zeros((0, 2)))
    keypoints = describe(pyramid, uv, level)
    usable = np.flatnonzero(np.isfinite(keypoints.angle_deg))
    map_ = segment.map
    best = 0
    for number in sorted(map_.keyframes, reverse=True)[: config.lost.recent_keyframes]:
        ids = map_.keyframes[number].point
        ids = np.unique(ids[ids >= 0])
        ids = ids[np.isfinite(map_.xyz[ids, 0]) & map_.described[ids]]
        anywhere = np.full(len(ids), 1e9)
        match = guided_match(
            np.zeros((len(ids), 2)),
            map_.level[ids].astype(np.float64),
            map_.descriptors[ids],
            keypoints.uv[usable],
            keypoints.level[usable],
            keypoints.descriptors[usable],
            anywhere,
            config.mapping.match_distance,
            config.mapping.match_ratio,
            level_slack=8.0,
        )
        hit = np.flatnonzero(match >= 0)
        points, seen = map_.xyz[ids[hit]], keypoints.uv[usable[match[hit]]]
        T = absolute_pose(points, seen, ranging.cam, 4.0)
        if T is None:
            continue
        n = len(hit)
        T, good, _ = refine_pose(
            T, points, seen, np.full(n, np.nan), np.full(n, 1.5), np.ones(n), ranging.cam, config.pose.outlier_sigmas, 4
        )
        best = max(best, int(good.sum()))
        if good.sum() >= 2 * config.pose.min_inliers:
            segment.tracker.start(frame, T, ids[hit[good]], seen[good])
            return Tracked(T, int(good.sum()))
    return Tracked(
        None, best, f"lost: at best {best} points of the recent map agree on a pose, need {2 * config.pose.min_inliers}"
    )
