"""Interface of every data set: sequences of frames, decoded on demand."""

from __future__ import annotations

import time
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, field
from enum import StrEnum
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar, TypeVar

import numpy as np
from numpy.typing import NDArray

from ..cameras.calibration import RawCamera
from ..cameras.description import UnderstoodCamera
from ..cameras.models import Rig, RigKind
from ..cameras.rectification import Rectifier
from ..errors import FrontendError, ImageSizeError
from ..files.positions import PositionFixes
from ..files.trajectory import Trajectory
from ..frames import Frame, PutOff
from ..stopwatch import Stopwatch, TimedStage
from .mask_files import FrameMasks
from .numbering import MissingImages
from .pixel_values import PixelValues
from .stored_image import ImageRef, read_colour, read_depth, read_grey

if TYPE_CHECKING:  # it brings the compiler, which few data sets need
    from ..cameras.depth_registration import DepthRegistration

Pixel = TypeVar("Pixel", bound=np.generic)
Value = TypeVar("Value")


class Severity(StrEnum):
    """``ERROR``: a run on this data would be wrong or stop; ``WARNING``: it can run, and its user should know."""

    ERROR = "error"
    WARNING = "warning"


@dataclass(frozen=True)
class Problem:
    """One thing wrong with a data set; ``message`` names file, number and unit in one line."""

    severity: Severity
    message: str


class Problems:
    """Problems gathered while a data set is opened, in ``found``."""

    def __init__(self) -> None:
        self.found: list[Problem] = []

    def error(self, message: str) -> None:
        """Add a problem that makes a run wrong or stops it; ``message`` names file, number and unit."""
        self.found.append(Problem(Severity.ERROR, message))

    def warning(self, message: str) -> None:
        """Add a problem that a run survives and its user should know; ``message`` as in :meth:`error`."""
        self.found.append(Problem(Severity.WARNING, message))


_RESIZE = "; resize depth that is registered to the image, by the nearest pixel"


