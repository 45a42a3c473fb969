"""A sequence with given poses as a job: done in a process of its own, its result kept like odometry's."""

from __future__ import annotations

import hashlib
import logging
from collections.abc import Callable
from dataclasses import dataclass

from ..common.digests import code_digest
from ..pipeline.tracking_cache import TrackingJob, load_tracked, save_tracked
from .given_points import GivenPoints
from .given_tracks import track_given
from .placed_images import PlacedImages

log = logging.getLogger(__name__)
_CODE = ("tools/interchange",)


@dataclass(frozen=True)
class GivenJob(TrackingJob):
    """``placed``: the images' poses, of the rectified camera; ``points``: given ones, None where there are none."""

    placed: PlacedImages
    points: GivenPoints | None


def given_job(job: TrackingJob, placed: PlacedImages, points: GivenPoints | None, name: str) -> GivenJob:
    """The job with ``placed`` instead of odometry, its result under ``name``."""
    digest = hashlib.sha256(f"{job.fingerprint} {code_digest(*_CODE)}".encode())
    for values in (placed.rows, placed.poses, placed.track):
        digest.update(values.tobytes())
    digest.update(bytes([placed.mounted]))
    digest.update(b"" if points is None else points.digest().encode())
    of = job.sequence, job.odometry, job.descriptor, job.vocabulary
    store = job.store.with_name(f"{name}{job.store.suffix}")
    return GivenJob(*of, store, digest.hexdigest(), job.provider, placed, points)


def track_given_job(job: GivenJob, advance: Callable[[int], None]) -> None:
    """Make the job's result, unless its store has it."""
    if load_tracked(job.store, job.fingerprint) is not None:
        log.info("taken from %s: images, poses, settings and code are the same", job.store)
    else:
        from maslam.descriptors.choice import load_descriptor
        from maslam.frontend.vocabulary.vocabulary import Vocabulary

        vocabulary, model = Vocabulary.load(job.vocabulary), load_descriptor(job.descriptor, job.provider)
        made = track_given(job.sequence, job.placed, job.odometry, vocabulary, model, advance, job.points)
        save_tracked(job.store, made, job.fingerprint)
    advance(len(job.sequence))
