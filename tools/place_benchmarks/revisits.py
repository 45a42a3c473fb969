"""A user's own sequences with ground truth as a place-recognition set: is a place that is visited again recognised?"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from maslam.frontend.datasets import ImageSequence, open_dataset

from ..common.errors import ToolError
from .public_sets import PlaceBenchmark

_TURN_DEG = 15.0
_POSE_TOLERANCE_S = 0.05
_UNDECIDED = 3.0  # times the radius: views so near may share what they see


@dataclass(frozen=True)
class RevisitSettings:
    """Two images show the same place within ``radius_m`` and ``angle_deg``. Of the frames, one is taken for each
    ``spacing_m`` driven or 15 degrees turned. A frame less than ``apart_s`` earlier in the same sequence is no visit
    of its own and is not compared."""

    radius_m: float = 5.0
    angle_deg: float = 30.0
    apart_s: float = 20.0
    spacing_m: float = 1.0

    def __post_init__(self) -> None:
        if min(self.radius_m, self.angle_deg, self.spacing_m) <= 0 or self.apart_s < 0:
            raise ToolError(
                f"revisits: radius ({self.radius_m:g} m), angle ({self.angle_deg:g} degrees) and spacing "
                f"({self.spacing_m:g} m) must be positive, and the time apart ({self.apart_s:g} s) not negative"
            )


@dataclass(frozen=True)
class _Visits:
    """The frames taken: ``sequence`` and ``stamp_ns`` ``(N,)`` int64, ``poses`` ``(N, 4, 4)`` ``T_W_C``."""

    sequence: NDArray[np.int64]
    stamp_ns: NDArray[np.int64]
    poses: NDArray[np.float64]
    images: list[NDArray[np.uint8]]


def posed_benchmark(
    folder: Path,
    settings: RevisitSettings,
    advance: Callable[[int, int], None] = lambda done, total: None,
    colour: bool = False,
) -> PlaceBenchmark:
    """Every frame taken against all that came before it, in the order of agents (sequences) and of time.

    ``colour``: the images for colour networks. Frames of several agents share one world in their poses.
    ``advance(done, total)`` counts decoded frames.
    ``ToolError`` where the folder has no ground truth, or nothing in it is visited twice.
    """
    dataset = open_dataset(folder, rig=None)
    visits = _gather(folder, dataset.sequences, settings, advance, colour)
    centres, forward = visits.poses[:, :3, 3], visits.poses[:, :3, 2]
    apart_m = np.linalg.norm(centres[:, None] - centres[None], axis=2)
    alike = forward @ forward.T >= np.cos(np.radians(settings.angle_deg))
    order = np.arange(len(centres))
    apart_s = np.abs(visits.stamp_ns[:, None] - visits.stamp_ns[None]) / 1e9
    one_visit = (visits.sequence[:, None] == visits.sequence[None]) & (apart_s < settings.apart_s)
    barred = (order[None] >= order[:, None]) | one_visit
    truth = (apart_m <= settings.radius_m) & alike & ~barred
    if not truth.any():
        raise ToolError(
            f"{folder}: no place is visited again within {settings.radius_m:g} m and {settings.angle_deg:g} degrees, "
            f"{settings.apart_s:g} s or more apart, in {len(order)} frames"
        )
    asked = ~barred.all(axis=1)
    undecided = (apart_m <= _UNDECIDED * settings.radius_m) & ~truth & ~barred
    return PlaceBenchmark(
        folder.resolve().name,
        [image for image, ask in zip(visits.images, asked, strict=True) if ask],
        visits.images,
        truth[asked],
        undecided[asked],
        barred[asked],
        (visits.poses[asked], visits.poses),
    )


def _gather(
    folder: Path,
    sequences: list[ImageSequence],
    settings: RevisitSettings,
    advance: Callable[[int, int], None],
    colour: bool,
) -> _Visits:
    taken = [_spread(sequence, settings.spacing_m) for sequence in sequences]
    if not any(len(frames) for frames, _ in taken):
        raise ToolError(f"{folder}: no ground truth at the times of its frames, so nothing to judge answers by")
    total, done = sum(len(frames) for frames, _ in taken), 0
    images: list[NDArray[np.uint8]] = []
    for sequence, (frames, _) in zip(sequences, taken, strict=True):
        for frame in frames:
            images.append(sequence.read_colour(int(frame)) if colour else sequence.read_image(int(frame)))
            done += 1
            advance(done, total)
    number = np.concatenate([np.full(len(frames), k) for k, (frames, _) in enumerate(taken)])
    stamps = np.concatenate([s.stamps_ns[frames] for s, (frames, _) in zip(sequences, taken, strict=True)])
    return _Visits(number, stamps, np.concatenate([poses for _, poses in taken]), images)


def _spread(sequence: ImageSequence, spacing_m: float) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Frames ``(n,)`` with known poses ``(n, 4, 4)``, each driven ``spacing_m`` or turned 15 degrees from the last."""
    truth = sequence.groundtruth
    if truth is None or not len(truth):
        return np.zeros(0, dtype=np.int64), np.zeros((0, 4, 4))
    rows = truth.nearest(sequence.stamps_ns, round(_POSE_TOLERANCE_S * 1e9))
    kept: list[int] = []
    poses: list[NDArray[np.float64]] = []
    for frame in np.flatnonzero(rows >= 0):
        pose = truth.poses[rows[frame]]
        moved = not poses or np.linalg.norm(pose[:3, 3] - poses[-1][:3, 3]) >= spacing_m
        if moved or pose[:3, 2] @ poses[-1][:3, 2] <= np.cos(np.radians(_TURN_DEG)):
            kept.append(int(frame))
            poses.append(pose)
    return np.array(kept, dtype=np.int64), np.stack(poses) if poses else np.zeros((0, 4, 4))
