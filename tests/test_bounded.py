"""Files that are damaged, or made to fill the memory, end in a few words."""

import io
import json
import zipfile

import numpy as np
import pytest

from maslam._bounded import Unreadable, load_json, load_yaml, open_npz, read_text
from maslam.descriptors.container import PlaceVectors
from maslam.descriptors.errors import DescriptorError
from maslam.frontend.cameras.calibration_files import load_fields
from maslam.frontend.errors import FrontendError
from maslam.frontend.vocabulary.vocabulary import Vocabulary
from maslam.mas.errors import MasError
from maslam.mas.manifest import read_manifest
from maslam.tools import cli

LAUGHS = "a: &a [x, x, x, x, x, x, x, x, x]\n" + "".join(
    f"{b}: &{b} [{', '.join([f'*{a}'] * 9)}]\n" for a, b in zip("abcdefgh", "bcdefghi", strict=True)
)


def header_only(shape, dtype="<f8"):
    """An array's head without the numbers that it claims."""
    out = io.BytesIO()
    np.lib.format.write_array_header_1_0(out, {"descr": dtype, "fortran_order": False, "shape": shape})
    return out.getvalue()


def archive(path, **members):
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as out:
        for name, data in members.items():
            out.writestr(f"{name}.npy", data)
    return path


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (LAUGHS, "line 2: .*references within references"),
        ("[" * 5000 + "]" * 5000, "line 1: nested deeper than 40"),
        ("{a: " * 3000, "line 1: nested deeper than 40"),
        ("a: [1\nb: 2", "not YAML"),
        ("a: 2001-99-99", "not YAML"),
        ("a: &a [*a]", "references within references"),
    ],
)
def test_yaml_without_end(tmp_path, capsys, text, said):
    with pytest.raises(Unreadable, match=said):
        load_yaml(text)
    config = tmp_path / "config.yaml"
    config.write_text(text)
    assert cli.main(["run", str(tmp_path), str(tmp_path / "out"), "--config", str(config)]) == 1
    line = capsys.readouterr().err
    assert line.startswith(f"maslam: {config}: ") and len(line.splitlines()) == 1 and "unexpected" not in line


def test_ordinary_yaml_is_read():
    assert load_yaml("base: &b {x: 1}\nmore:\n  <<: *b\n  y: [1, 2]") == {
        "base": {"x": 1},
        "more": {"x": 1, "y": [1, 2]},
    }


def test_other_letters_are_named_by_line(tmp_path, capsys):
    config = tmp_path / "config.yaml"
    config.write_bytes("seed: 1\n# Größe\n".encode("latin-1"))
    with pytest.raises(Unreadable, match="line 2: not UTF-8 text: byte 0xf6"):
        read_text(config)
    assert cli.main(["run", str(tmp_path), str(tmp_path / "out"), "--config", str(config)]) == 1
    assert "config.yaml: line 2: not UTF-8" in capsys.readouterr().err
    with pytest.raises(Unreadable, match="MiB of text"):
        read_text(config, most=3)
    with pytest.raises(Unreadable, match="nested too deep"):
        load_json("[" * 200_000)
    (tmp_path / "manifest.json").write_bytes(b'{"version": "\xff"}')
    with pytest.raises(MasError, match=r"manifest.json: line 1: not UTF-8"):
        read_manifest(tmp_path)
    (tmp_path / "summary.json").write_text("[" * 200_000)
    assert cli.main(["eval", str(tmp_path)]) == 1
    assert "unexpected" not in capsys.readouterr().err


@pytest.mark.parametrize("kind", ["claims", "zeros", "cut", "bytes", "no zip", "empty"])
def test_archives_of_arrays(tmp_path, kind):
    path = tmp_path / "netvlad.npz"
    if kind == "claims":
        archive(path, vectors=header_only((1 << 40,)))
    elif kind == "zeros":
        archive(path, vectors=header_only((300 << 20,), "|u1") + bytes(300 << 20))
    else:
        np.savez(path, vectors=np.arange(1000.0), version=1)
        data = path.read_bytes()
        changed = {"cut": data[:-200], "bytes": data[:300] + bytes(500) + data[800:], "no zip": b"PK", "empty": b""}
        path.write_bytes(changed[kind])
    with pytest.raises(Unreadable, match=r"claims|damaged"), open_npz(path) as stored:
        _ = {name: stored[name] for name in stored.files}
    with pytest.raises(DescriptorError, match=r"netvlad.npz: "):
        PlaceVectors.load(path)
    with pytest.raises(FrontendError, match=r"netvlad.npz: "):
        Vocabulary.load(path)


def test_sound_arrays_are_read(tmp_path):
    path = tmp_path / "a.npz"
    np.savez_compressed(path, a=np.zeros(4 << 20), b=np.arange(5))
    with open_npz(path) as stored:
        assert stored["a"].shape == (4 << 20,) and stored["b"].tolist() == [0, 1, 2, 3, 4]
    assert json.loads("1") == load_json("1")


def test_a_camera_file_without_end(tmp_path, capsys):
    (tmp_path / "images").mkdir()
    (tmp_path / "camera.yaml").write_text(LAUGHS)
    with pytest.raises(FrontendError, match=r"camera\.yaml: .*references"):
        load_fields(tmp_path / "camera.yaml")
    (tmp_path / "camera.yaml").write_text("[" * 50_000)
    with pytest.raises(FrontendError, match=r"camera\.yaml: .*nested"):
        load_fields(tmp_path / "camera.yaml")
