"""One contract for every kind of data set, on data made here with known content."""

from __future__ import annotations

import pickle
import threading
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from dataset_makers import (
    BASELINE_M,
    COLOUR_RIGHT_OF_DEPTH_M,
    COUNT,
    CX,
    CY,
    DEPTH_FOCAL_PX,
    FX,
    FY,
    HEIGHT,
    WIDTH,
    Scene,
    make_scene,
    own_camera,
    write_euroc,
    write_images,
    write_kitti,
    write_rendered,
    write_seven_scenes,
    write_tum,
)

from maslam.frontend.cameras.models import RigKind
from maslam.frontend.datasets import Dataset, ImageSequence, Severity, base, open_dataset
from maslam.frontend.errors import FrontendError
from maslam.frontend.stopwatch import Stopwatch, TimedStage


def truncate(path: Path) -> None:
    data = path.read_bytes()
    path.write_bytes(data[: len(data) // 2])


def resize(path: Path) -> None:
    image = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    assert cv2.imwrite(str(path), image[:-2])


class Contract:
    """What every kind must do. A subclass says how it is written and what of the scene it holds."""

    kind: str
    rigs: tuple[RigKind, ...]
    depth_tolerance_m = 0.0
    """0 where depth comes as stored."""
    left: str
    """Glob of the left images."""

    @pytest.fixture
    def scene(self) -> Scene:
        return make_scene()

    @pytest.fixture
    def folder(self, tmp_path: Path, scene: Scene) -> Path:
        folder = tmp_path / "here"
        folder.mkdir()
        self.write(folder, scene)
        return folder

    def write(self, folder: Path, scene: Scene) -> None:
        raise NotImplementedError

    def expected_stamps(self, scene: Scene) -> np.ndarray:
        return scene.stamps_ns

    def expected_depth_m(self, scene: Scene, i: int) -> np.ndarray:
        return scene.depth_mm[i] / 1000.0

    def open(self, folder: Path, rig: RigKind | None = None) -> ImageSequence:
        dataset = open_dataset(folder, rig)
        assert isinstance(dataset, Dataset) and dataset.kind == self.kind
        [sequence] = dataset.sequences
        return sequence

    def left_image(self, folder: Path, i: int) -> Path:
        return sorted(folder.glob(self.left))[i]

    def test_is_what_was_written(self, folder: Path, scene: Scene) -> None:
        sequence = self.open(folder)
        assert sequence.name == "here" and sequence.rig.kind is self.rigs[0] and len(sequence) == COUNT
        assert sequence.problems == ()
        camera = sequence.rig.camera
        assert (camera.width, camera.height) == (WIDTH, HEIGHT)
        np.testing.assert_allclose([camera.fx, camera.fy, camera.cx, camera.cy], [FX, FY, CX, CY], atol=1e-6)
        assert sequence.stamps_ns.dtype == np.int64
        np.testing.assert_array_equal(sequence.stamps_ns, self.expected_stamps(scene))
        if sequence.rig.kind is RigKind.STEREO:
            assert sequence.rig.baseline_m == pytest.approx(BASELINE_M)
        else:
            assert sequence.rig.baseline_m is None

    def test_frames_hold_the_images(self, folder: Path, scene: Scene) -> None:
        sequence = self.open(folder)
        for i in range(COUNT):
            frame = sequence.read(i)
            assert frame.index == i and frame.stamp_ns == sequence.stamps_ns[i] and Path(frame.name).is_file()
            assert frame.image.dtype == np.uint8
            # One grey level: decoders round colour to grey, and remapping interpolates.
            np.testing.assert_allclose(frame.image.astype(int), scene.images[i], atol=1)
            assert (frame.right is not None) == (sequence.rig.kind is RigKind.STEREO)
            assert (frame.depth_m is not None) == (sequence.rig.kind is RigKind.RGBD)
            if frame.right is not None:
                np.testing.assert_allclose(frame.right.astype(int), scene.rights[i], atol=1)
            if frame.depth_m is not None:
                assert frame.depth_m.dtype == np.float32
                np.testing.assert_allclose(frame.depth_m, self.expected_depth_m(scene, i), atol=1e-6)
        with pytest.raises(IndexError):
            sequence.read(COUNT)

    def test_ground_truth(self, folder: Path, scene: Scene) -> None:
        truth = self.open(folder).groundtruth
        assert truth is not None
        np.testing.assert_array_equal(truth.stamps_ns, self.expected_stamps(scene))
        np.testing.assert_allclose(truth.poses, scene.poses, atol=1e-8)

    def test_iterating_equals_reading(self, folder: Path) -> None:
        sequence = self.open(folder)
        for start, stop in ((0, None), (2, 5), (COUNT, None)):
            frames = list(sequence.frames(start, stop, ahead=2))
            assert [frame.index for frame in frames] == list(range(COUNT))[start:stop]
            for frame in frames:
                np.testing.assert_array_equal(frame.image, sequence.read(frame.index).image)

    def test_reads_ahead_in_another_thread_and_no_farther(self, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        sequence, read = self.open(folder), self.note_reading(monkeypatch)
        frames = sequence.frames(ahead=2)
        next(frames)
        frames.close()  # waits for the frame being decoded, drops the rest
        assert [path for path, _ in read] == list(sequence.left[: len(read)]) and 1 <= len(read) <= 3
        assert not any(in_main for _, in_main in read)
        assert not [thread for thread in threading.enumerate() if thread.name.startswith("decode")]

    def test_second_images_are_read_when_asked_for_once(self, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        sequence, read = self.open(folder), self.note_reading(monkeypatch)
        second = sequence.right or sequence.depth
        watch = Stopwatch()
        frames = list(sequence.frames(0, 4, watch=watch))
        assert [path for path, _ in read] == list(sequence.left[:4])
        for _ in range(2):
            for frame in (frames[1], frames[3]):
                frame.prepare()
                expected = sequence.read(frame.index)
                for mine, theirs in ((frame.right, expected.right), (frame.depth_m, expected.depth_m)):
                    assert (mine is None) == (theirs is None)
                    if mine is not None:
                        np.testing.assert_array_equal(mine, theirs)
                assert frame.problem == ""
        assert watch.times[TimedStage.DECODE].count == 4 + (2 if second else 0)
        # The reader's thread is free to work on what is asked for while the frames still come.
        del read[:]
        for frame in sequence.frames(0, 2):
            frame.prepare()
            assert (frame.right is None and frame.depth_m is None) == (not second)
        assert not any(in_main for _, in_main in read)

    def test_a_damaged_second_image_is_none_and_says_why(self, folder: Path) -> None:
        sequence = self.open(folder)
        second = sequence.right or sequence.depth
        if not second:
            pytest.skip("mono has no second images")
        truncate(second[2])
        with pytest.raises(FrontendError, match="cut off"):
            sequence.read(2)
        frames = list(sequence.frames(1, 4))
        assert len(frames) == 3
        for frame in frames:
            assert frame.problem == ""
            damaged = frame.index == 2
            assert (frame.right is None and frame.depth_m is None) == damaged
            assert frame.problem.startswith(f"{second[2]}: ") == damaged

    def note_reading(self, monkeypatch: pytest.MonkeyPatch) -> list[tuple[Path, bool]]:
        """Each image file read from now on, and whether the main thread did it."""
        read: list[tuple[Path, bool]] = []

        def noted(original: Callable) -> Callable:
            def reading(path: Path, *more: float) -> np.ndarray:
                read.append((path, threading.current_thread() is threading.main_thread()))
                return original(path, *more)

            return reading

        monkeypatch.setattr(base, "read_grey", noted(base.read_grey))
        monkeypatch.setattr(base, "read_depth", noted(base.read_depth))
        return read

    def test_every_rig_it_allows_and_no_other(self, folder: Path) -> None:
        for rig in RigKind:
            if rig in self.rigs:
                frame = self.open(folder, rig).read(1)
                assert self.open(folder, rig).rig.kind is rig
                assert (frame.right is None, frame.depth_m is None) == (
                    rig is not RigKind.STEREO,
                    rig is not RigKind.RGBD,
                )
            else:
                with pytest.raises(
                    FrontendError, match=f"cannot be read as {rig}; its files allow {', '.join(self.rigs)}"
                ):
                    open_dataset(folder, rig)

    def test_goes_to_another_process(self, folder: Path) -> None:
        sequence = pickle.loads(pickle.dumps(self.open(folder)))  # noqa: S301 (our own bytes)
        assert sequence.read(0).image.shape == (HEIGHT, WIDTH)

    @pytest.mark.parametrize(("damage", "message"), [(truncate, "cut off"), (resize, f"has {WIDTH}x{HEIGHT}")])
    def test_a_damaged_image_is_an_error_at_its_frame(self, folder: Path, damage, message: str) -> None:
        bad = self.left_image(folder, 3)
        damage(bad)
        frames = self.open(folder).frames(ahead=4)
        assert [next(frames).index for _ in range(3)] == [0, 1, 2]
        with pytest.raises(FrontendError, match=message) as error:
            next(frames)
        assert str(error.value).startswith(str(bad))

    def test_a_damaged_first_image_spoils_no_other(self, folder: Path, scene: Scene) -> None:
        truncate(self.left_image(folder, 0))
        sequence = self.open(folder)
        with pytest.raises(FrontendError, match="cut off"):
            sequence.read(0)
        np.testing.assert_allclose(sequence.read(1).image.astype(int), scene.images[1], atol=1)

    def test_a_missing_partner_is_an_error_before_anything_is_read(self, folder: Path) -> None:
        if self.rigs[0] is RigKind.MONO:
            pytest.skip("mono has no partner images")
        sequence = self.open(folder)
        partner = (sequence.right or sequence.depth)[2]
        partner.unlink()
        with pytest.raises(FrontendError, match=r"image is missing") as error:
            open_dataset(folder)
        assert str(error.value).startswith(str(partner))
        lenient = open_dataset(folder, strict=False).sequences[0]
        assert [p.severity for p in lenient.problems] == [Severity.ERROR]
        assert len(self.open(folder, RigKind.MONO)) == COUNT


class TestKitti(Contract):
    kind, rigs, left = "kitti", (RigKind.STEREO, RigKind.MONO), "image_0/*.png"

    def write(self, folder: Path, scene: Scene) -> None:
        write_kitti(folder, scene)

    def expected_stamps(self, scene: Scene) -> np.ndarray:
        return scene.stamps_ns - scene.stamps_ns[0]


class TestKittiColourWithoutLabels(TestKitti):
    left = "image_2/*.png"

    def write(self, folder: Path, scene: Scene) -> None:
        write_kitti(folder, scene, labels=False, colour=True)


class TestEuroc(Contract):
    kind, rigs, left = "euroc", (RigKind.STEREO, RigKind.MONO), "mav0/cam0/data/*.png"

    def write(self, folder: Path, scene: Scene) -> None:
        write_euroc(folder, scene)


class TestSevenScenes(Contract):
    kind, rigs, left = "7scenes", (RigKind.RGBD, RigKind.MONO), "*.color.png"

    def write(self, folder: Path, scene: Scene) -> None:
        write_seven_scenes(folder, scene)

    def expected_stamps(self, scene: Scene) -> np.ndarray:
        return np.arange(COUNT) * 10**9 // 30

    @pytest.fixture
    def scene(self) -> Scene:
        """A wall that faces the camera, nearer each time, with a corner that the depth camera does not know."""
        depth_mm = np.broadcast_to((2000 - 150 * np.arange(COUNT))[:, None, None], (COUNT, HEIGHT, WIDTH)).copy()
        depth_mm[:, :24, :24] = 0
        return replace(make_scene(), depth_mm=depth_mm.astype(np.uint16))

    def expected_depth_m(self, scene: Scene, i: int) -> np.ndarray:
        """Backwards: the pixel in which the depth camera sees each point of the wall that the colour camera sees."""
        z = scene.depth_mm[i].max() / 1000.0
        column = DEPTH_FOCAL_PX * ((np.arange(WIDTH) - CX) / FX + COLOUR_RIGHT_OF_DEPTH_M / z) + WIDTH / 2
        row = DEPTH_FOCAL_PX * (np.arange(HEIGHT) - CY) / FY + HEIGHT / 2
        rows, columns = np.rint(row).astype(int)[:, None], np.rint(column).astype(int)[None]
        inside = (rows >= 0) & (rows < HEIGHT) & (columns >= 0) & (columns < WIDTH)
        return np.where(inside, scene.depth_mm[i][rows % HEIGHT, columns % WIDTH] / 1000.0, 0.0)

    def test_ground_truth_is_the_colour_cameras_as_any_rig(self, folder: Path, scene: Scene) -> None:
        truth = self.open(folder, RigKind.MONO).groundtruth
        assert truth is not None
        np.testing.assert_allclose(truth.poses, scene.poses, atol=1e-8)


class TestTum(Contract):
    kind, rigs, left = "tum", (RigKind.RGBD, RigKind.MONO), "rgb/*.png"

    def write(self, folder: Path, scene: Scene) -> None:
        write_tum(folder, scene)


class TestRenderedStereo(Contract):
    kind, rigs, left = "images", (RigKind.STEREO, RigKind.MONO), "image_0/*.png"

    def write(self, folder: Path, scene: Scene) -> None:
        write_rendered(folder, scene, "stereo")


class TestRenderedDepth(Contract):
    kind, rigs, left = "images", (RigKind.RGBD, RigKind.MONO), "image_0/*.png"

    def write(self, folder: Path, scene: Scene) -> None:
        write_rendered(folder, scene, "rgbd")


class TestPlainFolder(Contract):
    kind, rigs, left = "images", (RigKind.MONO,), "*.png"

    def write(self, folder: Path, scene: Scene) -> None:
        write_images(folder, [f"{stamp}.png" for stamp in scene.stamps_ns], scene.images)
        (folder / "camera.yaml").write_text(own_camera())
        lines = [" ".join(map(repr, pose[:3].ravel().tolist())) for pose in scene.poses]
        (folder / "poses.txt").write_text("\n".join(lines))
