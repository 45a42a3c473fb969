"""The five VO files: a round trip, a reader written from the format's description alone, and every broken line."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from maslam.backend.geometry import se3_exp
from maslam.frontend.errors import FrontendError
from maslam.frontend.files import text_tables
from maslam.frontend.files.vo_files import VoTrack, read_tracks, write_track


def make_track(keyframes: int = 5, points: int = 40, observations: int = 120, seed: int = 0) -> VoTrack:
    rng = np.random.default_rng(seed)
    pairs = rng.choice(keyframes * points, observations, replace=False)
    pairs.sort()
    return VoTrack(
        stamps_s=1403715274.312143087 + 0.05 * np.arange(keyframes),
        poses=se3_exp(rng.normal(size=(keyframes, 6)) * [500, 500, 500, 1, 1, 1]),
        points=rng.normal(size=(points, 3)) * 1000,
        observations=np.stack([pairs // points, pairs % points], axis=1).astype(np.int32),
        descriptors=rng.integers(0, 256, (observations, 32)).astype(np.uint8),
        words=rng.integers(0, 11111, (observations, 2)).astype(np.int32),
    )


def assert_equal(a: VoTrack, b: VoTrack) -> None:
    for name in VoTrack.__dataclass_fields__:
        x, y = getattr(a, name), getattr(b, name)
        assert x.dtype == y.dtype, name
        np.testing.assert_array_equal(x, y, err_msg=name)


def test_round_trip_is_exact(tmp_path: Path) -> None:
    tracks = [make_track(seed=k) for k in range(11)]
    for k, track in enumerate(tracks):
        write_track(tmp_path / "agent", k, track)
    for written, read in zip(tracks, read_tracks(tmp_path / "agent"), strict=True):
        assert_equal(written, read)
    assert not [p for p in (tmp_path / "agent").iterdir() if not p.name.endswith(".txt")]


def test_same_track_same_bytes(tmp_path: Path) -> None:
    for name in ("a", "b"):
        write_track(tmp_path / name, 0, make_track())
    for path in (tmp_path / "a").iterdir():
        assert path.read_bytes() == (tmp_path / "b" / path.name).read_bytes()


def test_a_track_without_points_and_one_without_anything(tmp_path: Path) -> None:
    empty = make_track(3, 0, 0)
    nothing = make_track(0, 0, 0)
    write_track(tmp_path, 0, empty)
    write_track(tmp_path, 1, nothing)
    first, second = read_tracks(tmp_path)
    assert_equal(first, empty)
    assert_equal(second, nothing)


def test_a_reader_written_from_the_description_accepts_them(tmp_path: Path) -> None:
    track = make_track()
    write_track(tmp_path, 0, track)

    def rows(name: str) -> list[list[str]]:
        text = (tmp_path / f"{name}_0.txt").read_bytes().decode("ascii")
        assert text.endswith("\n") and "\r" not in text
        return [line.split(" ") for line in text.splitlines()]

    poses = np.array([[float(v) for v in row] for row in rows("poses")])
    assert poses.shape == (5, 16)
    np.testing.assert_allclose(poses.reshape(-1, 4, 4), track.poses, atol=1e-9)
    assert [len(row) for row in rows("times")] == [1] * 5
    np.testing.assert_allclose([float(row[0]) for row in rows("times")], track.stamps_s, atol=1e-6)
    np.testing.assert_allclose(np.array(rows("lm_pos"), dtype=float), track.points, atol=1e-9)
    assert [tuple(int(v) for v in row) for row in rows("lm_obs")] == [tuple(o) for o in track.observations.tolist()]
    described = [[int(v) for v in row] for row in rows("descs")]
    assert [row[:32] for row in described] == track.descriptors.tolist()
    assert [row[32:] for row in described] == track.words.tolist()


def test_files_of_another_writer_in_any_order_and_with_other_blanks(tmp_path: Path) -> None:
    track = make_track()
    order = np.random.default_rng(1).permutation(len(track.observations))
    np.savetxt(tmp_path / "poses_0.txt", track.poses.reshape(-1, 16), fmt="%.9f", delimiter="\t")
    np.savetxt(tmp_path / "times_0.txt", track.stamps_s, fmt="%.6f")
    np.savetxt(tmp_path / "lm_pos_0.txt", track.points)
    np.savetxt(tmp_path / "lm_obs_0.txt", track.observations[order])  # as 1.000000000000000000e+00
    np.savetxt(
        tmp_path / "descs_0.txt",
        np.concatenate([track.descriptors, track.words], axis=1)[order],
        fmt="%4d",
        newline=" \r\n",
    )
    [read] = read_tracks(tmp_path)
    np.testing.assert_array_equal(read.observations, track.observations)
    np.testing.assert_array_equal(read.descriptors, track.descriptors)
    np.testing.assert_array_equal(read.words, track.words)
    np.testing.assert_allclose(read.poses, track.poses, atol=1e-8)


def replace_line(name: str, number: int, edit: Callable[[str], str]) -> Callable[[Path], None]:
    def damage(folder: Path) -> None:
        lines = (folder / name).read_text().splitlines()
        lines[number - 1] = edit(lines[number - 1])
        (folder / name).write_text("\n".join(lines) + "\n")

    return damage


def drop_last(name: str) -> Callable[[Path], None]:
    return lambda folder: (
        (folder / name).write_text("".join((folder / name).read_text().splitlines(keepends=True)[:-1])) and None
    )


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (
            replace_line("poses_0.txt", 3, lambda s: s.rpartition(" ")[0]),
            r"poses_0.txt:3: a key-frame pose has 16 numbers, found 15",
        ),
        (replace_line("poses_0.txt", 2, lambda s: "nan" + s[s.index(" ") :]), r"poses_0.txt:2: NaN or infinity"),
        (replace_line("poses_0.txt", 2, lambda s: "x1" + s[s.index(" ") :]), r"poses_0.txt:2: not a number: 'x1'"),
        (
            replace_line("poses_0.txt", 4, lambda s: "3.0" + s[s.index(" ") :]),
            r"poses_0.txt:4: not a rigid 4x4 transform",
        ),
        (replace_line("times_0.txt", 5, lambda s: "1403715274.0"), r"times_0.txt:5: time goes back to 1403715274.0 s"),
        (replace_line("times_0.txt", 1, lambda s: s + " 7"), r"times_0.txt:1: a time stamp has 1 numbers, found 2"),
        (drop_last("times_0.txt"), r"times_0.txt: 4 times, but 5 poses in poses_0.txt"),
        (replace_line("lm_pos_0.txt", 7, lambda s: "1 2"), r"lm_pos_0.txt:7: a map point has 3 numbers, found 2"),
        (
            replace_line("lm_obs_0.txt", 9, lambda s: "5 0"),
            r"lm_obs_0.txt:9: a key-frame index is 5, allowed are 0 to 4",
        ),
        (
            replace_line("lm_obs_0.txt", 9, lambda s: "0 -1"),
            r"lm_obs_0.txt:9: a map-point index is -1, allowed are 0 to 39",
        ),
        (replace_line("lm_obs_0.txt", 9, lambda s: "0 1.5"), r"lm_obs_0.txt:9: not a whole number"),
        (
            replace_line("descs_0.txt", 4, lambda s: "256" + s[s.index(" ") :]),
            r"descs_0.txt:4: a descriptor byte is 256, allowed are 0 to 255",
        ),
        (replace_line("descs_0.txt", 4, lambda s: s.rpartition(" ")[0] + " -3"), r"descs_0.txt:4: a node id is -3"),
        (
            replace_line("descs_0.txt", 4, lambda s: s + " 1"),
            r"descs_0.txt:4: a descriptor with its two node ids has 34 numbers, found 35",
        ),
        (drop_last("descs_0.txt"), r"descs_0.txt: 119 descriptors, but 120 observations in lm_obs_0.txt"),
        (
            lambda folder: (folder / "descs_0.txt").unlink(),
            r"descs_0.txt: missing; the five files of track 0 belong together",
        ),
        (lambda folder: (folder / "times_2.txt").write_text("0\n") and None, r"poses_2.txt|lm_pos_2.txt: missing"),
    ],
)
def test_broken_files_are_named_by_file_and_line(tmp_path: Path, damage: Callable[[Path], None], message: str) -> None:
    write_track(tmp_path, 0, make_track())
    damage(tmp_path)
    with pytest.raises(FrontendError, match=message):
        read_tracks(tmp_path)


def test_no_files_and_no_folder(tmp_path: Path) -> None:
    with pytest.raises(FrontendError, match="no VO files here"):
        read_tracks(tmp_path)
    with pytest.raises(FrontendError, match="no such folder"):
        read_tracks(tmp_path / "nowhere")


def test_nothing_is_left_of_a_write_that_fails(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_track(tmp_path, 0, make_track(seed=1))
    before = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
    calls = []
    original = Path.write_bytes

    def full_disk(self: Path, data: bytes) -> int:
        calls.append(self)
        if len(calls) == 4:
            raise OSError(28, "No space left on device")
        return original(self, data)

    monkeypatch.setattr(Path, "write_bytes", full_disk)
    with pytest.raises(OSError, match=r"No space left on device.*_0\.txt"):
        write_track(tmp_path, 0, make_track(seed=2))
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == before


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("stamps_s", np.zeros(4)),
        ("observations", np.array([[5, 0]] * 120, np.int32)),
        ("words", np.zeros((120, 3), np.int32)),
    ],
)
def test_a_track_that_contradicts_itself_cannot_be_made(field: str, value: np.ndarray) -> None:
    fields = {name: getattr(make_track(), name) for name in VoTrack.__dataclass_fields__}
    with pytest.raises(ValueError, match=r"shape|beyond"):
        VoTrack(**{**fields, field: value})


def test_nan_is_not_written(tmp_path: Path) -> None:
    track = make_track()
    track.points[3, 1] = np.nan
    with pytest.raises(ValueError, match="NaN"):
        write_track(tmp_path, 0, track)


# ---- the tables beneath


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("", []),
        ("\n \n# 1 2\n", []),
        ("1 2\n\n  3\t4  \n# x\n5,6", [[1, 2], [3, 4], [5, 6]]),
        ("-1e-3 +2.5\r\n", [[-0.001, 2.5]]),
    ],
)
def test_tables(tmp_path: Path, text: str, expected: list[list[float]]) -> None:
    path = tmp_path / "t.txt"
    path.write_bytes(text.encode())
    np.testing.assert_array_equal(text_tables.read_table(path, 2, "a row"), np.array(expected).reshape(-1, 2))


def test_lines_are_counted_past_comments(tmp_path: Path) -> None:
    path = tmp_path / "t.txt"
    path.write_text("# head\n1 2\n\n# more\n3 4\n5 6 7\n")
    with pytest.raises(FrontendError, match=r"t.txt:6: a row has 2 numbers, found 3"):
        text_tables.read_table(path, 2, "a row")
    assert [text_tables.row_line(path, row) for row in range(4)] == [2, 5, 6, 0]
    path.write_text("1 2\n")
    with pytest.raises(FrontendError, match=r"t.txt:1: a row has 3 or 4 numbers, found 2"):
        text_tables.read_table(path, (3, 4), "a row")
    with pytest.raises(FrontendError, match="cannot be read: No such file"):
        text_tables.read_table(tmp_path / "none", 2, "a row")
