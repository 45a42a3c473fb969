"""Key-frames without texture: nobody is asked about them, nobody is answered with them, no loop is closed on them."""

from __future__ import annotations

import csv
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from factory import town

from maslam.mas.policies.presets import preset
from maslam.mas.simulation import run


@pytest.mark.parametrize("flat", ["all", "every other"])
def test_images_without_texture_are_no_candidates(tmp_path: Path, flat: str) -> None:
    manifest, sequences = town(2, 30, spacing_m=10.0)
    flags = [
        np.arange(len(s.places)) % 2 == 0 if flat == "every other" else np.zeros(len(s.places), bool) for s in sequences
    ]
    gated = [replace(s, places=replace(s.places, textured=f)) for s, f in zip(sequences, flags, strict=True)]
    whole = run(manifest, sequences, preset("default"), tmp_path / "whole")
    summary = run(manifest, gated, preset("default"), tmp_path / "gated")
    with open(tmp_path / "gated" / "matches.csv", newline="") as file:
        rows = list(csv.DictReader(file))
    assert whole.matches.candidates > 0
    assert (summary.matches.candidates == 0) == (flat == "all")
    assert len(rows) == summary.matches.candidates
    for row in rows:
        for side in ("query", "match"):
            assert flags[int(row[f"{side}_agent"])][int(row[f"{side}_keyframe"])]
    asked = summary.traffic["dvpr"].payload_bytes / whole.traffic["dvpr"].payload_bytes
    assert asked == pytest.approx({"all": 0.0, "every other": 0.5}[flat], abs=0.02)
