"""Verifications that travel in few bytes: the information as a triangle, points on a grid, few of them first."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
from factory import town

from maslam.mas.config import MasConfig, PlacesConfig
from maslam.mas.policies.presets import preset
from maslam.mas.protocol.tensors import pack_information, unpack_information
from maslam.mas.simulation import run


def test_information_survives_the_wire() -> None:
    rng = np.random.default_rng(0)
    half = rng.normal(size=(6, 8)) * 1e3
    back = unpack_information(pack_information(half @ half.T))
    np.testing.assert_allclose(back, half @ half.T, rtol=1e-6, atol=1.0)
    assert np.array_equal(back, back.T) and np.linalg.eigvalsh(back)[0] > 0


def test_the_rest_is_sent_where_the_first_points_promise_a_match(tmp_path: Path) -> None:
    manifest, sequences = town(2, 24, spacing_m=14.0)
    # So sure that the first points never decide alone.
    places = PlacesConfig(first_points=60, point_code="grid", descriptor_bytes=16, first_evidence=1e6)
    config: MasConfig = preset("default").model_copy(update={"places": places})
    summary = run(manifest, sequences, config, tmp_path)
    plain = run(manifest, sequences, preset("default"), tmp_path / "plain")
    assert summary.matches.accepted >= plain.matches.accepted - 1 > 0
    assert summary.matches.false_accepted == 0
    assert "not verified" not in summary.matches.rejected
    with open(tmp_path / "traffic.csv", newline="") as file:
        tasks = [int(row["payload_bytes"]) for row in csv.DictReader(file) if row["kind"] == "VerifyTask"]
    header, each = 9 + 24, 4 + 16
    first = [n for n in tasks if n == header + 60 * each]
    assert len(first) >= len(tasks) / 2 > 0 and len(first) < len(tasks)
    assert summary.traffic["relpose"].payload_bytes < 0.7 * plain.traffic["relpose"].payload_bytes
