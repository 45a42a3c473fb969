"""Frames from a folder that grows, a recording, a camera; and what is dropped on the way to odometry."""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from threading import Event

import cv2
import numpy as np
import pytest

from maslam.frontend.cameras.calibration_files import read_calibration
from maslam.frontend.cameras.models import RigKind
from maslam.frontend.datasets import open_dataset
from maslam.frontend.frames import PutOff
from maslam.tools.common.errors import ToolError
from maslam.tools.live import sources as sources_module
from maslam.tools.live.frames import CameraFrame, LatestFrames
from maslam.tools.live.sources import GrowingFolder, OpenCvCamera, PlayedRecording
from maslam.tools.live.tracker import LiveTracker


def frame(number: int) -> CameraFrame:
    return CameraFrame(np.full((4, 6), number, dtype=np.uint8), number)


class Steps(Event):
    """Instead of waiting, a test's next step is taken; after the last one the source is stopped."""

    def __init__(self, steps: list[Callable[[], object]]) -> None:
        super().__init__()
        self.steps = steps
        self.waited: list[float] = []

    def wait(self, timeout: float | None = None) -> bool:
        self.waited.append(timeout or 0.0)
        if self.steps:
            self.steps.pop(0)()
        else:
            self.set()
        return self.is_set()


# -- the queue ---------------------------------------------------------------------------------------------------------


def test_the_newest_frames_wait_and_older_ones_are_dropped() -> None:
    times = iter(range(10))
    frames = LatestFrames(2, lambda: float(next(times)))
    assert [frames.put(frame(k)) for k in range(5)] == [True, True, False, False, False]
    taken = [frames.take(0) for _ in range(3)]
    assert [None if t is None else (t.index, t.frame.time_ns, t.came_s) for t in taken] == [
        (3, 3, 3.0),
        (4, 4, 4.0),
        None,
    ]
    assert (frames.received, frames.dropped) == (5, 3)


def test_what_waits_at_the_end_is_taken_and_nothing_after_it() -> None:
    frames = LatestFrames(1)
    frames.put(frame(0))
    frames.end()
    frames.put(frame(1))
    assert not frames.over
    taken = frames.take()
    assert taken is not None and taken.index == 0 and frames.over and frames.take() is None


def test_dropped_frames_are_said_with_their_number(caplog: pytest.LogCaptureFixture) -> None:
    """Once in a while, not at each frame."""
    frames = LatestFrames(1)
    tracker = LiveTracker(None, frames, lambda *_: None, lambda _: None)  # type: ignore[arg-type]
    for k in range(4):
        frames.put(frame(k))
    tracker._say_dropped(100.0)
    frames.put(frame(4))
    tracker._say_dropped(101.0)
    assert [record.getMessage().split(" dropped")[0] for record in caplog.records] == ["3 of the last 4 frames"]
    tracker._say_dropped(106.0)
    assert caplog.records[-1].getMessage().startswith("1 of the last 1 frames dropped")


# -- a recording -------------------------------------------------------------------------------------------------------


