"""``maslam render --poses``: short ways are rendered, and another file under the same name is another way."""

import cv2
import numpy as np
import pytest

from maslam.tools import cli


def way(path, step_m, count, turn_deg=0.0):
    lines = []
    for k in range(count):
        a = np.deg2rad(turn_deg) * k
        lines.append(f"{np.cos(a)} 0 {np.sin(a)} 0 0 1 0 0 {-np.sin(a)} 0 {np.cos(a)} {step_m * k}")
    path.write_text("\n".join(lines) + "\n")


def rendered(tmp_path, out):
    words = ["render", str(tmp_path / out), "--poses", str(tmp_path / "way.txt"), "--agents", "1", "--frames", "4"]
    return cli.main([*words, "--size", "64x48", "--rig", "mono", "--workers", "1", "--quiet"])


@pytest.mark.parametrize(("step_m", "turn_deg"), [(0.0, 5.0), (0.5, 0.0), (2.0, 0.0), (4.0, 0.0)])
def test_a_short_way_is_rendered(tmp_path, capsys, step_m, turn_deg):
    way(tmp_path / "way.txt", step_m, 4, turn_deg)
    assert rendered(tmp_path, "out") == 0, capsys.readouterr().err
    images = [cv2.imread(str(path)) for path in sorted((tmp_path / "out" / "agent_00" / "image_0").iterdir())]
    assert len(images) == 4 and all(image.std() > 5 for image in images)


def test_what_cannot_be_driven_leaves_nothing_behind(tmp_path, capsys):
    way(tmp_path / "way.txt", 50.0, 4)
    assert rendered(tmp_path, "out") == 1
    assert "at most 12 m can be driven" in capsys.readouterr().err and not (tmp_path / "out").exists()


def test_another_way_under_the_same_name_is_not_taken_for_the_first(tmp_path, capsys):
    way(tmp_path / "way.txt", 2.0, 4)
    assert rendered(tmp_path, "out") == 0 and rendered(tmp_path, "out") == 0
    way(tmp_path / "way.txt", 3.0, 4)
    assert rendered(tmp_path, "out") == 1
    assert "other settings (poses_sha256)" in capsys.readouterr().err


def test_fewer_poses_than_frames_are_said(tmp_path, capsys):
    way(tmp_path / "way.txt", 2.0, 3)
    assert rendered(tmp_path, "out") == 0
    said = capsys.readouterr().err
    assert f"{tmp_path / 'way.txt'}: 3 poses, fewer than --frames 4: 3 frames are rendered" in said
    assert len(list((tmp_path / "out" / "agent_00" / "image_0").iterdir())) == 3
    way(tmp_path / "way.txt", 2.0, 4)
    assert rendered(tmp_path, "enough") == 0 and "fewer" not in capsys.readouterr().err
