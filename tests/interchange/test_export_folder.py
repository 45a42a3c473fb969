"""What is refused, in one line and before anything is written; what is replaced, and what is never half there."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pytest

import maslam
from maslam.backend.geometry import so3_exp
from maslam.mas.manifest import CameraEntry, StoredCameraEntry
from maslam.mas.output.stored_camera import stored_pixels
from maslam.tools import cli
from maslam.tools.interchange.rectified_pixels import rectified_pixels


def call(capsys: pytest.CaptureFixture[str], *words: object) -> tuple[int, str]:
    code = cli.main(["export", *map(str, words), "--quiet"])
    return code, capsys.readouterr().err


def test_other_peoples_files_stay_and_an_earlier_export_is_replaced_only_on_request(
    finished: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    full, out = tmp_path / "full", tmp_path / "out"
    full.mkdir()
    (full / "thesis.tex").write_text("years")
    code, said = call(capsys, finished, full, "--for", "evo", "--overwrite")
    assert code == 1 and said == f"maslam: {full}: holds other files; choose a new folder\n"
    assert [p.name for p in full.iterdir()] == ["thesis.tex"]
    assert call(capsys, finished, out, "--for", "evo")[0] == 0
    code, said = call(capsys, finished, out, "--for", "tf")
    assert code == 1 and said == f"maslam: {out}: holds an earlier export; --overwrite replaces it\n"
    assert (out / "agent_00.tum").is_file()
    assert call(capsys, finished, out, "--for", "tf", "--overwrite")[0] == 0
    assert sorted(p.name for p in out.iterdir()) == ["export.json", "tf.csv", "tf.jsonl"]
    code, said = call(capsys, finished, finished, "--for", "evo", "--overwrite")
    assert code == 1 and "is the run itself" in said and (finished / "summary.json").is_file()
    assert sorted(p.name for p in tmp_path.iterdir()) == ["full", "out"], "nothing aside is left"


def test_an_export_that_fails_leaves_nothing(
    finished: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    from maslam.tools.interchange import reconstruction

    def stopped(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(reconstruction, "write_transforms", stopped)
    assert call(capsys, finished, tmp_path / "new" / "out", "--for", "colmap")[0] == 130
    assert list(tmp_path.iterdir()) == []


def test_images_that_have_moved_are_named_and_found_again(
    finished: Path, town_stereo: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run, moved = tmp_path / "run", tmp_path / "moved"
    shutil.copytree(finished, run)
    manifest = json.loads((run / "manifest.json").read_text())
    manifest["source"] = str(tmp_path / "gone")
    (run / "manifest.json").write_text(json.dumps(manifest))
    code, said = call(capsys, run, tmp_path / "out", "--for", "colmap")
    assert code == 1 and f"{tmp_path / 'gone'}: no such folder" in said and "--images DIR" in said
    assert said.count("\n") == 1
    assert call(capsys, run, tmp_path / "poses", "--for", "evo")[0] == 0, "trajectories need no images"
    shutil.copytree(town_stereo, moved)
    code, _ = call(capsys, run, tmp_path / "out", "--for", "colmap", "--images", moved)
    assert code == 0 and (tmp_path / "out" / "images" / "agent_01").is_dir()
    (moved / "agent_01" / "image_0" / "000000.png").write_bytes(b"no image")
    code, said = call(capsys, run, tmp_path / "again", "--for", "colmap", "--images", moved)
    assert code == 1 and "000000.png" in said and not (tmp_path / "again").exists()


def test_images_of_another_camera_or_another_time_are_refused(
    finished: Path, town_stereo: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for name, file, old, new, words in (
        ("camera", "camera.yaml", "fx: 177.698", "fx: 178.698", "with fx 178.698, but the run was made with 320x180"),
        ("time", "times.txt", "", "0.0371", "no image of agent_00 at"),
    ):
        other = tmp_path / name
        shutil.copytree(town_stereo, other)
        path = other / "agent_00" / file
        if old:
            path.write_text(path.read_text().replace(old, new))
        else:
            path.write_text("".join(f"{float(t) + float(new):.6f}\n" for t in path.read_text().split()))
        code, said = call(capsys, finished, tmp_path / "out", "--for", "colmap", "--images", other)
        assert code == 1 and words in said and said.count("\n") == 1
        assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("words", "code", "said"),
    [
        (("--for", "colmap", "--agent", "7"), 2, "--agent 7: "),
        (("--for", "evo", "--frames", "all"), 2, "--frames is for colmap, hloc, nerfstudio, gsplat"),
        (("--for", "evo", "--with-images"), 2, "--with-images is for --for mcap"),
        (("--for", "mcap", "--images", "there"), 2, "--images is for colmap, hloc, nerfstudio, gsplat, and mcap"),
        (("--for", "colmop"), 2, "colmap"),
    ],
)
def test_options_that_do_not_fit(
    words: tuple[str, ...], code: int, said: str, finished: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    found, err = call(capsys, finished, tmp_path / "out", *words)
    assert found == code and said in err
    assert list(tmp_path.iterdir()) == []


def test_what_is_no_run_is_said(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    code, said = call(capsys, tmp_path, tmp_path / "out", "--for", "evo")
    assert code == 1 and "summary.json" in said and said.count("\n") == 1


def test_a_damaged_model_is_one_line(finished: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    run = tmp_path / "run"
    shutil.copytree(finished, run)
    path = run / "agent_00" / "maps" / "colmap" / "images.bin"
    path.write_bytes(path.read_bytes()[:1000])
    code, said = call(capsys, run, tmp_path / "out", "--for", "colmap")
    assert code == 1 and "the COLMAP model is damaged" in said and "unexpected" not in said


def test_python_gives_the_commands_files(finished: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    told: list[tuple[str, int, int]] = []
    made = maslam.export(maslam.Run.load(finished), tmp_path / "face", "nerfstudio", progress=lambda *s: told.append(s))
    assert call(capsys, finished, tmp_path / "command", "--for", "nerfstudio")[0] == 0
    files = [
        {p.relative_to(f): p.read_bytes() for p in f.rglob("*") if p.is_file()}
        for f in (tmp_path / "face", tmp_path / "command")
    ]
    assert files[0] == files[1] and len(files[0]) > 10
    assert json.loads((made.folder / "export.json").read_text()) == made.record and told[-1][1] == told[-1][2]
    assert [a["unit"] for a in made.record["models"][0]["agents"]] == ["metres", "metres"]
    with pytest.raises(maslam.MaslamError, match="to: 'colmop': one of colmap"):
        maslam.export(finished, tmp_path / "x", "colmop")  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("lens", "coefficients", "focal"),
    [
        ("none", (), 300.0),
        ("radial-tangential", (-0.3, 0.08, 0.0003, -0.0005, -0.01), 450.0),
        ("radial-tangential", (0.1, -0.02, 0.0003, -0.0005, 0.01, 0.4, 0.02, 0.001), 450.0),
        ("equidistant", (0.02, -0.01, 0.003, -0.0004), 280.0),
    ],
)
def test_pixels_are_undistorted_whatever_the_lens(lens: str, coefficients: tuple[float, ...], focal: float) -> None:
    """The inverse of what OpenCV's maps were compared with: out to 60 degrees through a fisheye."""
    rotation = tuple(so3_exp([0.02, -0.03, 0.01]).ravel().tolist())
    stored = StoredCameraEntry(
        distortion=lens, fx=focal, fy=focal + 5, cx=330, cy=235, coefficients=coefficients, rotation=rotation
    )
    wide = 170.0 if lens == "equidistant" else 420.0
    camera = CameraEntry(kind="mono", width=640, height=480, fx=wide, fy=wide, cx=319.5, cy=239.5, stored=stored)
    u, v = np.meshgrid(np.linspace(0, 639, 23), np.linspace(0, 479, 17))
    uv = np.column_stack([u.ravel(), v.ravel()])
    np.testing.assert_allclose(rectified_pixels(stored_pixels(uv, camera), camera), uv, atol=1e-2)
