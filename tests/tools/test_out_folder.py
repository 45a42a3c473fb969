"""OUT of the commands: what cannot be written to is refused before any work, and a failure leaves no empty folder."""

from __future__ import annotations

from pathlib import Path

import pytest
from dataset_makers import make_scene, write_rendered

import maslam
from maslam.frontend.datasets.folder import FolderReader
from maslam.mas.output.run_folder import SUMMARY, Recorder, check_out
from maslam.tools import cli
from maslam.tools.common.folders import check_apart


@pytest.fixture
def town(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Two agents' images; whatever reads or renders any before OUT is checked fails the test. ``seqs`` is missing."""

    def read_too_early(*_: object, **__: object) -> None:
        pytest.fail("the work begins before OUT is checked")

    for name in ("agent_00", "agent_01"):
        write_rendered(tmp_path / "town" / name, make_scene(), "stereo")
    monkeypatch.setattr(FolderReader, "open", read_too_early)
    monkeypatch.setattr("maslam.tools.worlds.dataset.load_open3d", read_too_early)
    monkeypatch.chdir(tmp_path)
    (tmp_path / "ud").mkdir()
    (tmp_path / "ud" / "thesis.tex").write_text("years of work")
    (tmp_path / "out.txt").write_text("a note")
    return tmp_path / "town"


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ("slam town ud", "ud: exists and is not an earlier run; choose another folder"),
        ("demo --out ud", "ud: exists and is not an earlier run; choose another folder"),
        ("run seqs ud", "ud: exists and is not an earlier run; choose another folder"),
        ("preprocess town ud", "ud: not empty, and no folder of agent sequences"),
        ("slam town town", "town: is the folder of the images; choose another folder for the results"),
        ("preprocess town ./town/", "town: is the folder of the images; choose another folder for the results"),
        (
            "slam town town/agent_00",
            "town/agent_00: would be read as an agent of town; choose another folder for the results",
        ),
        (
            "preprocess town town/agent_07",
            "town/agent_07: would be read as an agent of town; choose another folder for the results",
        ),
        (
            "slam town/agent_00 town/agent_00/image_0",
            "town/agent_00/image_0: exists and is not an earlier run; choose another folder",
        ),
        (
            "preprocess town/agent_00 town/agent_00/image_0",
            "town/agent_00/image_0: not empty, and no folder of agent sequences",
        ),
        ("slam town out.txt", "out.txt: is a file, not a folder"),
        ("preprocess town out.txt", "out.txt: is a file, not a folder"),
        ("run seqs out.txt", "out.txt: is a file, not a folder"),
        ("demo --out out.txt", "out.txt: is a file, not a folder"),
    ],
)
def test_out_is_checked_before_the_work(words: str, said: str, town: Path, capsys: pytest.CaptureFixture[str]) -> None:
    before = sorted(town.parent.rglob("*"))
    assert cli.main([*words.split(), "--quiet"]) == 1
    assert capsys.readouterr().err == f"maslam: {said}\n"
    assert sorted(town.parent.rglob("*")) == before


def test_python_refuses_the_same(town: Path) -> None:
    with pytest.raises(maslam.MaslamError, match="ud: exists and is not an earlier run"):
        maslam.slam("town", "ud")
    with pytest.raises(maslam.MaslamError, match="ud: exists and is not an earlier run"):
        maslam.run("town", "ud")
    with pytest.raises(maslam.MaslamError, match="agent_00: would be read as an agent"):
        maslam.slam("town", "town/agent_00")
    assert [path.name for path in Path("ud").iterdir()] == ["thesis.tex"]


def test_a_new_folder_beside_the_images_is_free(tmp_path: Path) -> None:
    write_rendered(tmp_path / "drive", make_scene(), "stereo")
    check_apart(tmp_path / "drive", tmp_path / "drive" / "out")


def test_an_earlier_run_an_empty_folder_and_what_a_command_left_are_free(tmp_path: Path) -> None:
    check_out(tmp_path / "new")
    check_out(tmp_path)
    (tmp_path / "sequences").mkdir()
    check_out(tmp_path)  # slam was interrupted
    (tmp_path / SUMMARY).write_text("{}")
    (tmp_path / "notes.txt").write_text("mine, beside an earlier run")
    check_out(tmp_path)


def test_a_run_may_be_written_to_where_one_stands(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    here = tmp_path / "here"
    here.mkdir()
    monkeypatch.chdir(here)
    with Recorder(Path()):
        pass
    assert (here / "traffic.csv").is_file()
    assert [path.name for path in tmp_path.iterdir()] == ["here"]
