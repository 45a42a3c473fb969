"""Any folder of images with a calibration file beside them; also what ``maslam render`` writes for each agent."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from ..cameras.calibration import RawRig
from ..cameras.models import RigKind
from ..errors import FrontendError
from .assemble import FoundSequence, assemble, available_rigs
from .base import ImageSequence, Problems, Reader, choose_rig
from .camera_file import find_camera_file, numbers_files
from .depth_files import FLOAT_SUFFIXES
from .depth_unit import unit_of_depth
from .guessed_camera import guess_camera, guess_text
from .image_times import TimedImages, timed_images
from .other_calibrations import calibrations_of_others
from .pairing import with_partners
from .second_images import SortedImages, has_images, sort_images, unread_depth, unread_folders
from .shared_camera import find_shared_camera
from .truth import find_truth
from .unnamed_depth import UnnamedDepth, find_unnamed_depth, floating_point_beside


class FolderReader(Reader):
    """Images in the folder itself or in ``image_0`` (``left``, ``images``, ``rgb``, ...); stereo with ``image_1``
    (``right``), RGB-D with ``depth_0`` (``depth``), or all in one folder by their names (see :mod:`.second_images`);
    a calibration file (see :mod:`maslam.frontend.cameras.calibration_files`).

    Partners: :mod:`.pairing`. Time stamps: :mod:`.image_times`. Ground truth: :mod:`.truth`.
    """

    kind = "images"

    def recognises(self, folder: Path) -> bool:
        """See :meth:`Reader.recognises`."""
        return has_images(folder)

    def open(self, folder: Path, rig: RigKind | None) -> ImageSequence:
        """See :meth:`Reader.open`."""
        problems = Problems()
        named = sort_images(folder)
        if named is None:
            raise FrontendError(f"{folder}: no images of a camera")
        unnamed = find_unnamed_depth(folder, named)
        found = unnamed.found
        calibration = (
            find_camera_file(folder) or find_camera_file(folder / found.inside) or find_shared_camera(folder, problems)
        )
        guess = ""
        if calibration is None:
            raw, guess = guess_camera(found.files)
            source = folder
            problems.warning(guess_text(folder, raw, guess) + _unread(folder))
        else:
            raw, source = calibration
        images = timed_images(folder, found.files, raw.rate_hz, problems)
        right: tuple[Path, ...] = ()
        depth: tuple[Path, ...] = ()
        if unnamed.look is not None:
            found = _with_depth_if_known(folder, unnamed, images, raw, source, rig, problems)
        elif not found.depth and not found.right and rig is None:
            _say_floating_point(folder, found, problems)
            _say_unread_depth(folder, problems)
        kind = choose_rig(_rigs(folder, found, raw, source, rig, problems), rig, folder)
        if kind is RigKind.STEREO:
            images, right = with_partners(folder, images, found.right, "right image", problems)
        if kind is RigKind.RGBD:
            images, depth = with_partners(folder, images, found.depth, "depth image", problems)
        sequence = FoundSequence(
            kind=self.kind,
            folder=folder,
            raw=raw,
            calibration=source,
            images=images.files,
            stamps_ns=images.stamps_ns,
            stamps_source=images.source,
            right=right,
            depth=depth,
            depth_unit_m=unit_of_depth(depth, raw.depth_unit_m, None, source, problems) if depth else 0.001,
            truth=find_truth(folder, images, problems),
            missing=images.missing,
            focal_guess=guess,
        )
        said = {path.parent for one in (named, found) for files in (one.files, one.right, one.depth) for path in files}
        others = unread_folders(folder, said | {found.unused or folder}) if rig is None else []
        notes = [f"images in {', '.join(others)} are not read"] if others else []
        found_sequence = assemble(sequence, kind, problems)
        return replace(found_sequence, notes=(*found_sequence.notes, *notes))


def _unread(folder: Path) -> str:
    """Files that are called as calibrations are, of no form that is read."""
    names = ", ".join(path.name for path in numbers_files(folder))
    said = f"; {names} is of no form that is read" if names else ""
    return said + "".join(f"; {text}" for text in calibrations_of_others(folder))


def _rigs(
    folder: Path, found: SortedImages, raw: RawRig, source: Path, rig: RigKind | None, problems: Problems
) -> list[RigKind]:
    """What the files allow, the most first; what they hold and the calibration does not, or the other way round, is
    said where nobody chose the rig."""
    stereo, depth = bool(found.right) and raw.right is not None, bool(found.depth)
    if found.right and not stereo:
        _say_unused(source, found.right[0].parent, raw, RigKind.RGBD if depth and rig is None else rig, problems)
    elif found.unused is not None and rig is None and not depth:
        problems.warning(
            f"{found.unused}: right images that are not used: the images in {folder / found.inside} are not called "
            "their left ones; name the folders left and right"
        )
    elif raw.right is not None and not stereo and not depth:  # of RGB-D, Camera.bf is the projector's
        problems.warning(f"{source}: a calibrated pair, but {folder} has no right images: read as mono")
    return available_rigs(stereo, depth)


def _with_depth_if_known(
    folder: Path,
    unnamed: UnnamedDepth,
    images: TimedImages,
    raw: RawRig,
    source: Path,
    rig: RigKind | None,
    problems: Problems,
) -> SortedImages:
    """The images with their depth where it is known which picture belongs to which image, and in which unit; else
    without, which is said."""
    assert unnamed.look is not None
    says = f"{unnamed.where}: depth pictures by their content ({unnamed.look.text()})"
    without = replace(unnamed.found, depth=())
    if rig not in (None, RigKind.RGBD):
        return without
    if raw.depth_unit_m is None and rig is None:
        problems.warning(f"{says}, which are not used: add depth_unit_m (metres a step) to {source}")
        return without
    try:
        with_partners(folder, images, unnamed.found.depth, "depth image", Problems())
    except FrontendError as error:
        if rig is not None:
            raise
        problems.warning(f"{says}, which are not used: {error}")
        return without
    problems.warning(f"{says}, taken as the images' depth; call the folder depth to be sure")
    return unnamed.found


def _say_floating_point(folder: Path, found: SortedImages, problems: Problems) -> None:
    place = floating_point_beside(folder, found)
    if place is not None:
        problems.warning(
            f"{place}: pictures of floating-point numbers beside the images, which are not used: "
            "call the folder depth if they are depth in metres"
        )


def _say_unread_depth(folder: Path, problems: Problems) -> None:
    place = unread_depth(folder)
    if place is not None:
        kinds = ", ".join(sorted({path.suffix or path.name for path in place.iterdir() if path.is_file()})[:4])
        problems.warning(
            f"{place}: depth in files that are not read ({kinds}), read as one camera: 16-bit images, or metres in "
            f"{', '.join(sorted(FLOAT_SUFFIXES))} or TIFF, are"
        )


def _say_unused(source: Path, folder: Path, raw: RawRig, rig: RigKind | None, problems: Problems) -> None:
    """Right images that the calibration is of no use for: an error where its pair cannot be what it says."""
    why = raw.contradiction or raw.no_pair or "no baseline of a pair: add baseline_m"
    if rig is RigKind.STEREO or (rig is None and raw.contradiction):
        raise FrontendError(f"{source}: {why}")
    if rig is None:
        problems.warning(f"{source}: right images in {folder} are not used, read as one camera: {why}")
