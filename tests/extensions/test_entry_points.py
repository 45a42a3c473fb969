"""Extensions that another package offers: found by name on the command line and in Python, named in what is written."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
import yaml
from factory import town
from test_contracts import write_csv_dataset

import maslam
from maslam.descriptors.choice import load_descriptor
from maslam.extensions import ExtensionGroup, installed, load_extension, name_of
from maslam.mas.policies.presets import preset
from maslam.mas.simulation import run
from maslam.tools import cli

EXAMPLES = Path(__file__).resolve().parents[2] / "examples"
ENTRY_POINTS = """
[maslam.policies]
likeliest = foreign_package.policy:AskTheLikeliest
nobody = foreign_package.policy:there_is_no_such_thing
number = foreign_package:NUMBER
[maslam.datasets]
csv = foreign_package.dataset:CsvReader
[maslam.descriptors]
edge-map = foreign_package.descriptor:EdgeMap
[maslam.transports]
plain = foreign_package:transport
"""
PACKAGE = """
from maslam.mas.transport.transport import InProcessTransport
NUMBER = 7
def transport():
    return InProcessTransport()
"""


@pytest.fixture(autouse=True)
def foreign_package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A package of somebody else's, installed: the classes of the examples under four entry points."""
    site = tmp_path / "site"
    (site / "foreign_package").mkdir(parents=True)
    (site / "foreign_package" / "__init__.py").write_text(PACKAGE)
    for name, example in (
        ("policy", "02_own_policy"),
        ("descriptor", "03_own_descriptor"),
        ("dataset", "04_own_dataset"),
    ):
        (site / "foreign_package" / f"{name}.py").write_text((EXAMPLES / f"{example}.py").read_text())
    info = site / "foreign_package-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: foreign-package\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text(ENTRY_POINTS)
    monkeypatch.syspath_prepend(str(site))


def one_line(capsys: pytest.CaptureFixture[str]) -> str:
    return capsys.readouterr().err.splitlines()[-1]


def test_what_is_installed_is_listed_without_being_imported() -> None:
    assert installed(ExtensionGroup.POLICIES) == ("likeliest", "nobody", "number")
    assert installed(ExtensionGroup.DATASETS) == ("csv",)


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("likeliset", "there is no policy 'likeliset'; did you mean 'likeliest'?"),
        ("zzz", "there is no policy 'zzz'; there are clustered, directory, likeliest, logic, nobody, number"),
        ("my_script:Mine", "policy 'my_script:Mine' was an object in Python: give it again"),
    ],
)
def test_an_unknown_name_is_one_line(name: str, said: str, capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    assert cli.main(["run", str(tmp_path), str(tmp_path / "out"), "--policy", name]) == 2
    assert said in one_line(capsys)


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("--dataset", "kiti"), "there is no dataset reader 'kiti'; did you mean 'kitti'?"),
        (("--dataset", "csw"), "did you mean 'csv'?"),
    ],
)
def test_an_unknown_reader_is_one_line(
    words: tuple[str, ...], said: str, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    assert cli.main(["preprocess", str(tmp_path), str(tmp_path / "out"), *words]) == 2
    assert said in one_line(capsys)


def test_an_unknown_descriptor_is_one_line() -> None:
    with pytest.raises(maslam.MaslamError, match=r"there is no descriptor 'edge-mpa'; did you mean 'edge-map'\?"):
        load_descriptor("edge-mpa")


def test_what_cannot_be_imported_or_is_something_else_says_whose_it_is() -> None:
    with pytest.raises(maslam.MaslamError, match=r"maslam\.policies: 'nobody' of foreign-package cannot be imported"):
        load_extension(ExtensionGroup.POLICIES, "nobody")
    manifest, sequences = town(2, 6)
    with pytest.raises(maslam.MaslamError, match="policy number: a int, not derived from"):
        run(manifest, sequences, preset("maslam").model_copy(update={"policy": "number"}), Path("never"))


def test_two_packages_with_one_name_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    info = tmp_path / "second" / "second_package-1.0.dist-info"
    info.mkdir(parents=True)
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: second-package\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text("[maslam.datasets]\ncsv = second_package:Reader\n")
    monkeypatch.syspath_prepend(str(tmp_path / "second"))
    with pytest.raises(maslam.MaslamError, match="both foreign-package and second-package offer 'csv'"):
        load_extension(ExtensionGroup.DATASETS, "csv")


def test_policy_and_transport_by_name_do_what_the_objects_do(tmp_path: Path) -> None:
    from foreign_package.policy import AskTheLikeliest  # type: ignore[import-not-found]

    manifest, sequences = town(3, 14, spacing_m=7.0)
    named = preset("maslam").model_copy(update={"policy": "likeliest", "transport": "plain"})
    run(manifest, sequences, named, tmp_path / "named")
    run(manifest, sequences, preset("maslam"), tmp_path / "given", policy=AskTheLikeliest())
    for name in ("traffic.csv", "matches.csv"):
        assert (tmp_path / "named" / name).read_bytes() == (tmp_path / "given" / name).read_bytes(), name
    summaries = [json.loads((tmp_path / name / "summary.json").read_text()) for name in ("named", "given")]
    assert [s.pop("policy") for s in summaries] == ["likeliest", "foreign_package.policy:AskTheLikeliest"]
    assert summaries[0] == summaries[1]
    settings = [yaml.safe_load((tmp_path / name / "config.yaml").read_text()) for name in ("named", "given")]
    assert [s["policy"] for s in settings] == ["likeliest", "foreign_package.policy:AskTheLikeliest"]
    assert [s["transport"] for s in settings] == ["plain", "in_process"]
    assert maslam.Run.load(tmp_path / "given").config.policy == name_of(AskTheLikeliest())


def test_a_reader_and_a_descriptor_by_name(tmp_path: Path, town_stereo: Path) -> None:
    source = tmp_path / "recording"
    source.mkdir()
    write_csv_dataset(source)
    assert maslam.open_dataset(source).kind == "csv", "before the reader that takes any folder of images"
    assert maslam.open_dataset(source, dataset="csv").kind == "csv"
    words = ["preprocess", str(town_stereo / "agent_00"), str(tmp_path / "seqs"), "--quiet", "--workers", "1"]
    assert cli.main([*words, "--model", "edge-map", "--dataset", "images", "--rig", "mono"]) == 0
    manifest = json.loads((tmp_path / "seqs" / "manifest.json").read_text())
    assert (manifest["kind"], manifest["descriptor"]["name"]) == ("images", "edge-map")
    assert (manifest["settings"]["model"], manifest["settings"]["dataset"]) == ("edge-map", "images")
