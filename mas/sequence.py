"""Input of an agent: the SEQS folder, written by preprocessing, read by the multi-agent system."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from maslam.frontend.files.point_views import PointViews, read_views
from maslam.frontend.files.positions import POSITIONS, PositionFixes, read_positions
from maslam.frontend.files.trajectory import Trajectory, read_tum, stamp_ns_from_s
from maslam.frontend.files.vo_files import VoTrack, read_tracks, track_numbers

from .errors import MasError
from .manifest import MANIFEST, AgentEntry, LostEntry, Manifest, MissingEntry, read_manifest

if TYPE_CHECKING:
    from maslam.descriptors.container import PlaceVectors

TRAJECTORY = "trajectory.tum"
GROUNDTRUTH = "groundtruth.tum"
PLACES = "netvlad.npz"

# Times pass through text files in seconds: half a millisecond is far above their rounding, far below a frame
# interval.
STAMP_TOLERANCE_NS = 500_000


@dataclass(frozen=True)
class AgentSequence:
    """One agent's preprocessed input, in memory.

    All its times count from its own first frame, so that all agents start at 0; ``start_ns`` is that frame's time stamp
    in the source. ``tracks``: key-frames and map points of each uninterrupted track, in order of time, each in its own
    world frame (that of its first key-frame); ``metric``: in metres. ``places``: one unit vector a key-frame, all
    tracks in order. ``trajectory``: every tracked frame, ``T_W_C`` in its track's frame. ``source``: name of the image
    sequence. ``groundtruth`` is for :mod:`maslam.mas.evaluation` alone, as are ``first_frame``, ``frames``, ``lost``,
    ``doubtful`` and ``missing``, which are those of :class:`AgentEntry` (``frames`` None: as many as were tracked); no
    agent ever sees them. Nor ``views``, which are for :mod:`maslam.mas.output`: one a track, None where the front end
    wrote none. ``positions``: of its antenna, in one frame for all agents, whose place is found.
    """

    name: str
    tracks: tuple[VoTrack, ...]
    places: PlaceVectors
    trajectory: Trajectory
    metric: bool
    start_ns: int
    source: str
    groundtruth: Trajectory | None = None
    first_frame: int = 0
    frames: int | None = None
    lost: tuple[LostEntry, ...] = ()
    doubtful: tuple[LostEntry, ...] = ()
    missing: tuple[MissingEntry, ...] = ()
    views: tuple[PointViews | None, ...] = ()
    positions: PositionFixes | None = None

    def __post_init__(self) -> None:
        stamps = self.keyframe_stamps_ns
        if len(stamps) > 1 and (np.diff(stamps) <= 0).any():
            at = int(np.argmax(np.diff(stamps) <= 0))
            before, after = stamps[at : at + 2] / 1e9
            raise MasError(f"{self.name}: key-frame times go back from {before:.9f} s to {after:.9f} s")
        if len(self.places.vectors) != len(stamps):
            vectors = len(self.places.vectors)
            raise MasError(f"{self.name}: {len(stamps)} key-frames but {vectors} place vectors in {PLACES}")
        apart = np.abs(np.asarray(self.places.stamps_ns) - stamps)
        if len(apart) and apart.max() > STAMP_TOLERANCE_NS:
            at = int(apart.argmax())
            raise MasError(
                f"{self.name}: key-frame {at} and its place vector are {apart[at] / 1e9:.6f} s apart: "
                "not made from the same images"
            )

    @property
    def read(self) -> int:
        """Frames that were read, tracked or not."""
        return len(self.trajectory) if self.frames is None else self.frames

    @property
    def keyframe_stamps_ns(self) -> NDArray[np.int64]:
        """``(K,)``: times of the key-frames of all tracks."""
        if not self.tracks:
            return np.zeros(0, dtype=np.int64)
        return stamp_ns_from_s(np.concatenate([t.stamps_s for t in self.tracks]))

    @property
    def keyframe_tracks(self) -> NDArray[np.int64]:
        """``(K,)``: number of the track of each key-frame."""
        return np.repeat(np.arange(len(self.tracks)), [len(t) for t in self.tracks])

    def track_of(self, stamps_ns: NDArray[np.int64]) -> NDArray[np.int64]:
        """Track number of each stamp: the last track that had begun by then, half a millisecond allowed."""
        begins = np.array([stamp_ns_from_s(t.stamps_s[0]) for t in self.tracks if len(t)], dtype=np.int64)
        return np.maximum(np.searchsorted(begins, stamps_ns + STAMP_TOLERANCE_NS, side="right") - 1, 0)


def load_sequences(folder: Path) -> tuple[Manifest, list[AgentSequence]]:
    """Read a SEQS folder: the manifest, and each agent's sequence in its order; what does not fit is an error."""
    manifest = read_manifest(folder)
    sequences = [load_agent(folder / entry.name, entry, manifest) for entry in manifest.agents]
    if not sequences:
        raise MasError(f"{folder / MANIFEST}: no agents in it")
    return manifest, sequences


def load_agent(folder: Path, entry: AgentEntry, manifest: Manifest) -> AgentSequence:
    """Read the folder of one agent; what does not fit its entry in the manifest is an error."""
    if not folder.is_dir():
        raise MasError(f"{folder}: missing, but {MANIFEST} names {entry.name}")
    from maslam.descriptors.container import PlaceVectors

    places = PlaceVectors.load(folder / PLACES)
    wanted = manifest.descriptor
    if (places.sha256, places.dim) != (wanted.sha256, wanted.dim):
        raise MasError(
            f"{folder / PLACES}: made by model {places.name} ({places.sha256[:12]}, {places.dim} numbers), "
            f"but {MANIFEST} says {wanted.name} ({wanted.sha256[:12]}, {wanted.dim}): make the folder anew"
        )
    truth = folder / GROUNDTRUTH
    tracks, views = _load_tracks(folder, (entry.camera.width, entry.camera.height)) if entry.tracks else ((), ())
    sequence = AgentSequence(
        name=entry.name,
        tracks=tracks,
        places=places,
        trajectory=read_tum(folder / TRAJECTORY),
        metric=manifest.scale == "metric" and entry.metric,
        start_ns=entry.start_ns,
        source=entry.sequence,
        groundtruth=read_tum(truth) if truth.is_file() else None,
        first_frame=entry.first_frame,
        frames=entry.frames,
        lost=entry.lost,
        doubtful=entry.doubtful,
        missing=entry.missing,
        views=views,
        positions=read_positions(folder / POSITIONS) if (folder / POSITIONS).is_file() else None,
    )
    count = len(sequence.keyframe_stamps_ns)
    if count != entry.keyframes:
        raise MasError(f"{folder}: {count} key-frames, but {MANIFEST} says {entry.keyframes}")
    return sequence


def _load_tracks(folder: Path, size_px: tuple[int, int]) -> tuple[tuple[VoTrack, ...], tuple[PointViews | None, ...]]:
    """The tracks that have key-frames, and the views of each, in images of ``size_px`` (width, height)."""
    numbered = zip(track_numbers(folder), read_tracks(folder), strict=True)
    kept = [(number, track) for number, track in numbered if len(track)]
    views = tuple(read_views(folder, number, len(track), len(track.points), size_px) for number, track in kept)
    return tuple(track for _, track in kept), views
