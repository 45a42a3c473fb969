"""One sequence through the front end: odometry and place vectors in one pass, every image decoded once."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import groupby
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from maslam.frontend.errors import FrontendError, ImageSizeError
from maslam.frontend.files.point_views import PointViews
from maslam.frontend.files.trajectory import Trajectory
from maslam.frontend.files.vo_files import VoTrack
from maslam.frontend.reason import STANDS_SHORT

if TYPE_CHECKING:
    from maslam.descriptors.base import PlaceDescriptor
    from maslam.frontend.config import OdometryConfig
    from maslam.frontend.datasets import ImageSequence
    from maslam.frontend.frames import Frame
    from maslam.frontend.odometry import FrameResult, Odometry, OdometryResult
    from maslam.frontend.stopwatch import Stopwatch
    from maslam.frontend.tracking.pose_log import DoubtfulInterval, LostInterval
    from maslam.frontend.vocabulary.vocabulary import Vocabulary

UNREADABLE_SHARE = (
    0.1  # more unreadable frames than this, and the sequence is refused: what is left is not what was filmed
)
UNREADABLE = "the image could not be read"
_KEEP_ONE = "move it, or keep its one key-frame by odometry.min_track_keyframes 1 (--odometry.min-track-keyframes 1)"
OTHER_SIZE = "the image has another size than the others"


@dataclass(frozen=True)
class Gap:
    """Frames ``first_frame`` to ``last_frame`` (inclusive, counted in the sequence) have no pose, or a doubtful one,
    and why. ``kinds``: the reason of each frame without figures, as runs ``(kind, frames)``; empty: not known."""

    first_frame: int
    last_frame: int
    reason: str
    kinds: tuple[tuple[str, int], ...] = ()


@dataclass(frozen=True)
class Tracked:
    """Result of the front end for one sequence of F frames.

    ``tracks``: one for each uninterrupted track, their key-frames numbered in ``keyframes`` by frame (ascending);
    ``views``: for each, every view of its points that was found, pixels of the pinhole camera.
    ``trajectories``: every tracked frame of each track, ``T_W_C`` in the track's frame. ``vectors`` ``(K, dim)`` and
    ``textured`` ``(K,)``: one per key-frame, all tracks in order. ``unreadable``: what was wrong with each image that
    was needed and could not be read; ``other_size``: frames whose image was whole, but of another size.
    """

    tracks: tuple[VoTrack, ...]
    views: tuple[PointViews, ...]
    keyframes: tuple[NDArray[np.int64], ...]
    trajectories: tuple[Trajectory, ...]
    vectors: NDArray[np.float32]
    textured: NDArray[np.bool_]
    lost: tuple[Gap, ...]
    unreadable: tuple[str, ...]
    stats: dict[str, float]
    doubtful: tuple[Gap, ...] = ()
    other_size: tuple[int, ...] = ()


def track(
    sequence: ImageSequence,
    config: OdometryConfig,
    vocabulary: Vocabulary,
    model: PlaceDescriptor,
    advance: Callable[[int], None],
) -> Tracked:
    """Run every frame through odometry, and each key-frame's image through the place descriptor.

    A frame that cannot be read is left out and reported, and so is a second image (right, depth) of a key-frame,
    which is then made without it; ``FrontendError`` where too many are, or where nothing could be tracked.
    """
    from maslam.frontend.odometry import Odometry

    odometry = Odometry(sequence.rig, config, vocabulary)
    places = _Places(sequence, model)
    unreadable: list[str] = []
    other_size: list[int] = []
    read = np.zeros(len(sequence), dtype=bool)
    for frame, result in follow(sequence, odometry, unreadable, other_size):
        read[frame.index] = True
        for keyframe in (result.first, frame if result.stays else None):
            if keyframe is not None:
                places.describe(keyframe.index, keyframe.image)
        advance(frame.index + 1)
    finished = odometry.finish()
    if not any(len(one) for one in finished.tracks):
        raise FrontendError(
            f"no frame of {len(sequence)} could be tracked: {_why_none(finished, sequence, read, other_size)}"
        )
    return _collect(finished, places, sequence.stamps_ns, read, tuple(unreadable), tuple(other_size))


def _why_none(
    finished: OdometryResult, sequence: ImageSequence, read: NDArray[np.bool_], other_size: Sequence[int]
) -> str:
    """Why a result has no track. A frame that had a pose in a track too short to be kept counts as well."""
    reasons: Counter[str] = Counter()
    for interval in finished.lost:
        for kind, frames in lost_gap(interval, sequence.stamps_ns, read, other_size).kinds:
            reasons[kind] += frames
    why = ", ".join(f"{kind} ({count} x)" for kind, count in reasons.most_common(3)) or "no frame could be used"
    if sequence.rig.metric and set(reasons) == {STANDS_SHORT}:
        return f"{why}: {_KEEP_ONE}"
    return why


def follow(
    sequence: ImageSequence, odometry: Odometry, unreadable: list[str], other_size: list[int] | None = None
) -> Iterator[tuple[Frame, FrameResult]]:
    """Every readable frame of ``sequence`` with what ``odometry`` makes of it; what is wrong with the others goes to
    ``unreadable``, and which of them have another size to ``other_size``."""
    for frame in _readable(sequence, unreadable, other_size, odometry.stopwatch):
        result = odometry.process(frame)
        if result.problem:
            _report(result.problem, unreadable, frame.index + 1, len(sequence))
        yield frame, result


def _readable(
    sequence: ImageSequence, unreadable: list[str], other_size: list[int] | None, watch: Stopwatch
) -> Iterator[Frame]:
    """The frames in order without those that cannot be read; what is wrong with these goes to ``unreadable`` and
    ``other_size``."""
    following = 0
    while following < len(sequence):
        try:
            for frame in sequence.frames(following, watch=watch):
                following = frame.index + 1
                yield frame
        except FrontendError as error:
            if isinstance(error, ImageSizeError) and other_size is not None:
                other_size.append(following)
            following += 1
            _report(str(error), unreadable, following, len(sequence))


def _report(problem: str, unreadable: list[str], frames: int, all_frames: int) -> None:
    """Note a frame of the first ``frames`` that cannot be read; an error where they are too many."""
    unreadable.append(problem)
    if len(unreadable) > max(1.0, UNREADABLE_SHARE * all_frames):
        raise FrontendError(f"{len(unreadable)} of the first {frames} frames cannot be read: {problem}")


class _Places:
    """Place vectors by frame number, made while the image is at hand; others are read again when they are asked for."""

    def __init__(self, sequence: ImageSequence, model: PlaceDescriptor) -> None:
        self._sequence = sequence
        self._model = model
        self._made: dict[int, tuple[NDArray[np.float32], bool]] = {}

    def describe(self, index: int, image: NDArray[np.uint8]) -> tuple[NDArray[np.float32], bool]:
        # Odometry decodes grey; a colour network's few key-frames are read again for their colours.
        seen = self._sequence.read_colour(index) if self._model.colour else image
        vectors, textured = self._model.look([seen])
        self._made[index] = vectors[0], bool(textured[0])
        return self._made[index]

    def of(self, index: int) -> tuple[NDArray[np.float32], bool]:
        if index not in self._made:
            # As in tracking, a damaged second image does not matter.
            self.describe(index, next(self._sequence.frames(index, index + 1)).image)
        return self._made[index]


def unread_kinds(first: int, last: int, other_size: Sequence[int]) -> NDArray[np.object_]:
    """Why each of the frames ``first`` to ``last`` could not be read, if it could not."""
    kinds = np.full(last - first + 1, UNREADABLE, dtype=object)
    kinds[[frame - first for frame in other_size if first <= frame <= last]] = OTHER_SIZE
    return kinds


def lost_gap(
    interval: LostInterval, stamps_ns: NDArray[np.int64], read: NDArray[np.bool_], other_size: Sequence[int] = ()
) -> Gap:
    """The interval in frames of a sequence, each of which has one reason; odometry saw those ``read`` ``(F,)`` only,
    and ``other_size`` are the frames that could not be read for their size."""
    first, last = (int(np.searchsorted(stamps_ns, t)) for t in (interval.first_ns, interval.last_ns))
    kinds = unread_kinds(first, last, other_size)
    seen = [kind for kind, frames in interval.kinds for _ in range(frames)]
    if not seen:
        return Gap(first, last, interval.reason)
    missing = Counter(kinds[~read[first : last + 1]].tolist())
    kinds[read[first : last + 1]] = seen
    more = "".join(f"; {kind} ({count} frame{'s'[count == 1 :]})" for kind, count in sorted(missing.items()))
    return Gap(first, last, interval.reason + more, runs_of(kinds.tolist()))


def runs_of(kinds: Iterable[str]) -> tuple[tuple[str, int], ...]:
    """Equal neighbours as one, with their number."""
    return tuple((kind, len(list(same))) for kind, same in groupby(kinds))


def _collect(
    finished: OdometryResult,
    places: _Places,
    stamps_ns: NDArray[np.int64],
    read: NDArray[np.bool_],
    unreadable: tuple[str, ...],
    other_size: tuple[int, ...],
) -> Tracked:
    def doubtful(interval: DoubtfulInterval) -> Gap:
        first, last = (int(np.searchsorted(stamps_ns, t)) for t in (interval.first_ns, interval.last_ns))
        return Gap(first, last, f"{interval.kind}: {interval.reason}")

    order = [k for k in range(len(finished.tracks)) if len(finished.tracks[k])]
    described = [places.of(int(index)) for k in order for index in finished.keyframe_indices[k]]
    return Tracked(
        tracks=tuple(finished.tracks[k] for k in order),
        views=tuple(finished.views[k] for k in order),
        keyframes=tuple(np.asarray(finished.keyframe_indices[k], dtype=np.int64) for k in order),
        trajectories=tuple(finished.trajectories[k] for k in order),
        vectors=np.stack([vector for vector, _ in described]).astype(np.float32),
        textured=np.array([textured for _, textured in described], dtype=bool),
        lost=tuple(lost_gap(one, stamps_ns, read, other_size) for one in finished.lost),
        unreadable=unreadable,
        stats={name: float(value) for name, value in sorted(finished.stats.items())},
        doubtful=tuple(doubtful(one) for one in finished.doubtful),
        other_size=other_size,
    )
