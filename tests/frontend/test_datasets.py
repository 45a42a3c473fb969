"""One contract for every kind of data set, on data made here with known content; then what is particular to each kind."""

from __future__ import annotations

import pickle
from pathlib import Path

import cv2
import numpy as np
import pytest
from dataset_makers import (
    BASELINE_M,
    COUNT,
    CX,
    CY,
    FX,
    FY,
    HEIGHT,
    WIDTH,
    Scene,
    make_scene,
    own_camera,
    seconds,
    write_euroc,
    write_images,
    write_kitti,
    write_rendered,
    write_seven_scenes,
    write_tum,
)

from frontend.cameras import RigKind
from frontend.datasets import Dataset, ImageSequence, Severity, open_dataset
from frontend.errors import FrontendError


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
                np.testing.assert_allclose(frame.depth_m, scene.depth_mm[i] / 1000.0, atol=1e-6)
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

    def test_every_rig_it_allows_and_no_other(self, folder: Path) -> None:
        for rig in RigKind:
            if rig in self.rigs:
                frame = self.open(folder, rig).read(1)
                assert self.open(folder, rig).rig.kind is rig
                assert (frame.right is None, frame.depth_m is None) == (rig is not RigKind.STEREO, rig is not RigKind.RGBD)
            else:
                with pytest.raises(FrontendError, match=f"cannot be read as {rig}; its files allow {', '.join(self.rigs)}"):
                    open_dataset(folder, rig)

    def test_goes_to_another_process(self, folder: Path) -> None:
        sequence = pickle.loads(pickle.dumps(self.open(folder)))  # noqa: S301
        assert sequence.read(0).image.shape == (HEIGHT, WIDTH)

    @pytest.mark.parametrize(("damage", "message"), [(truncate, "cut off"), (resize, f"has {WIDTH}x{HEIGHT}")])
    def test_a_damaged_image_is_an_error_at_its_frame(self, folder: Path, damage, message: str) -> None:  # noqa: ANN001
        bad = self.left_image(folder, 3)
        damage(bad)
        frames = self.open(folder).frames(ahead=4)
        assert [next(frames).index for _ in range(3)] == [0, 1, 2]
        with pytest.raises(FrontendError, match=message) as error:
            next(frames)
        assert str(error.value).startswith(str(bad))

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


# ---- several agents


def test_agents_of_any_kind_in_order_of_their_numbers(tmp_path: Path) -> None:
    scene = make_scene()
    write_kitti(tmp_path / "agent_10", scene)
    write_rendered(tmp_path / "agent_2", scene, "rgbd")
    (tmp_path / "world.json").write_text("{}")
    dataset = open_dataset(tmp_path)
    assert [(s.name, s.kind, s.rig.kind) for s in dataset.sequences] == [("agent_2", "images", "rgbd"), ("agent_10", "kitti", "stereo")]
    assert dataset.kind == "agents (images, kitti)"
    assert {s.rig.kind for s in open_dataset(tmp_path, RigKind.MONO).sequences} == {RigKind.MONO}


def test_a_broken_agent_is_named(tmp_path: Path) -> None:
    write_kitti(tmp_path / "agent_0", make_scene())
    (tmp_path / "agent_1").mkdir()
    with pytest.raises(FrontendError, match="agent_1: no images of a known layout"):
        open_dataset(tmp_path)


# ---- folders that are no data set


@pytest.mark.parametrize(
    ("files", "message"),
    [
        ([], "no images of a known layout here"),
        (["readme.txt"], "no images of a known layout here"),
        (["a/calib.txt", "a/image_0/x.png", "b/calib.txt", "b/image_0/x.png"], "holds several sequences \\(a, b\\); name one of them"),
        (["0.png"], "no calibration file; put a camera.yaml"),
        (["calib.txt", "image_0/readme.txt"], "no images in image_0 or image_2"),
        (["0.png", "one.yaml", "two.yaml"], "which of one.yaml, two.yaml is the camera"),
    ],
)
def test_folders_without_a_usable_data_set(tmp_path: Path, files: list[str], message: str) -> None:
    for name in files:
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text("")
    with pytest.raises(FrontendError, match=message):
        open_dataset(tmp_path)


