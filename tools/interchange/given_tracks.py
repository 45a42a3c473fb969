"""One sequence with given poses through the mapper: what odometry would have made of it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from maslam.descriptors.base import PlaceDescriptor
from maslam.frontend.config import OdometryConfig
from maslam.frontend.datasets.base import ImageSequence
from maslam.frontend.errors import FrontendError
from maslam.frontend.files.trajectory import NS_PER_S, Trajectory
from maslam.frontend.files.vo_files import VoTrack
from maslam.frontend.frames import Frame
from maslam.frontend.mapping.given_poses import GivenMap, GivenPoseMapper
from maslam.frontend.mapping.pose_agreement import agreeing
from maslam.frontend.vocabulary.vocabulary import Vocabulary

from ..common.errors import ToolError
from ..pipeline.tracking import UNREADABLE_SHARE, Gap, Tracked, runs_of
from .placed_images import PlacedImages

NO_POSE, TOO_SHORT = "no pose is given at its time", "the track is too short: fewer than 2 key-frames"
_REFUSE_BELOW, _WARN_BELOW = 0.4, 0.7
"""Share of key-points matched by their look that must agree with the poses; rendered and real sequences with right ones
have 0.85 and more."""
_UNIT_WARN, _UNIT_REFUSE = 0.1, 0.5
"""How far the unit of the poses may be off that of depth: share of it."""
_ERROR_WARN_PX = 3.0
_CURE = (
    "are they the camera's (--T-body-camera FILE for a body's or LiDAR's), on its clock (--clock-offset), and do they "
    "map camera to world?"
)


@dataclass(frozen=True)
class GivenTracks:
    """``tracked``: as odometry's; ``notes``: what was found, for people; ``warnings``: what its user should know."""

    tracked: Tracked
    notes: tuple[str, ...]
    warnings: tuple[str, ...]


def track_given(
    sequence: ImageSequence,
    placed: PlacedImages,
    config: OdometryConfig,
    vocabulary: Vocabulary,
    model: PlaceDescriptor,
    advance: Callable[[int], None],
) -> GivenTracks:
    """Key-frames, points and place vectors of ``sequence`` at the poses ``placed`` (of its rectified camera).

    :class:`ToolError` where the images contradict the poses, or nothing could be made.
    """
    unreadable: list[str] = []
    vectors: list[NDArray[np.float32]] = []
    textured: list[bool] = []
    maps: list[GivenMap] = []
    kept: list[NDArray[np.int64]] = []
    for number in range(int(placed.track[-1]) + 1):
        rows = np.flatnonzero(placed.track == number)
        mapper, described = GivenPoseMapper(sequence.rig, config), []
        for k in rows.tolist():
            index, T_W_C = int(placed.rows[k]), placed.poses[k]
            frame = _wanted(mapper, sequence, index, T_W_C, unreadable)
            if frame is not None:
                mapper.insert(frame, T_W_C)
                seen = sequence.read_colour(index) if model.colour else frame.image
                described.append(model.look([seen]))
            advance(index + 1)
        if len(described) < 2:
            continue
        maps.append(mapper.finish())
        kept.append(rows)
        vectors += [vector[0] for vector, _ in described]
        textured += [bool(flag[0]) for _, flag in described]
    if not maps:
        raise ToolError(
            f"{sequence.name}: no key-frames: the camera hardly moves in its {len(placed.rows)} posed images"
        )
    notes, warnings = _agreement(sequence, maps)
    posed = [placed.rows[rows] for rows in kept]
    tracked = Tracked(
        tracks=tuple(_vo_track(one, vocabulary) for one in maps),
        views=tuple(one.views for one in maps),
        keyframes=tuple(one.frames for one in maps),
        trajectories=tuple(Trajectory(sequence.stamps_ns[placed.rows[rows]], placed.poses[rows]) for rows in kept),
        vectors=np.stack(vectors).astype(np.float32),
        textured=np.array(textured, dtype=bool),
        lost=_lost(len(sequence), placed.rows, np.concatenate(posed)),
        unreadable=tuple(unreadable),
        stats={"error_px": float(np.median([one.error_px for one in maps]))},
    )
    return GivenTracks(tracked, notes, warnings)


