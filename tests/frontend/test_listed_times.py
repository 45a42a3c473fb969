"""Lists of times beside images: a column or a table, with headings, names, dates; and images that a list lacks."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from dataset_makers import COUNT, make_scene, numbered, own_camera, seconds, write_images, write_seven_scenes

from maslam.frontend.datasets import ImageSequence, open_dataset
from maslam.frontend.errors import FrontendError

START_NS = 1_700_000_000_000_000_000
STAMPS = START_NS + 50_000_000 * np.arange(COUNT)
NAMES = numbered()


def folder_with(folder: Path, text: str, name: str = "timestamps.txt", inside: str = "images") -> ImageSequence:
    write_images(folder / inside, NAMES, make_scene().images)
    (folder / "camera.yaml").write_text(own_camera())
    (folder / name).write_text(text)
    [sequence] = open_dataset(folder).sequences
    return sequence


def lines(form: str, names: list[str] = NAMES) -> str:
    return "".join(
        form.format(i=i, s=seconds(t), sec=t // 10**9, nsec=t % 10**9, ns=t, ms=t // 10**6, name=name,
                    date=f"2023-11-14 22:13:{20 + t // 10**9 - 1_700_000_000:02d}.{t % 10**9:09d}") + "\n"
        for i, (t, name) in enumerate(zip(STAMPS.tolist(), names, strict=True))
    )  # fmt: skip


@pytest.mark.parametrize("text", [
    lines("{s}"),
    lines("{ms}"),
    lines("{date}"),
    "timestamp,filename\n" + lines("{s},{name}"),
    "#timestamp [ns],filename\n" + lines("{ns},{name}"),
    "# name time\n" + lines("{name} {s}"),
    lines("{i} {s} rgb/{name}"),
    lines("{i},{ns}"),
    "frame;sec;nanosec\n" + lines("{i};{sec};{nsec}"),
    "\ufeff" + lines("{s}").replace("\n", "\r\n"),
    "filename,date\n" + lines("{name},{date}"),
])  # fmt: skip
def test_every_form_gives_the_same_times(tmp_path: Path, text: str) -> None:
    sequence = folder_with(tmp_path, text)
    np.testing.assert_array_equal(sequence.stamps_ns, STAMPS)
    assert [path.name for path in sequence.left] == NAMES and sequence.problems == ()


def test_a_list_beside_the_images_of_one_camera(tmp_path: Path) -> None:
    np.testing.assert_array_equal(folder_with(tmp_path, lines("{s}"), "images/times.txt").stamps_ns, STAMPS)
    np.testing.assert_array_equal(folder_with(tmp_path / "b", lines("{s}"), "images_times.txt").stamps_ns, STAMPS)


def test_listed_names_decide_the_order_and_what_is_read(tmp_path: Path) -> None:
    rows = lines("{s},{name}").splitlines()
    text = "\n".join(["time,image", *rows[1:], f"{seconds(int(STAMPS[-1]) + 10**8)},gone.png"]) + "\n"
    sequence = folder_with(tmp_path, text)
    assert [path.name for path in sequence.left] == NAMES[1:]
    messages = [problem.message for problem in sequence.problems]
    assert any("1 of 6 listed images are not there: first gone.png" in message for message in messages)
    assert any("no time for 1 of 6 images, which are left out: first 000000.png" in message for message in messages)


def test_images_taken_out_keep_their_rows_and_are_named(tmp_path: Path) -> None:
    write_images(tmp_path, NAMES, make_scene().images)
    (tmp_path / "camera.yaml").write_text(own_camera())
    (tmp_path / "times.txt").write_text(lines("{s}"))
    (tmp_path / "000003.png").unlink()
    [sequence] = open_dataset(tmp_path).sequences
    np.testing.assert_array_equal(sequence.stamps_ns, np.delete(STAMPS, 3))
    assert [str(one) for one in sequence.missing] == ["000003"]
    messages = [problem.message for problem in sequence.problems]
    assert any("6 times for 5 images; taken by the number" in message for message in messages)
    assert any("1 image missing by the numbers in the file names: 000003" in message for message in messages)
    # A list of what is left, with a hole where the image was.
    (tmp_path / "times.txt").write_text("".join(f"{seconds(t)}\n" for t in np.delete(STAMPS, 3).tolist()))
    [sequence] = open_dataset(tmp_path).sequences
    assert [str(one) for one in sequence.missing] == ["000003"]


def test_seven_scenes_names_missing_images(tmp_path: Path) -> None:
    write_seven_scenes(tmp_path, make_scene())
    for kind in ("color.png", "depth.png", "pose.txt"):
        (tmp_path / f"frame-000002.{kind}").unlink()
    [sequence] = open_dataset(tmp_path).sequences
    assert [str(one) for one in sequence.missing] == ["frame-000002"]
    assert "1 image missing by the numbers in the file names: frame-000002" in sequence.problems[0].message


@pytest.mark.parametrize(("text", "message"), [
    ("time,image\n0.1,x.png\n", r"names no image of .* \(first: 'x.png'\)"),
    (lines("{s}")[:40], "2 times for 6 images"),
    ("0.1\n0.2\nx\n", r"timestamps.txt:3: not a time: 'x'"),
    ("0.1,a\n0.2\n", r"timestamps.txt:2: 1 columns, but the rows before have 2"),
    ("", "0 times for 6 images"),
])  # fmt: skip
def test_lists_that_do_not_fit_are_refused_in_a_line(tmp_path: Path, text: str, message: str) -> None:
    with pytest.raises(FrontendError, match=message) as error:
        folder_with(tmp_path, text)
    assert "\n" not in str(error.value)


def test_milliseconds_of_a_recording_are_said(tmp_path: Path) -> None:
    sequence = folder_with(tmp_path, "".join(f"{50 * i}\n" for i in range(COUNT)))
    np.testing.assert_array_equal(sequence.stamps_ns, 50_000_000 * np.arange(COUNT))
    [problem] = sequence.problems
    assert "timestamps.txt: times are taken as milliseconds by their rate: 20 images per second" in problem.message


def test_names_that_are_times_come_in_order_of_time(tmp_path: Path) -> None:
    """Python's str() of a time leaves out zeros at the end: by their numbers 102.7 comes before 102.1013."""
    seconds_of = [102 + round(0.1 * i + 0.0013 * (i % 7), 4) for i in range(COUNT * 2)]
    images = np.stack([np.full((64, 96), 10 * i, np.uint8) for i in range(COUNT * 2)])
    write_images(tmp_path, [f"1305031{one}.png" for one in seconds_of], images)
    (tmp_path / "camera.yaml").write_text(own_camera())
    [sequence] = open_dataset(tmp_path).sequences
    assert [int(frame.image[0, 0]) for frame in sequence.frames()] == [10 * i for i in range(COUNT * 2)]
    assert sequence.problems == ()


