"""Films as a data set: one film, a left and a right one, or one for each robot."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ...cameras.calibration import RawRig
from ...cameras.models import RigKind
from ...errors import FrontendError
from ...files.timestamps import NS_PER_S
from ..assemble import FoundSequence, assemble, available_rigs
from ..base import ImageSequence, Problems, Reader, choose_rig
from ..guessed_camera import guess_text, usual_camera
from ..images import list_images, natural_key
from ..pairing import pair_by_time
from ..second_images import unread_folders
from ..sides import sides_of
from .beside import camera_beside, truth_beside
from .film import FILM_SUFFIXES, Film, FilmFrame, FilmIndex, index_film

_PAIRS = (("left", "right"), ("cam0", "cam1"), ("image_0", "image_1"))
_FEW_IMAGES = 3  # beside a film, fewer are a picture of it or of a calibration board, no sequence
_RATE = 0.05  # share by which the camera file's rate may differ from the film's
_REGULAR = 0.1  # share of the median interval by which others may differ in a film of constant rate
_SAME_MOMENT = 0.5  # of an interval


class FilmReader(Reader):
    """``drive.mp4`` (mov, avi, mkv, …) with a camera file beside it: ``drive.yaml`` or the folder's. ``left.mp4`` with
    ``right.mp4`` (or ``cam0``, ``cam1``) are a pair; other films of one folder a robot each.

    Time stamps: the film's own, from its start. Ground truth: ``drive.tum``.
    """

    kind = "film"
    suffixes = FILM_SUFFIXES

    def recognises(self, folder: Path) -> bool:
        """See :meth:`Reader.recognises`."""
        return bool(_films(folder)) and len(list_images(folder)) < _FEW_IMAGES

    def openers(self, path: Path, rig: RigKind | None) -> dict[str, Callable[[], ImageSequence]]:
        """See :meth:`Reader.openers`."""
        films = [path] if path.is_file() else _films(path)
        if len(films) == 1 or _pair(films) is not None:
            return {path.resolve().stem if path.is_file() else path.resolve().name: partial(self.open, path, rig)}
        return {film.stem: partial(_open_film, film, None, rig, False) for film in films}

    def open(self, folder: Path, rig: RigKind | None) -> ImageSequence:
        """See :meth:`Reader.open`."""
        films = [folder] if folder.is_file() else _films(folder)
        pair = _pair(films)
        if pair is not None:
            return _open_film(*pair, rig, True)
        if len(films) != 1:
            names = ", ".join(film.name for film in films)
            raise FrontendError(f"{folder}: {len(films)} films ({names}), one is expected here; name one of them")
        return _open_film(films[0], None, rig, folder.is_dir())


def robots_note(names: Sequence[str]) -> str:
    """What to know where each film of a folder is a robot of its own."""
    return (
        f"a robot for each of {len(names)} films: {', '.join(names)}; name one to read it alone, call two of one pair "
        "left and right, join parts of one film to a single file"
    )


def _films(folder: Path) -> list[Path]:
    if not folder.is_dir():
        return []
    found = [p for p in folder.iterdir() if p.suffix.lower() in FILM_SUFFIXES and not p.name.startswith(".")]
    return sorted((p for p in found if p.is_file()), key=lambda p: natural_key(p.name))


def _pair(films: list[Path]) -> tuple[Path, Path] | None:
    by_stem = {film.stem.lower(): film for film in films}
    if len(films) != 2 or len(by_stem) != 2:
        return None
    known = next(((by_stem[a], by_stem[b]) for a, b in _PAIRS if {a, b} == set(by_stem)), None)
    return known or _called_left_and_right(films)


def _called_left_and_right(films: Sequence[Path]) -> tuple[Path, Path] | None:
    """Two films whose names differ by left and right, or L and R, alone: ``drive_L.mp4`` and ``drive_R.mp4``."""
    sides = sides_of(films, words_only=True)
    if sides is None or sides.left.keys() != sides.right.keys():
        return None
    return next(iter(sides.left.values())), next(iter(sides.right.values()))


def _open_film(path: Path, right_path: Path | None, rig: RigKind | None, alone: bool) -> ImageSequence:
    """The sequence of a film, with a second one for a pair; ``alone``: in its folder, whose ground truth is its own."""
    problems = Problems()
    calibration = camera_beside([path.parent], path.stem)
    film = _film(path, None if calibration is None else calibration[0].left.size, problems)
    guess = ""
    if calibration is None:
        raw, guess = usual_camera(film.index.played_size if film.turned else film.index.size)
        source = path
        problems.warning(guess_text(path, raw, guess))
    else:
        raw, source = calibration
    stamps = film.index.stamps_ns
    frames = np.arange(len(stamps))
    right: tuple[FilmFrame, ...] = ()
    if right_path is not None and raw.right is None and rig is None:
        problems.warning(f"{source}: one camera, no baseline of a pair: {right_path.name} is not read")
    elif right_path is not None and rig in (None, RigKind.STEREO):
        other = _film(right_path, raw.right.size if raw.right is not None else None, problems)
        frames, partners = _paired(film, other, problems)
        right = tuple(FilmFrame(other, int(k)) for k in partners)
    elif raw.right is not None and right_path is None and rig is None:
        problems.warning(f"{source}: a calibrated pair, but {path.name} is one film: read as mono")
    _check_rate(raw, source, film.index, path, problems)
    images = unread_folders(path.parent, ()) if alone else []
    if images:
        problems.warning(f"{path.parent}: images in {', '.join(images)} are not read, the film is: name one of them")
    found = FoundSequence(
        kind=FilmReader.kind,
        folder=path.parent,
        raw=raw,
        calibration=source,
        images=tuple(FilmFrame(film, int(k)) for k in frames),
        stamps_ns=stamps[frames],
        stamps_source=path,
        right=right,
        truth=truth_beside([path.parent], path.stem, alone, problems),
        focal_guess=guess,
        name=path.resolve().parent.name if right else path.stem,
        origin=_described(path, film) + (f"; right: {right_path.name}" if right and right_path else ""),
    )
    return assemble(found, choose_rig(available_rigs(bool(right), False), rig, path), problems)


def _film(path: Path, calibrated: tuple[int, int] | None, problems: Problems) -> Film:
    """The film, turned as players turn it unless the calibration is of the images as stored."""
    index = index_film(path)
    if index.cut:
        problems.warning(
            f"{path}: the film is cut off: its header promises {index.promised} frames, {len(index.times_ms)} are read"
        )
    if index.repeated:
        problems.warning(f"{path}: {index.repeated} frames have the time of another; these are left out")
    turned = True
    if index.turn_deg:
        turned = calibrated != index.size or index.size == index.played_size
        size = index.played_size if turned else index.size
        reason = "as players do" if turned else f"as the calibration is for {size[0]}x{size[1]}"
        problems.warning(
            f"{path}: a flag says to turn the film by {index.turn_deg} degrees: "
            f"it is {'' if turned else 'not '}turned, {reason}: {size[0]}x{size[1]} pixels"
        )
    return Film(path, index, turned)


def _paired(film: Film, other: Film, problems: Problems) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Frames of both films of one moment."""
    left, right = film.index.stamps_ns, other.index.stamps_ns
    tolerance = int(_SAME_MOMENT * np.median(np.diff(left))) if len(left) > 1 else 0
    pairs = pair_by_time(left, right, tolerance)
    frames, partners = pairs.kept, pairs.second
    if not len(frames):
        raise FrontendError(f"{other.path}: no frame at the time of one of {film.path.name}")
    if len(frames) < len(left):
        problems.warning(
            f"{other.path}: no frame for {len(left) - len(frames)} of {len(left)} of {film.path.name}; "
            "these are left out"
        )
    return frames, partners


def _check_rate(raw: RawRig, source: Path, index: FilmIndex, path: Path, problems: Problems) -> None:
    rate_hz = _rate_hz(index)
    if raw.rate_hz and rate_hz and abs(raw.rate_hz / rate_hz - 1.0) > _RATE:
        problems.warning(
            f"{source}: rate_hz {raw.rate_hz:g}, but {path.name} has {rate_hz:.3f} frames per second by its own times: "
            "these are taken"
        )


def _rate_hz(index: FilmIndex) -> float:
    intervals = np.diff(index.times_ms)
    return 1e3 / float(np.median(intervals)) if len(intervals) else 0.0


def _described(path: Path, film: Film) -> str:
    """What the film is, in a line for people."""
    index = film.index
    width, height = index.size
    intervals = np.diff(index.stamps_ns) / NS_PER_S
    varies = len(intervals) > 0 and np.ptp(intervals) > _REGULAR * np.median(intervals)
    rate = f", variable rate ({1 / intervals.max():.2f} to {1 / intervals.min():.2f} Hz)" if varies else ""
    turned = f", turned by {index.turn_deg} degrees" if index.turn_deg and film.turned else ""
    return f"{path.name}, {len(index.times_ms)} frames of {width}x{height}{turned}{rate}"
