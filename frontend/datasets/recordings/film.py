"""A video file: which frames it has and when, and each of them decoded on demand."""

from __future__ import annotations

import os
from collections import OrderedDict
from dataclasses import dataclass, replace
from pathlib import Path
from threading import Lock
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from ...errors import FrontendError
from ..stored_image import StoredImage

FILM_SUFFIXES = frozenset({".mp4", ".mov", ".m4v", ".avi", ".mkv", ".webm"})
_KEPT = 8  # frames decoded last: a key-frame's colours are asked for while reading is some frames ahead
_CUT_SHARE = 0.01  # of the frames that the header promises: fewer missing may be how its duration was rounded
_MS_NS = 1_000_000
_HARDWARE_ONLY = ("av01", "av1 ")


@dataclass(frozen=True)
class FilmIndex:
    """Frames of a film without decoding: ``times_ms`` ``(N,)`` ascending, ``keys`` ``(M,)`` numbers of those from which
    decoding can begin. ``promised`` frames by its header. ``size`` ``(width, height)`` as stored, pixels; players turn
    it by ``turn_deg`` clockwise. ``repeated``: packets with a time that another has. ``rate_hz`` by its header.
    ``late_ms``: by how much a decoder's times are after these."""

    times_ms: NDArray[np.float64]
    keys: NDArray[np.int64]
    promised: int
    size: tuple[int, int]
    turn_deg: int
    repeated: int
    rate_hz: float = 0.0
    late_ms: float = 0.0

    @property
    def stamps_ns(self) -> NDArray[np.int64]:
        """``(N,)`` nanoseconds since the film's start."""
        return np.rint(self.times_ms * _MS_NS).astype(np.int64)

    @property
    def played_size(self) -> tuple[int, int]:
        """``(width, height)`` as players show it."""
        return self.size[::-1] if self.turn_deg % 180 else self.size

    @property
    def cut(self) -> bool:
        """Whether the film ends before its header says: in frames, and in time, since Matroska's header knows its
        duration only, in which a variable rate has fewer frames."""
        missing = self.promised - len(self.times_ms) - self.repeated
        usual_ms = float(np.median(np.diff(self.times_ms))) if len(self.times_ms) > 1 else 0.0
        lasts_ms = float(self.times_ms[-1] - self.times_ms[0]) + usual_ms if len(self.times_ms) else 0.0
        whole_ms = 1e3 * self.promised / self.rate_hz if self.rate_hz > 0 else np.inf
        share = max(1.0, _CUT_SHARE * self.promised)
        return missing > share and lasts_ms < whole_ms * (1.0 - _CUT_SHARE)


def index_film(path: Path) -> FilmIndex:
    """Read all packets of the film, none is decoded. :class:`FrontendError` for a file that is no film, or cut off
    before its index.

    Decoders give frames in order of their times, so frame k is the k-th time.
    """
    capture = _open(path, cv2.CAP_PROP_FORMAT, -1)  # -1: packets as they are
    times, keys = [], []
    while capture.grab():
        times.append(capture.get(cv2.CAP_PROP_POS_MSEC))
        keys.append(capture.get(cv2.CAP_PROP_LRF_HAS_KEY_FRAME) > 0)
    stored = np.array(times, dtype=np.float64)
    ascending = np.unique(stored)
    if len(ascending) < max(1.0, len(stored) / 2):
        raise FrontendError(f"{path}: its {len(stored)} frames have no times; write it anew as mp4 or mkv")
    begins = np.flatnonzero(np.isin(ascending, stored[np.array(keys, dtype=bool)]))
    size = (int(capture.get(cv2.CAP_PROP_FRAME_WIDTH)), int(capture.get(cv2.CAP_PROP_FRAME_HEIGHT)))
    late_ms = _late_ms(path, ascending) if path.suffix.lower() == ".avi" else 0.0
    turn = round(_open(path).get(cv2.CAP_PROP_ORIENTATION_META)) % 360  # known to decoders only
    promised = capture.get(cv2.CAP_PROP_FRAME_COUNT)
    index = FilmIndex(
        ascending,
        begins,
        int(promised) if 0 < promised < 2**31 else len(stored),
        size,
        turn,
        len(stored) - len(ascending),
        float(capture.get(cv2.CAP_PROP_FPS)),
        late_ms,
    )
    if index.cut:  # of the last frame, a part may be there
        index = replace(index, times_ms=ascending[:-1], keys=begins[begins < len(ascending) - 1])
    if not len(index.times_ms):
        raise FrontendError(f"{path}: no frame of this film can be read")
    return index


def _late_ms(path: Path, times_ms: NDArray[np.float64]) -> float:
    """By how much the first frame decoded of an AVI is later than its first packet: packets have no times of their own
    there, and with B frames the first picture comes out some packets later."""
    capture = _open(path)
    usual_ms = float(np.median(np.diff(times_ms))) if len(times_ms) > 1 else 0.0
    late_ms = capture.get(cv2.CAP_PROP_POS_MSEC) - times_ms[0] if capture.grab() else 0.0
    return float(late_ms) if late_ms > 0.5 * usual_ms else 0.0


