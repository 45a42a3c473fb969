"""The images that a run was made from, found again and written undistorted."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import TYPE_CHECKING

import cv2
import numpy as np
from numpy.typing import NDArray

from maslam.frontend.cameras.models import RigKind
from maslam.frontend.datasets import ImageSequence, open_dataset
from maslam.frontend.datasets.reading_config import ReadingConfig
from maslam.frontend.datasets.stored_image import name_in
from maslam.frontend.errors import FrontendError
from maslam.frontend.recording_config import RecordingConfig
from maslam.mas.manifest import AgentEntry, Manifest
from maslam.mas.sequence import STAMP_TOLERANCE_NS

from ..common.errors import ToolError
from ..pipeline.focal_length import with_focal
from ..pipeline.preprocess_options import READING

if TYPE_CHECKING:
    from maslam.frontend.datasets.readers import ReaderLike

_JPEG_QUALITY = 95
_COPIED = {"PNG": {".png"}, "JPEG": {".jpg", ".jpeg"}}  # what every program of ours reads under these names
_CAMERA_PX = 1e-3  # how far the camera may differ from that of the run
_ORIENTATION = 274  # EXIF


@dataclass(frozen=True)
class AgentImages:
    """The source's images of one agent, and what they are called in the export."""

    entry: AgentEntry
    sequence: ImageSequence
    root: Path

    def rows(self, stamps_ns: NDArray[np.int64]) -> NDArray[np.int64]:
        """Frames ``(n,)`` of these times; ``ToolError`` where the source has none."""
        stamps = self.sequence.stamps_ns
        at = np.clip(np.searchsorted(stamps, stamps_ns), 1, max(len(stamps) - 1, 1))
        at = np.minimum(at, len(stamps) - 1)
        before = np.maximum(at - 1, 0)
        at = np.where(np.abs(stamps[before] - stamps_ns) < np.abs(stamps[at] - stamps_ns), before, at)
        for off in np.flatnonzero(np.abs(stamps[at] - stamps_ns) > STAMP_TOLERANCE_NS)[:1]:
            raise ToolError(
                f"{self.root}: no image of {self.entry.name} at {stamps_ns[off] / 1e9:.6f} s: "
                "not the images that the run was made from"
            )
        return at.astype(np.int64)

    def name(self, row: int) -> str:
        """``agent_00/image_0/000000.png``: the agent, then the user's name from the agent's folder on. What is no PNG
        or JPEG gets ``.png`` behind its name; a space, which ends a name in lists of pairs, becomes ``_``."""
        parts = list(PurePosixPath(name_in(self.sequence.left[row], self.root)).parts)
        if len(parts) > 1 and parts[0] == self.entry.sequence:
            parts = parts[1:]
        name = "_".join("/".join([self.entry.name, *parts]).split())
        return name if Path(name).suffix.lower() in {s for of in _COPIED.values() for s in of} else f"{name}.png"

    def encoded(self, row: int) -> tuple[bytes, NDArray[np.uint8]]:
        """Frame ``row``, undistorted: a file of the kind that its :meth:`name` ends with, and the image ``(H, W, 3)``
        BGR. A file that every program reads as it is, is taken byte by byte; others are encoded anew."""
        image = self.sequence.read_colour(row)
        source = self.sequence.left[row]
        if self.sequence.rectifier is None and isinstance(source, Path) and _is_plain(source):
            return source.read_bytes(), image
        suffix = Path(self.name(row)).suffix.lower()
        flags = [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY] if suffix in _COPIED["JPEG"] else []
        done, data = cv2.imencode(suffix, image, flags)
        if not done:
            raise ToolError(f"{source}: the image cannot be encoded as {suffix}")
        return data.tobytes(), image


def find_images(
    manifest: Manifest, moved: Path | None, readers: Sequence[ReaderLike], members: Sequence[int]
) -> dict[int, AgentImages]:
    """The images of each of the agents ``members``.

    ``moved``: where the source's folder is now, None where it was. ``ToolError`` where they are not there, or are taken
    with another camera than the run was made with.
    """
    for entry in (manifest.agents[a] for a in members if manifest.agents[a].source is not None):
        raise ToolError(f"{entry.name} is of an earlier run of {entry.source}: export its images from that run")
    root = Path(manifest.source) if moved is None else moved
    cure = "name their folder with --images DIR" if moved is None else "--images names another folder"
    settings = manifest.settings
    rig = RigKind(settings["rig"]) if settings.get("rig") else None
    part = RecordingConfig(**(settings.get("recording") or {}))
    reading = ReadingConfig(**(settings.get(READING) or {}))
    kind = settings.get("dataset")
    try:
        dataset = open_dataset(root, rig, strict=False, readers=readers, kind=kind, recording=part, reading=reading)
    except FrontendError as error:
        raise ToolError(f"{error}: the images of this run cannot be read from there; {cure}") from error
    sequences = {sequence.name: sequence for sequence in dataset.sequences}
    own = {entry.sequence for entry in manifest.agents if entry.source is None}
    if len(sequences) == 1 and len(own) == 1:
        sequences = {own.pop(): dataset.sequences[0]}  # the folder was renamed
    found = {}
    for a in members:
        entry = manifest.agents[a]
        if entry.sequence not in sequences:
            why = "".join(f": {problem.message}" for problem in dataset.problems if entry.sequence in problem.message)
            raise ToolError(f"{root}: holds no images of {entry.name} that can be read{why}; {cure}")
        sequence = _as_then(entry, sequences[entry.sequence])
        _check_camera(entry, sequence, root)
        found[a] = AgentImages(entry, sequence, dataset.root)
    return found


def _as_then(entry: AgentEntry, sequence: ImageSequence) -> ImageSequence:
    """With the camera that the run has found from the images, where nobody calibrated it."""
    if not sequence.focal_guess:
        return sequence
    stored = entry.camera.stored
    return (
        with_focal(sequence, stored.fx, stored.coefficients[0])
        if stored
        else with_focal(sequence, entry.camera.fx, 0.0)
    )


def _check_camera(entry: AgentEntry, sequence: ImageSequence, root: Path) -> None:
    known, now = entry.camera, sequence.rig.camera
    same = (known.width, known.height) == (now.width, now.height)
    numbers = np.array([[known.fx, known.fy, known.cx, known.cy], [now.fx, now.fy, now.cx, now.cy]])
    if not same or np.abs(numbers[0] - numbers[1]).max() > _CAMERA_PX:
        raise ToolError(
            f"{root}: the camera of {entry.sequence} is {now.width}x{now.height} with fx {now.fx:.3f}, but the run was "
            f"made with {known.width}x{known.height} and fx {known.fx:.3f}: other images, or another calibration"
        )


def _is_plain(path: Path) -> bool:
    """Whether every program reads the file alike: an 8-bit colour PNG or JPEG of that name, not to be turned. Some take
    the columns of a grey image for its channels."""
    from PIL import Image, UnidentifiedImageError

    if not path.is_file():
        return False
    try:
        with Image.open(path) as image:
            named = path.suffix.lower() in _COPIED.get(image.format or "", set())
            return named and image.mode == "RGB" and image.getexif().get(_ORIENTATION, 1) == 1
    except (UnidentifiedImageError, OSError):
        return False
