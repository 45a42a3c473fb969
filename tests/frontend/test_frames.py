"""Frames whose second image comes late."""

from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import replace
from threading import Event

import numpy as np
import pytest

from maslam.frontend.errors import FrontendError
from maslam.frontend.frames import Frame, PutOff

IMAGE, RIGHT = np.zeros((4, 6), np.uint8), np.ones((4, 6), np.uint8)


def test_what_is_given_is_there() -> None:
    frame = Frame(3, 70, IMAGE, RIGHT, name="a.png")
    assert frame.right is RIGHT and frame.depth_m is None and frame.problem == ""
    other = replace(frame, right=None)
    assert other.right is None and other.image is IMAGE and other.name == "a.png" and frame.right is RIGHT


def test_what_is_put_off_is_made_once_when_asked_for() -> None:
    made: list[int] = []

    def make() -> np.ndarray:
        made.append(1)
        return RIGHT

    frame = Frame(0, 0, IMAGE, PutOff(make))
    frame.prepare()  # there is nobody to begin
    assert made == [] and frame.right is RIGHT and frame.right is RIGHT and made == [1]


def test_a_failure_is_said_once_asked_for_and_only_a_frontend_error_is_one() -> None:
    def fail() -> np.ndarray:
        raise FrontendError("b.png: cut off")

    frame = Frame(0, 0, IMAGE, depth_m=PutOff(fail))
    assert frame.problem == "" and frame.depth_m is None and frame.problem == "b.png: cut off"
    with pytest.raises(ZeroDivisionError):
        _ = Frame(0, 0, IMAGE, PutOff(lambda: RIGHT // (1 // 0))).right


def test_it_is_made_elsewhere_once_prepared_and_here_when_that_has_ended() -> None:
    go = Event()

    def make() -> np.ndarray:
        go.wait(10)
        return RIGHT

    with ThreadPoolExecutor(1) as pool:
        frame = Frame(0, 0, IMAGE, PutOff(make, pool.submit))
        frame.prepare()
        go.set()
        assert frame.right is RIGHT
        late = Frame(1, 1, IMAGE, PutOff(make, pool.submit))
    late.prepare()
    assert late.right is RIGHT
    cancelled: Future[np.ndarray] = Future()
    cancelled.cancel()
    frame = Frame(2, 2, IMAGE, PutOff(make, lambda _: cancelled))
    frame.prepare()
    assert frame.right is RIGHT


def test_a_wrong_size_is_an_error_that_says_both() -> None:
    with pytest.raises(FrontendError, match=r"frame 5 a.png: right image is 6x4 pixels, the camera 8x4"):
        Frame(5, 0, IMAGE, RIGHT, name="a.png").check_size(RIGHT, "right image", (8, 4))


def test_the_same_images_at_another_moment() -> None:
    calls: list[int] = []

    def make() -> np.ndarray:
        calls.append(1)
        return RIGHT

    frame = Frame(0, 0, IMAGE, PutOff(make), name="a.png")
    other = frame.at(7, 700)
    assert (other.index, other.stamp_ns, other.name, calls) == (7, 700, "a.png", []) and other.image is IMAGE
    assert other.right is frame.right is RIGHT and calls == [1] and (frame.index, frame.stamp_ns) == (0, 0)
