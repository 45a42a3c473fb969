"""Poses in arrays of numpy: which of an archive's they are, by shape and name, and the times or numbers beside them."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from maslam._bounded import Unreadable, open_npz
from maslam.backend.geometry import se3_inverse

from ..errors import FrontendError
from .pose_entries import AS_XYZW, INVERSE_KEYS, MATRIX_KEYS, TIME_KEYS

Array = NDArray[np.float64]
_WIDTHS = (7, 8, 12, 13, 16, 17)
_POSES = ("poses", "pose", "trajectory", "groundtruth", "ground_truth", "gt", "traj", *MATRIX_KEYS)
_INVERSE = ("poses_w2c", "w2cs", *INVERSE_KEYS)
_DIRECTION_OPEN = re.compile("extrinsic|view_?mat", re.IGNORECASE)  # some mean T_W_C by it, others T_C_W
_TIMES = ("timestamps", "times", "stamps", "timestamps_ns", "stamps_ns", "times_ns", *TIME_KEYS)
_NUMBERS = (
    *("ids", "id", "frame_ids", "image_ids", "indices", "index", "frames", "frame_indices", "names", "image_names"),
    *("filenames", "file_names", "files", "images"),
)
_POSITIONS = ("positions", "position", "translations", "translation", "trans", "t", "p", "xyz", "tvecs")
_ROTATIONS = ("rotations", "rotation", "R", "Rs", "rot", "rotation_matrices")
_QUATERNIONS = ("quaternions", "quaternion", "quats", "quat", "q", "orientations", "orientation", *_ROTATIONS[:2])


def rows_of_array(path: Path, array: NDArray[Any]) -> Array:
    """Rows of numbers ``(N, k)`` of an array ``(N, 4, 4)``, ``(N, 3, 4)`` or ``(N, k)``; one matrix is one row.
    :class:`FrontendError` for another shape."""
    if array.ndim not in (2, 3) or (array.ndim == 3 and array.shape[1:] not in ((4, 4), (3, 4))):
        raise FrontendError(f"{path}: numbers of shape {array.shape}; N matrices, (N, 4, 4), are meant")
    one = array.shape in ((4, 4), (3, 4))
    return np.asarray((array[None] if one else array), dtype=np.float64).reshape(1 if one else len(array), -1)


def read_archive(path: Path) -> tuple[list[list[str]], tuple[str, ...], tuple[str, ...]]:
    """The poses of an ``.npz`` as :func:`cells_of_arrays` gives them. :class:`FrontendError` for a damaged file too."""
    return cells_of_arrays(path, _stored(path))


def read_times_archive(path: Path) -> NDArray[Any]:
    """The times ``(N,)`` in an ``.npz``: an array of a usual name, or the only one of that shape.
    :class:`FrontendError` for a damaged file, and for one without."""
    arrays = {name: array for name, array in _stored(path).items() if array.ndim == 1 and array.dtype.kind in "fiu"}
    name = next(iter(_named(arrays, _TIMES)), None) or (next(iter(arrays)) if len(arrays) == 1 else None)
    if name is None:
        raise FrontendError(f"{path}: no times among its arrays; one called timestamps, (N,), is meant")
    return arrays[name]


def _stored(path: Path) -> dict[str, NDArray[Any]]:
    try:
        with open_npz(path) as stored:
            return {name: stored[name] for name in stored.files}
    except Unreadable as error:
        raise FrontendError(f"{path}: {error}") from error
    except OSError as error:
        raise FrontendError(f"{path}: cannot be read: {error.strerror}") from error


def cells_of_arrays(
    path: Path, arrays: Mapping[str, NDArray[Any]]
) -> tuple[list[list[str]], tuple[str, ...], tuple[str, ...]]:
    """Rows of the poses among ``arrays``, a time in front of each where there are some, the images' names or numbers,
    and what to know. :class:`FrontendError` where no array, or none of several, is known to be the poses."""
    poses, notes = _poses(path, {name: array for name, array in arrays.items() if array.dtype.kind in "fiu"})
    rows = [list(map(repr, row)) for row in poses.tolist()]
    along = {name: array for name, array in arrays.items() if array.shape in ((len(rows),), (len(rows), 1))}
    time = next((name for name in _named(along, _TIMES) if along[name].dtype.kind in "fiu"), None)
    if time is not None and poses.shape[1] in (7, 12, 16):
        return [[repr(at), *row] for at, row in zip(along[time].reshape(-1).tolist(), rows, strict=True)], (), notes
    names = next((name for name in _named(along, _NUMBERS) if along[name].dtype.kind in "iuU"), None)
    return rows, () if names is None else tuple(map(str, along[names].reshape(-1).tolist())), notes


def has_columns(arrays: Mapping[str, NDArray[Any]]) -> bool:
    """Whether ``arrays`` hold poses under a usual name, as one array or as positions and rotations."""
    return (
        any(_is_poses(arrays[name]) for name in _named(arrays, (*_POSES, *_INVERSE))) or _of_parts(arrays) is not None
    )


def _poses(path: Path, arrays: Mapping[str, NDArray[Any]]) -> tuple[Array, tuple[str, ...]]:
    shaped = [name for name, array in arrays.items() if _is_poses(array)]
    inverse = [name for name in _named(arrays, _INVERSE) if name in shaped and arrays[name].ndim == 3]
    known = [name for name in _named(arrays, _POSES) if name in shaped]
    others = [name for name in shaped if name not in (*known, *inverse) and not _DIRECTION_OPEN.search(name)]
    if known or (len(others) == 1 and not inverse):
        name = known[0] if known else others[0]
        return rows_of_array(path, arrays[name]), () if known else (f"its array {name!r} is taken as the poses",)
    if inverse:
        T = np.tile(np.eye(4), (len(arrays[inverse[0]]), 1, 1))
        T[:, : arrays[inverse[0]].shape[1]] = arrays[inverse[0]]
        return se3_inverse(T).reshape(-1, 16), (f"its {inverse[0]} map the world to the camera, and are inverted",)
    made = _of_parts(arrays)
    if made is not None:
        return made
    listed = ", ".join(f"{name} {array.shape}" for name, array in sorted(arrays.items())) or "none"
    which = "which of its arrays are the poses?" if others else "no poses among its arrays:"
    raise FrontendError(f"{path}: {which} {listed}; one called poses or c2w (T_W_C), or w2c, (N, 4, 4), is meant")


def _of_parts(arrays: Mapping[str, NDArray[Any]]) -> tuple[Array, tuple[str, ...]] | None:
    """Positions ``(N, 3)`` with rotations ``(N, 3, 3)`` or quaternions ``(N, 4)``; None without."""
    for at in _named(arrays, _POSITIONS):
        t = arrays[at].reshape(len(arrays[at]), -1) if arrays[at].ndim in (2, 3) else np.zeros((0, 0))
        if t.shape[1:] != (3,):
            continue
        for name in _named(arrays, _ROTATIONS):
            if arrays[name].shape == (len(t), 3, 3):
                return np.concatenate([arrays[name], t[:, :, None]], axis=2).reshape(-1, 12).astype(np.float64), ()
        for name in _named(arrays, _QUATERNIONS):
            if arrays[name].shape == (len(t), 4):
                note = f"its {name} are {AS_XYZW}"
                return np.hstack([t, arrays[name]]).astype(np.float64), (note,)
    return None


def _is_poses(array: NDArray[Any]) -> bool:
    matrices = array.ndim == 3 and array.shape[1:] in ((4, 4), (3, 4))
    return len(array.shape) > 1 and len(array) > 0 and (matrices or (array.ndim == 2 and array.shape[1] in _WIDTHS))


def _named(arrays: Mapping[str, Any], names: Sequence[str]) -> list[str]:
    """Those of ``arrays`` that are called so, in whatever case, in order of ``names``."""
    lower = {name.lower(): name for name in arrays}
    return list(dict.fromkeys(lower[name.lower()] for name in names if name.lower() in lower))
