"""One sequence with given poses through the mapper: what odometry would have made of it."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from maslam._replaced import replaced
from maslam.descriptors.base import PlaceDescriptor
from maslam.frontend.cameras.models import Rig, RigKind
from maslam.frontend.config import OdometryConfig
from maslam.frontend.datasets.base import ImageSequence
from maslam.frontend.errors import FrontendError
from maslam.frontend.files.trajectory import NS_PER_S, Trajectory
from maslam.frontend.files.vo_files import VoTrack
from maslam.frontend.frames import Frame
from maslam.frontend.mapping.body_axes import fitting_axes
from maslam.frontend.mapping.given_poses import GivenMap, GivenPoseMapper
from maslam.frontend.mapping.pose_agreement import agreeing
from maslam.frontend.vocabulary.vocabulary import Vocabulary

from ..common.errors import ToolError
from ..pipeline.tracking import UNREADABLE_SHARE, Gap, Tracked, runs_of
from .given_points import GivenPoints
from .placed_images import PlacedImages

NO_POSE, TOO_SHORT = "no pose is given at its time", "the track is too short: fewer than 2 key-frames"
_REFUSE_BELOW, _WARN_BELOW = 0.4, 0.7
"""Share of key-points matched by their look that must agree with the poses; rendered and real sequences with right ones
have 0.85 and more."""
_AXES_BELOW, _AXES_BETTER = 0.85, 0.2
"""Share below which other axes are tried, and by how much more must agree in these: they are named then."""
_UNIT_WARN, _UNIT_REFUSE = 0.1, 0.5
"""How far the unit of the poses may be off that of depth: share of it."""
_ERROR_WARN_PX = 3.0
_REFUSE_DEPTH, _WARN_DEPTH, _COMPARED = 0.5, 0.75, 10
"""Share of depths that are the same by points and by rays; rendered points have 0.8 and more. Fewer tell nothing."""
_POINTS_ASKED = "are the points in the frame and the unit of the poses?"
_ANY_DEPTH = 1e4
"""Given points count however far away they are, in their unit."""
_CURE = (
    "are they the camera's (--T-body-camera FILE for a body's or LiDAR's), on its clock (--clock-offset), and do they "
    "map camera to world?"
)


def track_given(
    sequence: ImageSequence,
    placed: PlacedImages,
    config: OdometryConfig,
    vocabulary: Vocabulary,
    model: PlaceDescriptor,
    advance: Callable[[int], None],
    points: GivenPoints | None = None,
) -> Tracked:
    """Key-frames, points and place vectors of ``sequence`` at the poses ``placed`` (of its rectified camera).

    ``points``: what measures depth where images have none. :func:`agreement_lines` says what a user should know of it.
    :class:`ToolError` where the images contradict the poses, or nothing could be made.
    """
    rig = sequence.rig
    if points is not None:
        rig = Rig(RigKind.RGBD, rig.camera)
        config = replaced(config, stereo=replaced(config.stereo, max_depth_m=_ANY_DEPTH))
    unreadable: list[str] = []
    vectors: list[NDArray[np.float32]] = []
    textured: list[bool] = []
    maps: list[GivenMap] = []
    kept: list[NDArray[np.int64]] = []
    for number in range(int(placed.track[-1]) + 1):
        rows = np.flatnonzero(placed.track == number)
        mapper, described = GivenPoseMapper(rig, config), []
        for k in rows.tolist():
            index, T_W_C = int(placed.rows[k]), placed.poses[k]
            frame = _wanted(mapper, sequence, index, T_W_C, unreadable)
            if frame is not None:
                if points is not None:
                    depth = points.depth(index, frame.stamp_ns, T_W_C, rig.camera)
                    frame = Frame(index, frame.stamp_ns, frame.image, None, depth, frame.name, frame.used)
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
        raise ToolError(f"no key-frames: the camera hardly moves in its {len(placed.rows)} posed images")
    stats = _agreement(maps)
    if points is not None:
        _refuse_points(stats)
    if not placed.mounted and stats.get("agreeing", 1.0) < _AXES_BELOW:
        _refuse_axes(stats, maps, sequence)
    _refuse_contradiction(stats)
    posed = [placed.rows[rows] for rows in kept]
    return Tracked(
        tracks=tuple(_vo_track(one, vocabulary) for one in maps),
        views=tuple(one.views for one in maps),
        keyframes=tuple(one.frames for one in maps),
        trajectories=tuple(Trajectory(sequence.stamps_ns[placed.rows[rows]], placed.poses[rows]) for rows in kept),
        vectors=np.stack(vectors).astype(np.float32),
        textured=np.array(textured, dtype=bool),
        lost=_lost(len(sequence), placed.rows, np.concatenate(posed)),
        unreadable=tuple(unreadable),
        stats=stats,
    )


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


def _agreement(maps: list[GivenMap]) -> dict[str, float]:
    """What the images say of the poses: ``error_px``, how far points are seen from where the poses put them;
    ``agreeing`` share of what looks alike, in ``pairs`` of key-frames; ``unit``: lengths of the poses over those of
    depth; ``same_depth``: share of depths that rays confirm."""
    pairs = [pair for one in maps for pair in one.agreement]
    stats = {
        "keyframes": float(sum(len(one) for one in maps)),
        "points": float(sum(len(one.points) for one in maps)),
        "measured": float(sum(one.measured for one in maps)),
        "pairs": float(len(pairs)),
    }
    errors = np.array([one.error_px for one in maps])
    stats |= {"error_px": float(np.median(errors[np.isfinite(errors)]))} if np.isfinite(errors).any() else {}
    stats |= {"agreeing": float(agreeing(pairs))} if pairs else {}
    units = np.array([pair.unit for pair in pairs])
    compared = sum(pair.compared for pair in pairs)
    stats |= {"same_depth": sum(pair.same for pair in pairs) / compared} if compared >= _COMPARED else {}
    return stats | ({"unit": float(np.median(units[np.isfinite(units)]))} if np.isfinite(units).any() else {})


def _share_text(stats: Mapping[str, float]) -> str:
    share, pairs = 100 * stats["agreeing"], int(stats["pairs"])
    return f"{share:.0f} % of the key-points that look alike agree with the poses (median of {pairs} pairs)"


def _unit_text(stats: Mapping[str, float]) -> str:
    return f"lengths of the poses are {stats['unit']:.3g} times those of the measured depth"


def _refuse_contradiction(stats: Mapping[str, float]) -> None:
    """:class:`ToolError` where the images contradict the poses."""
    if stats.get("agreeing", 1.0) < _REFUSE_BELOW:
        raise ToolError(f"images and poses contradict each other: only {_share_text(stats)}; {_CURE}")
    if abs(np.log(stats.get("unit", 1.0))) > np.log1p(_UNIT_REFUSE):
        raise ToolError(
            f"{_unit_text(stats)}: they are not in metres, or the baseline or depth unit is wrong; "
            "--rig mono --scale arbitrary takes them as they are"
        )
    if not stats["points"]:
        raise ToolError("no point could be placed by the poses given")


def _refuse_axes(stats: Mapping[str, float], maps: Sequence[GivenMap], sequence: ImageSequence) -> None:
    """:class:`ToolError` where the images contradict the poses as a camera's, and agree with them in other axes."""
    camera = sequence.rig.camera
    found = fitting_axes([one for m in maps for one in m.matched], camera.fx, camera.width, sequence.R_rectified_left)
    if found is None or found.share < _WARN_BELOW or found.share < stats["agreeing"] + _AXES_BETTER:
        return
    cure = "invert them" if found.inverted else f"--T-body-camera={found.numbers()}, or with its place on the body"
    as_given = "; --T-body-camera=0,0,0,0,0,0,1 takes them as the camera's all the same"
    raise ToolError(
        f"images and poses contradict each other: only {_share_text(stats)}; as {found.words()}, "
        f"{100 * found.share:.0f} % do: {cure}{as_given if stats['agreeing'] >= _REFUSE_BELOW else ''}"
    )


