"""Result of the front end for a sequence, kept on disk and reused while images, settings and code are the same."""

from __future__ import annotations

import hashlib
import json
import logging
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any
from zipfile import BadZipFile

import numpy as np

from maslam._atomic import write_npz
from maslam.frontend.datasets.stored_image import identities
from maslam.frontend.files.point_views import PointViews
from maslam.frontend.files.trajectory import Trajectory
from maslam.frontend.files.vo_files import VoTrack

from ..common.digests import code_digest
from ..common.errors import ToolError
from .tracking import Gap, Tracked, track

if TYPE_CHECKING:
    from maslam.descriptors.choice import DescriptorLike
    from maslam.frontend.config import OdometryConfig
    from maslam.frontend.datasets.base import ImageSequence

log = logging.getLogger(__name__)
TRACK_FIELDS = ("stamps_s", "poses", "points", "observations", "descriptors", "words")
# What decides a tracking result.
CODE_PARTS = ("frontend", "descriptors", "backend/geometry.py", "tools/pipeline/tracking.py")


@dataclass(frozen=True)
class TrackingJob:
    """One sequence to be tracked, with what it takes, the file for the result, and the fingerprint of all of it."""

    sequence: ImageSequence
    odometry: OdometryConfig
    descriptor: DescriptorLike | str | Path
    vocabulary: Path | None
    store: Path
    fingerprint: str
    provider: str


def make_job(
    sequence: ImageSequence,
    odometry: OdometryConfig,
    descriptor: DescriptorLike | str | Path,
    vocabulary: Path | None,
    folder: Path,
    provider: str = "CPU",
) -> TrackingJob:
    """The job of a sequence, its result to be kept in ``folder``; ``provider``: what runs the descriptor.

    The fingerprint covers the images (see ``identities``), the calibration, the settings, the models and the
    code.
    """
    code, model = code_digest(*CODE_PARTS), _identity(descriptor)
    digest = hashlib.sha256(f"{sequence.rig} {odometry.model_dump_json()} {model} {provider} {code}".encode())
    digest.update(sequence.stamps_ns.tobytes() + _decoding(sequence))
    models = [path for path in (vocabulary, Path(model), Path(model).with_suffix(".json")) if path and path.is_file()]
    files = (*sequence.left, *sequence.right, *sequence.depth, *_masks(sequence), *models)
    for identity in identities(files):
        digest.update(identity.encode())
    store = folder / f"{sequence.name}.npz"
    return TrackingJob(sequence, odometry, descriptor, vocabulary, store, digest.hexdigest(), provider)


def _masks(sequence: ImageSequence) -> list[Path]:
    """Every file of masks, once."""
    files = () if sequence.masks is None else (*sequence.masks.left, *sequence.masks.right)
    return list(dict.fromkeys(path for path in files if path is not None))


def _identity(descriptor: DescriptorLike | str | Path) -> str:
    """What makes the place vectors: name or file of a model; of any other descriptor its name and hash."""
    from maslam.descriptors.choice import is_model, load_descriptor

    if is_model(descriptor):
        return str(descriptor)
    other = load_descriptor(descriptor)
    return f"{other.name} {other.sha256}"


def _decoding(sequence: ImageSequence) -> bytes:
    """What turns stored files into frames, beside the rig: depth unit, depth sensor, rectification, grey levels, and
    which mask is whose."""
    masks = None if sequence.masks is None else (sequence.masks.left, sequence.masks.right)
    parts = [repr((sequence.depth_unit_m, sequence.values, masks)).encode()]
    if sequence.registration is not None:
        sensor = sequence.registration
        parts += [repr(sensor.depth_camera).encode(), repr(sensor.camera).encode(), sensor.T_C_D.tobytes()]
    if sequence.rectifier is not None:
        maps = (*sequence.rectifier.left, *(sequence.rectifier.right or ()), sequence.rectifier.depth_index)
        parts += [m.tobytes() for m in maps if m is not None]
    return b"".join(parts)


