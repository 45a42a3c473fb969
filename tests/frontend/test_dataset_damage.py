"""Whatever is damaged in a data set, it is read or refused in one line that names it: never another exception."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from dataset_makers import Scene, make_scene, write_euroc, write_kitti, write_rendered, write_seven_scenes, write_tum

from maslam.frontend.datasets import open_dataset
from maslam.frontend.errors import FrontendError

ROUNDS = 60
WRONG_VALUES = (b"nan", b"-1", b"0", b"1e30", b"1e-30", b"x", b"", b"[", b"9" * 23)
WRITERS: dict[str, Callable[[Path, Scene], None]] = {
    "kitti": write_kitti,
    "euroc": write_euroc,
    "tum": write_tum,
    "7scenes": write_seven_scenes,
    "stereo": lambda folder, scene: write_rendered(folder, scene, "stereo"),
    "rgbd": lambda folder, scene: write_rendered(folder, scene, "rgbd"),
}


def cut_off(data: bytes, rng: np.random.Generator) -> bytes:
    return data[: rng.integers(len(data) + 1)]


def flip_bytes(data: bytes, rng: np.random.Generator) -> bytes:
    out = bytearray(data)
    for _ in range(3):
        out[rng.integers(len(out))] = rng.integers(256)
    return bytes(out)


def wrong_value(data: bytes, rng: np.random.Generator) -> bytes:
    fields = data.split(b" ")
    fields[rng.integers(len(fields))] = WRONG_VALUES[rng.integers(len(WRONG_VALUES))]
    return b" ".join(fields)


def lose_a_line(data: bytes, rng: np.random.Generator) -> bytes:
    lines = data.split(b"\n")
    del lines[rng.integers(len(lines))]
    return b"\n".join(lines)


def repeat_a_line(data: bytes, rng: np.random.Generator) -> bytes:
    lines = data.split(b"\n")
    at = rng.integers(len(lines))
    return b"\n".join([*lines[: at + 1], *lines[at:]])


def shuffle_lines(data: bytes, rng: np.random.Generator) -> bytes:
    lines = data.split(b"\n")
    return b"\n".join(lines[i] for i in rng.permutation(len(lines)))


DAMAGES = (cut_off, flip_bytes, wrong_value, lose_a_line, repeat_a_line, shuffle_lines)


def said(folder: Path) -> list[str]:
    """Everything said when the folder is opened and read as by ``maslam inspect --all``; only refusals may stop it."""
    try:
        [sequence] = open_dataset(folder, strict=False).sequences
    except FrontendError as error:
        return [str(error)]
    messages = [problem.message for problem in sequence.problems]
    for i in range(len(sequence)):
        try:
            sequence.read(i)
        except FrontendError as error:
            messages.append(str(error))
    return messages


def check(folder: Path) -> None:
    for message in said(folder):
        assert str(folder) in message and "\n" not in message


@pytest.mark.parametrize("kind", WRITERS)
def test_damaged_files(tmp_path: Path, kind: str) -> None:
    folder = tmp_path / kind
    folder.mkdir()
    WRITERS[kind](folder, make_scene())
    files = sorted(path for path in folder.rglob("*") if path.is_file())
    texts = [path for path in files if path.suffix in (".txt", ".yaml", ".csv")]
    rng = np.random.default_rng(11)
    for _ in range(ROUNDS):
        path = (texts if rng.random() < 0.8 else files)[rng.integers(len(texts))]
        whole = path.read_bytes()
        path.write_bytes(DAMAGES[rng.integers(len(DAMAGES))](whole, rng))
        check(folder)
        path.write_bytes(whole)
    kept = tmp_path / "kept"
    for path in files:
        shutil.move(path, kept)
        check(folder)
        shutil.move(kept, path)