def _refuse_points(stats: Mapping[str, float]) -> None:
    """:class:`ToolError` where given points measure nothing, or contradict the images."""
    if not stats["measured"]:
        raise ToolError(f"no given point is where an image has a key-point: {_POINTS_ASKED}")
    if stats.get("same_depth", 1.0) < _REFUSE_DEPTH:
        raise ToolError(f"{_depth_text(stats)}; {_POINTS_ASKED}")


def _depth_text(stats: Mapping[str, float]) -> str:
    return f"only {100 * stats['same_depth']:.0f} % of the depths measured are those of the images' rays"


def agreement_lines(name: str, stats: Mapping[str, float]) -> tuple[list[str], list[str]]:
    """What was found in the images of a sequence, for people, and what its user should know."""
    error_px = stats.get("error_px", 0.0)
    off = f"seen {error_px:.2f} px from where the poses put them (median)"
    measured = f", {stats['measured']:.0f} with measured depth" if stats["measured"] else ""
    notes = [f"{name}: {stats['keyframes']:.0f} key-frames, {stats['points']:.0f} points{measured}, {off}"]
    if not stats["pairs"]:
        return notes, [f"{name}: too few matches between key-frames to check the poses by the images"]
    warnings = []
    if stats["agreeing"] < _WARN_BELOW:
        warnings.append(f"{name}: only {_share_text(stats)}; {_CURE}")
    if error_px > _ERROR_WARN_PX:
        warnings.append(f"{name}: points are seen {error_px:.1f} px from where the poses put them (median); {_CURE}")
    if abs(np.log(stats.get("unit", 1.0))) > np.log1p(_UNIT_WARN):
        warnings.append(f"{name}: {_unit_text(stats)}")
    if stats.get("same_depth", 1.0) < _WARN_DEPTH:
        warnings.append(
            f"{name}: {_depth_text(stats)}; are depth, or given points, in the frame and unit of the poses?"
        )
    return notes, warnings


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
