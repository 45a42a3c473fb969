"""nerfstudio's and instant-ngp's folders: images, their camera and their poses in ``transforms.json``."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from maslam.backend.geometry import product

from ..cameras.calibration import RawRig
from ..cameras.calibration_files import Fields, load_fields, nerfstudio, read_calibration
from ..cameras.models import RigKind
from ..errors import FrontendError
from ..files.pose_conventions import OPENGL
from ..files.pose_entries import OPENGL_NOTE
from .assemble import FoundSequence, assemble, available_rigs
from .base import ImageSequence, Problems, Reader, choose_rig
from .camera_file import usual_camera_file
from .depth_files import stored_depth
from .depth_unit import unit_of_depth
from .folder import FolderReader
from .image_times import timed_images
from .images import IMAGE_SUFFIXES, first_size, natural_key
from .masks import with_named_masks
from .truth import Truth, frame_truth

_FILE = "transforms.json"
_MILLIMETRE = 0.001
_TRUTH_NOTE = f"ground truth: {OPENGL_NOTE}"


class NerfstudioReader(Reader):
    """``transforms.json`` with ``frames`` that name images, and depth if all do (``depth_file_path``, millimetres).

    Camera: of the file (a missing size is the images'), unless ``camera.yaml`` or the like lies beside it. Ground
    truth: ``transform_matrix``. Masks: ``mask_path``, of which white is used. Time stamps: :mod:`.image_times`, in the
    order of the names. A file without such frames is a calibration beside plain images.
    """

    kind = "nerfstudio"

    def recognises(self, folder: Path) -> bool:
        """See :meth:`Reader.recognises`."""
        return (folder / _FILE).is_file()

    def open(self, folder: Path, rig: RigKind | None) -> ImageSequence:
        """See :meth:`Reader.open`."""
        data = load_fields(folder / _FILE)
        listed = data.data.get("frames")
        if not isinstance(listed, list) or not any(isinstance(one, dict) and "file_path" in one for one in listed):
            return FolderReader().open(folder, rig)
        problems = Problems()
        frames = _by_image(data, problems)
        raw, source = _camera(folder, data, list(frames), problems)
        images = timed_images(folder, list(frames), raw.rate_hz, problems)
        in_time = [frames[path] for path in images.files]
        depth = _depth(folder, in_time, first_size(images.files), problems)
        truth = _truth(data, in_time, images.stamps_ns, problems)
        found = FoundSequence(
            kind=self.kind,
            folder=folder,
            raw=raw,
            calibration=source,
            images=images.files,
            stamps_ns=images.stamps_ns,
            stamps_source=images.source,
            depth=depth,
            depth_unit_m=unit_of_depth(depth, raw.depth_unit_m, _MILLIMETRE, source, problems),
            truth=truth,
            missing=images.missing,
        )
        sequence = assemble(found, choose_rig(available_rigs(False, bool(depth)), rig, folder), problems)
        masks = tuple(folder / name if (name := frame.text("mask_path")) else None for frame in in_time)
        sequence = with_named_masks(sequence, masks, data.path, problems)
        return sequence if truth is None else replace(sequence, notes=(*sequence.notes, _TRUTH_NOTE))


def _by_image(data: Fields, problems: Problems) -> dict[Path, Fields]:
    """The frames by their images, in natural order of these; a repeated image keeps its first frame."""
    folder, twice = data.path.parent, 0
    found: dict[Path, Fields] = {}
    for frame in data.listed("frames"):
        name = frame.text("file_path")
        if not name:
            raise frame.fail("file_path", "the name of an image")
        path = _file(folder, name)
        twice += path in found
        found.setdefault(path, frame)
    if twice:
        problems.warning(f"{data.path}: {twice} frames name the image of another: left out")
    places = sorted({path.parent.name for path in found})
    if len(places) > 1:
        raise FrontendError(
            f"{data.path}: its images lie in {len(places)} folders ({', '.join(places[:4])}): of several cameras? "
            "one folder with a transforms.json for each is needed"
        )
    return dict(sorted(found.items(), key=lambda one: natural_key(one[0].name)))


def _file(folder: Path, name: str) -> Path:
    """The image that a frame names: without a suffix in instant-ngp's files, with a path of another machine in some."""
    written = folder / name
    places = (written, folder / "images" / written.name, folder / written.name)
    for path in places:
        if path.suffix and path.is_file():
            return path
    for path in places:
        for suffix in sorted(IMAGE_SUFFIXES) if path.parent.is_dir() else ():
            if (beside := path.with_name(path.name + suffix)).is_file():
                return beside
    return written


def _camera(folder: Path, data: Fields, images: Sequence[Path], problems: Problems) -> tuple[RawRig, Path]:
    beside = usual_camera_file(folder)
    if beside is not None:
        return read_calibration(beside), beside
    if not nerfstudio.recognises(data):
        raise FrontendError(
            f"{data.path}: no camera in this file (fl_x or camera_angle_x), and no camera.yaml beside it"
        )
    there = [path for path in images if path.is_file()]
    raw = nerfstudio.read(data, first_size(there) if there else None)
    note = nerfstudio.focus_note(data)
    if note:
        problems.warning(f"{data.path}: {note}")
    return replace(raw, form="nerfstudio"), data.path


def _depth(folder: Path, frames: Sequence[Fields], size: tuple[int, int], problems: Problems) -> tuple[Path, ...]:
    """Depth images of all frames; none where some frame has none, or they are of another size, which is said."""
    names = [frame.text("depth_file_path") for frame in frames]
    if not any(names):
        return ()
    if not all(names):
        problems.warning(
            f"{folder / _FILE}: depth for {sum(map(bool, names))} of {len(names)} frames: read without depth"
        )
        return ()
    files = tuple(folder / name for name in names)
    try:
        height, width = stored_depth(files[0]).shape[:2]
    except FrontendError:  # named when its turn comes
        return files
    if (width, height) == size:
        return files
    problems.warning(
        f"{files[0]}: depth of {width}x{height} pixels for images of {size[0]}x{size[1]}: read without depth"
    )
    return ()


def _truth(data: Fields, frames: Sequence[Fields], stamps_ns: NDArray[np.int64], problems: Problems) -> Truth | None:
    """``T_W_C`` of the frames that have a pose, in the unit of the poses before ``applied_scale``."""
    known, poses, broken = [], [], []
    for i, frame in enumerate(frames):
        if "transform_matrix" not in frame:
            continue
        try:
            poses.append(frame.transform("transform_matrix"))
            known.append(i)
        except FrontendError as error:
            broken.append(str(error))
    if broken:
        more = f" (and {len(broken) - 1} more)" if len(broken) > 1 else ""
        problems.warning(f"{broken[0]}{more}: left out of the ground truth")
    if not poses:
        return None
    given = np.array(poses)
    scale = data.number("applied_scale", 1.0)
    if scale <= 0.0:
        raise data.fail("applied_scale", "a number above 0")
    given[:, :3, 3] /= scale
    trajectory = frame_truth(stamps_ns[known], product(given, OPENGL))
    return None if trajectory is None else Truth(trajectory, data.path)
