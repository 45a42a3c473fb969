"""``maslam inspect`` on positions (GPS) beside the images: what a run would take, and what it would refuse."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "frontend"))
from dataset_makers import make_scene, write_rendered

from maslam.tools.cli import main
from maslam.tools.inspection.command import inspect_dataset

SCENE = make_scene()
FIRST_NS = int(SCENE.stamps_ns[0])


def write_gps(folder: Path, late_s: float = 0.0, head: str = "time,lat,lon,alt", row: str = "47.5,8.25,400") -> None:
    """Seven fixes, 50 ms apart as the six images are, the first so long after the first image."""
    stamps = [FIRST_NS + round(late_s * 1e9) + 50_000_000 * i for i in range(7)]
    rows = "".join(f"{stamp // 10**9}.{stamp % 10**9:09d},{row}\n" for stamp in stamps)
    (folder / "gps.csv").write_text(f"{head}\n{rows}")


def refused_by_a_run(source: Path, out: Path, capsys: pytest.CaptureFixture[str]) -> str:
    """What ``maslam slam`` says where it stops."""
    assert main(["slam", str(source), str(out), "--quiet"]) == 1
    return capsys.readouterr().err


def test_count_and_span_are_shown(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_rendered(tmp_path, SCENE, "stereo")
    assert main(["inspect", str(tmp_path)]) == 0
    assert "  positions " not in capsys.readouterr().out
    write_gps(tmp_path, -0.05)
    assert main(["inspect", str(tmp_path)]) == 0
    span = f"{FIRST_NS / 1e9 - 0.05:.3f} to {FIRST_NS / 1e9 + 0.25:.3f} s, in degrees"
    line = f"6 of 7 positions in gps.csv while images are, {span}"
    assert f"  positions     {line}\n" in capsys.readouterr().out
    assert main(["inspect", str(tmp_path), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["sequences"][0]["positions"] == line


@pytest.mark.parametrize(
    ("late_s", "head", "row", "words"),
    [
        (1e6, "time,lat,lon,alt", "47.5,8.25,400", "but images"),
        (0.0, "time,lat,lon,alt", "97.5,8.25,400", "latitude 97.5"),
        (0.0, "time,lat,lon,alt", "47.5,east,400", "gps.csv:2"),
        (0.0, "a,b,c,d", "47.5,8.25,400", "gps.csv"),
    ],
)
def test_what_a_run_refuses_is_an_error_in_the_same_words(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], late_s: float, head: str, row: str, words: str
) -> None:
    source = tmp_path / "drive"
    write_rendered(source, SCENE, "stereo")
    write_gps(source, late_s, head, row)
    assert main(["inspect", str(source)]) == 1
    [error] = [line for line in capsys.readouterr().out.splitlines() if "  ERROR " in line]
    message = error.removeprefix("  ERROR    ")
    assert words in message and message in refused_by_a_run(source, tmp_path / "out", capsys)


def test_each_robot_has_its_own_and_one_frame_serves_all(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    source = tmp_path / "team"
    for name in ("alice", "bob", "carol"):
        write_rendered(source / name, SCENE, "stereo")
    write_gps(source / "alice")
    report = inspect_dataset(source)
    assert [one.positions[:6] for one in report.sequences] == ["6 of 7", "", ""] and not report.errors
    write_gps(source / "bob", 0.0, "time,east,north,up", "1,2,3")
    [problem] = inspect_dataset(source).problems
    assert problem.severity == "error" and "positions in degrees and in metres" in problem.message
    assert problem.message in refused_by_a_run(source, tmp_path / "out", capsys)
    write_gps(source / "bob", 1e6)
    alice, bob, carol = inspect_dataset(source).sequences
    assert not alice.problems and not carol.problems
    assert f"{source / 'bob' / 'gps.csv'}: positions" in bob.problems[0].message


def test_a_track_under_another_name_is_said_and_a_usual_one_read(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write_rendered(tmp_path, SCENE, "stereo")
    day = "2014-06-25T16:54:34."  # the images' second
    point = '<trkpt lat="47.5" lon="8.25"><ele>400</ele><time>{}</time></trkpt>'
    points = "".join(point.format(f"{day}{312 + 50 * i:03d}Z") for i in range(6))
    (tmp_path / "track.gpx").write_text(f"<gpx><trk><trkseg>{points}</trkseg></trk></gpx>")
    assert main(["inspect", str(tmp_path)]) == 0
    assert "track.gpx is not read: call it gps.gpx, or give --gps FILE" in capsys.readouterr().out
    (tmp_path / "track.gpx").rename(tmp_path / "gps.gpx")
    [report] = inspect_dataset(tmp_path).sequences
    assert report.positions.startswith("5 of 6 positions in gps.gpx"), "the first is a fraction of a millisecond early"