def test_no_such_folder(tmp_path: Path) -> None:
    with pytest.raises(FrontendError, match="no such folder"):
        open_dataset(tmp_path / "nowhere")
    (tmp_path / "file").write_text("")
    with pytest.raises(FrontendError, match="not a folder"):
        open_dataset(tmp_path / "file")


# ---- numbers that cannot be right


@pytest.mark.parametrize(
    ("file", "old", "new", "message"),
    [
        ("times.txt", "0.150000000", "0.020000000", r"times.txt: time goes back at frame 3 \(000003.png\): 0.100000000 s, then 0.020000000 s"),
        ("times.txt", "0.150000000", "0.100000000", r"times.txt: time stands still at frame 3"),
        ("times.txt", "0.150000000", "nan", r"times.txt:4: not a time in seconds: 'nan'"),
        ("times.txt", "0.150000000\n", "", r"times.txt: 5 times for 6 images"),
        ("calib.txt", f"P0: {FX}", "P0: nan", r"calib.txt:1: a projection matrix has 12 finite numbers"),
        ("calib.txt", f"P0: {FX} 0", "P0: 0", r"calib.txt:1: a projection matrix has 12 finite numbers, found 11"),
        ("calib.txt", f"P0: {FX}", "P0: 0", r"calib.txt:1: focal lengths 0.0, 80.0 px cannot be"),
        ("calib.txt", f" {CX} ", " 470.5 ", r"the principal point \(470.5, 31.5\) px lies outside the image of 96x64"),
        ("calib.txt", "-20.0", "20.0", r"baseline is -0.25 m: the right camera stands left of the left one"),
        ("calib.txt", "-20.0", "-20000.0", r"baseline is 250 m, outside 0.001 to 10 m: another unit"),
        ("calib.txt", "-20.0", "-0.02", r"baseline is 0.00025 m"),
        ("calib.txt", "-20.0", "0.0", r"baseline is -0.0 m"),
        ("poses.txt", "1.500000000000e+00", "inf", r"poses.txt:2: NaN or infinity"),
        ("poses.txt", "1.500000000000e+00\n", "\n", r"poses.txt:2: a KITTI pose \(13 with a time\) has 12 numbers, found 11"),
    ],
)
def test_kitti_numbers(tmp_path: Path, file: str, old: str, new: str, message: str) -> None:
    write_kitti(tmp_path, make_scene())
    text = (tmp_path / file).read_text()
    assert old in text
    (tmp_path / file).write_text(text.replace(old, new))
    with pytest.raises(FrontendError, match=message):
        open_dataset(tmp_path)


@pytest.mark.parametrize(("factor", "rate"), [(1e-3, "2e\\+04"), (1e3, "0.02")])
def test_times_in_another_unit(tmp_path: Path, factor: float, rate: str) -> None:
    write_kitti(tmp_path, make_scene())
    if factor > 1:
        factor *= 10
        rate = "0.002"
    (tmp_path / "times.txt").write_text("".join(f"{i * 0.05 * factor:.9f}\n" for i in range(COUNT)))
    with pytest.raises(FrontendError, match=rf"times.txt: {rate} images a second .* another unit"):
        open_dataset(tmp_path)


def test_warnings_do_not_stop(tmp_path: Path) -> None:
    write_kitti(tmp_path, make_scene())
    calib = tmp_path / "calib.txt"
    calib.write_text(calib.read_text().replace(f" {CX} ", " 90.0 ").replace(f" {FY} {CY} ", f" 100.0 {CY} "))
    (tmp_path / "times.txt").write_text("".join(f"{t}\n" for t in (0, 0.05, 0.1, 2.1, 2.15, 2.2)))
    [sequence] = open_dataset(tmp_path, RigKind.MONO).sequences
    messages = [problem.message for problem in sequence.problems]
    assert all(problem.severity is Severity.WARNING for problem in sequence.problems) and len(messages) == 3
    assert any("a gap of 2.000 s after 000002.png" in m for m in messages)
    assert any("fx 80.00 px and fy 100.00 px differ by 25 %" in m for m in messages)
    assert any("principal point (90.0, 31.5) px is far from the centre" in m for m in messages)


