"""Input of an agent: the SEQS folder, written by preprocessing, read by the multi-agent system."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from maslam._atomic import write_atomically
from maslam._bounded import Unreadable, read_text
from maslam.frontend.cameras.models import PinholeCamera, Rig, RigKind
from maslam.frontend.files.point_views import PointViews, read_views
from maslam.frontend.files.positions import POSITIONS, PositionFixes, read_positions
from maslam.frontend.files.trajectory import Trajectory, read_tum, stamp_ns_from_s
from maslam.frontend.files.vo_files import VoTrack, read_tracks, track_numbers

from .errors import MasError

if TYPE_CHECKING:
    from maslam.descriptors.container import PlaceVectors

MANIFEST = "manifest.json"
TRAJECTORY = "trajectory.tum"
GROUNDTRUTH = "groundtruth.tum"
PLACES = "netvlad.npz"

# Times pass through text files in seconds: half a millisecond is far above their rounding, far below a frame
# interval.
STAMP_TOLERANCE_NS = 500_000


class _Entry(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")


class StoredCameraEntry(_Entry):
    """The camera of image files that are not rectified as stored: pixels; ``coefficients`` in OpenCV's order;
    ``rotation``: 9 numbers, row by row, of the matrix that turns its coordinates into the rectified camera's."""

    distortion: Literal["none", "radial-tangential", "equidistant", "field-of-view"]
    fx: float
    fy: float
    cx: float
    cy: float
    coefficients: tuple[float, ...] = Field(default=(), max_length=8)
    rotation: tuple[float, ...] = Field(min_length=9, max_length=9)


class CameraEntry(_Entry):
    """A rectified rig as JSON: pixels, metres; ``stored``: the camera of the image files, where they are not
    rectified."""

    kind: Literal["mono", "stereo", "rgbd"]
    width: int = Field(gt=0)
    height: int = Field(gt=0)
    fx: float
    fy: float
    cx: float
    cy: float
    baseline_m: float | None = None
    stored: StoredCameraEntry | None = None

    @classmethod
    def from_rig(cls, rig: Rig, stored: StoredCameraEntry | None = None) -> CameraEntry:
        """The entry that describes a rig."""
        c = rig.camera
        return cls(
            kind=rig.kind.value,
            width=c.width,
            height=c.height,
            fx=c.fx,
            fy=c.fy,
            cx=c.cx,
            cy=c.cy,
            baseline_m=rig.baseline_m,
            stored=stored,
        )

    def rig(self) -> Rig:
        """The rig that the entry describes."""
        camera = PinholeCamera(self.width, self.height, self.fx, self.fy, self.cx, self.cy)
        return Rig(RigKind(self.kind), camera, self.baseline_m)


class LostEntry(_Entry):
    """An interval without a pose, or with a doubtful one: first and last frame of the agent's block, counted from 0,
    and why. ``first_image``, ``last_image``: the names of their image files without suffix, where these are not the
    same numbers; else empty."""

    first_frame: int
    last_frame: int
    reason: str
    first_image: str = ""
    last_image: str = ""
    kinds: dict[str, int] = Field(
        default={}, description="lost frames by reason without figures: each has one, so they add up; empty: not known"
    )


class MissingEntry(_Entry):
    """Images that the numbers of the source's file names lack after a frame of the agent's block: ``first`` to
    ``last``, ``count`` of them. They were never read and are no lost frames."""

    after_frame: int
    first: str
    last: str
    count: int = Field(ge=1)


class AgentEntry(_Entry):
    """One agent: its folder in SEQS, and which frames of which source sequence it was made from."""

    name: str = Field(pattern=r"^agent_\d{2,}$")
    sequence: str = Field(description="name of the source's image sequence")
    first_frame: int = Field(ge=0, description="index of its first frame in that sequence")
    frames: int = Field(ge=0, description="frames in its block, tracked or not")
    keyframes: int = Field(ge=0)
    tracks: int = Field(ge=0, description="uninterrupted tracks: one unless tracking was lost")
    start_ns: int = Field(description="time stamp of its first frame in the source: 0 in all files of its folder")
    camera: CameraEntry
    lost: tuple[LostEntry, ...] = ()
    doubtful: tuple[LostEntry, ...] = Field(default=(), description="intervals with poses that are not to be relied on")
    missing: tuple[MissingEntry, ...] = Field(default=(), description="images that the source's numbering lacks")
    source: str | None = Field(default=None, description="of an earlier run's agent: where its images came from")
    scale: Literal["metric", "arbitrary"] | None = Field(
        default=None, description="unit of poses that another system gave; null: by the camera"
    )

    @property
    def metric(self) -> bool:
        """Whether its lengths are metres; with one camera each of its tracks has a unit of its own, which drifts, but
        where another system's poses say otherwise."""
        return self.camera.kind != "mono" if self.scale is None else self.scale == "metric"


class DescriptorEntry(_Entry):
    """The place descriptor that made the vectors; vectors of another model are refused."""

    name: str
    sha256: str
    dim: int = Field(gt=0)
    threshold: float = Field(gt=0, description="two places match below this Euclidean distance of unit vectors, 0 to 2")
    strict_threshold: float | None = Field(
        default=None,
        gt=0,
        description="below this appearance alone decides (precision 0.99 where calibrated); None: not known",
    )
    min_std: float = Field(ge=0, description="grey-level spread under which an image counts as without texture")


class LeftOutEntry(_Entry):
    """A sequence of the source from which no agent was made, and why."""

    sequence: str
    frames: int = Field(ge=0)
    reason: str


class SplitEntry(_Entry):
    """Split of one sequence into agents: consecutive blocks, widened by ``overlap`` key-frames on both sides."""

    agents: int = Field(ge=1)
    overlap: int = Field(ge=0)


class Manifest(_Entry):
    """``manifest.json``: what a SEQS folder holds, and its source. Written last: it marks the folder as complete."""

    version: Literal[1] = 1
    source: str = Field(description="dataset folder the images came from")
    kind: str = Field(description="kind of dataset that was found there")
    scale: Literal["metric", "arbitrary"] = Field(
        description="arbitrary: all agents have one camera, and units of length of their own; else metric"
    )
    descriptor: DescriptorEntry
    agents: tuple[AgentEntry, ...]
    split: SplitEntry | None = None
    left_out: tuple[LeftOutEntry, ...] = Field(default=(), description="sequences from which no agent was made")
    settings: dict[str, Any] = Field(default_factory=dict, description="everything that was set when this was made")


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


def write_manifest(folder: Path, manifest: Manifest) -> None:
    """Write ``folder/manifest.json`` in one move, as the last file of a SEQS folder."""
    write_atomically(folder / MANIFEST, manifest.model_dump_json(indent=1) + "\n")


def read_manifest(folder: Path) -> Manifest:
    """The manifest of a SEQS folder; a folder without one was not finished or is something else."""
    path = folder / MANIFEST
    if not folder.exists():
        raise MasError(f"{folder}: no such folder")
    if not path.is_file():
        raise MasError(f"{folder}: no {MANIFEST}: not a folder of agent sequences, or its preprocessing did not finish")
    try:
        return Manifest.model_validate_json(read_text(path))
    except Unreadable as error:
        raise MasError(f"{path}: {error}") from error
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(str(part) for part in first["loc"])
        raise MasError(f"{path}: {where or 'the file'}: {first['msg']}") from error


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
