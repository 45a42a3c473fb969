"""``maslam inspect`` on data sets with known content and known faults."""

from __future__ import annotations

import sys
from pathlib import Path

import cv2
import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "frontend"))
from dataset_makers import make_scene, own_camera, write_euroc, write_kitti, write_rendered

from maslam.tools.cli import main
from maslam.tools.inspection.command import inspect_dataset


def test_what_is_there(tmp_path: Path) -> None:
    scene = make_scene()
    write_kitti(tmp_path, scene)
    report = inspect_dataset(tmp_path)
    [sequence] = report.sequences
    steps = np.linalg.norm(np.diff(scene.poses[:, :3, 3], axis=0), axis=1)
    assert (report.kind, sequence.frames, sequence.decoded, report.errors, report.warnings) == ("kitti", 6, 6, 0, 0)
    assert sequence.rate_hz == pytest.approx(20.0) and sequence.duration_s == pytest.approx(0.25)
    assert sequence.path_length_m == pytest.approx(steps.sum())
    text = "\n".join(report.lines())
    for part in (
        "1 sequence, 6 frames",
        "stereo, baseline 0.2500 m; scale metric",
        "96x64 px, fx 80.00",
        f"6 poses, {steps.sum():.1f} m of path, at 6 of 6 frames",
        "0 errors, 0 warnings",
    ):
        assert part in text


def test_every_fault_is_listed(tmp_path: Path) -> None:
    write_rendered(tmp_path / "agent_0", make_scene(), "stereo")
    write_rendered(tmp_path / "agent_1", make_scene(), "rgbd")
    (tmp_path / "agent_0/image_1/000002.png").unlink()
    bad = tmp_path / "agent_1/image_0/000004.png"
    bad.write_bytes(bad.read_bytes()[:100])
    (tmp_path / "agent_1/poses.txt").unlink()
    report = inspect_dataset(tmp_path, decode_all=True)
    assert [len(sequence.problems) for sequence in report.sequences] == [1, 1] and report.errors == 2
    text = "\n".join(report.lines())
    assert (
        "ERROR" in text
        and "000002.png: the right image is missing" in text
        and "000004.png: the image is cut off after 100 bytes" in text
    )
    assert "ground truth  none" in text
    (tmp_path / "agent_2").mkdir()
    report = inspect_dataset(tmp_path)
    assert len(report.sequences) == 2 and report.errors == 2 + (report.sequences[1].decoded == 6)
    assert "agent_2: no images of a known layout" in "\n".join(report.lines())


def test_a_sample_is_decoded_or_all(tmp_path: Path) -> None:
    scene = make_scene()
    write_euroc(tmp_path, scene)
    assert inspect_dataset(tmp_path).sequences[0].rectified_here
    from maslam.tools.checks.findings import samples_of

    sequence = inspect_dataset(tmp_path, decode_all=True).sequences[0]
    assert sequence.decoded == 6 and len(samples_of(100)) >= 2


def test_the_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_kitti(tmp_path, make_scene())
    assert main(["inspect", str(tmp_path), "--rig", "mono", "--all"]) == 0
    assert "mono; scale arbitrary" in capsys.readouterr().out
    (tmp_path / "image_1/000002.png").unlink()
    assert main(["inspect", str(tmp_path)]) == 1
    assert "1 error," in capsys.readouterr().out
    (tmp_path / "empty").mkdir()
    assert main(["inspect", str(tmp_path / "empty")]) == 1
    printed = capsys.readouterr()
    assert printed.out == "" and printed.err.count("\n") == 1 and "no images" in printed.err


def test_depth_of_another_size_is_one_line_with_the_count(tmp_path: Path) -> None:
    scene = make_scene()
    write_rendered(tmp_path, scene, "rgbd")
    for path in (tmp_path / "depth_0").iterdir():
        assert cv2.imwrite(str(path), scene.depth_mm[0, ::2, ::2])
    [sequence] = inspect_dataset(tmp_path).sequences
    [line] = [problem.message for problem in sequence.problems if problem.severity == "error"]
    assert line == (
        f"{tmp_path / 'depth_0' / '000000.png'}: 48x32 pixels, but this sequence has 96x64; resize depth that is "
        "registered to the image, by the nearest pixel (and 5 more of 6 looked at)"
    )


def test_paths_are_named_as_the_user_wrote_them(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    for name in ("Alice", "Bob"):
        write_rendered(tmp_path / "team" / name, make_scene(), "stereo")
        (tmp_path / "team" / name / "camera.yaml").unlink()
    (tmp_path / "team" / "camera.yaml").write_text(own_camera("rate_hz: 20.0\nbaseline_m: 0.25\n"))
    write_euroc(tmp_path / "drone", make_scene())
    (tmp_path / "drone/mav0/state_groundtruth_estimate0/data.csv").unlink()
    (tmp_path / "drone/groundtruth.tum").write_text("nothing\n")
    monkeypatch.chdir(tmp_path)
    for source, file in (("team", "team/camera.yaml: taken"), ("drone", "drone/groundtruth.tum:")):
        main(["inspect", source])
        said = capsys.readouterr().out
        assert file in said and str(tmp_path) not in said
    monkeypatch.chdir(tmp_path / "team/Alice")
    main(["inspect", "."])
    said = capsys.readouterr().out
    assert "../camera.yaml: taken as the calibration of Alice" in said and str(tmp_path) not in said
