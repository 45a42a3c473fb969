"""``manifest.json`` of a SEQS folder: where it comes from, cameras, descriptor, agents, what was left out."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from maslam._atomic import write_atomically
from maslam._bounded import Unreadable, read_text
from maslam.frontend.cameras.models import PinholeCamera, Rig, RigKind

from .errors import MasError

MANIFEST = "manifest.json"


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