def track_job(job: TrackingJob, advance: Callable[[int], None]) -> None:
    """Track the job's sequence into its store, unless the store has it."""
    if load_tracked(job.store, job.fingerprint) is not None:
        log.info("taken from %s: images, settings and code are the same", job.store)
    else:
        from maslam.descriptors.choice import load_descriptor
        from maslam.frontend.vocabulary.vocabulary import Vocabulary

        vocabulary, model = Vocabulary.load(job.vocabulary), load_descriptor(job.descriptor, job.provider)
        save_tracked(job.store, track(job.sequence, job.odometry, vocabulary, model, advance), job.fingerprint)
    advance(len(job.sequence))


def is_tracked(job: TrackingJob) -> bool:
    """Whether the store has the job's result."""
    try:
        with np.load(job.store, allow_pickle=False) as stored:
            return bool(json.loads(str(stored["header"]))["fingerprint"] == job.fingerprint)
    except (OSError, ValueError, KeyError, EOFError, BadZipFile):
        return False


def take_tracked(job: TrackingJob) -> Tracked:
    """The result of a job that :func:`track_job` has done."""
    tracked = load_tracked(job.store, job.fingerprint)
    if tracked is None:
        raise ToolError(f"{job.store}: changed or deleted while it was needed; run the command again")
    return tracked


def save_tracked(path: Path, tracked: Tracked, fingerprint: str) -> None:
    """Write ``path`` (npz) in one move; ``fingerprint`` says what it was made from and how."""
    header = {
        "fingerprint": fingerprint,
        "tracks": len(tracked.tracks),
        "lost": [asdict(gap) for gap in tracked.lost],
        "doubtful": [asdict(gap) for gap in tracked.doubtful],
        "unreadable": tracked.unreadable,
        "other_size": tracked.other_size,
        "stats": tracked.stats,
    }
    arrays = {
        "header": np.array(json.dumps(header)),
        "vectors": tracked.vectors,
        "textured": tracked.textured,
    }
    for k, (one, keyframes) in enumerate(zip(tracked.tracks, tracked.keyframes, strict=True)):
        arrays[f"keyframes_{k}"] = keyframes
        arrays[f"frame_stamps_ns_{k}"] = tracked.trajectories[k].stamps_ns
        arrays[f"frame_poses_{k}"] = tracked.trajectories[k].poses
        arrays[f"views_{k}"], arrays[f"views_uv_{k}"] = tracked.views[k].observations, tracked.views[k].uv
        arrays |= {f"{name}_{k}": getattr(one, name) for name in TRACK_FIELDS}
    path.parent.mkdir(parents=True, exist_ok=True)
    write_npz(path, arrays)


def load_tracked(path: Path, fingerprint: str) -> Tracked | None:
    """Read the result of :func:`save_tracked`; None where there is none or it was made from something else."""
    if not path.is_file():
        return None
    try:
        with np.load(path, allow_pickle=False) as stored:
            header = json.loads(str(stored["header"]))
            if header["fingerprint"] != fingerprint:
                return None
            count = header["tracks"]
            return Tracked(
                tracks=tuple(VoTrack(**{name: stored[f"{name}_{k}"] for name in TRACK_FIELDS}) for k in range(count)),
                views=tuple(PointViews(stored[f"views_{k}"], stored[f"views_uv_{k}"]) for k in range(count)),
                keyframes=tuple(stored[f"keyframes_{k}"] for k in range(count)),
                trajectories=tuple(
                    Trajectory(stored[f"frame_stamps_ns_{k}"], stored[f"frame_poses_{k}"]) for k in range(count)
                ),
                vectors=stored["vectors"],
                textured=stored["textured"],
                lost=tuple(_gap(gap) for gap in header["lost"]),
                doubtful=tuple(_gap(gap) for gap in header["doubtful"]),
                unreadable=tuple(header["unreadable"]),
                stats=header["stats"],
                other_size=tuple(header["other_size"]),
            )
    except (OSError, ValueError, KeyError, EOFError, BadZipFile):
        return None  # damaged: made anew


def _gap(stored: dict[str, Any]) -> Gap:
    return Gap(**{**stored, "kinds": tuple((kind, frames) for kind, frames in stored["kinds"])})
