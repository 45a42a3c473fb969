"""Films: every frame, its time and its way up, against what was written; and what is said of damaged ones."""

from __future__ import annotations

import multiprocessing
import pickle
import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest
from contracts import ReaderContract
from numpy.typing import NDArray
from recording_makers import retime_film, turn_film, write_film

import maslam
from maslam.frontend.cameras.models import RigKind
from maslam.frontend.datasets import ImageSequence, open_dataset
from maslam.frontend.datasets.recordings.film import Film, FilmFrame, index_film
from maslam.frontend.datasets.recordings.films import FilmReader
from maslam.frontend.datasets.stored_image import name_in
from maslam.frontend.errors import FrontendError
from maslam.frontend.recording_config import RecordingConfig

ROOT = Path(__file__).resolve().parents[2]
COUNT, WIDTH, HEIGHT = 40, 96, 64
CAMERA = f"width: {WIDTH}\nheight: {HEIGHT}\nfx: 80\nfy: 80\ncx: 47.5\ncy: 31.5\n"
NEAR = 6.0
"""Mean difference in grey levels up to which a decoded frame is the one that was written: neighbours differ by 30."""


def scene(count: int = COUNT, width: int = WIDTH, height: int = HEIGHT) -> NDArray[np.uint8]:
    """Smooth images that differ from each other, ``(count, height, width)``."""
    rng = np.random.default_rng(3)
    noise = rng.uniform(0, 255, (count, height // 8, width // 8)).astype(np.float32)
    return (
        np.stack([cv2.resize(n, (width, height), interpolation=cv2.INTER_CUBIC) for n in noise])
        .clip(0, 255)
        .astype(np.uint8)
    )


def difference(a: NDArray[np.uint8], b: NDArray[np.uint8]) -> float:
    return float(np.abs(a.astype(float) - b).mean()) if a.shape == b.shape else np.inf


def messages(sequence: ImageSequence) -> str:
    return "\n".join(problem.message for problem in sequence.problems)


@pytest.fixture(scope="module")
def images() -> NDArray[np.uint8]:
    return scene()


@pytest.fixture
def folder(tmp_path: Path, images: NDArray[np.uint8]) -> Path:
    """A film beside a camera file."""
    folder = tmp_path / "ride"
    folder.mkdir()
    write_film(folder / "drive.mp4", images, 25.0)
    (folder / "camera.yaml").write_text(CAMERA)
    return folder


class TestFilmReader(ReaderContract):
    def make(self) -> maslam.Reader:
        return FilmReader()

    def write(self, folder: Path) -> None:
        write_film(folder / "drive.avi", scene(6), 20.0, "MJPG")
        (folder / "camera.yaml").write_text(CAMERA)


@pytest.mark.parametrize(
    ("name", "codec"), [("a.mp4", "mp4v"), ("a.mov", "mp4v"), ("a.avi", "MJPG"), ("a.mkv", "mp4v"), ("A.AVI", "XVID")]
)
def test_every_frame_is_the_one_that_was_written(
    tmp_path: Path, images: NDArray[np.uint8], name: str, codec: str
) -> None:
    write_film(tmp_path / name, images, 25.0, codec)
    (tmp_path / "camera.yaml").write_text(CAMERA)
    sequence = open_dataset(tmp_path / name).sequences[0]
    assert sequence.name == Path(name).stem and len(sequence) == COUNT
    for i, frame in enumerate(sequence.frames()):
        assert difference(frame.image, images[i]) < NEAR, i
    assert np.abs(sequence.stamps_ns - np.arange(COUNT) * 40_000_000).max() <= 1_000_000  # mkv has milliseconds


def test_frames_in_any_order_are_those_in_order(folder: Path) -> None:
    path = folder / "drive.mp4"
    film = Film(path, index_film(path), True)
    in_order = [film.read(k).copy() for k in range(COUNT)]
    others = [30, 5, 4, 39, 0, 12, 13, 11, 38, 1, 24, 23, 25]
    for k in others:
        again = Film(path, index_film(path), True)
        np.testing.assert_array_equal(film.read(k), in_order[k])
        np.testing.assert_array_equal(again.read(k), in_order[k])


def read_in_another(sequence: ImageSequence, queue: multiprocessing.queues.Queue) -> None:  # type: ignore[type-arg]
    queue.put(sequence.read_image(20))


def test_two_processes_read_one_film(folder: Path) -> None:
    sequence = open_dataset(folder).sequences[0]
    first = sequence.read_image(19).copy()
    context = multiprocessing.get_context("spawn")
    queue = context.Queue()
    process = context.Process(target=read_in_another, args=(sequence, queue))
    process.start()
    other = queue.get(timeout=120)
    process.join()
    np.testing.assert_array_equal(sequence.read_image(20), other)
    np.testing.assert_array_equal(sequence.read_image(19), first)


def test_a_film_goes_to_another_process_once_and_without_its_decoder(folder: Path) -> None:
    sequence = open_dataset(folder).sequences[0]
    sequence.read(3)
    copy = pickle.loads(pickle.dumps(sequence))  # noqa: S301 - our own
    assert len({id(frame.film) for frame in copy.left}) == 1
    np.testing.assert_array_equal(copy.read(9).image, sequence.read(9).image)


def test_colour_is_kept(tmp_path: Path, images: NDArray[np.uint8]) -> None:
    red = np.zeros((HEIGHT, WIDTH, 3), dtype=np.uint8)
    red[:, :, 2] = 200
    write_film(tmp_path / "red.avi", [red, red], 10.0, "MJPG")
    (tmp_path / "red.yaml").write_text(CAMERA)
    middle = open_dataset(tmp_path / "red.avi").sequences[0].read_colour(1)[30, 40].astype(int)
    assert middle[2] > 180 and middle[:2].max() < 30


class TestTimes:
    def test_a_variable_rate_has_its_own_times(self, folder: Path, images: NDArray[np.uint8]) -> None:
        durations = [1 + (i % 3 == 2) for i in range(COUNT)]  # of 40 ms each
        retime_film(folder / "drive.mp4", durations)
        sequence = open_dataset(folder).sequences[0]
        expected = 40_000_000 * np.r_[0, np.cumsum(durations[:-1])]
        np.testing.assert_allclose(sequence.stamps_ns, expected, atol=1000)
        assert "variable rate (12.50 to 25.00 Hz)" in sequence.origin
        assert all(difference(frame.image, images[i]) < NEAR for i, frame in enumerate(sequence.frames()))

    @pytest.mark.parametrize(
        ("changes", "frames"),
        [
            ({"start_s": 0.4}, range(10, 40)),
            ({"end_s": 0.4}, range(11)),
            ({"start_s": 0.4, "end_s": 0.8, "stride": 4}, (10, 14, 18)),
            ({"stride": 13}, (0, 13, 26, 39)),
            ({"rate_hz": 5.0}, range(0, 40, 5)),
            ({"rate_hz": 100.0}, range(40)),
        ],
    )
    def test_a_part_is_read(
        self, folder: Path, images: NDArray[np.uint8], changes: dict[str, float], frames: range
    ) -> None:
        sequence = open_dataset(folder, recording=RecordingConfig(**changes)).sequences[0]
        assert (sequence.stamps_ns // 40_000_000).tolist() == list(frames)
        assert all(difference(sequence.read_image(i), images[k]) < NEAR for i, k in enumerate(frames))
        assert name_in(sequence.left[0], folder) == f"drive.mp4/{frames[0]:06d}"  # of the film, not of the part

    def test_a_part_that_is_not_there_is_refused(self, folder: Path) -> None:
        with pytest.raises(FrontendError, match=r"no image between 100 and inf s: there are 1.560 s"):
            open_dataset(folder, recording=RecordingConfig(start_s=100.0))

    def test_another_rate_in_the_camera_file_is_said(self, folder: Path) -> None:
        (folder / "camera.yaml").write_text(CAMERA + "rate_hz: 30\n")
        assert "rate_hz 30, but drive.mp4 has 25.000 frames per second" in messages(open_dataset(folder).sequences[0])


class TestTurned:
    """Players turn clockwise by the flag: what was written upright lies on its side."""

    @pytest.fixture
    def phone(self, tmp_path: Path, images: NDArray[np.uint8]) -> Path:
        path = tmp_path / "phone.mp4"
        write_film(path, images, 25.0)
        turn_film(path, 90)
        return path

    def test_it_is_read_as_players_show_it(self, phone: Path, images: NDArray[np.uint8]) -> None:
        camera = f"width: {HEIGHT}\nheight: {WIDTH}\nfx: 80\nfy: 80\ncx: 31.5\ncy: 47.5\n"
        phone.with_name("camera.yaml").write_text(camera)
        sequence = open_dataset(phone).sequences[0]
        upright = cv2.rotate(images[7], cv2.ROTATE_90_CLOCKWISE)
        assert difference(sequence.read_image(7), upright) < NEAR
        assert "turn the film by 90 degrees: it is turned, as players do: 64x96 pixels" in messages(sequence)

    def test_a_calibration_of_images_as_stored_says_otherwise(self, phone: Path, images: NDArray[np.uint8]) -> None:
        phone.with_name("camera.yaml").write_text(CAMERA)
        sequence = open_dataset(phone).sequences[0]
        assert difference(sequence.read_image(7), images[7]) < NEAR
        assert "it is not turned, as the calibration is for 96x64: 96x64 pixels" in messages(sequence)

    def test_upside_down(self, tmp_path: Path, images: NDArray[np.uint8]) -> None:
        path = tmp_path / "phone.mp4"
        write_film(path, images, 25.0)
        turn_film(path, 180)
        path.with_name("camera.yaml").write_text(CAMERA)
        sequence = open_dataset(path).sequences[0]
        assert difference(sequence.read_image(7), images[7][::-1, ::-1]) < NEAR
        assert "by 180 degrees: it is turned" in messages(sequence)


class TestSeveral:
    def test_left_and_right_are_a_pair(self, tmp_path: Path, images: NDArray[np.uint8]) -> None:
        write_film(tmp_path / "left.avi", images, 25.0, "MJPG")
        write_film(tmp_path / "right.avi", images[::-1], 25.0, "MJPG")
        (tmp_path / "camera.yaml").write_text(CAMERA + "baseline_m: 0.2\n")
        dataset = open_dataset(tmp_path)
        assert len(dataset.sequences) == 1 and dataset.sequences[0].rig.kind is RigKind.STEREO
        right = dataset.sequences[0].read(4).right
        assert right is not None and difference(right, images[COUNT - 5]) < NEAR

    @pytest.mark.parametrize("names", [("GX010012_L", "GX010012_R"), ("drive-right", "drive-left")])
    def test_names_that_differ_by_left_and_right_are_a_pair(
        self, tmp_path: Path, images: NDArray[np.uint8], names: tuple[str, str]
    ) -> None:
        left, right = names if names[0].endswith("L") else names[::-1]
        write_film(tmp_path / f"{left}.avi", images, 25.0, "MJPG")
        write_film(tmp_path / f"{right}.avi", images[::-1], 25.0, "MJPG")
        (tmp_path / "camera.yaml").write_text(CAMERA + "baseline_m: 0.2\n")
        [sequence] = open_dataset(tmp_path).sequences
        frame = sequence.read(4)
        assert frame.right is not None and difference(frame.right, images[COUNT - 5]) < NEAR
        assert difference(frame.image, images[4]) < NEAR

    def test_images_beside_a_film_that_are_not_read_are_said(self, tmp_path: Path, images: NDArray[np.uint8]) -> None:
        write_film(tmp_path / "drive.avi", images, 25.0, "MJPG")
        (tmp_path / "camera.yaml").write_text(CAMERA)
        (tmp_path / "images").mkdir()
        cv2.imwrite(str(tmp_path / "images" / "0.png"), images[0])
        [sequence] = open_dataset(tmp_path).sequences
        assert "images in images are not read, the film is" in messages(sequence)

    def test_others_are_robots(self, tmp_path: Path, images: NDArray[np.uint8]) -> None:
        write_film(tmp_path / "alice.mp4", images, 25.0)
        write_film(tmp_path / "bob.mp4", scene(12, 48, 32), 10.0)
        (tmp_path / "alice.yaml").write_text(CAMERA)
        (tmp_path / "bob.yaml").write_text("width: 48\nheight: 32\nfx: 40\nfy: 40\ncx: 23.5\ncy: 15.5\n")
        dataset = open_dataset(tmp_path)
        assert [(s.name, len(s), s.stored_size) for s in dataset.sequences] == [
            ("alice", 40, (96, 64)),
            ("bob", 12, (48, 32)),
        ]

    def test_one_for_each_agent_folder(self, tmp_path: Path, images: NDArray[np.uint8]) -> None:
        for agent in ("agent_00", "agent_01"):
            (tmp_path / agent).mkdir()
            write_film(tmp_path / agent / "drive.mp4", images, 25.0)
            (tmp_path / agent / "camera.yaml").write_text(CAMERA)
        dataset = open_dataset(tmp_path)
        assert (dataset.kind, [s.name for s in dataset.sequences]) == ("agents (film)", ["agent_00", "agent_01"])
        assert name_in(dataset.sequences[1].left[2], tmp_path) == "agent_01/drive.mp4/000002"


class TestDamage:
    def test_a_film_that_is_cut_off_is_read_as_far_as_it_goes(self, tmp_path: Path, images: NDArray[np.uint8]) -> None:
        path = tmp_path / "drive.avi"
        write_film(path, images, 25.0, "MJPG")
        whole = path.read_bytes()
        path.write_bytes(whole[: len(whole) * 6 // 10])
        (tmp_path / "camera.yaml").write_text(CAMERA)
        sequence = open_dataset(path).sequences[0]
        assert 20 <= len(sequence) < 26
        assert f"its header promises 40 frames, {len(sequence)} are read" in messages(sequence)
        assert all(difference(frame.image, images[i]) < NEAR for i, frame in enumerate(sequence.frames()))

    @pytest.mark.parametrize("content", [b"", b"no film at all" * 100])
    def test_what_is_no_film_is_said_in_one_line(self, tmp_path: Path, content: bytes) -> None:
        """In a process of its own: FFmpeg writes to the console itself."""
        (tmp_path / "drive.mp4").write_bytes(content)
        (tmp_path / "camera.yaml").write_text(CAMERA)
        command = [sys.executable, "-m", "maslam", "inspect", str(tmp_path)]
        done = subprocess.run(command, capture_output=True, text=True, cwd=ROOT)
        assert done.returncode == 1 and done.stdout == ""
        (line,) = done.stderr.splitlines()
        assert "drive.mp4: not a film that can be read: damaged, cut off before its index was written" in line

    def test_an_mp4_without_its_end_is_said(self, folder: Path) -> None:
        path = folder / "drive.mp4"
        path.write_bytes(path.read_bytes()[: path.stat().st_size * 6 // 10])
        with pytest.raises(FrontendError, match="cut off before its index was written"):
            open_dataset(folder)

    def test_a_film_that_changed_meanwhile_is_an_error_of_that_frame(self, folder: Path) -> None:
        sequence = open_dataset(folder).sequences[0]
        write_film(folder / "drive.mp4", scene(10), 25.0)
        assert sequence.read(3).image.shape == (HEIGHT, WIDTH)
        with pytest.raises(FrontendError, match=r"drive.mp4: frame 30 \(1.200 s\): cannot be decoded"):
            sequence.read(30)

    def test_of_a_film_without_calibration_the_focal_length_is_a_guess_that_is_said(self, folder: Path) -> None:
        (folder / "camera.yaml").unlink()
        sequence = open_dataset(folder).sequences[0]
        assert sequence.rig.camera.fx == pytest.approx(1.2 * WIDTH) and sequence.focal_guess
        (said,) = [p.message for p in sequence.problems if "calibration" in p.message]
        assert "drive.mp4: no calibration file" in said and "maslam calibrate" in said

    def test_a_film_holds_no_depth(self, folder: Path) -> None:
        path = folder / "drive.mp4"
        with pytest.raises(FrontendError, match="no depth can be read"):
            FilmFrame(Film(path, index_film(path), True), 0).read_depth(0.001)

    @pytest.mark.parametrize("name", ["a.heic", "notes.txt", "a.bag.active"])
    def test_a_file_of_an_unknown_kind_names_those_that_are_known(self, tmp_path: Path, name: str) -> None:
        (tmp_path / name).write_bytes(b"something")
        with pytest.raises(FrontendError, match=r"not a folder, and no recording of a known kind \(.*\.mp4"):
            open_dataset(tmp_path / name)
