"""The predecessor's folders (dslam_open, ICRA 2018) as agent sequences: the five VO files with ``netvlad_feats.bin``.

A folder holds one sequence, or one in each sub-folder. ``times.txt`` says when each image was taken whose features the
binary file holds; without it there must be as many features as key-frames.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import NDArray

from maslam.descriptors.base import Images, PlaceDescriptor
from maslam.descriptors.container import PREDECESSOR_DIM, PREDECESSOR_NAME, PlaceVectors, import_predecessor
from maslam.frontend.cameras.models import PinholeCamera, Rig, RigKind
from maslam.frontend.datasets.base import Dataset, ImageSequence
from maslam.frontend.files.point_views import PointViews
from maslam.frontend.files.timestamps import read_stamps
from maslam.frontend.files.trajectory import Trajectory, stamp_ns_from_s
from maslam.frontend.files.vo_files import read_tracks

from ..common.errors import ToolError, UsageError
from ..common.folders import check_apart
from ..common.progress import Progress
from ..common.writing import writing
from .earlier_result import check_same_sequences
from .sequences_folder import begun, check_free, sequences_made_of
from .tracking import Gap, Tracked

if TYPE_CHECKING:
    from maslam.mas.manifest import Manifest
    from maslam.mas.sequence import AgentSequence

FEATURES = "netvlad_feats.bin"
SEQUENCES = "sequences"  # in OUT: what was made of the images or files
_FIVE = "poses_0.txt"
_DIM = 128
_MATCH_DISTANCE = 0.1
"""Of the first 128 numbers as they stand in the file: the predecessor's squared distance of 0.01."""
_CANDIDATES = 1.5
"""Geometry verifies what is up to so many times as far apart."""
_NO_POSE = "no key-frame: the five files have no pose of it"
_KITTI = PinholeCamera(1241, 376, 718.856, 718.856, 607.1928, 185.2157)
"""The camera of the predecessor's own data; where another one is not given only tolerances of angles depend on it."""


class ImportedVectors(PlaceDescriptor):
    """Stands for the network that made the vectors of a file: it can describe no further image."""

    def __init__(self, vectors: PlaceVectors, threshold: float) -> None:
        self._vectors, self._threshold = vectors, threshold

    @property
    def name(self) -> str:
        return PREDECESSOR_NAME

    @property
    def dim(self) -> int:
        return self._vectors.dim

    @property
    def threshold(self) -> float:
        return self._threshold

    @property
    def candidate_threshold(self) -> float:
        return min(_CANDIDATES * self._threshold, 2.0)

    @property
    def sha256(self) -> str:
        return self._vectors.sha256

    @property
    def min_std(self) -> float:
        return 0.0

    def describe(self, images: Images) -> NDArray[np.float32]:
        raise ToolError(f"{PREDECESSOR_NAME}: its vectors were read from a file; it describes no images here")


@dataclass(frozen=True)
class _Sequence:
    """One folder: its images' times, its tracks and vectors, and the lengths that these had in the file."""

    sequence: ImageSequence
    tracked: Tracked
    vectors: PlaceVectors
    lengths: NDArray[np.float64]


def is_predecessor(folder: Path) -> bool:
    """Whether ``folder``, or folders in it, hold the five files with the predecessor's features."""
    return bool(_folders(folder))


def sequences_for(
    folder: Path, out: Path, progress: Progress, overwrite: bool = False
) -> tuple[Manifest, list[AgentSequence]]:
    """What a run on ``folder`` plays: the agent sequences in it, or those made from the predecessor's files into
    ``out/sequences``."""
    from maslam.mas.manifest import MANIFEST
    from maslam.mas.sequence import load_sequences

    if (folder / MANIFEST).is_file() or not is_predecessor(folder):
        return load_sequences(folder)
    import_folder(folder, out / SEQUENCES, progress, overwrite=overwrite)
    return load_sequences(out / SEQUENCES)


def import_folder(
    folder: Path,
    out: Path,
    progress: Progress,
    scale: Literal["metric", "arbitrary"] = "metric",
    agents: int | None = None,
    overlap: int = 0,
    overwrite: bool = False,
) -> Manifest:
    """Make the SEQS folder ``out`` from the predecessor's ``folder``; errors name file and line.

    ``scale``: the unit of its poses; ``agents``: cut one sequence for so many, which share ``overlap`` key-frames;
    ``overwrite``: replace what ``out`` holds of another folder or with other settings.
    """
    from maslam.mas.manifest import SplitEntry

    from .agent_folder import plan_agents, write_sequences

    check_apart(folder, out)
    check_free(out)
    folders = _folders(folder)
    if not folders:
        raise ToolError(
            f"{folder}: no {_FIVE} with {FEATURES}; with a trajectory name its images too: POSES IMAGES OUT"
        )
    if agents is not None and len(folders) > 1:
        raise UsageError(f"--agents splits one sequence, but {folder} holds {len(folders)}; leave it out")
    rig = _rig(folder, progress)
    read = [_read(path, rig) for path in folders]
    lengths = np.concatenate([one.lengths for one in read])
    typical = float(np.median(lengths[lengths > 0])) if (lengths > 0).any() else 1.0
    model = ImportedVectors(read[0].vectors, min(_MATCH_DISTANCE / typical, 2.0))
    split = SplitEntry(agents=agents, overlap=overlap) if agents else None
    dataset = Dataset("predecessor's five files", folder, [one.sequence for one in read])
    plans = plan_agents([(one.sequence, one.tracked) for one in read], split)
    settings = {"scale": scale}
    made_of = sequences_made_of(folder, split, settings)
    if not overwrite:
        check_same_sequences(out, made_of)
    with writing(out), begun(out, made_of):
        return write_sequences(out, dataset, plans, model, split, settings, (), scale)