def test_names_with_nanoseconds_without_zeros_are_named(tmp_path: Path) -> None:
    stamps = [START_NS + 33_000_000 * i for i in range(40)]
    write_images(tmp_path, [f"{t // 10**9}.{t % 10**9}.png" for t in stamps], np.zeros((40, 64, 96), np.uint8))
    (tmp_path / "camera.yaml").write_text(own_camera())
    [sequence] = open_dataset(tmp_path).sequences
    np.testing.assert_array_equal(sequence.stamps_ns, stamps)
    [problem] = sequence.problems
    assert "seconds and nanoseconds without leading zeros (1700000000." in problem.message


@pytest.mark.parametrize("form", ["{s},{name}", "{ms},{name}", "{sec} {nsec} {name}"])
def test_rows_in_reverse_order_are_sorted_by_their_times(tmp_path: Path, form: str) -> None:
    text = "".join(reversed(lines(form).splitlines(keepends=True)))
    sequence = folder_with(tmp_path, text, "times.csv")
    np.testing.assert_array_equal(sequence.stamps_ns, STAMPS)
    assert [path.name for path in sequence.left] == NAMES
    [problem] = sequence.problems
    assert problem.message == f"{tmp_path / 'times.csv'}: its rows are in reverse order of time: sorted"


def test_small_times_in_reverse_order_keep_their_unit(tmp_path: Path) -> None:
    text = "".join(f"{50 * i},{NAMES[i]}\n" for i in reversed(range(COUNT)))
    np.testing.assert_array_equal(folder_with(tmp_path, text).stamps_ns, 50_000_000 * np.arange(COUNT))


