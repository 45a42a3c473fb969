"""The five VO files of one uninterrupted track: the border between a front end and the rest of the system.

Same layout as the public predecessor (dslam_open, ICRA 2018), so its files are read and ours can be read there;
thesis section 3.3.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from maslam._atomic import write_together
from maslam.backend.geometry import is_se3

from ..errors import FrontendError
from . import text_tables

_NAMES = (
    "lm_pos",
    "lm_obs",
    "descs",
    "times",
    "poses",
)  # in the order in which they are put in place: poses_<k> marks a whole track
_ROTATION_TOLERANCE = 1e-3  # of R R^T against the identity: files with few decimals are read too


@dataclass(frozen=True)
class VoTrack:
    """K key-frames, P map points, N observations, in the track's own world frame W.

    Metres, or the track's own unit with one camera; the five files are those of dslam_open (ICRA 2018).
    ``stamps_s`` ``(K,)`` float64 seconds; ``poses`` ``(K, 4, 4)`` ``T_W_C``; ``points`` ``(P, 3)``; ``observations``
    ``(N, 2)`` int32: key-frame index, map-point index, sorted; ``descriptors`` ``(N, 32)`` uint8 ORB; ``words``
    ``(N, 2)`` int32: DBoW2 node id at level 3 and at level 4. Arrays of other shapes, and observations of what does
    not exist, are a ``ValueError``.
    """

    stamps_s: NDArray[np.float64]
    poses: NDArray[np.float64]
    points: NDArray[np.float64]
    observations: NDArray[np.int32]
    descriptors: NDArray[np.uint8]
    words: NDArray[np.int32]

    def __post_init__(self) -> None:
        k, p, n = len(self.stamps_s), len(self.points), len(self.observations)
        expected = {
            "stamps_s": (k,),
            "poses": (k, 4, 4),
            "points": (p, 3),
            "observations": (n, 2),
            "descriptors": (n, 32),
            "words": (n, 2),
        }
        for name, shape in expected.items():
            if getattr(self, name).shape != shape:
                raise ValueError(f"{name} has shape {getattr(self, name).shape}, expected {shape}")
        if n and (self.observations.min() < 0 or (self.observations.max(axis=0) >= (k, p)).any()):
            raise ValueError(f"an observation of key-frame or point beyond the {k} key-frames and {p} points")

    def __len__(self) -> int:
        return len(self.stamps_s)


def write_track(folder: Path, number: int, track: VoTrack) -> None:
    """Write ``poses_<k>.txt times_<k>.txt lm_pos_<k>.txt lm_obs_<k>.txt descs_<k>.txt`` of track ``number`` into
    ``folder``.

    Floats are written with as many digits as give back the same float64. All five appear together or not at all.
    """
    if not all(np.isfinite(values).all() for values in (track.stamps_s, track.poses, track.points)):
        raise ValueError("NaN or infinity in a track's stamps, poses or points")
    folder.mkdir(parents=True, exist_ok=True)
    contents = {
        "poses": text_tables.format_floats(track.poses.reshape(-1, 16)),
        "times": text_tables.format_floats(track.stamps_s.reshape(-1, 1)),
        "lm_pos": text_tables.format_floats(track.points),
        "lm_obs": text_tables.format_integers(track.observations),
        "descs": text_tables.format_bytes_and_integers(track.descriptors, track.words),
    }
    write_together((folder / f"{name}_{number}.txt", contents[name]) for name in _NAMES)


def read_tracks(folder: Path) -> list[VoTrack]:
    """All tracks in ``folder``, in order of their numbers.

    Observations come back sorted by key-frame and point, whatever their order in the file. Raises
    :class:`FrontendError` with file and line for a broken row, and for a folder that has no track or only some of a
    track's five files.
    """
    return [_read_track(folder, number) for number in track_numbers(folder)]


def track_numbers(folder: Path) -> list[int]:
    """The numbers of the tracks in ``folder``, ascending; :class:`FrontendError` where there is none."""
    if not folder.is_dir():
        raise FrontendError(f"{folder}: no such folder")
    pattern = re.compile(rf"(?:{'|'.join(_NAMES)})_(\d+)\.txt")
    numbers = sorted({int(found[1]) for path in folder.iterdir() if (found := pattern.fullmatch(path.name))})
    if not numbers:
        raise FrontendError(
            f"{folder}: no VO files here (poses_0.txt, times_0.txt, lm_pos_0.txt, lm_obs_0.txt, descs_0.txt)"
        )
    return numbers


def _read_track(folder: Path, number: int) -> VoTrack:
    paths = {name: folder / f"{name}_{number}.txt" for name in _NAMES}
    for path in paths.values():
        if not path.is_file():
            raise FrontendError(f"{path}: missing; the five files of track {number} belong together")
    poses = _read_poses(paths["poses"])
    stamps = text_tables.read_table(paths["times"], 1, "a time stamp")[:, 0]
    if len(stamps) != len(poses):
        raise FrontendError(f"{paths['times']}: {len(stamps)} times, but {len(poses)} poses in {paths['poses'].name}")
    for row in np.flatnonzero(np.diff(stamps) < 0)[:1] + 1:
        raise FrontendError(
            f"{paths['times']}:{text_tables.row_line(paths['times'], row)}: time goes back to {float(stamps[row])} s"
        )
    points = text_tables.read_table(paths["lm_pos"], 3, "a map point")
    observations = _read_observations(paths["lm_obs"], len(poses), len(points))
    described = text_tables.read_integer_table(paths["descs"], 34, "a descriptor with its two node ids")
    if len(described) != len(observations):
        raise FrontendError(
            f"{paths['descs']}: {len(described)} descriptors, "
            f"but {len(observations)} observations in {paths['lm_obs'].name}"
        )
    _check_range(paths["descs"], described[:, :32], 0, 255, "a descriptor byte")
    _check_range(paths["descs"], described[:, 32:], 0, 2**31 - 1, "a node id")
    order = np.lexsort((observations[:, 1], observations[:, 0]))
    return VoTrack(
        stamps,
        poses,
        points,
        observations[order].astype(np.int32),
        described[order, :32].astype(np.uint8),
        described[order, 32:].astype(np.int32),
    )


def _read_poses(path: Path) -> NDArray[np.float64]:
    poses = text_tables.read_table(path, 16, "a key-frame pose").reshape(-1, 4, 4)
    if not is_se3(poses, _ROTATION_TOLERANCE):
        row = next(i for i, pose in enumerate(poses) if not is_se3(pose, _ROTATION_TOLERANCE))
        raise FrontendError(
            f"{path}:{text_tables.row_line(path, row)}: not a rigid 4x4 transform "
            "(rotation, position, last row 0 0 0 1)"
        )
    return poses


def _read_observations(path: Path, keyframes: int, points: int) -> NDArray[np.int64]:
    observations = text_tables.read_integer_table(path, 2, "an observation")
    _check_range(path, observations[:, :1], 0, keyframes - 1, "a key-frame index")
    _check_range(path, observations[:, 1:], 0, points - 1, "a map-point index")
    return observations


def _check_range(path: Path, values: NDArray[np.int64], low: int, high: int, what: str) -> None:
    wrong = (values < low) | (values > high)
    if wrong.any():
        row, column = np.argwhere(wrong)[0]
        raise FrontendError(
            f"{path}:{text_tables.row_line(path, row)}: {what} is {values[row, column]}, allowed are {low} to {high}"
        )
