"""What becomes of the user's files: names and pixels, whatever they are stored as."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from maslam.frontend.datasets import open_dataset
from maslam.mas.manifest import AgentEntry, CameraEntry
from maslam.tools.interchange.source_images import AgentImages


def images_of(folder: Path, pixels: NDArray[np.uint8], names: tuple[str, ...]) -> AgentImages:
    """A folder of two images under a user's names, as an agent's."""
    (folder / "left").mkdir(parents=True)
    for name in names:
        done, data = cv2.imencode(Path(name).suffix, pixels)
        assert done
        (folder / "left" / name).write_bytes(data.tobytes())
    height, width = pixels.shape[:2]
    camera = f"width: {width}\nheight: {height}\nfx: 80\nfy: 80\ncx: {width / 2}\ncy: {height / 2}\nrate_hz: 10\n"
    (folder / "camera.yaml").write_text(camera)
    dataset = open_dataset(folder, strict=False)
    sequence = dataset.sequences[0]
    entry = AgentEntry(
        name="agent_03",
        sequence=sequence.name,
        first_frame=0,
        frames=2,
        keyframes=2,
        tracks=1,
        start_ns=0,
        camera=CameraEntry.from_rig(sequence.rig),
    )
    return AgentImages(entry, sequence, dataset.root)


def picture(channels: int) -> NDArray[np.uint8]:
    rng = np.random.default_rng(0)
    small = rng.integers(0, 255, (8, 12, channels), dtype=np.uint8)
    return cv2.resize(small, (96, 64), interpolation=cv2.INTER_CUBIC)


@pytest.mark.parametrize("suffix", [".png", ".PNG", ".jpg", ".jpeg"])
def test_a_colour_file_that_needs_nothing_is_the_users_own(tmp_path: Path, suffix: str) -> None:
    one = images_of(tmp_path / "drive", picture(3), (f"a1{suffix}", f"a2{suffix}"))
    assert one.name(0) == f"agent_03/left/a1{suffix}"
    data, pixels = one.encoded(0)
    assert data == (tmp_path / "drive" / "left" / f"a1{suffix}").read_bytes() and pixels.shape == (64, 96, 3)


def test_a_grey_file_becomes_a_colour_file_since_some_take_columns_for_channels(tmp_path: Path) -> None:
    grey = picture(1)
    one = images_of(tmp_path / "drive", grey, ("a1.png", "a2.png"))
    found = cv2.imdecode(np.frombuffer(one.encoded(1)[0], dtype=np.uint8), cv2.IMREAD_UNCHANGED)
    assert found.shape == (64, 96, 3)
    np.testing.assert_array_equal(found, np.repeat(grey[..., None], 3, axis=2))


@pytest.mark.parametrize("suffix", [".bmp", ".tif", ".ppm", ".webp"])
def test_other_kinds_become_png_under_their_own_name(tmp_path: Path, suffix: str) -> None:
    one = images_of(tmp_path / "drive", picture(3), (f"a1{suffix}", f"a2{suffix}"))
    assert one.name(1) == f"agent_03/left/a2{suffix}.png"
    data, pixels = one.encoded(1)
    assert data.startswith(b"\x89PNG")
    np.testing.assert_array_equal(cv2.imdecode(np.frombuffer(data, dtype=np.uint8), cv2.IMREAD_UNCHANGED), pixels)


def test_a_png_that_is_called_jpg_is_written_as_what_it_is_called(tmp_path: Path) -> None:
    one = images_of(tmp_path / "drive", picture(3), ("a1.jpg", "a2.jpg"))
    done, data = cv2.imencode(".png", picture(3))
    assert done
    (tmp_path / "drive" / "left" / "a1.jpg").write_bytes(data.tobytes())
    assert one.encoded(0)[0].startswith(b"\xff\xd8")


def test_spaces_do_not_cut_names_in_lists_of_pairs(tmp_path: Path) -> None:
    one = images_of(tmp_path / "my drive", picture(3), ("IMG 1.png", "IMG  2.png"))
    assert [one.name(k) for k in (0, 1)] == ["agent_03/left/IMG_1.png", "agent_03/left/IMG_2.png"]
