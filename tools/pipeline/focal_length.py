"""Cameras that nobody calibrated, refined by their own images before they are tracked."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from maslam._atomic import write_atomically
from maslam.frontend.datasets.focal_length import REFINE_STEPS, RefinedFocal, refine
from maslam.frontend.datasets.stored_image import identities

from ..common.digests import code_digest
from ..common.progress import Progress

if TYPE_CHECKING:
    from maslam.frontend.datasets.base import Dataset, ImageSequence

_BENT_PX = 1.0
"""Displacement in the corners from which ``k1`` is used."""
_CODE = ("frontend/datasets", "frontend/cameras", "maslam/_pycolmap.py")


def refine_guessed(dataset: Dataset, store: Path, progress: Progress, workers: int) -> tuple[Dataset, list[str]]:
    """``dataset`` with the cameras refined that were guessed, and what is to be said of each. Results are kept in
    ``store``, and used again as long as images and code are the same."""
    from ..common.parallel import run_jobs

    guessed = [s for s in dataset.sequences if s.focal_guess and not _spoilt(s)]
    if not guessed:
        return dataset, []
    jobs = {s.name: ((s, store), REFINE_STEPS) for s in guessed}
    outcomes = run_jobs(refine_job, jobs, workers, progress)
    done, said = {}, []
    for sequence in guessed:
        outcome = outcomes[sequence.name]
        if outcome.result is None:
            found = RefinedFocal(None, 0.0, " ".join(str(outcome.error).split()))
        else:
            found = outcome.result
        done[sequence.name], text = _applied(sequence, found)
        said.append(f"{sequence.name}: {text}")
    return replace(dataset, sequences=[done.get(s.name, s) for s in dataset.sequences]), said


def refine_job(job: tuple[ImageSequence, Path], advance: Callable[[int], None]) -> RefinedFocal:
    """Refine one sequence, unless its result is in the store."""
    sequence, store = job
    path = store / f"{sequence.name}.focal.json"
    fingerprint = _fingerprint(sequence)
    kept = _kept(path, fingerprint)
    if kept is None:
        kept = refine(sequence, advance)
        path.parent.mkdir(parents=True, exist_ok=True)
        write_atomically(path, json.dumps({"fingerprint": fingerprint, **asdict(kept)}, indent=1))
    advance(REFINE_STEPS)
    return kept


def with_focal(sequence: ImageSequence, focal_px: float, k1: float) -> ImageSequence:
    """A sequence of a guessed camera with another focal length, pixels, and the lens's ``k1``, 0 for none."""
    from maslam.frontend.cameras.calibration import Distortion, RawCamera, RawRig
    from maslam.frontend.cameras.models import Rig
    from maslam.frontend.cameras.rectification import rectify_rig

    width, height = sequence.stored_size
    lens = Distortion.RADIAL_TANGENTIAL if k1 else Distortion.NONE
    coefficients = (k1, 0.0, 0.0, 0.0) if k1 else ()
    centre = (width - 1) / 2.0, (height - 1) / 2.0
    raw = RawCamera(focal_px, focal_px, *centre, sequence.stored_size, lens, coefficients)
    ideal = rectify_rig(RawRig(raw), sequence.rig.kind, sequence.stored_size)
    return replace(
        sequence,
        rig=Rig(sequence.rig.kind, ideal.camera, sequence.rig.baseline_m),
        rectifier=ideal.rectifier,
        stored_camera=None if ideal.rectifier is None else raw,
        R_rectified_left=None if ideal.rectifier is None else ideal.R_rectified_left,
    )


def _applied(sequence: ImageSequence, found: RefinedFocal) -> tuple[ImageSequence, str]:
    """``sequence`` with the refined camera, and what is said of it."""
    guess = sequence.rig.camera.fx
    if found.focal_px is None:
        return sequence, (
            f"the focal length is a guess, {guess:.1f} px ({sequence.focal_guess}), and could not be refined: "
            f"{found.why}; shapes and lengths are off by as much as it is"
        )
    camera = sequence.rig.camera
    radius = float(np.hypot(camera.width, camera.height)) / 2.0 / found.focal_px
    bent = abs(found.k1) * radius**3 * found.focal_px > _BENT_PX
    k1 = f", k1 {found.k1:+.4f}" if bent else ""
    return with_focal(sequence, found.focal_px, found.k1 if bent else 0.0), (
        f"the focal length is estimated from the images: {found.focal_px:.1f} px{k1} ({found.why}; first guess "
        f"{guess:.1f} px, {sequence.focal_guess}); `maslam calibrate` measures it"
    )


def _spoilt(sequence: ImageSequence) -> bool:
    from maslam.frontend.datasets.base import Severity

    return any(problem.severity is Severity.ERROR for problem in sequence.problems)


def _fingerprint(sequence: ImageSequence) -> str:
    digest = hashlib.sha256(f"{sequence.rig} {sequence.values} {code_digest(*_CODE)}".encode())
    for image in identities(sequence.left):
        digest.update(image.encode())
    return digest.hexdigest()


def _kept(path: Path, fingerprint: str) -> RefinedFocal | None:
    """What the store has; None where there is nothing, or of other images."""
    try:
        stored = json.loads(path.read_text(encoding="utf-8"))
        if stored.pop("fingerprint") != fingerprint:
            return None
        return RefinedFocal(**stored)
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        return None
