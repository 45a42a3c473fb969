"""The ground truth of a sequence: found, read in whatever form, and compared with the images' times. What is wrong with
it is a warning: a run needs none."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from maslam.backend.geometry import product

from ..errors import FrontendError
from ..files.colmap_poses import find_colmap_images
from ..files.pose_arrays import ARRAY_SUFFIXES
from ..files.pose_table import read_poses
from ..files.timestamps import NS_PER_S, span_text
from ..files.trajectory import TRUTH_TOLERANCE_NS, Trajectory
from .base import Problems
from .image_times import TimedImages
from .images import natural_key
from .poses_of_images import given_poses

_SUFFIXES = (".txt", ".tum", ".csv")
_UNREAD = frozenset(
    (
        *(".xlsx", ".xls", ".ods", ".jsonl", ".ndjson", ".gz", ".zip", ".tgz", ".7z", ".pkl", ".pickle", ".mat", ".h5"),
        *(".hdf5", ".parquet", ".feather", ".pt", ".pth", ".kml", ".dat", ".yaml", ".yml", ".xml", ".log"),
    )
)
_BY_NAME = "trajectory"
_NAMES = ("poses", "groundtruth", "ground_truth", "gt", "gt_poses", "gt_pose", "traj", _BY_NAME)
POSE_FOLDERS, _POSE_SUFFIXES = ("poses", "pose"), (".txt", *ARRAY_SUFFIXES)
_ESTIMATED = re.compile(
    r"((camera|key_?frame|frame|est(imated)?)_?)?traj(ectory)?(_est(imated?)?)?|odom(etry)?|vo|slam"
)
_LOOKS_TRUE = re.compile(r"ground.?truth|(?:^|[^a-z])gt(?:[^a-z]|$)")
LEFT_OUT = "ground truth left out, errors cannot be known"
_FASTEST_M_S = 150.0  # of what carries a camera: an airliner takes off at half of it
_MANY, _AHEAD = 10, 0.9  # poses, and the share of their path ahead, from which axes are a body's


@dataclass(frozen=True)
class Truth:
    """``trajectory``: ``T_W_C`` at its own times, or those of the images; ``source``: the file or folder."""

    trajectory: Trajectory
    source: Path

    def moved(self, T_given_camera: NDArray[np.float64]) -> Truth:
        """That of another camera or frame fixed to the one whose poses are given; ``T_given_camera`` ``(4, 4)``."""
        poses = product(self.trajectory.poses, T_given_camera)
        return Truth(Trajectory(self.trajectory.stamps_ns, poses), self.source)


def as_truth(trajectory: Trajectory | None, source: Path) -> Truth | None:
    """A trajectory that a reader has found by itself in ``source``, or None."""
    return None if trajectory is None else Truth(trajectory, source)


def find_truth(folder: Path, images: TimedImages, problems: Problems) -> Truth | None:
    """The ground truth beside the images of ``folder``, under a usual name, in any form that
    :func:`~maslam.frontend.files.pose_table.read_poses` knows, one file an image in ``poses``, or a model of COLMAP;
    None without.

    A file that is damaged or does not fit is named in ``problems`` and left out, and so is one that looks like ground
    truth and is not read.
    """
    files = sorted(
        (path for path in folder.iterdir() if path.suffix.lower() in (*_SUFFIXES, *ARRAY_SUFFIXES) and path.is_file()),
        key=lambda path: natural_key(path.name),
    )
    files, arrays = ([p for p in files if (p.suffix.lower() in ARRAY_SUFFIXES) is array] for array in (False, True))
    usual = [path for some in (files, arrays) for name in _NAMES for path in some if path.stem.lower() == name]
    looks = [path for path in files if _LOOKS_TRUE.search(path.stem.lower()) and path not in usual]
    found = [*usual, *looks]
    if found:
        if len(found) > 1:
            others = ", ".join(path.name for path in found[1:])
            problems.warning(f"{found[0]}: taken as the ground truth; {others} beside it is not used")
        truth = read_truth(found[0], images, problems)
        if truth is not None:
            check_axes(truth, problems)
            _check_speed(truth, problems)
            if found[0].stem.lower() == _BY_NAME:
                problems.warning(
                    f"{found[0]}: taken as the ground truth by its name; if it is an estimate, move it away"
                )
        return truth
    unread = _of_unread_forms(folder)
    if unread:
        problems.warning(
            f"{folder}: {', '.join(unread)}: by the name a ground truth, in a form that is not read "
            f"({', '.join((*_SUFFIXES, *ARRAY_SUFFIXES))} are)"
        )
    estimated = [path.name for path in files if _ESTIMATED.fullmatch(path.stem.lower())]
    if estimated:
        problems.warning(
            f"{folder}: {', '.join(estimated)}: by the name a trajectory that a program has estimated, not read; call "
            "it groundtruth if it is true (`maslam import` takes estimates)"
        )
    inside = next((folder / name for name in POSE_FOLDERS if (folder / name).is_dir()), None)
    if inside is not None:
        return _of_single_files(inside, images, problems)
    model = find_colmap_images(folder)
    if model is None:
        return None
    truth = read_truth(model, images, problems)
    if truth is not None:
        problems.warning(f"{model}: taken as the ground truth, which COLMAP has estimated; move it away to do without")
    return truth


def _of_unread_forms(folder: Path) -> list[str]:
    """Names of files that are called as ground truth is, with suffixes of data that no reader of it takes."""
    found = []
    for path in folder.iterdir():
        stem = path.name.partition(".")[0].lower()
        true = (stem in _NAMES and stem != _BY_NAME) or _LOOKS_TRUE.search(stem)
        if true and path.suffix.lower() in _UNREAD and path.is_file():
            found.append(path.name)
    return sorted(found)


def read_truth(path: Path, images: TimedImages, problems: Problems, wxyz: bool = False) -> Truth | None:
    """The ground truth in ``path``; poses without times are those of the images, in order or by the numbers in the
    names. None, and a warning, where it cannot be used. ``wxyz``: see :func:`read_poses`."""
    try:
        given = given_poses(path, read_poses(path, wxyz), images)
    except FrontendError as error:
        problems.warning(f"{error}: {LEFT_OUT}")
        return None
    for note in given.notes:
        problems.warning(f"{path}: {note}")
    return Truth(given.trajectory, path)


def frame_truth(stamps_ns: NDArray[np.int64], poses: NDArray[np.float64]) -> Trajectory | None:
    """Ground truth from ``poses`` ``(N, 4, 4)`` ``T_W_C``, one per frame, at ``stamps_ns`` ``(N,)``; None where the
    stamps do not ascend, which is listed as a problem of its own."""
    return Trajectory(stamps_ns, poses) if (np.diff(stamps_ns) > 0).all() else None


def check_cover(truth: Truth, stamps_ns: NDArray[np.int64], problems: Problems) -> None:
    """Warn where frames at ``stamps_ns`` ``(N,)`` have no true pose near them in time: some, or all: another clock."""
    covered = frames_covered(truth.trajectory, stamps_ns)
    if covered == len(stamps_ns):
        return
    near = f"within {TRUTH_TOLERANCE_NS / 1e6:.0f} ms"
    if not covered:
        problems.warning(
            f"{truth.source}: no true pose {near} of any image: its times are {span_text(truth.trajectory.stamps_ns)}, "
            f"the images' {span_text(stamps_ns)}: on another clock? errors cannot be known"
        )
    else:
        problems.warning(
            f"{truth.source}: a true pose {near} for {covered} of {len(stamps_ns)} frames; errors are of these alone"
        )


def check_axes(truth: Truth, problems: Problems) -> None:
    """Warn of poses that move ahead along their own x, as those of a vehicle's body do, not of a camera, whose z looks
    ahead, and of such that never turn where the path does. More than that cannot be known of axes."""
    if _never_turns(truth.trajectory):
        problems.warning(
            f"{truth.source}: poses never turn, where their path does: positions alone (of a satellite receiver?); "
            "these are compared, rotations of matches are not to be relied on"
        )
        return
    steps = np.diff(truth.trajectory.centres, axis=0)
    ahead = np.einsum("nij,ni->nj", truth.trajectory.poses[:-1, :3, :3], steps)[:, 0]
    length = float(np.linalg.norm(steps, axis=1).sum())
    share = float(ahead.sum()) / length if length > 0 else 0.0
    if len(steps) >= _MANY and share > _AHEAD:
        problems.warning(
            f"{truth.source}: poses move along their own x axis ({100 * share:.0f} % of the path): axes of a body (x "
            "ahead) rather than of a camera (z ahead)? positions are compared all the same, rotations of matches are "
            "not to be relied on"
        )


def _check_speed(truth: Truth, problems: Problems) -> None:
    """Warn of positions that go faster than anything with a camera: in another unit than metres, or of the times."""
    steps = np.linalg.norm(np.diff(truth.trajectory.centres, axis=0), axis=1)
    seconds = np.diff(truth.trajectory.stamps_ns) / NS_PER_S
    speed = float(np.median(steps / seconds)) if len(steps) >= _MANY else 0.0
    if speed > _FASTEST_M_S:
        problems.warning(
            f"{truth.source}: positions move at {speed:.0f} m/s (median), if they are metres: are they? a heading such "
            "as 'x [mm]' says their unit; or are its times in another one?"
        )


def _never_turns(trajectory: Trajectory) -> bool:
    """Whether all rotations are one while the path bends by more than a quarter of a circle."""
    rotations, steps = trajectory.poses[:, :3, :3], np.diff(trajectory.centres, axis=0)
    if len(rotations) < _MANY or np.abs(rotations - rotations[0]).max() > 1e-9:
        return False
    lengths = np.linalg.norm(steps, axis=1)
    ahead = steps[lengths > 0.1 * lengths.max(initial=0.0)]
    ahead = ahead / np.linalg.norm(ahead, axis=1, keepdims=True)
    return bool(len(ahead)) and float((ahead @ ahead[0]).min()) < 0.0


def frames_covered(truth: Trajectory, stamps_ns: NDArray[np.int64]) -> int:
    """How many of the frames at ``stamps_ns`` have a true pose at their time."""
    return int((truth.nearest(stamps_ns, TRUTH_TOLERANCE_NS) >= 0).sum())


def _of_single_files(inside: Path, images: TimedImages, problems: Problems) -> Truth | None:
    """A 4x4 or 3x4 matrix in a file of its own for each image, of the same name, or in the same order."""
    files = sorted(
        (path for path in inside.iterdir() if path.suffix.lower() in _POSE_SUFFIXES),
        key=lambda path: natural_key(path.name),
    )
    files = [path for path in files if path.suffix == files[0].suffix]
    if not files:
        return None
    matched = _match_names(files, images.files)
    if matched is None:
        problems.warning(
            f"{inside}: {len(files)} pose files of other names for {len(images.files)} images: which is whose? "
            f"{LEFT_OUT}"
        )
        return None
    return truth_of_files(inside, matched, images.stamps_ns, problems)


def truth_of_files(
    source: Path, files: Sequence[Path | None], stamps_ns: NDArray[np.int64], problems: Problems
) -> Truth | None:
    """Ground truth from one file an image, each with one pose; None for an image without. Files that hold no pose are
    counted; those without a finite one are moments at which it was not known."""
    stamps, poses, broken = [], [], []
    for stamp, path in zip(stamps_ns.tolist(), files, strict=True):
        if path is None:
            continue
        try:
            poses.append(_one_pose(path))
            stamps.append(stamp)
        except FrontendError as error:
            broken.append(str(error))
    if broken:
        more = f" (and {len(broken) - 1} more)" if len(broken) > 1 else ""
        problems.warning(f"{broken[0]}{more}: left out of the ground truth")
    if not poses:
        return None
    trajectory = frame_truth(np.array(stamps, dtype=np.int64), np.array(poses))
    return None if trajectory is None else Truth(trajectory, source)


def _one_pose(path: Path) -> NDArray[np.float64]:
    """The only pose in a file, ``(4, 4)``: four rows of four, three rows of four, or one row."""
    table = read_poses(path)
    if len(table.poses) != 1:
        raise FrontendError(f"{path}: one pose expected, found {len(table.poses)}")
    pose: NDArray[np.float64] = table.poses[0]
    return pose


def _match_names(files: Sequence[Path], images: Sequence[Path]) -> list[Path | None] | None:
    by_stem = {path.name.split(".")[0]: path for path in files}
    matched = [by_stem.get(image.name.split(".")[0]) for image in images]
    if any(matched):
        return matched
    return list(files) if len(files) == len(images) else None