class Film:
    """The frames of one video file, decoded in order; a jump decodes from the key frame before.

    ``turned``: as players show it, else as stored. One process has one decoder, opened when a frame is first asked for;
    threads take turns.
    """

    def __init__(self, path: Path, index: FilmIndex, turned: bool) -> None:
        self.path, self.index, self.turned = path, index, turned
        intervals = np.diff(index.times_ms)
        self._near_ms = 0.5 * float(intervals.min()) if len(intervals) else 1.0
        self._forget()

    def _forget(self) -> None:
        self._lock, self._process = Lock(), os.getpid()
        self._capture: cv2.VideoCapture | None = None
        self._at_ms = -np.inf
        self._decoded: OrderedDict[int, NDArray[np.uint8]] = OrderedDict()

    def __getstate__(self) -> dict[str, Any]:
        return {"path": self.path, "index": self.index, "turned": self.turned, "_near_ms": self._near_ms}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        self._forget()

    def read(self, k: int) -> NDArray[np.uint8]:
        """Frame ``k``, ``(H, W, 3)`` uint8 BGR. :class:`FrontendError` where it cannot be decoded."""
        if self._process != os.getpid():  # a decoder's place in the file is shared by processes that fork
            self._forget()
        with self._lock:
            if k not in self._decoded:
                self._decoded[k] = self._decode(k)
                while len(self._decoded) > _KEPT:
                    self._decoded.popitem(last=False)
            return self._decoded[k]

    def _decode(self, k: int) -> NDArray[np.uint8]:
        wanted = float(self.index.times_ms[k])
        capture = self._reach(k)
        while self._at_ms < wanted - self._near_ms and self._grab(capture):
            pass
        there, image = capture.retrieve() if abs(self._at_ms - wanted) <= self._near_ms else (False, None)
        if not there or image is None or image.ndim != 3:
            raise FrontendError(f"{FilmFrame(self, k)}: cannot be decoded{_foreign_codec(capture)}")
        return image.astype(np.uint8, copy=False)

    def _reach(self, k: int) -> cv2.VideoCapture:
        """The decoder at frame ``k`` or before it, and not before the key frame from which it is decoded."""
        times, keys = self.index.times_ms, self.index.keys
        key = int(keys[keys <= k][-1]) if (keys <= k).any() else 0
        least = times[max(key - 1, 0)] - self._near_ms
        if self._capture is not None and least <= self._at_ms <= times[k] + self._near_ms:
            return self._capture
        capture = self._opened(key)
        if key and self._at_ms > times[k] + self._near_ms:  # the jump went too far: all is decoded from the start
            capture = self._opened(0)
        return capture

    def _opened(self, first: int) -> cv2.VideoCapture:
        """A new decoder at frame ``first``, or near it."""
        self._capture, self._at_ms = _open(self.path), -np.inf
        capture = self._capture
        capture.set(cv2.CAP_PROP_ORIENTATION_AUTO, int(self.turned))
        if first:
            capture.set(cv2.CAP_PROP_POS_FRAMES, first)
        self._grab(capture)
        if not first:
            self._at_ms = max(self._at_ms, float(self.index.times_ms[0]))  # some films begin with a time before 0
        return capture

    def _grab(self, capture: cv2.VideoCapture) -> bool:
        """Decode the next frame; False at the end."""
        if not capture.grab():
            self._at_ms = np.inf
            return False
        before, self._at_ms = self._at_ms, capture.get(cv2.CAP_PROP_POS_MSEC) - self.index.late_ms
        if self.index.late_ms and self._at_ms < before:  # the last pictures come out behind all packets, without a time
            later = self.index.times_ms[self.index.times_ms > before + self._near_ms]
            self._at_ms = float(later[0]) if len(later) else np.inf
        return True


@dataclass(frozen=True)
class FilmFrame(StoredImage):
    """Frame ``k`` of a film, counted from 0."""

    film: Film
    k: int

    def __str__(self) -> str:
        return f"{self.film.path}: frame {self.k} ({self.film.index.times_ms[self.k] / 1e3:.3f} s)"

    @property
    def file(self) -> Path:
        """See :attr:`StoredImage.file`."""
        return self.film.path

    @property
    def name(self) -> str:
        """See :attr:`StoredImage.name`: ``drive.mp4/000012``."""
        return f"{self.film.path.name}/{self.k:06d}"

    def read_grey(self) -> NDArray[np.uint8]:
        """See :meth:`StoredImage.read_grey`."""
        return cv2.cvtColor(self.film.read(self.k), cv2.COLOR_BGR2GRAY).astype(np.uint8, copy=False)

    def read_colour(self) -> NDArray[np.uint8]:
        """See :meth:`StoredImage.read_colour`."""
        return self.film.read(self.k)

    def read_depth(self, unit_m: float) -> NDArray[np.float32]:
        """A film holds no depth: :class:`FrontendError`."""
        raise FrontendError(f"{self}: a film has 8 bits a channel: no depth can be read from it")


def _foreign_codec(capture: cv2.VideoCapture) -> str:
    """The kind of video and the cure, where it is one that OpenCV's FFmpeg decodes on some graphics cards only."""
    name = int(capture.get(cv2.CAP_PROP_FOURCC)).to_bytes(4, "little", signed=False).decode("ascii", "replace")
    if name.lower() not in _HARDWARE_ONLY:
        return ""
    return (
        f": the video is {name.upper()}, which this OpenCV has no decoder for; "
        "`ffmpeg -i FILM -c:v libx264 -crf 15 OTHER.mp4` makes one that is read, with the same times"
    )


def _open(path: Path, *parameters: int) -> cv2.VideoCapture:
    """A film, opened with ``parameters``, quiet: FFmpeg writes past this program to the console."""
    os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")
    level = cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)
    try:
        capture = cv2.VideoCapture(str(path), cv2.CAP_FFMPEG, parameters)
    except cv2.error as error:
        raise FrontendError(f"{path}: cannot be opened as a film: {error.err}") from error
    finally:
        cv2.utils.logging.setLogLevel(level)
    if not capture.isOpened():
        raise FrontendError(
            f"{path}: not a film that can be read: damaged, cut off before its index was written, or of a kind that "
            "FFmpeg does not know"
        )
    return capture
