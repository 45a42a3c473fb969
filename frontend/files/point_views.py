"""Where the key-frames of a track see its map points: a file beside the five VO files, for programs that want pixels.

The five files hold which key-frame sees which point, not where (dslam_open's layout). A structure-from-motion model
lives on the pixels, and on every view of a point; multi-agent SLAM needs neither, and no agent ever reads this file.
"""

from __future__ import annotations

import zlib
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from zipfile import BadZipFile

import numpy as np
from numpy.typing import NDArray

from maslam._atomic import write_npz
from maslam._bounded import open_npz

from ..errors import FrontendError

_DAMAGE = (
    OSError,
    ValueError,
    TypeError,
    AttributeError,
    KeyError,
    EOFError,
    BadZipFile,
    NotImplementedError,
    zlib.error,
)
"""What numpy raises of a file that is no archive, an array alone, or an archive cut or changed."""
_BEYOND = 0.1
"""Share of the image's size that a pixel may lie outside: what odometry found of the lens moves those at the edge."""


@dataclass(frozen=True, eq=False)
class PointViews:
    """N views: ``observations`` ``(N, 2)`` int32, key-frame and point as in ``lm_obs_<k>.txt``, sorted, none twice;
    ``uv`` ``(N, 2)`` float32, pixels, the first one's centre at (0, 0). In a file they are those of the pinhole camera:
    what odometry has found that rectification left is taken out."""

    observations: NDArray[np.int32]
    uv: NDArray[np.float32]

    def __len__(self) -> int:
        return len(self.uv)

    @classmethod
    def sorted(cls, keyframe: NDArray[np.integer], point: NDArray[np.integer], uv: NDArray[np.floating]) -> PointViews:
        """Views in any order, ``(N,)``, ``(N,)`` and ``(N, 2)``."""
        order = np.lexsort((point, keyframe))
        observations = np.column_stack([keyframe, point])[order].astype(np.int32)
        return cls(observations, np.asarray(uv, dtype=np.float32)[order])


def write_views(folder: Path, number: int, views: PointViews) -> None:
    """Write ``views_<number>.npz`` in one move."""
    write_npz(folder / f"views_{number}.npz", {"observations": views.observations, "uv": views.uv})


def read_views(folder: Path, number: int, keyframes: int, points: int, size_px: tuple[int, int]) -> PointViews | None:
    """The views of a track of so many key-frames and points, in images of ``size_px`` (width, height); None where there
    is no file: other front ends write none.

    :class:`FrontendError` for a file that cannot be read or that does not fit the track.
    """
    path = folder / f"views_{number}.npz"
    if not path.is_file():
        return None
    observations, uv = _stored(path)
    kinds = np.issubdtype(observations.dtype, np.integer) and np.issubdtype(uv.dtype, np.floating)
    if not kinds or uv.ndim != 2 or not observations.shape == uv.shape == (len(uv), 2):
        raise FrontendError(f"{path}: arrays of shapes {observations.shape} and {uv.shape} are no views")
    if len(uv) and (observations.min() < 0 or (observations.max(axis=0) >= (keyframes, points)).any()):
        raise FrontendError(f"{path}: a view of a key-frame or point beyond the track's {keyframes} and {points}")
    if not np.isfinite(uv).all():
        raise FrontendError(f"{path}: NaN or infinity in the pixels")
    far = (np.abs(uv / size_px - 0.5) > 0.5 + _BEYOND).any(axis=1)
    if far.any():
        (u, v), (width, height) = uv[np.argmax(far)], size_px
        raise FrontendError(f"{path}: a view at pixel ({u:.1f}, {v:.1f}), far outside the image of {width}x{height}")
    return PointViews.sorted(observations[:, 0], observations[:, 1], uv)


def _stored(path: Path) -> tuple[NDArray[Any], NDArray[Any]]:
    """The two arrays of the file, unchecked."""
    try:
        with open_npz(path) as stored:
            return stored["observations"], stored["uv"]
    except _DAMAGE as error:
        raise FrontendError(f"{path}: damaged: run preprocess again, or delete it") from error
