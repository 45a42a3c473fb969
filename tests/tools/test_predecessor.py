"""The predecessor's five files with ``netvlad_feats.bin``: run as they are, or imported."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from maslam.frontend.files.vo_files import VoTrack, write_track
from maslam.mas.sequence import load_sequences
from maslam.tools import cli

DIM, IMAGES, EVERY = 4096, 40, 4


def write_sequence(folder: Path, seed: int) -> None:
    """A straight drive past points of its own, key-frames at every fourth image; all folders see the same places."""
    rng, places = np.random.default_rng(seed), np.random.default_rng(99)
    times = 5.0 + 0.1 * np.arange(IMAGES)
    kept = np.arange(0, IMAGES, EVERY)
    poses = np.tile(np.eye(4), (len(kept), 1, 1))
    poses[:, 2, 3] = 0.5 * kept
    world = np.random.default_rng(7)
    points = world.uniform([-8, -3, 5], [8, 1, 40], (300, 3))
    descriptors = world.integers(0, 256, (300, 32), dtype=np.uint8)
    rows = [
        (k, j)
        for k in range(len(kept))
        for j in np.flatnonzero((points[:, 2] > poses[k, 2, 3] + 2) & (points[:, 2] < poses[k, 2, 3] + 25)).tolist()
    ]
    observed = np.array(rows, dtype=np.int32)
    noisy = points + 0.01 * rng.standard_normal(points.shape)
    words = np.column_stack([observed[:, 1] % 900 + 111, observed[:, 1] + 1111]).astype(np.int32)
    write_track(folder, 0, VoTrack(times[kept], poses, noisy, observed, descriptors[observed[:, 1]], words))
    (folder / "times.txt").write_text("".join(f"{t:.6f}\n" for t in times))
    features = np.zeros((IMAGES, DIM), dtype="<f4")
    features[:, :128] = 0.05 * places.standard_normal((IMAGES, 128)) + 1e-4 * rng.standard_normal((IMAGES, 128))
    features.tofile(folder / "netvlad_feats.bin")


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    for k, name in enumerate(("first", "second")):
        write_sequence(tmp_path / "vo" / name, k)
    return tmp_path / "vo"


def test_a_run_takes_the_folder_as_it_is(folder: Path, tmp_path: Path) -> None:
    assert cli.main(["run", str(folder), str(tmp_path / "run"), "--quiet"]) == 0
    summary = json.loads((tmp_path / "run" / "summary.json").read_text())
    assert summary["agents"] == 2
    assert summary["keyframes"] == 2 * IMAGES // EVERY
    assert summary["matches"]["accepted"] > 0
    # What lies between key-frames was not lost for want of an image.
    kinds = [entry["kinds"] for entry in summary["coverage"][0]["lost"]]
    assert kinds == [{"no key-frame: the five files have no pose of it": EVERY - 1}] * (IMAGES // EVERY)
    _, sequences = load_sequences(tmp_path / "run" / "sequences")
    assert all(one.metric for one in sequences)


def test_an_import_splits_one_sequence(folder: Path, tmp_path: Path) -> None:
    words = [str(folder / "first"), str(tmp_path / "seqs"), "--agents", "2", "--scale", "arbitrary", "--quiet"]
    assert cli.main(["import", *words]) == 0
    manifest, sequences = load_sequences(tmp_path / "seqs")
    assert [entry.keyframes for entry in manifest.agents] == [5, 5]
    assert not any(one.metric for one in sequences)
    # As far apart as the predecessor's rule says of the numbers in the file.
    features = np.fromfile(folder / "first" / "netvlad_feats.bin", dtype="<f4").reshape(-1, DIM)[::EVERY, :128]
    length = float(np.median(np.linalg.norm(features, axis=1)))
    assert manifest.descriptor.strict_threshold == pytest.approx(0.1 / length, rel=1e-3)


@pytest.mark.parametrize(
    ("spoil", "said"),
    [
        (lambda f: (f / "netvlad_feats.bin").write_bytes(b"\0" * 5000), "netvlad_feats.bin: not whole blocks"),
        (lambda f: (f / "times.txt").unlink(), "times.txt: missing"),
        (lambda f: (f / "times.txt").write_text("1\n2\n"), "2 images of 4096 float32"),
        (lambda f: (f / "descs_0.txt").unlink(), "descs_0.txt: missing"),
    ],
)
def test_what_does_not_belong_together_is_named(spoil, said: str, folder: Path, tmp_path: Path, capsys) -> None:  # type: ignore[no-untyped-def]
    spoil(folder / "first")
    assert cli.main(["import", str(folder), str(tmp_path / "seqs"), "--quiet"]) == 1
    assert said in capsys.readouterr().err


def test_an_import_of_other_files_needs_to_be_told_to_overwrite(folder: Path, tmp_path: Path, capsys) -> None:  # type: ignore[no-untyped-def]
    out = str(tmp_path / "seqs")
    assert cli.main(["import", str(folder), out, "--quiet"]) == 0
    assert cli.main(["import", str(folder), out, "--quiet"]) == 0
    assert cli.main(["import", str(folder / "first"), out, "--quiet"]) == 1
    assert "--overwrite" in capsys.readouterr().err
    assert cli.main(["import", str(folder / "first"), out, "--overwrite", "--quiet"]) == 0
    assert len(load_sequences(tmp_path / "seqs")[1]) == 1
