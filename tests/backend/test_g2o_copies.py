"""The same graph twice in a set, packed files, ids beyond 64 bits, and results of other settings in OUT."""

import gzip
import json

import numpy as np
import pytest
from graphs import loops

from maslam.backend.errors import BackendError
from maslam.backend.pose_graph.g2o import read_g2o, write_g2o
from maslam.tools import cli


@pytest.fixture
def plain(tmp_path):
    graph, _ = loops(np.random.default_rng(0), robots=1, length=12)
    write_g2o(tmp_path / "one.g2o", graph, plain_ids=True)
    return tmp_path / "one.g2o"


@pytest.fixture
def robots(tmp_path):
    graph, _ = loops(np.random.default_rng(1), robots=2, length=10)
    (tmp_path / "robots").mkdir()
    for robot in graph.robots:
        write_g2o(tmp_path / "robots" / f"{robot}.g2o", graph.of_robot(robot))
    return tmp_path / "robots"


def test_a_file_given_twice_is_no_second_robot(plain, tmp_path, capsys):
    (tmp_path / "link.g2o").symlink_to(plain)
    for again in (plain, tmp_path / "." / "one.g2o", tmp_path / "link.g2o"):
        with pytest.raises(BackendError, match=r"given twice.*leave one out"):
            read_g2o([plain, again])
    assert cli.main(["pgo", str(plain), str(plain), str(tmp_path / "out")]) == 1
    assert "one.g2o: given twice" in capsys.readouterr().err and not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    "change",
    [
        lambda text: text,
        lambda text: "# a copy\n" + text.replace("\n", "\r\n"),
        lambda text: "\n".join(reversed(text.splitlines())),
        lambda text: text.replace("\n", " \n").replace(" ", "  "),
    ],
)
def test_a_copy_of_a_file_is_said(plain, tmp_path, change):
    (tmp_path / "copy.g2o").write_text(change(plain.read_text()))
    notes = []
    assert len(read_g2o([plain, tmp_path / "copy.g2o"], notes=notes).robots) == 2
    assert "copy.g2o holds the same" in notes[-1] and "one.g2o: taken as robots alike; leave one out" in notes[-1]


def test_another_robot_on_a_like_path_is_one(plain, tmp_path):
    lines = plain.read_text().splitlines()
    (tmp_path / "other.g2o").write_text("\n".join(lines[:-1]))
    notes = []
    assert len(read_g2o([plain, tmp_path / "other.g2o"], notes=notes).robots) == 2 and not notes


def test_symbols_name_robots_in_whichever_file(robots, tmp_path):
    whole = "".join((robots / f"{k}.g2o").read_text() for k in range(2))
    for k in range(2):
        (tmp_path / f"{k}.g2o").write_text(whole)
    both = read_g2o([tmp_path / "0.g2o", tmp_path / "1.g2o"])
    assert len(both.robots) == 2 and len(both.edges) == len(read_g2o(tmp_path / "0.g2o").edges)


def test_packed_files_are_read(plain, robots, tmp_path, capsys):
    text = plain.read_bytes()
    (tmp_path / "packed.g2o.gz").write_bytes(gzip.compress(text[:500]) + gzip.compress(text[500:]))  # of two members
    unpacked = read_g2o(tmp_path / "packed.g2o.gz")
    assert unpacked.nodes == read_g2o(plain).nodes and len(unpacked.edges) == len(read_g2o(plain).edges)
    for path in robots.glob("*.g2o"):
        (robots / f"{path.name}.gz").write_bytes(gzip.compress(path.read_bytes()))
        path.unlink()
    assert cli.main(["pgo", str(robots), str(tmp_path / "out"), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["robots"] == 2
    assert cli.main(["pgo", str(plain), str(tmp_path / "result.g2o.gz")]) == 2
    assert "OUT is written without compression" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("data", "said"),
    [
        (gzip.compress(b"VERTEX_SE2 0 0 0 0\n", mtime=0)[:-3], "gzip file is cut off"),
        (gzip.compress(b"VERTEX_SE2 0 0 0 0\n", mtime=0)[:10] + b"\xff" * 20, "damaged gzip file"),
    ],
    ids=["cut off", "damaged"],
)
def test_damaged_packed_files_are_named(tmp_path, data, said):
    (tmp_path / "bad.g2o.gz").write_bytes(data)
    with pytest.raises(BackendError, match=f"bad.g2o.gz: {said}"):
        read_g2o(tmp_path / "bad.g2o.gz")


def test_what_unpacks_without_end_is_refused(tmp_path, monkeypatch):
    from maslam.backend.pose_graph import g2o_lines

    monkeypatch.setattr(g2o_lines, "_MOST_BYTES", 1000)
    (tmp_path / "bomb.g2o").write_bytes(gzip.compress(b"\n" * 5000))
    with pytest.raises(BackendError, match=r"bomb.g2o: more than .* when unpacked"):
        read_g2o(tmp_path / "bomb.g2o")


@pytest.mark.parametrize("number", [2**64, 99999999999999999999])
def test_an_id_beyond_64_bits_is_named_with_its_line(tmp_path, number):
    (tmp_path / "big.g2o").write_text(f"VERTEX_SE2 0 0 0 0\nVERTEX_SE2 {number} 1 0 0\n")
    with pytest.raises(BackendError, match=f"big.g2o:2: {number} is not a node id: it is beyond 64 bits"):
        read_g2o(tmp_path / "big.g2o")
    (tmp_path / "largest.g2o").write_text(f"VERTEX_SE2 0 0 0 0\nVERTEX_SE2 {2**64 - 1} 1 0 0\n")
    assert len(read_g2o(tmp_path / "largest.g2o").nodes) == 2


def test_a_result_of_other_settings_or_files_is_not_replaced_unasked(robots, plain, tmp_path, capsys):
    out = tmp_path / "out"
    words = ["pgo", str(robots), str(out), "--quiet"]
    assert cli.main(words) == 0
    before = (out / "0.g2o").read_bytes()
    assert cli.main(words) == 0 and (out / "0.g2o").read_bytes() == before
    capsys.readouterr()
    for more, name in (
        (["--method", "central"], "method"),
        (["--weights", "unit"], "weights"),
        (["--robust", "pcm"], "robust"),
        (["--solver.elected-fineness", "300"], "solver.elected_fineness"),
        (["--skip-broken-lines"], "skip_broken_lines"),
    ):
        assert cli.main([*words, *more]) == 1
        said = capsys.readouterr().err
        assert f"holds a result with other settings ({name}" in said and "replace it with --overwrite" in said
    assert cli.main(["pgo", str(plain), str(out)]) == 2
    assert "holds a result of" in capsys.readouterr().err
    assert (out / "0.g2o").read_bytes() == before
    assert cli.main([*words, "--method", "central", "--overwrite"]) == 0
    assert json.loads((out / "summary.json").read_text())["settings"]["method"] == "central"


def test_a_result_of_an_earlier_version_has_no_settings_to_compare(robots, tmp_path):
    out = tmp_path / "out"
    assert cli.main(["pgo", str(robots), str(out)]) == 0
    summary = json.loads((out / "summary.json").read_text())
    del summary["settings"]
    (out / "summary.json").write_text(json.dumps(summary))
    assert cli.main(["pgo", str(robots), str(out), "--method", "central"]) == 0