def test_a_calibration_for_another_size(tmp_path: Path) -> None:
    write_rendered(tmp_path, make_scene(), "stereo")
    camera = tmp_path / "camera.yaml"
    camera.write_text(camera.read_text().replace(f"width: {WIDTH}", "width: 640"))
    with pytest.raises(FrontendError, match=rf"camera.yaml: a calibration for 640x{HEIGHT} pixels, but .*000000.png has {WIDTH}x{HEIGHT}"):
        open_dataset(tmp_path)


# ---- particular to one kind


def test_kitti_poses_in_their_published_place_and_moved_to_a_colour_camera(tmp_path: Path) -> None:
    scene = make_scene()
    folder = tmp_path / "sequences" / "07"
    write_kitti(folder, scene, colour=True)
    (tmp_path / "poses").mkdir()
    (folder / "poses.txt").rename(tmp_path / "poses" / "07.txt")
    calib = folder / "calib.txt"
    # Camera 2 stands 6 cm left of camera 0: P2 = K [I | (0.06, 0, 0)].
    calib.write_text(calib.read_text().replace(f"P2: {FX} 0 {CX} -0.0", f"P2: {FX} 0 {CX} {FX * 0.06}"))
    truth = open_dataset(folder).sequences[0].groundtruth
    assert truth is not None
    expected = [pose[:3, 3] + pose[:3, :3] @ [-0.06, 0, 0] for pose in scene.poses]
    np.testing.assert_allclose(truth.centres, expected, atol=1e-9)


def test_kitti_cut_out_images_keep_their_rows(tmp_path: Path) -> None:
    scene = make_scene()
    write_kitti(tmp_path, scene)
    for side in ("image_0", "image_1"):
        for i in (0, 1, 4):
            (tmp_path / side / f"{i:06d}.png").unlink()
    [sequence] = open_dataset(tmp_path).sequences
    np.testing.assert_array_equal(sequence.stamps_ns, np.array([2, 3, 5]) * 50_000_000)
    assert sequence.groundtruth is not None
    np.testing.assert_allclose(sequence.groundtruth.poses, scene.poses[[2, 3, 5]], atol=1e-9)
    assert [problem.severity for problem in sequence.problems] == [Severity.WARNING]


def test_names_are_sorted_as_numbers(tmp_path: Path) -> None:
    names = ["frame2.png", "frame10.png", "frame1.png"]
    images = np.stack([np.full((HEIGHT, WIDTH), value, np.uint8) for value in (2, 10, 1)])
    write_images(tmp_path, names, images)
    (tmp_path / "my_camera.yaml").write_text(own_camera("rate_hz: 4\n"))
    [sequence] = open_dataset(tmp_path).sequences
    assert [int(frame.image[0, 0]) for frame in sequence.frames()] == [1, 2, 10]
    np.testing.assert_array_equal(sequence.stamps_ns, [0, 250_000_000, 500_000_000])
    assert sequence.problems == ()


@pytest.mark.parametrize(("name", "stamp_ns"), [("1403715274.25", 1403715274250000000), ("1403715274250", 1403715274250000000), ("1403715274250000", 1403715274250000000)])
def test_times_in_file_names(tmp_path: Path, name: str, stamp_ns: int) -> None:
    write_images(tmp_path, [f"{name}.png"], make_scene().images[:1])
    (tmp_path / "camera.yaml").write_text(own_camera())
    assert open_dataset(tmp_path).sequences[0].stamps_ns.tolist() == [stamp_ns]


