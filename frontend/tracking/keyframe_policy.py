"""Decision whether a tracked frame becomes a key-frame."""

from __future__ import annotations

from dataclasses import dataclass

from ..config import KeyframeConfig


@dataclass(frozen=True)
class SinceKeyframe:
    """What happened since the last key-frame: ``frames`` passed, map points tracked now (``points``) and seen by the
    reference key-frame (``reference_points``), median displacement of the points as a share of the image width
    (``flow``), ``keyframes`` so far."""

    frames: int
    points: int
    reference_points: int
    flow: float
    keyframes: int


def wants_keyframe(since: SinceKeyframe, config: KeyframeConfig, metric: bool) -> bool:
    """Thesis section 2.1.3: 20 frames passed, at least 50 points tracked, fewer than 90 % of the reference's.

    Motion policy: the view has moved by ``min_flow``, or many points were lost, or ``max_frames`` passed with some
    motion; metric rigs take the first moving frames all, since early geometry decides later accuracy.
    """
    if config.policy == "thesis":
        return (
            since.frames >= config.min_frames
            and since.points >= config.min_points
            and since.points < config.max_overlap * since.reference_points
        )
    if since.flow < config.still_flow and since.points > 0.5 * since.reference_points:
        return False
    starving = since.points < config.refill_share * since.reference_points
    starting = metric and since.keyframes < config.startup_keyframes
    return starting or starving or since.flow >= config.min_flow or since.frames >= config.max_frames