def test_a_recording_is_played_at_its_rate(town_stereo: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    sequence = open_dataset(town_stereo).sequences[0]
    monkeypatch.setattr(sources_module.time, "monotonic", lambda: 50.0)
    got: list[CameraFrame] = []
    stop = Steps([lambda: None] * 6)
    PlayedRecording(sequence, 2.0).run(got.append, stop)
    assert stop.waited[:6] == pytest.approx([0.0, 0.05, 0.10, 0.15, 0.20, 0.25])
    assert [f.time_ns for f in got] == sequence.stamps_ns[:6].tolist()
    np.testing.assert_array_equal(got[3].image, sequence.read(3).image)
    assert isinstance(got[3].right, PutOff)
    np.testing.assert_array_equal(got[3].right.get(), sequence.read(3).right)


def test_a_recording_that_was_begun_goes_on(town_stereo: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """After the frame that an earlier process came to, at once; where that was the last one there are none."""
    sequence = open_dataset(town_stereo).sequences[0]
    monkeypatch.setattr(sources_module.time, "monotonic", lambda: 50.0)
    got: list[CameraFrame] = []
    source, stop = PlayedRecording(sequence, 2.0), Steps([lambda: None] * 3)
    source.after_ns = int(sequence.stamps_ns[7])
    source.run(got.append, stop)
    assert stop.waited[:3] == pytest.approx([0.0, 0.05, 0.10])
    assert [f.time_ns for f in got] == sequence.stamps_ns[8:11].tolist()
    for after_ns in (int(sequence.stamps_ns[-1]), 2**63 - 1):
        source.after_ns = after_ns
        source.run(got.append, Steps([lambda: None] * 3))
    assert len(got) == 3


# -- a folder that grows -----------------------------------------------------------------------------------------------


class Driver:
    """A camera's driver: it writes images of a rendered drive into a folder."""

    def __init__(self, source: Path, folder: Path, names: Callable[[int], str] = "{:06d}".format) -> None:
        self.source, self.folder, self.names = source, folder, names
        for side in ("image_0", "image_1"):
            (folder / side).mkdir(parents=True)
        shutil.copy(source / "camera.yaml", folder)

    def write(self, number: int, side: str = "both", share: float = 1.0) -> None:
        """The images of a moment, or the first ``share`` of their bytes."""
        for one in ("image_0", "image_1") if side == "both" else (side,):
            data = (self.source / one / f"{number:06d}.png").read_bytes()
            path = self.folder / one / f"{self.names(number)}.png"
            path.write_bytes(data[: round(share * len(data))])
            os.utime(path, ns=(10**18 + number * 10**8,) * 2)


@pytest.fixture
def driver(town_stereo: Path, tmp_path: Path) -> Driver:
    driver = Driver(town_stereo / "agent_00", tmp_path / "incoming")
    driver.write(0)
    driver.write(1)
    return driver


def test_images_are_taken_as_they_come_once_both_are_whole(driver: Driver) -> None:
    folder = GrowingFolder(driver.folder)
    assert folder.rig.kind is RigKind.STEREO
    got: list[CameraFrame] = []
    counts: list[int] = []

    def step(write: Callable[[], object]) -> Callable[[], None]:
        def run() -> None:
            counts.append(len(got))
            write()

        return run

    writes = [
        lambda: driver.write(2, "image_0"),
        lambda: driver.write(2, "image_1", share=0.5),
        lambda: driver.write(3),
        lambda: driver.write(2, "image_1"),
        lambda: None,
    ]
    folder.run(got.append, Steps([step(write) for write in writes]))
    assert counts == [1, 1, 1, 1, 3], "the newest of those there, then none until the partner of 2 is whole, in order"
    assert [Path(f.name).stem for f in got] == ["000001", "000002", "000003"]
    assert [f.time_ns for f in got] == [10**18 + k * 10**8 for k in (1, 2, 3)]
    sequence = open_dataset(driver.source).sequences[0]
    for k, one in zip((1, 2, 3), got, strict=True):
        np.testing.assert_array_equal(one.image, sequence.read(k).image)
        np.testing.assert_array_equal(one.right, sequence.read(k).right)


def test_an_image_that_stays_damaged_is_left_out(driver: Driver, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = GrowingFolder(driver.folder)
    now = [0.0]
    monkeypatch.setattr(sources_module.time, "monotonic", lambda: now[0])
    got: list[CameraFrame] = []

    def later() -> None:
        now[0] += 1.5

    writes = [lambda: driver.write(2, share=0.5), lambda: driver.write(3), later, later, lambda: None]
    folder.run(got.append, Steps(writes))
    assert [Path(f.name).stem for f in got] == ["000001", "000003"]


def test_times_in_the_names_are_the_images(town_stereo: Path, tmp_path: Path) -> None:
    driver = Driver(
        town_stereo / "agent_00", tmp_path / "incoming", lambda k: str(1_700_000_000_000_000_000 + k * 10**8)
    )
    for k in range(3):
        driver.write(k)
    got: list[CameraFrame] = []
    GrowingFolder(driver.folder).run(got.append, Steps([lambda: driver.write(3), lambda: None]))
    assert [f.time_ns for f in got] == [1_700_000_000_200_000_000, 1_700_000_000_300_000_000]


def test_a_folder_ends_when_no_image_comes_and_one_without_images_is_said(
    driver: Driver, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    now = [0.0]
    folder = GrowingFolder(driver.folder, idle_s=3.0)
    monkeypatch.setattr(sources_module.time, "monotonic", lambda: now[0])

    def later() -> None:
        now[0] += 2.0

    stop = Steps([later] * 9)
    folder.run(lambda _: None, stop)
    assert len(stop.waited) == 2
    (tmp_path / "empty").mkdir()
    with pytest.raises(ToolError, match="no images came within 0 s"):
        GrowingFolder(tmp_path / "empty", wait_s=0.0)


# -- a camera ----------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def film(town_stereo: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The drive as OpenCV films it: left and right image side by side, without loss."""
    path = tmp_path_factory.mktemp("film") / "pair.avi"
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"FFV1"), 10, (640, 180))
    if not writer.isOpened():
        pytest.skip("this OpenCV writes no FFV1")
    sequence = open_dataset(town_stereo).sequences[0]
    for k in range(4):
        read = sequence.read(k)
        writer.write(cv2.cvtColor(np.hstack([read.image, read.right]), cv2.COLOR_GRAY2BGR))
    writer.release()
    return path


def test_a_stereo_camera_gives_its_sides_by_opencv(film: Path, town_stereo: Path) -> None:
    raw = read_calibration(town_stereo / "agent_00" / "camera.yaml")
    camera = OpenCvCamera(str(film), raw)
    sequence = open_dataset(town_stereo).sequences[0]
    assert camera.rig == sequence.rig
    got: list[CameraFrame] = []
    camera.run(got.append, Event())
    assert len(got) == 4 and all(a.time_ns <= b.time_ns for a, b in pairwise(got))
    for k, one in enumerate(got):
        read = sequence.read(k)
        assert one.image.shape == (180, 320, 3)
        np.testing.assert_allclose(one.image[:, :, 0].astype(int), read.image, atol=3)
        np.testing.assert_allclose(one.right[:, :, 0].astype(int), read.right, atol=3)


def test_a_camera_of_another_size_than_its_calibration_is_refused(film: Path, town_stereo: Path) -> None:
    text = (town_stereo / "agent_00" / "camera.yaml").read_text().replace("width: 320", "width: 400")
    path = film.parent / "other.yaml"
    path.write_text(text)
    with pytest.raises(ToolError, match="its images are 640x180 pixels, the calibration's 400x180"):
        OpenCvCamera(str(film), read_calibration(path))
    with pytest.raises(ToolError, match="cannot be opened"):
        OpenCvCamera(str(film.parent / "none.avi"), read_calibration(path))