def test_rows_out_of_order_are_sorted_only_where_the_names_agree(tmp_path: Path) -> None:
    rows = lines("{s},{name}").splitlines(keepends=True)
    rows[2], rows[4] = rows[4], rows[2]
    np.testing.assert_array_equal(folder_with(tmp_path / "a", "".join(rows)).stamps_ns, STAMPS)
    swapped = [NAMES[i] for i in (0, 1, 4, 3, 2, 5)]
    rows = lines("{s},{name}", swapped).splitlines(keepends=True)
    rows[1], rows[3] = rows[3], rows[1]
    with pytest.raises(FrontendError, match="time goes back"):
        folder_with(tmp_path / "b", "".join(rows))


@pytest.mark.parametrize("form", ["{sec} {nsec:09d}", "{sec},{nsec}", "{i} {sec} {nsec}", "{sec} {nsec} {name}"])
@pytest.mark.parametrize("rate_hz", [3, 30])
def test_seconds_and_nanoseconds_in_two_columns(tmp_path: Path, form: str, rate_hz: int) -> None:
    stamps = START_NS + 10**9 * np.arange(COUNT) // rate_hz
    text = "".join(
        form.format(i=i, sec=t // 10**9, nsec=t % 10**9, name=NAMES[i]) + "\n" for i, t in enumerate(stamps.tolist())
    )
    sequence = folder_with(tmp_path, text)
    np.testing.assert_array_equal(sequence.stamps_ns, stamps)
    assert not sequence.problems


def test_seconds_and_microseconds_in_two_columns(tmp_path: Path) -> None:
    stamps = START_NS + 700_000_000 + 100_000_000 * np.arange(COUNT)
    rows = [(t // 10**9, t % 10**9 // 1000) for t in stamps.tolist()]
    plain = folder_with(tmp_path / "a", "".join(f"{a} {b}\n" for a, b in rows))
    headed = folder_with(tmp_path / "b", "tv_sec tv_usec\n" + "".join(f"{a} {b}\n" for a, b in rows))
    np.testing.assert_array_equal(plain.stamps_ns, stamps)
    np.testing.assert_array_equal(headed.stamps_ns, stamps)


def test_two_columns_in_an_open_unit_are_refused_with_the_cure(tmp_path: Path) -> None:
    text = "".join(f"1700000000 {20000 * i}\n" for i in range(COUNT))
    with pytest.raises(FrontendError, match=r"timestamps.txt:1: seconds, and .* head the columns: sec nsec"):
        folder_with(tmp_path, text)


def test_times_without_names_in_reverse_are_refused_with_the_cure(tmp_path: Path) -> None:
    text = "".join(reversed(lines("{s}").splitlines(keepends=True)))
    with pytest.raises(FrontendError, match="all are in reverse: list each image's name beside its time"):
        folder_with(tmp_path, text)


def test_associations_in_reverse_order_are_sorted(tmp_path: Path) -> None:
    write_images(tmp_path / "rgb", NAMES, make_scene().images)
    (tmp_path / "camera.yaml").write_text(own_camera())
    rows = lines("{s} rgb/{name} {s} 0 0 0 0 0 0 1").splitlines(keepends=True)
    (tmp_path / "associations.txt").write_text("".join(reversed(rows)))
    [sequence] = open_dataset(tmp_path).sequences
    np.testing.assert_array_equal(sequence.stamps_ns, STAMPS)
    assert [path.name for path in sequence.left] == NAMES and sequence.groundtruth is not None
    assert "its rows are in reverse order of time: sorted" in sequence.problems[0].message