@dataclass(frozen=True)
class ImageSequence:
    """The images of one agent, in order of time, with a calibrated and rectified camera.

    ``kind``: the reader's; ``name``: of the folder, unique in a data set. ``stamps_ns`` ``(N,)`` int64, ascending.
    ``left`` names one image per frame, a file or a part of a recording; ``right`` (stereo) and ``depth`` (RGB-D)
    likewise, else empty; ``depth_unit_m``: metres per step or number of its files. ``rectifier`` maps the images as
    stored to those of ``rig``; None where they are rectified already. ``registration`` maps depth as stored to the
    camera of ``rig``; None where it is stored registered to the image (and goes through the ``rectifier`` with it).
    ``stored_size`` ``(width, height)`` of the image files, pixels; ``stored_camera``: the calibrated camera that took
    them, and ``R_rectified_left`` ``(3, 3)``, which turns its coordinates into the rectified one's; None where the
    images are rectified already. ``groundtruth``: ``T_W_C`` of the rectified left camera, at all known moments, not
    only those of frames. ``missing``: images that the names' numbers lack. ``understood``: each camera as its
    calibration file describes it. ``origin``: what of a recording is read, in a line for people; empty for image files.
    ``focal_guess``: where the focal length comes from that nobody calibrated, else empty.
    ``values``: how stored values become grey levels; ``masks``: None where all of every image is used. ``notes``: what
    was found out about the files and done with them, a sentence each.
    ``positions``: of an antenna, measured from outside (GPS); of a recording's, degrees and the receiver's own noise.
    """

    kind: str
    name: str
    rig: Rig
    stamps_ns: NDArray[np.int64]
    left: tuple[ImageRef, ...]
    stored_size: tuple[int, int]
    right: tuple[ImageRef, ...] = ()
    depth: tuple[ImageRef, ...] = ()
    depth_unit_m: float = 0.001
    rectifier: Rectifier | None = None
    stored_camera: RawCamera | None = None
    R_rectified_left: NDArray[np.float64] | None = None
    registration: DepthRegistration | None = None
    groundtruth: Trajectory | None = None
    problems: tuple[Problem, ...] = ()
    missing: tuple[MissingImages, ...] = ()
    understood: tuple[UnderstoodCamera, ...] = ()
    origin: str = ""
    positions: PositionFixes | None = None
    focal_guess: str = ""
    values: PixelValues = field(default_factory=PixelValues)
    masks: FrameMasks | None = None
    notes: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        for count in (len(self.stamps_ns), len(self.right) or len(self.left), len(self.depth) or len(self.left)):
            if count != len(self.left):
                raise ValueError(f"{count} files or stamps for {len(self.left)} images")

    def __len__(self) -> int:
        return len(self.left)

    def read(self, i: int) -> Frame:
        """Frame ``i``, decoded and rectified at once.

        :class:`FrontendError` where a file is missing, damaged or of another size; ``IndexError`` outside 0 to N - 1.
        """
        if not 0 <= i < len(self):
            raise IndexError(f"frame {i} of {len(self)}")
        right = self._right(i) if self.right else None
        depth = self._depth(i) if self.depth else None
        return Frame(i, int(self.stamps_ns[i]), self._left(i), right, depth, str(self.left[i]), *self._masks(i))

    def read_image(self, i: int) -> NDArray[np.uint8]:
        """The image of frame ``i`` alone, ``(H, W)`` uint8 grey; errors as :meth:`read`'s."""
        return self._left(i)

    def read_right(self, i: int) -> NDArray[np.uint8]:
        """The right image of frame ``i`` of a stereo sequence alone, as :meth:`read_image`."""
        return self._right(i)

    def read_colour(self, i: int) -> NDArray[np.uint8]:
        """The image of frame ``i``, rectified like its grey one, ``(H, W, 3)`` BGR; of three equal channels where the
        file is grey. Errors as :meth:`read`'s."""
        image = self.values.levels(self._sized(read_colour(self.left[i]), self.left[i]))
        return image if self.rectifier is None else self.rectifier.rectify_left(image)

    def frames(
        self, start: int = 0, stop: int | None = None, ahead: int = 4, watch: Stopwatch | None = None
    ) -> Iterator[Frame]:
        """Frames ``start`` to ``stop`` in order, each decoded once; a thread decodes up to ``ahead`` frames in advance.

        An error that :meth:`read` would raise for the image is raised when the damaged frame's turn comes, not before.
        The second image (right, depth) is decoded on demand, see :class:`Frame`. ``watch`` receives the time that
        decoding takes.
        """
        indices = iter(range(len(self))[start:stop])
        pending: deque[Future[Frame]] = deque()
        reader = ThreadPoolExecutor(1, thread_name_prefix="decode")
        try:
            for i in indices:
                pending.append(reader.submit(self._put_off, i, reader, watch))
                if len(pending) > ahead:
                    yield pending.popleft().result()
            while pending:
                yield pending.popleft().result()
        finally:
            reader.shutdown(wait=True, cancel_futures=True)

    def _put_off(self, i: int, reader: ThreadPoolExecutor, watch: Stopwatch | None) -> Frame:
        """Frame ``i`` with its second image still to be decoded."""
        image = _timed(partial(self._left, i), watch)()
        right = PutOff(_timed(partial(self._right, i), watch), reader.submit) if self.right else None
        depth = PutOff(_timed(partial(self._depth, i), watch), reader.submit) if self.depth else None
        return Frame(i, int(self.stamps_ns[i]), image, right, depth, str(self.left[i]), *self._masks(i))

    def _left(self, i: int) -> NDArray[np.uint8]:
        image = self.values.levels(self._sized(read_grey(self.left[i]), self.left[i]))
        return image if self.rectifier is None else self.rectifier.rectify_left(image)

    def _right(self, i: int) -> NDArray[np.uint8]:
        image = self.values.levels(self._sized(read_grey(self.right[i]), self.right[i]))
        return image if self.rectifier is None else self.rectifier.rectify_right(image)

    def _depth(self, i: int) -> NDArray[np.float32]:
        sensor = None if self.registration is None else self.registration.depth_camera
        size = self.stored_size if sensor is None else (sensor.width, sensor.height)
        depth = self._sized(read_depth(self.depth[i], self.depth_unit_m), self.depth[i], size, _RESIZE)
        if self.registration is not None:
            depth = self.registration.register(depth)
        elif self.rectifier is not None:
            depth = self.rectifier.rectify_depth(depth)
        used, _ = self._masks(i)
        return depth if used is None else np.where(used, depth, np.float32(0.0))

    def _masks(self, i: int) -> tuple[NDArray[np.bool_] | None, NDArray[np.bool_] | None]:
        """Used pixels of the rectified image and right image of frame ``i``; None: all."""
        return (None, None) if self.masks is None else (self.masks.of_left(i), self.masks.of_right(i))

    def _sized(
        self, image: NDArray[Pixel], stored: ImageRef, size: tuple[int, int] | None = None, cure: str = ""
    ) -> NDArray[Pixel]:
        """The image, where it has the sequence's size, or this; ``cure``: what to do where it has another."""
        width, height = size or self.stored_size
        if image.shape[:2] != (height, width):
            raise ImageSizeError(
                f"{stored}: {image.shape[1]}x{image.shape[0]} pixels, but this sequence has {width}x{height}{cure}"
            )
        return image


