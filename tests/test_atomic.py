"""Whatever ends a write early, its place holds what it held before and nothing is left beside it."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from maslam._atomic import replacing, write_atomically, write_npz, write_together


def contents(folder: Path) -> dict[str, bytes]:
    return {str(p.relative_to(folder)): p.read_bytes() for p in sorted(folder.rglob("*")) if p.is_file()}


def test_text_keeps_its_line_ends_and_bytes_stay_as_they_are(tmp_path: Path) -> None:
    write_atomically(tmp_path / "a.txt", "ä\n1\r\n")
    write_atomically(tmp_path / "b.bin", b"\x00\r\n")
    assert contents(tmp_path) == {"a.txt": "ä\n1\r\n".encode(), "b.bin": b"\x00\r\n"}


@pytest.mark.parametrize("error", [ValueError, OSError, KeyboardInterrupt, SystemExit])
def test_a_file_that_is_not_finished_leaves_the_old_one(tmp_path: Path, error: type[BaseException]) -> None:
    path = tmp_path / "summary.json"
    path.write_text("old")

    def broken() -> None:
        with replacing(path) as part:
            part.write_text("half")
            raise error

    with pytest.raises(error):
        broken()
    assert contents(tmp_path) == {"summary.json": b"old"}


def fill(folder: Path, **files: str) -> None:
    folder.mkdir()
    for name, text in files.items():
        (folder / name).write_text(text)


def test_a_folder_replaces_another_whole(tmp_path: Path) -> None:
    fill(tmp_path / "agent_00", poses="old", stale="old")
    for text in ("new", "newer"):
        with replacing(tmp_path / "agent_00") as part:
            fill(part, poses=text)
        assert contents(tmp_path) == {"agent_00/poses": text.encode()}
        assert [p.name for p in tmp_path.iterdir()] == ["agent_00"]


def test_a_folder_that_is_not_finished_or_cannot_be_moved_leaves_the_old_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    fill(tmp_path / "agent_00", poses="old")

    def make(then: Callable[[], None]) -> None:
        with replacing(tmp_path / "agent_00") as part:
            fill(part, poses="new")
            then()

    def interrupted() -> None:
        raise KeyboardInterrupt

    def locked(self: object = None, *_: object) -> None:
        raise PermissionError(13, "in use", str(tmp_path / "agent_00"))

    with pytest.raises(KeyboardInterrupt):
        make(interrupted)
    assert contents(tmp_path) == {"agent_00/poses": b"old"}

    moves: list[Path] = []
    move = __import__("os").replace

    def second_move_fails(a: Path, b: Path) -> None:
        moves.append(a)
        if len(moves) == 2:
            locked()
        move(a, b)

    monkeypatch.setattr("os.replace", second_move_fails)
    with pytest.raises(PermissionError, match="agent_00"):
        make(lambda: None)
    assert contents(tmp_path) == {"agent_00/poses": b"old"}
    assert [p.name for p in tmp_path.iterdir()] == ["agent_00"]


def test_a_program_that_is_killed_leaves_the_old_file_and_nothing_that_a_reader_would_take(tmp_path: Path) -> None:
    write_atomically(tmp_path / "0.g2o", "old")
    code = (
        "import os, sys, pathlib; from maslam._atomic import replacing\n"
        "with replacing(pathlib.Path(sys.argv[1])) as part: part.write_text('half'); os._exit(9)"
    )
    assert subprocess.run([sys.executable, "-c", code, str(tmp_path / "0.g2o")], check=False).returncode == 9
    assert [p.read_text() for p in tmp_path.glob("*.g2o")] == ["old"]
    left = [p.name for p in tmp_path.iterdir() if p.name != "0.g2o"]
    assert len(left) == 1 and left[0].startswith(".") and left[0].endswith(".part")


def test_several_files_are_all_whole_before_the_first_is_moved(tmp_path: Path) -> None:
    names = ["poses.txt", "times.txt", "descs.txt"]
    write_together([(tmp_path / name, "old") for name in names])
    with pytest.raises(OSError, match="nowhere"):
        write_together([*((tmp_path / name, "new") for name in names), (tmp_path / "nowhere" / "x", "new")])
    with pytest.raises(OSError, match="nowhere"):
        write_together([(tmp_path / "nowhere" / "x", "new"), *((tmp_path / name, "new") for name in names)])
    assert contents(tmp_path) == dict.fromkeys(sorted(names), b"old")


def test_several_files_are_moved_in_the_order_given(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    moved: list[str] = []
    monkeypatch.setattr("os.replace", lambda part, path: moved.append(path.name))
    write_together([(tmp_path / name, "") for name in ("b", "a", "c")])
    assert moved == ["b", "a", "c"]


def test_an_error_of_the_disk_names_the_file_that_was_wanted(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(self: Path, data: bytes) -> int:
        raise OSError(28, "No space left on device")

    with pytest.raises(FileNotFoundError) as missing:
        write_atomically(tmp_path / "no" / "a.txt", "")
    assert missing.value.filename == str(tmp_path / "no" / "a.txt")
    monkeypatch.setattr(Path, "write_bytes", full)
    with pytest.raises(OSError, match="No space left on device") as no_space:
        write_atomically(tmp_path / "a.txt", "")
    assert no_space.value.filename == str(tmp_path / "a.txt")


def test_an_error_of_another_file_keeps_its_name(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError) as missing, replacing(tmp_path / "out.txt") as part:
        part.write_bytes((tmp_path / "source.txt").read_bytes())
    assert missing.value.filename == str(tmp_path / "source.txt")


def test_one_place_may_be_written_from_two_sides_at_once(tmp_path: Path) -> None:
    path = tmp_path / "cache.npz"
    with replacing(path) as first, replacing(path) as second:
        first.write_text("first")
        second.write_text("second")
    assert contents(tmp_path) == {"cache.npz": b"first"}


@pytest.mark.parametrize("compressed", [False, True])
def test_arrays_come_back_and_equal_ones_give_equal_bytes(tmp_path: Path, compressed: bool) -> None:
    arrays = {"a": np.arange(6.0).reshape(2, 3), "name": "words", "n": np.int64(3), "part": [1, 2]}
    for name in ("one.npz", "two"):
        write_npz(tmp_path / name, arrays, compressed)
    assert (tmp_path / "one.npz").read_bytes() == (tmp_path / "two").read_bytes()
    with np.load(tmp_path / "one.npz", allow_pickle=False) as stored:
        assert sorted(stored.files) == sorted(arrays)
        for name, values in arrays.items():
            np.testing.assert_array_equal(stored[name], values)
    with pytest.raises(TypeError, match="no plain numbers or text: b"):
        write_npz(tmp_path / "three.npz", {"a": 1, "b": np.array([object()])})
    assert not (tmp_path / "three.npz").exists()


def test_nobody_else_moves_a_finished_file_into_place() -> None:
    root = Path(__file__).resolve().parent.parent
    own = {"_atomic.py", "recorder.py", "run_folder.py"}  # a RUN folder keeps what lies beside it: never replaced whole
    folders = [root / name for name in ("backend", "descriptors", "frontend", "mas", "tools")]
    sources = [path for folder in folders for path in folder.rglob("*.py") if path.name not in own]
    assert len(sources) > 100
    assert [str(path) for path in sources if "os.replace(" in path.read_text(encoding="utf-8")] == []
