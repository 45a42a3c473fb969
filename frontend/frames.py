"""One moment of one agent's camera, decoded and rectified: the only form in which images travel."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future
from copy import copy
from dataclasses import dataclass
from typing import Any, Generic, TypeVar, overload

import numpy as np
from numpy.typing import NDArray

from .errors import FrontendError

Value = TypeVar("Value")


class PutOff(Generic[Value]):
    """A value made once, when it is first read. :meth:`begin` starts making it earlier by ``start``, in a thread of its
    creator. A :class:`FrontendError` raised while it is made becomes ``problem``, and the value None."""

    def __init__(
        self, make: Callable[[], Value], start: Callable[[Callable[[], Value]], Future[Value]] | None = None
    ) -> None:
        self._make, self._start = make, start
        self._future: Future[Value] | None = None
        self._value: Value | None = None
        self._done = False
        self.problem = ""

    def begin(self) -> None:
        """Start making the value in the background, if a thread was given and it is not made yet."""
        if self._start is not None and self._future is None and not self._done:
            try:
                self._future = self._start(self._make)
            except RuntimeError:  # that thread has ended: the value is made when it is asked for
                self._start = None

    def get(self) -> Value | None:
        """Return the value, made now if it is not there yet; None where making it failed, see ``problem``."""
        if not self._done:
            started = self._future is not None and not self._future.cancelled()
            try:
                self._value = self._future.result() if self._future is not None and started else self._make()
            except FrontendError as error:
                self.problem = str(error)
            self._done, self._future = True, None
        return self._value


class _Second(Generic[Value]):
    """A field of :class:`Frame` that may be given as a :class:`PutOff` and is then made when it is first read."""

    def __set_name__(self, owner: type, name: str) -> None:
        self._name = f"_{name}"

    @overload
    def __get__(self, frame: None, owner: type) -> None: ...
    @overload
    def __get__(self, frame: Frame, owner: type) -> Value | None: ...
    def __get__(self, frame: Frame | None, owner: type) -> Value | None:
        given: Any = None if frame is None else frame.__dict__.get(self._name)
        return given.get() if isinstance(given, PutOff) else given

    def __set__(self, frame: Frame, given: Value | PutOff[Value] | None) -> None:
        frame.__dict__[self._name] = given


@dataclass(frozen=True)
class Frame:
    """``image`` ``(H, W)`` uint8 grey; ``right`` likewise (stereo); ``depth_m`` ``(H, W)`` float32 metres along +Z,
    0 = unknown (RGB-D). ``index`` counts the frames of the sequence from 0; ``name`` is the image file, for messages to
    people. ``used``, ``right_used`` ``(H, W)``: pixels of ``image`` and ``right`` that may give points; None: all.
    ``original``: the frame as it was read, where this one is an enlarged copy of it.

    Only key-frames need the second image, so it may be decoded as late as when it is first read; it is None where that
    failed, and ``problem`` then says why.
    """

    index: int
    stamp_ns: int
    image: NDArray[np.uint8]
    right: _Second[NDArray[np.uint8]] = _Second()
    depth_m: _Second[NDArray[np.float32]] = _Second()
    name: str = ""
    used: NDArray[np.bool_] | None = None
    right_used: NDArray[np.bool_] | None = None
    original: Frame | None = None

    @property
    def problem(self) -> str:
        """Damage of a second image that was decoded on demand; empty as long as none is known."""
        return "; ".join(put_off.problem for put_off in self._put_off() if put_off.problem)

    def check_size(self, image: NDArray[Any], what: str, size: tuple[int, int]) -> None:
        """:class:`FrontendError` for an image of another ``(width, height)``: a broken configuration."""
        if image.shape != (size[1], size[0]):
            found = f"{image.shape[1]}x{image.shape[0]}"
            raise FrontendError(
                f"frame {self.index} {self.name}: {what} is {found} pixels, the camera {size[0]}x{size[1]}"
            )

    def at(self, index: int, stamp_ns: int) -> Frame:
        """The same images as another moment; what was put off stays put off."""
        other = copy(self)
        other.__dict__.update(index=index, stamp_ns=stamp_ns)
        return other

    def prepare(self) -> None:
        """Have what was put off decoded in the background: it is needed soon."""
        for put_off in self._put_off():
            put_off.begin()

    def _put_off(self) -> list[PutOff[Any]]:
        """Of an enlarged copy those of the original: that is where damage is found."""
        return [given for given in (self.original or self).__dict__.values() if isinstance(given, PutOff)]