def _timed(make: Callable[[], Value], watch: Stopwatch | None) -> Callable[[], Value]:
    """Run ``make`` and add its time to ``watch``."""

    def timed() -> Value:
        cpu, wall = time.thread_time(), time.perf_counter()
        value = make()
        if watch is not None:
            watch.add(TimedStage.DECODE, time.thread_time() - cpu, time.perf_counter() - wall)
        return value

    return timed


@dataclass(frozen=True)
class Dataset:
    """Contents of the folder ``root``: one sequence, or one for each agent of a multi-agent data set, in order of their
    names.

    ``kind``: that of the sequences; ``problems``: agents that could not be opened at all, so that no sequence can list
    them; ``notes``: how the folder was understood, a sentence each.
    """

    kind: str
    root: Path
    sequences: list[ImageSequence]
    problems: tuple[Problem, ...] = ()
    notes: tuple[str, ...] = ()


class Reader(ABC):
    """Reader of one kind of data set: recognises its folder and opens it as one sequence.

    A user's own derives from this class and is given as ``maslam.open_dataset(..., readers=[...])`` or by an entry
    point of the group ``maslam.datasets``. ``kind`` names it: in messages, in ``manifest.json``, and for ``--dataset``.
    """

    kind: str
    suffixes: ClassVar[frozenset[str]] = frozenset()
    """Of single files that this kind of data set may be, in lower case with the dot."""

    @abstractmethod
    def recognises(self, folder: Path) -> bool:
        """Whether ``folder`` looks like this kind; quick, and no error whatever is in it."""

    @abstractmethod
    def open(self, folder: Path, rig: RigKind | None) -> ImageSequence:
        """Open the sequence in ``folder``, as ``rig`` or, for None, as the most that its files allow.

        Problems of a usable sequence are listed in it; others are raised as :class:`FrontendError`.
        """

    def openers(self, path: Path, rig: RigKind | None) -> dict[str, Callable[[], ImageSequence]]:
        """What opens each sequence in ``path``, by its name: one, unless a recording holds several robots."""
        return {path.resolve().name: partial(self.open, path, rig)}


def choose_rig(available: Sequence[RigKind], wanted: RigKind | None, folder: Path) -> RigKind:
    """Return ``wanted`` if the files allow it, else raise :class:`FrontendError` with what they allow; None takes the
    first ``available``."""
    if wanted is None:
        return available[0]
    if wanted not in available:
        raise FrontendError(f"{folder}: cannot be read as {wanted}; its files allow {', '.join(available)}")
    return wanted
