"""A part of a sequence: of its time, or every so-manieth image."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ..errors import FrontendError
from ..files.timestamps import NS_PER_S
from ..recording_config import RecordingConfig
from .base import ImageSequence

_SLACK = 1e-3  # of an interval: times that are rounded to milliseconds still fall into their own


def select(sequence: ImageSequence, config: RecordingConfig) -> ImageSequence:
    """The images of ``sequence`` that ``config`` asks for; :class:`FrontendError` where none is left."""
    if (config.start_s, config.end_s, config.stride, config.rate_hz) == (0.0, None, 1, None) or not len(sequence):
        return sequence
    since_s = (sequence.stamps_ns - sequence.stamps_ns[0]) / NS_PER_S
    end_s = np.inf if config.end_s is None else config.end_s
    kept = np.flatnonzero((since_s >= config.start_s) & (since_s <= end_s))
    if not len(kept):
        raise FrontendError(
            f"{sequence.name}: no image between {config.start_s:g} and {end_s:g} s: there are {since_s[-1]:.3f} s of it"
        )
    kept = _thinned(kept, since_s, config)
    return replace(
        sequence,
        stamps_ns=sequence.stamps_ns[kept],
        left=tuple(sequence.left[i] for i in kept),
        right=tuple(sequence.right[i] for i in kept) if sequence.right else (),
        depth=tuple(sequence.depth[i] for i in kept) if sequence.depth else (),
        missing=(),
    )


def _thinned(kept: NDArray[np.int64], since_s: NDArray[np.float64], config: RecordingConfig) -> NDArray[np.int64]:
    kept = kept[:: config.stride]
    if config.rate_hz is None:
        return kept
    interval = np.floor((since_s[kept] - since_s[kept[0]]) * config.rate_hz + _SLACK)
    return kept[np.r_[True, np.diff(interval) > 0]]
