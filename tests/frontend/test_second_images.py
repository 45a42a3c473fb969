"""Second images, right or depth, brought together with the first: by name, time or number; what is not used is said."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from dataset_makers import (
    BASELINE_M,
    COUNT,
    make_scene,
    numbered,
    own_camera,
    write_euroc,
    write_images,
    write_kitti,
    write_rendered,
    write_tum,
)

from maslam.frontend.cameras.models import RigKind
from maslam.frontend.datasets import ImageSequence, Severity, open_dataset
from maslam.frontend.datasets.pairing import pair_by_time
from maslam.frontend.errors import FrontendError

STEREO = f"rate_hz: 20.0\nbaseline_m: {BASELINE_M}\n"
LATE_NS = 1_234_000


def opened(folder: Path, rig: RigKind | None = None) -> ImageSequence:
    [sequence] = open_dataset(folder, rig).sequences
    return sequence


def said(sequence: ImageSequence) -> list[str]:
    assert all(problem.severity is Severity.WARNING for problem in sequence.problems)
    return [problem.message for problem in sequence.problems]


def write_pair(folder: Path, late_ns: int | np.ndarray = LATE_NS, lost: tuple[int, int] | None = (1, 3)) -> None:
    """``cam0`` and ``cam1`` with names in nanoseconds, one image lost on each side."""
    scene = make_scene()
    for side, images, stamps in (
        ("cam0", scene.images, scene.stamps_ns), ("cam1", scene.rights, scene.stamps_ns + late_ns)
    ):  # fmt: skip
        write_images(folder / side, [f"{stamp}.png" for stamp in stamps], images)
        if lost is not None:
            (folder / side / f"{stamps[lost[side == 'cam1']]}.png").unlink()
    (folder / "camera.yaml").write_text(own_camera(STEREO))


def test_names_that_differ_are_paired_by_time(tmp_path: Path) -> None:
    write_pair(tmp_path)
    sequence, scene = opened(tmp_path), make_scene()
    kept = [0, 2, 4, 5]
    np.testing.assert_array_equal(sequence.stamps_ns, scene.stamps_ns[kept])
    for i, k in enumerate(kept):
        np.testing.assert_array_equal(sequence.read(i).image, scene.images[k])
        np.testing.assert_array_equal(sequence.read(i).right, scene.rights[k])
    assert said(sequence) == [
        f"{tmp_path / 'cam1'}: no right image for 1 of 5 frames; no image for 1 of 5 right images; these are left out: "
        "4 pairs, 1.2 ms apart (median)"
    ]
    assert len(opened(tmp_path, RigKind.MONO)) == 5


def test_euroc_with_times_of_each_cameras_own(tmp_path: Path) -> None:
    scene = make_scene()
    write_euroc(tmp_path, scene)
    cam = tmp_path / "mav0/cam1"
    for row, stamp in enumerate(scene.stamps_ns):
        image = cam / "data" / f"{stamp}.png"
        image.rename(cam / "data" / f"{stamp + LATE_NS}.png") if row != 2 else image.unlink()
    (cam / "data.csv").unlink()
    sequence = opened(tmp_path)
    np.testing.assert_array_equal(sequence.stamps_ns, np.delete(scene.stamps_ns, 2))
    np.testing.assert_allclose(sequence.read(2).right, scene.rights[3], atol=1)
    assert len(said(sequence)) == 1 and "no right image for 1 of 6 frames" in said(sequence)[0]


def test_pairs_are_each_others_nearest_and_no_image_is_used_twice() -> None:
    """Irregular times, against a search of all."""
    rng = np.random.default_rng(4)
    for _ in range(20):
        first, second = (np.sort(rng.choice(1000, n, replace=False)).astype(np.int64) for n in (40, 60))
        pairs = pair_by_time(first, second, 9)
        apart = np.abs(first[:, None] - second[None])
        expected = [
            (i, j)
            for i in range(len(first))
            for j in range(len(second))
            if apart[i, j] <= 9 and apart[i, j] == apart[i].min() == apart[:, j].min()
        ]
        found = list(zip(pairs.kept.tolist(), pairs.second.tolist(), strict=True))
        assert set(found) <= set(expected) and len(set(pairs.second.tolist())) == len(found)
        clear = {
            (i, j) for i, j in expected if (apart[i] == apart[i, j]).sum() == (apart[:, j] == apart[i, j]).sum() == 1
        }
        assert clear <= set(found)


@pytest.mark.parametrize(("late_ms", "words"), [(12, "12.0 ms after"), (-20, "20.0 ms before")])
def test_pairs_that_are_not_of_one_moment_are_named(tmp_path: Path, late_ms: int, words: str) -> None:
    write_pair(tmp_path, late_ms * 10**6, None)
    [message] = said(opened(tmp_path))
    assert f"{tmp_path / 'cam1'}: not synchronised: a right image is taken {words} its image" in message


def test_clocks_that_drift_apart_are_named(tmp_path: Path) -> None:
    write_pair(tmp_path, np.linspace(0, 22e6, COUNT).astype(np.int64), None)
    [message] = said(opened(tmp_path))
    assert "not synchronised" in message and "at most 22.0 ms apart" in message


def test_right_images_on_another_clock_are_refused_with_both_spans(tmp_path: Path) -> None:
    write_pair(tmp_path, 10**12, None)
    with pytest.raises(FrontendError, match=r"cam1: no right image within 25 ms .* 1403716274.* 1403715274.*clock"):
        open_dataset(tmp_path)


def test_names_with_other_text_are_paired_by_number(tmp_path: Path) -> None:
    scene = make_scene()
    for side, images in (("left", scene.images), ("right", scene.rights)):
        write_images(tmp_path / side, [f"{side}_{i:04d}.png" for i in range(COUNT)], images)
    (tmp_path / "camera.yaml").write_text(own_camera(STEREO))
    sequence = opened(tmp_path)
    assert sequence.rig.kind is RigKind.STEREO and said(sequence) == []
    np.testing.assert_array_equal(sequence.read(4).right, scene.rights[4])
    (tmp_path / "right" / "right_0004.png").unlink()
    with pytest.raises(FrontendError, match=r"right image is missing"):
        open_dataset(tmp_path)


def test_names_with_nothing_in_common_are_refused(tmp_path: Path) -> None:
    scene = make_scene()
    write_images(tmp_path / "left", [f"{c}.png" for c in "abcdef"], scene.images)
    write_images(tmp_path / "right", [f"{c}.png" for c in "uvwxyz"], scene.rights)
    (tmp_path / "camera.yaml").write_text(own_camera(STEREO))
    with pytest.raises(FrontendError, match=r"right: which right image belongs to which image\? .* the same names"):
        open_dataset(tmp_path)


def test_right_images_without_a_left_one_are_counted(tmp_path: Path) -> None:
    write_rendered(tmp_path, make_scene(), "stereo")
    (tmp_path / "image_0" / "000005.png").unlink()
    for name in ("times.txt", "poses.txt"):
        (tmp_path / name).unlink()
    assert f"{tmp_path / 'image_1'}: 1 of 6 right images belong to no image; these are not used" in said(
        opened(tmp_path)
    )


def test_left_and_right_in_one_folder(tmp_path: Path) -> None:
    scene = make_scene()
    for side, images in (("left", scene.images), ("right", scene.rights)):
        write_images(tmp_path, [f"{side}{i:04d}.png" for i in range(COUNT)], images)
    (tmp_path / "camera.yaml").write_text(own_camera(STEREO))
    sequence = opened(tmp_path)
    assert len(sequence) == COUNT and said(sequence) == []
    np.testing.assert_array_equal(sequence.read(3).image, scene.images[3])
    np.testing.assert_array_equal(sequence.read(3).right, scene.rights[3])


@pytest.mark.parametrize("colour", ["frame", "rgb_", ""])
def test_depth_beside_colour_in_one_folder(tmp_path: Path, colour: str) -> None:
    scene = make_scene()
    write_images(tmp_path, [f"{colour}{i:06d}.jpg" for i in range(COUNT)], scene.images)
    write_images(tmp_path, [f"depth{i:06d}.png" for i in range(COUNT)], scene.depth_mm)
    (tmp_path / "camera.yaml").write_text(own_camera("rate_hz: 20.0\ndepth_unit_m: 0.001\n"))
    sequence = opened(tmp_path)
    assert sequence.rig.kind is RigKind.RGBD and len(sequence) == COUNT and said(sequence) == []
    np.testing.assert_allclose(sequence.read(2).depth_m, scene.depth_mm[2] / 1000.0, atol=1e-6)
    assert len(opened(tmp_path, RigKind.MONO)) == COUNT


def test_right_images_that_nobody_uses_are_named(tmp_path: Path) -> None:
    scene = make_scene()
    write_images(tmp_path / "images", numbered(), scene.images)
    write_images(tmp_path / "right", numbered(), scene.rights)
    (tmp_path / "camera.yaml").write_text(own_camera("rate_hz: 20.0\n"))
    [message] = said(opened(tmp_path))
    assert message.startswith(f"{tmp_path / 'right'}: right images that are not used")
    assert said(opened(tmp_path, RigKind.MONO)) == [], "one camera was asked for"


def test_kitti_and_euroc_right_images_without_calibration_are_named(tmp_path: Path) -> None:
    write_kitti(tmp_path / "k", make_scene())
    (tmp_path / "k" / "calib.txt").write_text((tmp_path / "k" / "calib.txt").read_text().splitlines()[0] + "\n")
    [message] = said(opened(tmp_path / "k"))
    assert "one camera, but image_1 has right images: not used" in message
    write_euroc(tmp_path / "e", make_scene())
    (tmp_path / "e/mav0/cam1/sensor.yaml").unlink()
    [message] = said(opened(tmp_path / "e"))
    assert "right images, but no sensor.yaml: not used" in message


def test_a_file_listed_twice_is_named(tmp_path: Path) -> None:
    write_tum(tmp_path, make_scene())
    rows = (tmp_path / "rgb.txt").read_text().splitlines()
    rows[-1] = f"{rows[-1].split()[0]} {rows[-2].split()[1]}"
    (tmp_path / "rgb.txt").write_text("\n".join(rows) + "\n")
    [message] = said(opened(tmp_path))
    assert "1 of 6 images are files that come a second time" in message


# ---- depth


def write_depth(folder: Path, suffix: str, depth_m: np.ndarray, camera: str = "") -> None:
    write_images(folder / "rgb", numbered(), make_scene().images)
    (folder / "depth").mkdir()
    for i, depth in enumerate(depth_m.astype(np.float32)):
        path = folder / "depth" / f"{i:06d}{suffix}"
        if suffix == ".npy":
            np.save(path, depth)
        else:
            assert cv2.imwrite(str(path), depth)
    (folder / "camera.yaml").write_text(own_camera(f"rate_hz: 20.0\n{camera}"))


@pytest.mark.parametrize("suffix", [".pfm", ".tiff", ".npy"])
def test_floating_point_depth_is_metres(tmp_path: Path, suffix: str) -> None:
    depth = make_scene().depth_mm / 1000.0
    depth[:, 0, 0], depth[:, 0, 1] = np.nan, np.inf
    write_depth(tmp_path, suffix, depth)
    sequence = opened(tmp_path)
    assert sequence.rig.kind is RigKind.RGBD and said(sequence) == []
    expected = np.where(np.isfinite(depth[3]), depth[3], 0.0)
    np.testing.assert_allclose(sequence.read(3).depth_m, expected, rtol=1e-6)


def test_a_unit_of_16_bits_beside_metres_is_told(tmp_path: Path) -> None:
    depth = make_scene().depth_mm / 1000.0
    write_depth(tmp_path, ".tiff", depth, "depth_unit_m: 0.001\n")
    sequence = opened(tmp_path)
    assert (
        len(said(sequence)) == 1
        and "floating-point numbers" in said(sequence)[0]
        and "metres taken" in said(sequence)[0]
    )
    np.testing.assert_allclose(sequence.read(3).depth_m, depth[3], rtol=1e-6)


def test_floating_point_millimetres_by_the_calibration(tmp_path: Path) -> None:
    depth_mm = make_scene().depth_mm
    write_depth(tmp_path, ".tiff", depth_mm, "depth_unit_m: 0.001\n")
    sequence = opened(tmp_path)
    assert said(sequence) == []
    np.testing.assert_allclose(sequence.read(3).depth_m, depth_mm[3] / 1000.0, rtol=1e-6)


def test_sixteen_bits_without_a_unit_say_what_each_would_be(tmp_path: Path) -> None:
    scene = make_scene()
    write_rendered(tmp_path, scene, "rgbd")
    camera = tmp_path / "camera.yaml"
    camera.write_text(camera.read_text().replace("depth_unit_m: 0.001\n", ""))
    [message] = said(opened(tmp_path))
    median = np.median(scene.depth_mm[0][scene.depth_mm[0] > 0])
    assert f"millimetres taken; half of the depths are then below {median / 1000:.3g} m" in message
    assert f"below {median / 5000:.3g} m in TUM's" in message


@pytest.mark.parametrize("suffix", [".npy", ".exr", ".pfm"])
def test_depth_files_that_are_none(tmp_path: Path, suffix: str) -> None:
    write_depth(tmp_path, ".tiff", make_scene().depth_mm / 1000.0)
    for path in list((tmp_path / "depth").iterdir()):
        path.rename(path.with_suffix(suffix)).write_bytes(b"\x93NUMPY\x01\x00" if suffix == ".npy" else b"v/1\x01 rest")
    sequence = opened(tmp_path)
    with pytest.raises(FrontendError, match=rf"000001\{suffix}: ") as error:
        sequence.read(1)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(("left", "right"), [("image_2", "image_3"), ("image_02", "image_03"), ("cam_0", "cam_1")])
def test_numbered_cameras_are_a_pair_whose_missing_baseline_is_named(tmp_path: Path, left: str, right: str) -> None:
    scene = make_scene()
    write_images(tmp_path / left, numbered(), scene.images)
    write_images(tmp_path / right, numbered(), scene.rights)
    (tmp_path / "camera.yaml").write_text(own_camera("rate_hz: 20.0\n"))
    sequence = opened(tmp_path)
    assert sequence.rig.kind is RigKind.MONO
    [warning] = said(sequence)
    assert f"right images in {tmp_path / right} are not used" in warning and "add baseline_m" in warning
    (tmp_path / "camera.yaml").write_text(own_camera(STEREO))
    sequence = opened(tmp_path)
    assert sequence.rig.kind is RigKind.STEREO and not sequence.problems
    np.testing.assert_array_equal(sequence.read(3).right, scene.rights[3])
