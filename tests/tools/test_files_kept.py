"""What commands write over: their own earlier results, never the user's files, and nothing before the work is done."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest

import maslam
from maslam.frontend.datasets import open_dataset
from maslam.frontend.files.trajectory import Trajectory, write_tum
from maslam.tools import cli


def said(capsys: pytest.CaptureFixture[str], *words: object) -> tuple[int, str]:
    code = cli.main([*map(str, words)])
    return code, capsys.readouterr().err


@pytest.fixture
def board(tmp_path: Path) -> Path:
    """Images that are only looked at where something is wrong with the order of checks."""
    folder = tmp_path / "board"
    folder.mkdir()
    for k in range(3):
        (folder / f"{k}.png").write_bytes(b"mine")
    return folder


@pytest.mark.parametrize(
    ("out", "words"),
    [
        ("board/0.png", "the name of the file to write ends in .yaml or .yml"),
        ("board", "board: is a folder; a file is meant"),
        ("mine.yaml", "mine.yaml: is there already; choose another name, or replace it with --overwrite"),
    ],
)
def test_a_calibration_replaces_nobody_elses_file(
    out: str, words: str, board: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "mine.yaml").write_text("fx: 100\n")
    code, line = said(capsys, "calibrate", board, tmp_path / out, "--quiet")
    assert code == 1 and words in line and line.count("\n") == 1
    assert (tmp_path / "mine.yaml").read_text() == "fx: 100\n" and (board / "0.png").read_bytes() == b"mine"


def test_its_own_and_what_the_user_says_it_replaces(
    board: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "ours.yaml").write_text("%YAML:1.0\n---\n# maslam calibrate: 20 views, 0.1 px root mean square\n")
    (tmp_path / "mine.yaml").write_text("fx: 100\n")
    for words in (("ours.yaml",), ("mine.yaml", "--overwrite")):
        _, line = said(capsys, "calibrate", board, tmp_path / words[0], "--quiet", *words[1:])
        assert "not an image" in line, "the check is passed, the work begins"


@pytest.mark.parametrize("command", [["inspect"], ["calibrate", "out.yaml"]])
def test_pictures_replace_no_image_that_is_read(
    command: list[str], board: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = [command[0], board, *[board.parent / name for name in command[1:]], "--png"]
    code, line = said(capsys, *words, board / "1.png")
    assert code == 1 and line == f"maslam: {board / '1.png'}: is one of the files that are read; choose another name\n"
    assert (board / "1.png").read_bytes() == b"mine"
    code, line = said(capsys, *words, board.parent / "p.jpg")
    assert code == 1 and line.endswith("p.jpg: the name of the file to write ends in .png\n")


@pytest.fixture
def poses(town_stereo: Path, tmp_path: Path) -> Path:
    """True trajectories of both agents, as another system's."""
    (tmp_path / "poses").mkdir()
    for sequence in open_dataset(town_stereo).sequences:
        truth = sequence.groundtruth
        assert truth is not None
        write_tum(tmp_path / "poses" / f"{sequence.name}.txt", Trajectory(truth.stamps_ns, truth.poses))
    return tmp_path / "poses"


def test_an_import_replaces_no_other_sequences(
    poses: Path, town_stereo: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out, other = tmp_path / "seqs", tmp_path / "other"
    one = poses / "agent_00.txt", town_stereo / "agent_00"
    assert said(capsys, "import", *one, out, "--quiet")[0] == 0
    whole = (out / "manifest.json").read_bytes()
    assert said(capsys, "import", *one, out, "--quiet")[0] == 0, "the same command makes it anew"
    assert (out / "manifest.json").read_bytes() == whole
    shutil.copytree(town_stereo / "agent_01", other)
    code, line = said(capsys, "import", poses / "agent_01.txt", other, out, "--quiet")
    assert code == 1 and f"holds agent sequences of {town_stereo / 'agent_00'}, not of {other}" in line
    code, line = said(capsys, "import", *one, out, "--quiet", "--gap", "3")
    assert code == 1 and "holds agent sequences with other settings (imports)" in line and "--overwrite" in line
    with pytest.raises(maslam.MaslamError, match="holds agent sequences of"):
        maslam.import_sequence(poses / "agent_01.txt", other, out)
    assert (out / "manifest.json").read_bytes() == whole
    assert said(capsys, "import", poses / "agent_01.txt", other, out, "--quiet", "--overwrite")[0] == 0
    assert json.loads((out / "manifest.json").read_text())["source"] == str(other)


def test_an_import_that_adds_and_is_ended_keeps_what_was_there(
    poses: Path, town_stereo: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    from maslam.tools.pipeline import agent_folder

    out = tmp_path / "seqs"
    first, second = ((poses / f"agent_0{k}.txt", town_stereo / f"agent_0{k}") for k in (0, 1))
    assert said(capsys, "import", *first, out, "--quiet")[0] == 0
    whole = (out / "manifest.json").read_bytes()

    def stopped(*_: object) -> None:
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(agent_folder, "_write_agent", stopped)
        assert said(capsys, "import", *second, out, "--quiet", "--add")[0] == 130
        assert (out / "manifest.json").read_bytes() == whole
        assert said(capsys, "import", *first, out, "--quiet")[0] == 130
    assert not (out / "manifest.json").exists(), "what is being made anew is not taken for whole"
    code, line = said(capsys, "import", *second, out, "--quiet")
    assert code == 1 and "holds agent sequences of" in line
    assert said(capsys, "import", *first, out, "--quiet")[0] == 0, "the same command goes on"
    assert (out / "manifest.json").read_bytes() == whole
    assert said(capsys, "import", *second, out, "--quiet", "--add")[0] == 0
    assert len(json.loads((out / "manifest.json").read_text())["agents"]) == 2


def test_the_predecessors_files_are_written_to_no_folder_with_other_files(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    images = tmp_path / "mine" / "agent_00"
    images.mkdir(parents=True)
    (images / "000000.png").write_bytes(b"mine")
    (tmp_path / "five").mkdir()
    code, line = said(capsys, "import", tmp_path / "five", tmp_path / "mine", "--quiet")
    assert code == 1 and line == f"maslam: {tmp_path / 'mine'}: not empty, and no folder of agent sequences\n"
    assert (images / "000000.png").is_file()