def _wanted(
    mapper: GivenPoseMapper, sequence: ImageSequence, index: int, T_W_C: NDArray[np.float64], unreadable: list[str]
) -> Frame | None:
    """The frame, where it becomes a key-frame; only those and a start's are decoded."""
    wanted = mapper.wants(T_W_C)
    if wanted is False:
        return None
    try:
        if wanted is None and not mapper.wants_image(sequence.read_image(index), T_W_C):
            return None
        return sequence.read(index)
    except FrontendError as error:
        unreadable.append(str(error))
        if len(unreadable) > max(1.0, UNREADABLE_SHARE * len(sequence)):
            raise ToolError(f"{len(unreadable)} images cannot be read: {error}") from error
        return None


def _vo_track(one: GivenMap, vocabulary: Vocabulary) -> VoTrack:
    words = vocabulary.words(one.descriptors) if len(one.descriptors) else np.zeros((0, 2))
    return VoTrack(
        one.stamps_ns / NS_PER_S, one.poses, one.points, one.views.observations, one.descriptors, words.astype(np.int32)
    )


def _agreement(sequence: ImageSequence, maps: list[GivenMap]) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """What the images say of the poses; :class:`ToolError` where they contradict them."""
    pairs = [pair for one in maps for pair in one.agreement]
    points, keyframes = sum(len(one.points) for one in maps), sum(len(one) for one in maps)
    error_px = float(np.median([one.error_px for one in maps]))
    name = sequence.name
    off = f"seen {error_px:.2f} px from where the poses put them (median)"
    notes = [f"{name}: {keyframes} key-frames, {points} points, {off}"]
    warnings = []
    if not pairs:
        return tuple(notes), (f"{name}: too few matches between key-frames to check the poses by the images",)
    share = agreeing(pairs)
    said = f"{100 * share:.0f} % of the key-points that look alike agree with the poses (median of {len(pairs)} pairs)"
    if share < _REFUSE_BELOW:
        raise ToolError(f"{name}: images and poses contradict each other: only {said}; {_CURE}")
    if share < _WARN_BELOW:
        warnings.append(f"{name}: only {said}; {_CURE}")
    if error_px > _ERROR_WARN_PX:
        warnings.append(f"{name}: points are seen {error_px:.1f} px from where the poses put them (median); {_CURE}")
    units = np.array([pair.unit for pair in pairs])
    units = units[np.isfinite(units)]
    if len(units):
        unit = float(np.median(units))
        text = f"{name}: lengths of the poses are {unit:.3g} times those of the measured depth"
        if abs(np.log(unit)) > np.log1p(_UNIT_REFUSE):
            raise ToolError(
                f"{text}: they are not in metres, or the baseline or depth unit is wrong; --rig mono --scale arbitrary "
                "takes them as they are"
            )
        if abs(np.log(unit)) > np.log1p(_UNIT_WARN):
            warnings.append(text)
    if not points:
        raise ToolError(f"{name}: no point could be placed by the poses given")
    return tuple(notes), tuple(warnings)


def _lost(frames: int, with_pose: NDArray[np.int64], used: NDArray[np.int64]) -> tuple[Gap, ...]:
    """Intervals of frames without a pose in any track."""
    kind = np.full(frames, NO_POSE, dtype=object)
    kind[with_pose] = TOO_SHORT
    missing = np.ones(frames, dtype=bool)
    missing[used] = False
    rows = np.flatnonzero(missing)
    out = []
    for run in np.split(rows, np.flatnonzero(np.diff(rows) > 1) + 1) if len(rows) else []:
        kinds = runs_of(kind[run].tolist())
        out.append(Gap(int(run[0]), int(run[-1]), "; ".join(dict.fromkeys(name for name, _ in kinds)), kinds))
    return tuple(out)