def test_a_folder_without_any_time_is_read_with_a_warning(tmp_path: Path) -> None:
    write_images(tmp_path, ["a.png", "b.png"], make_scene().images[:2])
    (tmp_path / "camera.yaml").write_text(own_camera())
    [sequence] = open_dataset(tmp_path).sequences
    assert sequence.stamps_ns.tolist() == [0, 100_000_000] and "10 Hz taken" in sequence.problems[0].message


def test_euroc_leaves_out_frames_that_one_camera_dropped(tmp_path: Path) -> None:
    scene = make_scene()
    write_euroc(tmp_path, scene)
    table = tmp_path / "mav0/cam1/data.csv"
    table.write_text("".join(line for i, line in enumerate(table.read_text().splitlines(keepends=True)) if i != 3))
    [sequence] = open_dataset(tmp_path / "mav0").sequences
    np.testing.assert_array_equal(sequence.stamps_ns, np.delete(scene.stamps_ns, 2))
    assert "no right image for 1 of 6 frames" in sequence.problems[0].message
    np.testing.assert_allclose(sequence.read(2).right, scene.rights[3], atol=1)


def test_tum_pairs_by_time(tmp_path: Path) -> None:
    scene = make_scene()
    write_tum(tmp_path, scene)
    table = tmp_path / "depth.txt"
    gone = seconds(int(scene.stamps_ns[2]) + 7_000_000)
    table.write_text("".join(line for line in table.read_text().splitlines(keepends=True) if not line.startswith(gone)))
    [sequence] = open_dataset(tmp_path).sequences
    np.testing.assert_array_equal(sequence.stamps_ns, np.delete(scene.stamps_ns, 2))
    np.testing.assert_allclose(sequence.read(2).depth_m, scene.depth_mm[3] / 1000.0, atol=1e-6)
    assert "no depth image for 1 of 6 frames" in sequence.problems[0].message


def test_tum_camera_by_the_name_of_the_recording(tmp_path: Path) -> None:
    scene = make_scene()
    folder = tmp_path / "rgbd_dataset_freiburg3_office"
    write_tum(folder, scene)
    (folder / "camera.yaml").unlink()
    with pytest.raises(FrontendError, match=f"a calibration for 640x480 pixels, but .* has {WIDTH}x{HEIGHT}"):
        open_dataset(folder)


def test_seven_scenes_without_a_camera_file_takes_the_colour_cameras_focal_length(tmp_path: Path) -> None:
    write_seven_scenes(tmp_path, make_scene())
    (tmp_path / "camera.txt").unlink()
    [sequence] = open_dataset(tmp_path).sequences
    assert sequence.rig.camera.fx == pytest.approx(525.0 * WIDTH / 640)
    assert sequence.problems[0].severity is Severity.WARNING


def test_jpegs_that_stop_early(tmp_path: Path) -> None:
    image = np.random.default_rng(0).integers(0, 255, (HEIGHT, WIDTH), dtype=np.uint8)
    write_images(tmp_path, ["0.jpg", "1.jpg", "2.jpg"], np.stack([image] * 3))
    (tmp_path / "camera.yaml").write_text(own_camera("rate_hz: 1\n"))
    whole = (tmp_path / "1.jpg").read_bytes()
    (tmp_path / "1.jpg").write_bytes(whole[:-2])
    (tmp_path / "2.jpg").write_bytes(b"")
    [sequence] = open_dataset(tmp_path).sequences
    assert sequence.read(0).image.shape == (HEIGHT, WIDTH)
    with pytest.raises(FrontendError, match="cut off"):
        sequence.read(1)
    with pytest.raises(FrontendError, match="empty"):
        sequence.read(2)


def test_depth_of_the_wrong_type(tmp_path: Path) -> None:
    scene = make_scene()
    write_seven_scenes(tmp_path, scene)
    write_images(tmp_path, ["frame-000001.depth.png"], scene.images[:1])
    with pytest.raises(FrontendError, match=r"frame-000001.depth.png: a depth image has one channel of 16 bits, found 1 of 8"):
        open_dataset(tmp_path).sequences[0].read(1)