def _folders(folder: Path) -> list[Path]:
    if not folder.is_dir():
        return []
    inside = sorted(path for path in folder.iterdir() if path.is_dir())
    return [path for path in (folder, *inside) if (path / _FIVE).is_file() and (path / FEATURES).is_file()]


def _rig(folder: Path, progress: Progress) -> Rig:
    """The camera of a calibration file beside the five files, else KITTI's."""
    from maslam.frontend.datasets.camera_file import find_camera_file

    found = find_camera_file(folder)
    if found is None:
        progress.say(f"warning: {folder}: no camera.yaml: KITTI's camera is taken, for tolerances of angles only")
        return Rig(RigKind.MONO, _KITTI)
    c = found[0].left
    width, height = c.size or (_KITTI.width, _KITTI.height)
    return Rig(RigKind.MONO, PinholeCamera(width, height, c.fx, c.fy, c.cx, c.cy))


def _read(folder: Path, rig: Rig) -> _Sequence:
    tracks = [track for track in read_tracks(folder) if len(track)]
    if not tracks:
        raise ToolError(f"{folder}: no key-frame in the five files")
    keyframes_ns = stamp_ns_from_s(np.concatenate([track.stamps_s for track in tracks]))
    stamps_ns = _image_times(folder, keyframes_ns)
    order = np.argsort(stamps_ns, kind="stable")
    images = stamps_ns[order]
    vectors = import_predecessor(folder / FEATURES, stamps_ns, keyframes_ns, _DIM)
    nearest = Trajectory(images, np.tile(np.eye(4), (len(images), 1, 1))).nearest(keyframes_ns, 2**62)
    if (np.diff(nearest) <= 0).any():
        row = int(np.argmax(np.diff(nearest) <= 0))
        raise ToolError(
            f"{folder}: key-frames {row} and {row + 1} have the same nearest image in times.txt: not the times of this "
            "sequence"
        )
    ends = np.cumsum([0, *(len(track) for track in tracks)])
    of = [nearest[a:b] for a, b in pairwise(ends.tolist())]
    sequence = ImageSequence(
        kind="five files",
        name=folder.name,
        rig=rig,
        stamps_ns=images,
        left=tuple(folder / f"{k:06d}" for k in range(len(images))),
        stored_size=(rig.camera.width, rig.camera.height),
    )
    tracked = Tracked(
        tracks=tuple(tracks),
        views=tuple(PointViews(np.zeros((0, 2), np.int32), np.zeros((0, 2), np.float32)) for _ in tracks),
        keyframes=tuple(of),
        trajectories=tuple(Trajectory(images[k], track.poses) for k, track in zip(of, tracks, strict=True)),
        vectors=vectors.vectors,
        textured=vectors.textured,
        lost=_between(len(images), nearest),
        unreadable=(),
        stats={},
    )
    every = np.memmap(folder / FEATURES, dtype="<f4", mode="r").reshape(-1, PREDECESSOR_DIM)
    lengths = np.linalg.norm(np.asarray(every[order[nearest], :_DIM], dtype=np.float64), axis=1)
    return _Sequence(sequence, tracked, vectors, lengths)


def _between(images: int, keyframes: NDArray[np.int64]) -> tuple[Gap, ...]:
    """The images between key-frames, whose poses the files do not have."""
    rest = np.setdiff1d(np.arange(images), keyframes)
    runs = np.split(rest, np.flatnonzero(np.diff(rest) > 1) + 1) if len(rest) else []
    return tuple(Gap(int(run[0]), int(run[-1]), _NO_POSE, ((_NO_POSE, len(run)),)) for run in runs)


def _image_times(folder: Path, keyframes_ns: NDArray[np.int64]) -> NDArray[np.int64]:
    """Times ``(N,)`` of the images whose features the binary file holds."""
    path = folder / "times.txt"
    blocks, rest = divmod((folder / FEATURES).stat().st_size, 4 * PREDECESSOR_DIM)
    if rest or not blocks:
        raise ToolError(f"{folder / FEATURES}: not whole blocks of {PREDECESSOR_DIM} float32: cut off, or another file")
    if path.is_file():
        return read_stamps(path)
    if blocks != len(keyframes_ns):
        raise ToolError(f"{path}: missing: it says when each of the {blocks} images with features was taken")
    return keyframes_ns
