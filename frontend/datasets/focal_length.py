"""The focal length of a camera by its own images: structure from motion on some of them, from several first guesses."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from maslam._pycolmap import SelfCalibration, SelfCalibrator

from ..errors import FrontendError
from .base import ImageSequence

_READ, _IMAGES, _FEWEST = 1500, 40, 12
"""Frames looked at; images chosen of these; fewest that tell anything."""
_SMALL_PX, _SIFT_PX = 320, 560
"""Longest side of the images that motion is measured in; root of the area, pixels, of those that are reconstructed."""
_STEP = 0.06
"""Motion between two chosen images, share of the width."""
_STARTS = (1.0, 0.75, 0.5, 1.5)
"""First guesses, multiples of what the file or custom says."""
_AGREE, _BETTER, _APART = 0.015, 1.3, 0.05
"""Two reconstructions agree: focal lengths by this share. One is better: its error is smaller by this factor. Those
that none is better than lie apart by more than this share: nothing is known."""
_TURNED_DEG = 10.0
"""Optical axes that differ by less: the images look alike for every focal length, with a scene stretched along them."""
_PLACED = 0.6
"""Share of the images that a reconstruction must place."""
REFINE_STEPS = len(_STARTS) + 1
"""Steps that :func:`refine` tells."""


@dataclass(frozen=True)
class RefinedFocal:
    """``focal_px`` in pixels of the stored image, with ``k1``; None where it cannot be known, and ``why``."""

    focal_px: float | None
    k1: float
    why: str


def refine(sequence: ImageSequence, advance: Callable[[int], None]) -> RefinedFocal:
    """The focal length by the images of ``sequence``; its camera holds the first guess."""
    images = _chosen_images(sequence)
    if len(images) < _FEWEST:
        return RefinedFocal(None, 0.0, f"only {len(images)} images differ enough, {_FEWEST} are needed")
    share = min(1.0, _SIFT_PX / float(np.sqrt(images[0].size)))
    small = [_resized(image, share) for image in images]
    camera = sequence.rig.camera
    guess = camera.fx * share
    runs: list[SelfCalibration] = []
    with tempfile.TemporaryDirectory(prefix="maslam-focal-") as folder:
        centre = ((camera.cx + 0.5) * share, (camera.cy + 0.5) * share)  # COLMAP's pixels begin at their corners
        calibrator = SelfCalibrator(small, centre, Path(folder))
        advance(1)
        for k, factor in enumerate(_STARTS):
            found = calibrator.run(factor * guess)
            if found is not None and found.images >= _PLACED * len(small):
                runs.append(found)
            advance(k + 2)
            if _settled(runs):
                break
        if runs and not _settled(runs):  # begun at the best of them, it must come out the same
            again = calibrator.run(min(runs, key=lambda run: run.error_px).focal_px)
            runs += [again] if again is not None else []
    return _judged(runs, share)


def _settled(runs: Sequence[SelfCalibration]) -> bool:
    """Whether the two best of several reconstructions agree."""
    if len(runs) < 2:
        return False
    best, other = sorted(runs, key=lambda run: run.error_px)[:2]
    return abs(best.focal_px / other.focal_px - 1.0) < _AGREE


def _judged(runs: Sequence[SelfCalibration], share: float) -> RefinedFocal:
    """What the reconstructions of images of ``share`` of their stored size say."""
    if not runs:
        return RefinedFocal(None, 0.0, "the images could not be reconstructed with any focal length")
    ranked = sorted(runs, key=lambda run: run.error_px)
    best = ranked[0]
    if best.turned_deg < _TURNED_DEG:
        why = f"the camera turns by {best.turned_deg:.0f} degrees only, {_TURNED_DEG:.0f} are needed"
        return RefinedFocal(None, 0.0, why)
    near = [run for run in ranked if run.error_px < _BETTER * best.error_px]
    apart = max(abs(run.focal_px / best.focal_px - 1.0) for run in near)
    if len(near) < 2:
        return RefinedFocal(None, 0.0, "no two first guesses lead to the same")
    if apart > _APART:
        focals = ", ".join(f"{run.focal_px / share:.0f} px" for run in near)
        return RefinedFocal(None, 0.0, f"several focal lengths fit nearly alike: {focals}")
    why = (
        f"{best.images} images, {best.error_px:.2f} px mean error, {len(near)} first guesses within {100 * apart:.1f} %"
    )
    return RefinedFocal(best.focal_px / share, best.k1, why)


def _chosen_images(sequence: ImageSequence) -> list[NDArray[np.uint8]]:
    """Images between which the view moves by about the same, from the stretch that turns most."""
    kept: list[int] = []
    moved: list[NDArray[np.float64]] = []
    last: NDArray[np.uint8] | None = None
    since = np.zeros(2)
    length = 0.0
    for i in range(min(len(sequence), _READ)):
        try:
            image = sequence.read_image(i)
        except FrontendError:
            continue
        small = _resized(image, min(1.0, _SMALL_PX / max(image.shape)))
        if last is not None:
            flow = _flow(last, small)
            since = since + np.median(flow, axis=0) if len(flow) else since
            length += float(np.median(np.linalg.norm(flow, axis=1))) if len(flow) else _STEP * small.shape[1]
        if last is None or length >= _STEP * small.shape[1]:
            kept.append(i)
            moved.append(since)
            since, length = np.zeros(2), 0.0
        last = small
    first = _most_turned(np.cumsum(moved, axis=0)) if kept else 0
    return [sequence.read_image(i) for i in kept[first : first + _IMAGES]]


def _most_turned(path: NDArray[np.float64]) -> int:
    """Where the window of images begins over which the view moves farthest to one side, by its ``path`` ``(n, 2)``."""
    starts = range(max(len(path) - _IMAGES, 0) + 1)
    return max(starts, key=lambda k: (round(float(np.ptp(path[k : k + _IMAGES], axis=0).max()), 6), -k))


def _flow(before: NDArray[np.uint8], after: NDArray[np.uint8]) -> NDArray[np.float64]:
    """Motion ``(n, 2)`` of corners, pixels."""
    corners = cv2.goodFeaturesToTrack(before, 150, 0.01, 8)
    if corners is None:
        return np.zeros((0, 2))
    found, ok, _ = cv2.calcOpticalFlowPyrLK(before, after, corners, None)
    good = ok.ravel() > 0
    return np.asarray((found - corners).reshape(-1, 2)[good], dtype=np.float64)


def _resized(image: NDArray[np.uint8], share: float) -> NDArray[np.uint8]:
    if share >= 1.0:
        return image
    return np.asarray(cv2.resize(image, None, fx=share, fy=share, interpolation=cv2.INTER_AREA), dtype=np.uint8)
